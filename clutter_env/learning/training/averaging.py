"""An average of the actor's weights over the last steps of training, which swings less than the weights themselves."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import torch
from stable_baselines3.common.callbacks import BaseCallback

__all__ = ["AveragedActor"]

HORIZON = 1000
"""Steps over which weights are averaged, with exponentially falling shares (Polyak and Juditsky 1992)."""


class AveragedActor(BaseCallback):
    """Averages the weights of the actor of SAC or TQC; the average is evaluated and saved, and does not act.

    A run that is resumed goes on from the average that was saved.
    """

    def __init__(self) -> None:
        super().__init__()
        self._steps = 0

    def _on_training_start(self) -> None:
        self._mean = [weight.detach().clone() for weight in self._weights()]

    def _on_step(self) -> bool:
        self._steps += 1
        share = 1.0 / min(self._steps, HORIZON)
        with torch.no_grad():
            for mean, weight in zip(self._mean, self._weights(), strict=True):
                mean.lerp_(weight, share)
        return True

    @contextmanager
    def in_place(self) -> Iterator[None]:
        """The model's actor has the average weights within the block."""
        own = [weight.detach().clone() for weight in self._weights()]
        self._put(self._mean)
        try:
            yield
        finally:
            self._put(own)

    def _weights(self) -> list[torch.Tensor]:
        return list(self.model.policy.actor.parameters())

    def _put(self, values: list[torch.Tensor]) -> None:
        with torch.no_grad():
            for weight, value in zip(self._weights(), values, strict=True):
                weight.copy_(value)
