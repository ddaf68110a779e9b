"""Gradient descent with a learning rate that falls to zero."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

import torch

Report: TypeAlias = Callable[[int, float], None]
"""Called with the number of a gradient step and the loss."""

_REPORT_EVERY = 500
"""Steps between two reports."""


@dataclass(frozen=True)
class DescentConfig:
    """Settings of a regression; each learner has its own values.

    Attributes:
        steps: gradient steps.
        batch: examples in each step.
        learning_rate: the first one; it falls to zero along a cosine.
        width: of the hidden layers.
        seed: random seed.
    """

    steps: int = 4000
    batch: int = 256
    learning_rate: float = 1e-3
    width: int = 256
    seed: int = 0


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
