"""What the trainings share: examples as arrays, and gradient descent."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Self, TypeAlias

import numpy as np
import torch

from clutter_env.reporting.files import written_atomically

Report: TypeAlias = Callable[[int, float], None]
"""Called with the number of a gradient step and the loss."""

_REPORT_EVERY = 500
"""Steps between two reports."""


@dataclass(frozen=True, eq=False)
class ExampleArrays:
    """Base of examples that are kept as arrays, one for each field."""

    @classmethod
    def joined(cls, parts: Sequence[Self]) -> Self:
        """Join several."""
        return cls(*(np.concatenate([getattr(part, field.name) for part in parts]) for field in fields(cls)))

    @classmethod
    def kept(cls, path: Path, collect: Callable[[], Self]) -> Self:
        """Read the examples that a file (npz) holds; those that are not there are collected and written."""
        if not path.exists():
            path.parent.mkdir(parents=True, exist_ok=True)
            with written_atomically(path) as part, part.open("wb") as file:
                np.savez_compressed(file, **vars(collect()))
        with np.load(path, allow_pickle=False) as content:
            return cls(**{field.name: content[field.name] for field in fields(cls)})


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
