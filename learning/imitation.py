"""Demonstrations for SAC and TQC: in the replay buffer, and as what the actor should not forget."""

from __future__ import annotations

import copy
import math
from collections.abc import Sequence

import gymnasium as gym
import numpy as np
import torch
from sb3_contrib import TQC
from stable_baselines3 import SAC
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm

from learning.episode import Episode
from learning.rl import ScaledActions

__all__ = ["Imitation", "KeepImitating", "add_demonstrations"]

BATCH = 256
"""Steps of the demonstrations in one step of imitation."""
LEARNING_RATE = 1e-3
DEVIATION = 0.15
"""Of the actor's first actions, before they are squashed into [-1, 1]."""
HELD, RELEASED = 1 / 3, 2 / 3
"""Shares of the run until which the actor only imitates, and after which it no longer does."""


def add_demonstrations(model: OffPolicyAlgorithm, env: gym.Env, episodes: Sequence[Episode]) -> int:
    """Put every transition of the episodes into the model's replay buffer, to be relabelled like its own; how many."""
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
    """Regression of an actor's mean on what the demonstrations do.

    It has an optimiser of its own: beside the gradients of the values, which are far greater, Adam would hardly move.
    """

    def __init__(self, model: SAC | TQC, env: gym.Env, episodes: Sequence[Episode]) -> None:
        assert isinstance(env, ScaledActions)
        names = episodes[0].observations.keys()
        seen = {name: np.concatenate([episode.observations[name][:-1] for episode in episodes]) for name in names}
        self._model = model
        self._optimiser = torch.optim.Adam(model.actor.parameters(), lr=LEARNING_RATE)
        self._seen, _ = model.policy.obs_to_tensor(seen)
        self._wanted = torch.from_numpy(env.reverse_action(np.concatenate([episode.actions for episode in episodes])))

    def begin(self, steps: int) -> None:
        """Take so many steps, and let the actor explore near what it was shown instead of anywhere."""
        for _ in range(steps):
            self.step()
        spread = self._model.actor.log_std
        assert isinstance(spread, torch.nn.Linear)
        torch.nn.init.zeros_(spread.weight)
        torch.nn.init.constant_(spread.bias, math.log(DEVIATION))

    def step(self) -> float:
        """One gradient step; the loss before it."""
        actor = self._model.actor
        chosen = torch.randint(len(self._wanted), (BATCH,))
        mean = actor({name: value[chosen] for name, value in self._seen.items()}, deterministic=True)
        loss = torch.nn.functional.mse_loss(mean, self._wanted[chosen])
        self._optimiser.zero_grad()
        loss.backward()
        self._optimiser.step()
        return float(loss.detach())


class KeepImitating(BaseCallback):
    """Guards what the actor was shown while values are still wrong: without it, SAC forgets it within 2,000 steps.

    For the first third of the run only the critics learn: the actor is put back to what imitation made of it. From then
    on there is a step of imitation beside each of the learner's own, ever more rarely, never in the last third. (A term
    for imitation in the actor's loss is from Nair et al. 2018, Overcoming exploration in reinforcement learning with
    demonstrations, section V.)
    """

    def __init__(self, imitation: Imitation, steps: int, seed: int) -> None:
        super().__init__()
        self._imitation, self._steps = imitation, steps
        self._rng = np.random.default_rng(seed)

    def _on_training_start(self) -> None:
        self._shown = copy.deepcopy(self.model.policy.actor.state_dict())

    def _on_step(self) -> bool:
        share = self.num_timesteps / self._steps
        if share < HELD:
            self.model.policy.actor.load_state_dict(self._shown)
        elif self._rng.random() < (RELEASED - share) / (RELEASED - HELD):
            self.logger.record("train/imitation_loss", self._imitation.step())
        return True
