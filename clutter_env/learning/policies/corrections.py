"""A learner that corrects an imitation: its environment, and the policy of both together."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from clutter_env.learning.policies.features import feature_vector
from clutter_env.learning.policies.policy import Policy

__all__ = ["CORRECTION_SHARE", "CorrectedActions", "corrected_observations"]

CORRECTION_SHARE = 0.06
"""Largest correction, as a share of the largest action of a learner without an imitation.

A gripper that approaches a point with the gain of the scripts, 1.6/s, stops 0.3 m/s × `CORRECTION_SHARE` / 1.6 beside
it under the largest correction: 11 mm, less than the room of 12 mm between the object and each finger. Larger ones let
critics that are still wrong hold the gripper beside an object that the imitation would grasp.
"""


class CorrectedActions(gym.Wrapper[Any, Any, Any, Any]):
    """The environment as a learner sees it that adds corrections to the actions of an imitation.

    Its observation is the vector of features, then the imitation's action; its action, in [-1, 1], times `scale` is
    added to that action. The zero action is the imitation itself, so that learning starts from its success.
    (Silver et al. 2018, Residual policy learning; Johannink et al. 2019.)

    Attributes:
        imitation: the policy that is corrected.
        scale: (a,) largest correction of each action.
    """

    def __init__(self, env: gym.Env, imitation: Policy, scale: NDArray[np.floating[Any]]) -> None:
        super().__init__(env)
        self.imitation = imitation
        self.scale = CORRECTION_SHARE * np.asarray(scale, np.float32)
        num_features, num_actions, _ = imitation.shape
        self.observation_space = spaces.Box(-np.inf, np.inf, (num_features + num_actions,), np.float32)
        self.action_space = spaces.Box(-1.0, 1.0, (num_actions,), np.float32)
        self._imitated = np.zeros(num_actions, np.float32)

    def reset(self, **keywords: Any) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Start an episode."""
        observation, info = self.env.reset(**keywords)
        return self._seen(observation), info

    def step(self, action: Any) -> tuple[NDArray[np.float32], float, bool, bool, dict[str, Any]]:
        """One step with the corrected action."""
        observation, reward, terminated, truncated, info = self.env.step(self.corrected(self._imitated, action))
        return self._seen(observation), float(reward), terminated, truncated, info

    def corrected(self, imitated: NDArray[Any], action: NDArray[Any]) -> NDArray[np.float32]:
        """The environment's actions (..., a) for actions of the imitation and of the learner."""
        return np.clip(imitated + self.scale * np.asarray(action), -1.0, 1.0).astype(np.float32)

    def corrections(self, imitated: NDArray[Any], wanted: NDArray[Any]) -> NDArray[np.float32]:
        """The learner's actions (..., a) that come closest to wanted ones of the environment."""
        return np.clip((wanted - imitated) / self.scale, -1.0, 1.0).astype(np.float32)

    def _seen(self, observation: Any) -> NDArray[np.float32]:
        seen = corrected_observations(self.imitation, observation)
        self._imitated = seen[-len(self._imitated) :]
        return seen


def corrected_observations(imitation: Policy, observation: Any) -> NDArray[np.float32]:
    """What the learner sees (..., f + a): the features (..., f), and the imitation's actions (..., a)."""
    features = feature_vector(observation)
    return np.concatenate((features, imitation.act_on(features)), axis=-1)
