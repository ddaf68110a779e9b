"""A replay buffer of which half of every batch are demonstrations (Ball et al. 2023, RLPD, section 4.1)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from stable_baselines3.common.buffers import ReplayBuffer
from stable_baselines3.common.type_aliases import ReplayBufferSamples

from clutter_env.learning.demonstrations.episode import Episode
from clutter_env.learning.policies.corrections import (
    HELD_STEPS,
    CorrectedActions,
    corrected_observations,
    learning_rewards,
)

__all__ = ["SymmetricReplayBuffer"]


class SymmetricReplayBuffer(ReplayBuffer):
    """Half of every batch comes from demonstrations, the other half from the learner's own steps.

    Attributes:
        demonstrations: their steps; None until `keep` has been called, and then batches are all of the learner's own.
    """

    demonstrations: ReplayBuffer | None = None

    def keep(self, env: CorrectedActions, episodes: Sequence[Episode]) -> int:
        """Keep all stretches of `HELD_STEPS` steps of episodes, as the learner in `env` sees them; their number."""
        count = sum(max(len(episode) - HELD_STEPS + 1, 0) for episode in episodes)
        kept = ReplayBuffer(count, self.observation_space, self.action_space, self.device)
        for episode in episodes:
            seen = corrected_observations(env.imitation, episode.observations)
            imitated = seen[:-1, -episode.actions.shape[1] :]
            actions = env.corrections(imitated, episode.actions)
            before = {name: values[:-1] for name, values in episode.observations.items()}
            after = {name: values[1:] for name, values in episode.observations.items()}
            rewards = learning_rewards(before, after, episode.rewards, actions)
            for first in range(len(episode) - HELD_STEPS + 1):
                last = first + HELD_STEPS
                is_last = last == len(episode)
                kept.add(
                    seen[first],
                    seen[last],
                    actions[first:last].mean(axis=0),
                    np.array([rewards[first:last].sum()]),
                    np.array([is_last]),
                    [{"TimeLimit.truncated": is_last and episode.truncated}],
                )
        self.demonstrations = kept
        return count

    def sample(self, batch_size: int, env: Any = None) -> ReplayBufferSamples:
        """A batch: half from the demonstrations."""
        if self.demonstrations is None:
            return super().sample(batch_size, env)
        own = super().sample(batch_size - batch_size // 2, env)
        shown = self.demonstrations.sample(batch_size // 2, env)
        return ReplayBufferSamples(*(_joined(one, other) for one, other in zip(own, shown, strict=True)))


def _joined(one: torch.Tensor | None, other: torch.Tensor | None) -> torch.Tensor | None:
    return None if one is None or other is None else torch.cat((one, other))
