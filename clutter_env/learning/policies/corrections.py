"""A learner that corrects an imitation: its environment, and the policy of both together."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from clutter_env.learning.policies.features import feature_vector
from clutter_env.learning.policies.policy import Policy
from clutter_env.learning.policies.progress import progress, shows_target, target_features

__all__ = ["HELD_STEPS", "CorrectedActions", "CorrectedAgent", "corrected_observations", "learning_rewards"]

HELD_STEPS = 4
"""Steps of the environment for which a correction is held. The gripper follows a command of its vertical velocity over
seven steps, and by 5% in the first: the critics cannot tell what a correction of one step is worth."""
CORRECTION_SHARE = 0.06
"""Largest correction where nothing else is said, as a share of the largest action of a learner without an imitation."""
PICK_INDICES = (0, 1, 5, 9)
"""What is corrected in Pick: the base's velocities ahead and to the left, the gripper's upward one, its width."""
PICK_SCALE = (0.045, 0.045, 0.15, 1.0)
"""Largest corrections of these: all velocities by 0.045 m/s. Corrections move the base, not the gripper sideways, since
the arm is often at the end of its range while it carries; together they move the gripper 18 mm before the next one."""
CORRECTION_PRICE = 0.1
"""What a step costs with the largest corrections: the imitation stays as it is where corrections bring nothing."""


class CorrectedActions(gym.Wrapper[Any, Any, Any, Any]):
    """The environment as a learner sees it that adds corrections to the actions of an imitation.

    Its action, in [-1, 1], times `scale` is added to the imitation's actions of the next `HELD_STEPS` steps; its
    reward is the sum of theirs. The zero action is the imitation itself, so that learning starts from its success.
    (Silver et al. 2018, Residual policy learning; Johannink et al. 2019.)

    Attributes:
        imitation: the policy that is corrected.
        indices: (c,) of the actions that are corrected.
        scale: (c,) largest correction of each of them.
    """

    def __init__(self, env: gym.Env, imitation: Policy, scale: NDArray[np.floating[Any]]) -> None:
        super().__init__(env)
        self.imitation = imitation
        assert isinstance(env.observation_space, spaces.Dict)
        empty = {name: np.zeros(part.shape or (), part.dtype) for name, part in env.observation_space.items()}
        if shows_target(empty) and env.get_wrapper_attr("control_mode") == "ee":
            self.indices, self.scale = np.array(PICK_INDICES), np.array(PICK_SCALE, np.float32)
        else:
            self.indices, self.scale = np.arange(len(scale)), CORRECTION_SHARE * np.asarray(scale, np.float32)
        seen = corrected_observations(imitation, empty)
        self.observation_space = spaces.Box(-np.inf, np.inf, seen.shape, np.float32)
        self.action_space = spaces.Box(-1.0, 1.0, self.scale.shape, np.float32)
        self._observation: Any = empty

    def reset(self, **keywords: Any) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Start an episode."""
        self._observation, info = self.env.reset(**keywords)
        return corrected_observations(self.imitation, self._observation), info

    def step(self, action: Any) -> tuple[NDArray[np.float32], float, bool, bool, dict[str, Any]]:
        """`HELD_STEPS` steps with the same correction, or fewer if the episode ends."""
        total = 0.0
        for _ in range(HELD_STEPS):
            before = self._observation
            chosen = self.corrected(self.imitation.act(before), action)
            self._observation, reward, terminated, truncated, info = self.env.step(chosen)
            total += float(learning_rewards(before, self._observation, reward, np.asarray(action)))
            if terminated or truncated:
                break
        return corrected_observations(self.imitation, self._observation), total, terminated, truncated, info

    def corrected(self, imitated: NDArray[Any], action: NDArray[Any]) -> NDArray[np.float32]:
        """The environment's actions (..., a) for actions (..., a) of the imitation and (..., c) of the learner."""
        chosen = np.array(imitated, np.float32)
        chosen[..., self.indices] += self.scale * np.asarray(action, np.float32)
        return np.clip(chosen, -1.0, 1.0)

    def corrections(self, imitated: NDArray[Any], wanted: NDArray[Any]) -> NDArray[np.float32]:
        """The learner's actions (..., c) that come closest to wanted ones (..., a) of the environment."""
        missing = (wanted - imitated)[..., self.indices]
        return np.clip(missing / self.scale, -1.0, 1.0).astype(np.float32)


class CorrectedAgent:
    """Imitation and learner together as a policy; `reset` begins a new episode.

    Args:
        env: gives the corrected actions.
        correct: from what the learner sees to its most probable action (c,).
    """

    def __init__(self, env: CorrectedActions, correct: Callable[[NDArray[np.float32]], NDArray[Any]]) -> None:
        self._env, self._correct = env, correct
        self.reset()

    def reset(self) -> None:
        """The next observation is the first one of an episode."""
        self._steps = 0

    def __call__(self, observation: Any) -> NDArray[np.float32]:
        """The imitation's action with a correction, a new one every `HELD_STEPS` steps."""
        if self._steps % HELD_STEPS == 0:
            self._held = self._correct(corrected_observations(self._env.imitation, observation))
        self._steps += 1
        return self._env.corrected(self._env.imitation.act(observation), self._held)


def corrected_observations(imitation: Policy, observation: Any) -> NDArray[np.float32]:
    """What the learner sees (..., f + a): features (..., f), and the imitation's actions (..., a).

    In Pick the features are those of `target_features`, else all of them.
    """
    features = feature_vector(observation)
    seen = target_features(features) if shows_target(observation) else features
    return np.concatenate((seen, imitation.act_on(features)), axis=-1)


def learning_rewards(before: Any, after: Any, rewards: Any, corrections: NDArray[Any]) -> Any:
    """Rewards (...,) while learning: those of the environment, the progress in Pick, and the price of corrections.

    Args:
        before: observations with entries (..., n).
        after: those after one step of the environment.
        rewards: (...,) of the environment.
        corrections: (..., c) of the learner.
    """
    worth = rewards - CORRECTION_PRICE * np.square(corrections).mean(axis=-1)
    return worth + progress(before, after) if shows_target(before) else worth
