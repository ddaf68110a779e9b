"""The critics learn alone at the beginning of a run."""

from __future__ import annotations

import torch
from stable_baselines3.common.callbacks import BaseCallback

__all__ = ["CriticsFirst"]


class CriticsFirst(BaseCallback):
    """Keeps the actor of SAC or TQC as it is until `steps` steps have been taken.

    An actor that begins as an imitation would otherwise follow critics that have not learned anything yet.
    """

    def __init__(self, steps: int) -> None:
        super().__init__()
        self._until = steps

    def _on_training_start(self) -> None:
        self._first = [weight.detach().clone() for weight in self.model.policy.actor.parameters()]

    def _on_step(self) -> bool:
        if self.num_timesteps <= self._until:
            with torch.no_grad():
                for weight, first in zip(self.model.policy.actor.parameters(), self._first, strict=True):
                    weight.copy_(first)
        return True
