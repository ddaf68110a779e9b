"""The weights of a run that did best on validation scenes: they act, whatever training did to the model afterwards."""

from __future__ import annotations

from io import BytesIO
from pathlib import Path

import torch

from clutter_env.reporting.files import write_atomically

__all__ = ["consider", "forget_chosen", "put_chosen"]

_FILE = "chosen.pt"


def consider(actor: torch.nn.Module, success: float, directory: Path) -> bool:
    """Keep an actor's weights in a run's directory, if it did better than the one kept there; whether it is kept.

    Args:
        actor: to be kept.
        success: on the validation scenes, the same for all actors of the run. At equal success the earlier one stays.
        directory: of the run.

    Raises:
        OSError: the disk is full or cannot be written; the one kept before stays.
    """
    path = directory / _FILE
    if path.exists() and success <= torch.load(path, weights_only=True)["success"]:
        return False
    content = BytesIO()
    torch.save({"success": success, "actor": actor.state_dict()}, content)
    write_atomically(path, content.getvalue())
    return True


def put_chosen(actor: torch.nn.Module, directory: Path) -> None:
    """Give an actor the weights kept in a run's directory; a run that chooses none leaves the actor as it is."""
    path = directory / _FILE
    if path.exists():
        actor.load_state_dict(torch.load(path, weights_only=True)["actor"])


def forget_chosen(directory: Path) -> None:
    """Keep no weights in the directory any more: a run begins there anew."""
    (directory / _FILE).unlink(missing_ok=True)
