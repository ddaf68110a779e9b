"""Demonstrations for SAC and TQC: in the replay buffer, and as regularisation of the actor."""

from __future__ import annotations

import math
from collections.abc import Sequence

import gymnasium as gym
import numpy as np
import torch
from sb3_contrib import TQC
from stable_baselines3 import SAC
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm

from clutter_env.learning.demonstrations.episode import Episode
from clutter_env.learning.policies.rl import ScaledActions

__all__ = ["BCRegularisation", "Imitation", "add_demonstrations"]

BATCH = 256
"""Steps of the demonstrations in one gradient step of imitation."""
LEARNING_RATE, LATER_RATE = 1e-3, 1e-4
"""Learning rates of imitation, before and during reinforcement learning."""
DEVIATION = 0.15
"""Initial standard deviation of the actor's actions, before tanh squashes them into [-1, 1]."""
CRITICS_ONLY_SHARE = 1 / 3
"""Share of the run during which only the critics learn."""
ACTOR_STEP_SCALE = 0.03
"""Factor by which the steps of the actor are shortened from then on."""


def add_demonstrations(model: OffPolicyAlgorithm, env: gym.Env, episodes: Sequence[Episode]) -> int:
    """Add every transition of the episodes to the replay buffer, to be relabelled by hindsight; their number."""
    buffer = model.replay_buffer
    assert buffer is not None
    assert isinstance(env, ScaledActions)
    count = 0
    for episode in episodes:
        for step in range(len(episode)):
            before = {name: values[step][None] for name, values in episode.observations.items()}
            after = {name: values[step + 1][None] for name, values in episode.observations.items()}
            is_last = step == len(episode) - 1
            info = {
                "is_success": bool(episode.is_success[step + 1]),
                "TimeLimit.truncated": is_last and episode.truncated,
            }
            buffer.add(
                before,
                after,
                env.reverse_action(episode.actions[step])[None],
                np.array([episode.rewards[step]]),
                np.array([is_last]),
                [info],
            )
            count += 1
    return count


class Imitation:
    """Regression of an actor's mean action on the demonstrations.

    It has its own optimiser: the gradients of the critics are much larger, and Adam scales its steps by all gradients.
    """

    def __init__(self, model: SAC | TQC, env: gym.Env, episodes: Sequence[Episode]) -> None:
        assert isinstance(env, ScaledActions)
        names = episodes[0].observations.keys()
        observations = {
            name: np.concatenate([episode.observations[name][:-1] for episode in episodes]) for name in names
        }
        self._model = model
        self._optimiser = torch.optim.Adam(model.actor.parameters(), lr=LEARNING_RATE)
        self._expert_observations, _ = model.policy.obs_to_tensor(observations)
        self._wanted = torch.from_numpy(env.reverse_action(np.concatenate([episode.actions for episode in episodes])))

    def begin(self, steps: int) -> None:
        """Take gradient steps, then let the actor explore with a standard deviation of `DEVIATION`."""
        for _ in range(steps):
            self.step(LEARNING_RATE)
        spread = self._model.actor.log_std
        assert isinstance(spread, torch.nn.Linear)
        torch.nn.init.zeros_(spread.weight)
        torch.nn.init.constant_(spread.bias, math.log(DEVIATION))

    def step(self, learning_rate: float) -> float:
        """One gradient step; the loss before it."""
        self._optimiser.param_groups[0]["lr"] = learning_rate
        actor = self._model.actor
        chosen = torch.randint(len(self._wanted), (BATCH,))
        mean = actor({name: value[chosen] for name, value in self._expert_observations.items()}, deterministic=True)
        loss = torch.nn.functional.mse_loss(mean, self._wanted[chosen])
        self._optimiser.zero_grad()
        loss.backward()
        self._optimiser.step()
        return float(loss.detach())


class BCRegularisation(BaseCallback):
    """Keeps the actor close to the demonstrations during reinforcement learning.

    Without it SAC forgets the demonstrations within 2,000 steps, because its critics are still wrong for the states
    that the changed actor visits. So only the critics learn during the first `CRITICS_ONLY_SHARE` of the run; then each
    step of the actor is shortened by `ACTOR_STEP_SCALE` and followed by a step of imitation. (Nair et al. 2018,
    Overcoming exploration in reinforcement learning with demonstrations, section V, has an imitation term in the loss
    of the actor instead.)
    """

    def __init__(self, imitation: Imitation, steps: int) -> None:
        super().__init__()
        self._imitation, self._steps = imitation, steps

    def _on_training_start(self) -> None:
        self._before = self._actor()

    def _on_step(self) -> bool:
        scale = 0.0 if self.num_timesteps < self._steps * CRITICS_ONLY_SHARE else ACTOR_STEP_SCALE
        with torch.no_grad():
            for before, now in zip(self._before, self.model.policy.actor.parameters(), strict=True):
                now.copy_(before + scale * (now - before))
        if scale > 0:
            self.logger.record("train/imitation_loss", self._imitation.step(LATER_RATE))
        self._before = self._actor()
        return True

    def _actor(self) -> list[torch.Tensor]:
        """A copy of the actor's parameters."""
        return [parameter.detach().clone() for parameter in self.model.policy.actor.parameters()]
