"""The network behind a keyframe mover, and its file."""

from __future__ import annotations

from collections.abc import Sequence
from io import BytesIO
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from clutter_env.learning.errors import DatasetError
from clutter_env.learning.keyframes.features import NUM_FEATURES
from clutter_env.learning.keyframes.ground import Ground
from clutter_env.learning.keyframes.phases import NUM_PHASES, phase_index
from clutter_env.learning.regression.perceptron import perceptron
from clutter_env.reporting.files import write_atomically

__all__ = ["KeyframeNetwork", "Prediction", "load_arrays", "save_arrays"]

_SIZES = (3, 8, 3, 1, 1)
"""Numbers in each part of a `Prediction`."""
_FINGER, _LENGTH = 0.01, 0.05
"""[m] of finger position, and of offset and line length, that are one unit of an output."""


class Prediction(NamedTuple):
    """Of k situations.

    Attributes:
        base: (k, 3) where the base is to stand, in its frame at the contact: x, y [m], yaw [rad].
        q: (k, 8) torso [m] and arm [rad].
        offset: (k, 3) [m] of the TCP from the contact, in the contact's frame.
        finger: (k,) [m] position of one finger.
        length: (k,) [m] of the straight line.
        excess: (k,) by how much the joints were clipped to their limits, [m] and [rad] together.
    """

    base: torch.Tensor
    q: torch.Tensor
    offset: torch.Tensor
    finger: torch.Tensor
    length: torch.Tensor
    excess: torch.Tensor


class KeyframeNetwork(nn.Module):
    """From the features of a situation to the keyframe that it leads to.

    Attributes:
        home: (8,) configuration that the output is added to.
        lower, upper: (8,) limits of the joints, which the output keeps.
        seen: (p,) flags of the phases that the demonstrations show.
        is_under_board: whether it drives in to contacts under a board, and out again; see `boards`.
        shown: (m, 7) contacts and postures demonstrated under a board, see `shown_postures`; none in the open.
        closed: (2, 2) lowest and highest x and y [m] of the ground that no demonstrated drive enters, see `Ground`.
    """

    home: torch.Tensor
    lower: torch.Tensor
    upper: torch.Tensor
    seen: torch.Tensor
    closed: torch.Tensor
    shown: torch.Tensor

    def __init__(
        self,
        home: Sequence[float],
        lower: Sequence[float],
        upper: Sequence[float],
        width: int = 128,
        is_under_board: bool = False,
    ) -> None:
        super().__init__()
        self.is_under_board = is_under_board
        for name, values in (("home", home), ("lower", lower), ("upper", upper)):
            self.register_buffer(name, torch.tensor(values, dtype=torch.float32))
        self.register_buffer("seen", torch.zeros(NUM_PHASES, dtype=torch.bool))
        if is_under_board:
            self.register_buffer("shown", torch.zeros((0, 7)))
        self.register_buffer("closed", torch.zeros((2, 2), dtype=torch.float64))
        self.layers = perceptron(NUM_FEATURES, width, sum(_SIZES))

    def forward(self, features: torch.Tensor) -> Prediction:
        """Keyframes of features (k, f)."""
        base, q, offset, finger, length = torch.split(self.layers(features), _SIZES, dim=1)
        wanted = self.home + q
        q = torch.clamp(wanted, self.lower, self.upper)
        excess = torch.abs(wanted - q).sum(1)
        return Prediction(base, q, _LENGTH * offset, _FINGER * finger[:, 0], _LENGTH * length[:, 0], excess)

    def has_seen(self, skill: str, phase: str) -> bool:
        """Whether the demonstrations show a phase of a skill."""
        number = phase_index(skill, phase)
        return number is not None and bool(self.seen[number])

    @property
    def ground(self) -> Ground:
        """Which ground the base keeps out of."""
        return Ground(*self.closed.numpy())

    def keep_out_of(self, ground: Ground) -> None:
        """Set which ground the base keeps out of."""
        self.closed = torch.tensor(np.stack((ground.low, ground.high)))

    def offer_postures(self, shown: NDArray[np.float64]) -> None:
        """Set which postures are chosen from under a board, see `shown_postures`."""
        self.shown = torch.tensor(shown, dtype=torch.float32)

    def save(self, path: Path) -> None:
        """Write the weights; the file is complete, or the old one stays.

        Raises:
            OSError: the disk is full or cannot be written.
        """
        save_arrays(path, self)

    @classmethod
    def load(cls, path: Path) -> KeyframeNetwork:
        """The network that `save` wrote.

        Raises:
            DatasetError: there is no such file.
        """
        arrays = load_arrays(path)
        home, lower, upper = (arrays[name].tolist() for name in ("home", "lower", "upper"))
        is_under_board = "shown" in arrays
        network = cls(home, lower, upper, len(arrays["layers.0.bias"]), is_under_board)
        if is_under_board:
            network.shown = arrays["shown"]
        network.load_state_dict(arrays)
        return network


def save_arrays(path: Path, module: nn.Module) -> None:
    """Write the weights of a module to an .npz file.

    Raises:
        OSError: the disk is full or cannot be written.
    """
    content = BytesIO()
    np.savez_compressed(content, **{name: value.numpy() for name, value in module.state_dict().items()})
    write_atomically(path, content.getvalue())


def load_arrays(path: Path) -> dict[str, torch.Tensor]:
    """The weights that `save_arrays` wrote, by name.

    Raises:
        DatasetError: there is no such file, or it holds no weights.
    """
    if not path.exists():
        raise DatasetError(f"there are no weights at {path}")
    try:
        with np.load(path) as content:
            return {name: torch.from_numpy(content[name]) for name in content.files}
    except (ValueError, OSError) as problem:
        raise DatasetError(f"{path} holds no weights of this package: {problem}") from problem
