"""Gradient descent with a learning rate that falls to zero, and the log of a run."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeAlias

import torch
from torch.utils.tensorboard import SummaryWriter

from clutter_env.policies.runs import HISTORY_FILE
from clutter_env.reporting.files import write_json
from clutter_env.training.run import Run

Report: TypeAlias = Callable[[int, float], None]
"""Called with the number of a gradient step and the loss."""

_REPORT_EVERY = 500
"""Steps between two reports."""


def descend(
    optimiser: torch.optim.Optimizer,
    steps: int,
    loss_at: Callable[[int], torch.Tensor],
    report: Report = lambda *_: None,
    max_gradient: float | None = None,
) -> None:
    """Change the parameters of an optimiser by gradient steps.

    Args:
        optimiser: of one group of parameters; its learning rate is the first one, which falls to zero along a cosine.
        steps: how many.
        loss_at: the loss () of a step, which draws its own batch.
        report: called every 500 steps and after the last one.
        max_gradient: length to which gradients are clipped; None: they are not.
    """
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, steps)
    for step in range(steps):
        loss = loss_at(step)
        optimiser.zero_grad()
        loss.backward()
        if max_gradient is not None:
            torch.nn.utils.clip_grad_norm_(optimiser.param_groups[0]["params"], max_gradient)
        optimiser.step()
        schedule.step()
        if step % _REPORT_EVERY == 0 or step == steps - 1:
            report(step, loss.item())


class RunLog:
    """The history of a run, written to its directory as it grows, and to TensorBoard; a context manager."""

    def __init__(self, run: Run) -> None:
        self.history: list[dict[str, float]] = []
        self._directory = run.directory
        self._writer = SummaryWriter(str(run.directory / "tensorboard"))

    def __enter__(self) -> RunLog:
        return self

    def __exit__(self, *_: Any) -> None:
        self._writer.close()

    def loss(self, step: int, loss: float) -> None:
        """Note the loss of a gradient step."""
        self._writer.add_scalar("train/loss", loss, step)

    def add(self, **entry: float) -> None:
        """Add an entry to the history: what was measured on held-out scenes."""
        self.history.append(entry)
        write_json(self._directory / HISTORY_FILE, self.history)
        for name, value in entry.items():
            self._writer.add_scalar(f"held_out/{name}", value, len(self.history) - 1)
