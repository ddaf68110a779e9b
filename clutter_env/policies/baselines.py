"""Policies without training, with which learned ones are compared; they read the simulation. See `experts` for more."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import gymnasium as gym
import numpy as np

from clutter_env.policies.protocol import PolicyError

_FRONT_FIRST = (0, 1, 5, 2, 4, 3)
"""Indices of the approach directions, those from the robot's side first."""


class RandomPolicy:
    """Draws actions uniformly; skills among those that have not just failed. Each episode has a generator of its own.

    Attributes:
        acts_by_skills: whether it plays the Skill environment of the scenes.
        grasps: those of the skills are level ones.
    """

    is_privileged = True

    def __init__(self, seed: int, acts_by_skills: bool = False) -> None:
        self.acts_by_skills = acts_by_skills
        self.grasps = "side" if acts_by_skills else "all"
        self._seed = seed

    def reset(self, info: Mapping[str, Any], env: gym.Env[Any, Any]) -> None:  # noqa: ARG002  part of the protocol
        """Start an episode."""
        self._env, self._rng = env, np.random.default_rng(self._seed + env.unwrapped.np_random_seed)

    def act(self, observation: Any) -> Any:  # noqa: ARG002  part of the protocol
        """A random action."""
        space = self._env.action_space
        if isinstance(space, gym.spaces.Box):
            return self._rng.uniform(space.low, space.high).astype(np.float32)
        masks = self._env.get_wrapper_attr("action_masks")(geometric=False)
        return int(self._rng.choice(np.flatnonzero(masks)))


class GreedyPolicy:
    """Takes the target by skills; while that fails, it clears the nearest object, from the robot's side first."""

    is_privileged, acts_by_skills, grasps = True, True, "side"

    def reset(self, info: Mapping[str, Any], env: gym.Env[Any, Any]) -> None:  # noqa: ARG002  part of the protocol
        """Start an episode.

        Raises:
            PolicyError: the environment has no skills.
        """
        if not isinstance(env.action_space, gym.spaces.Discrete):
            raise PolicyError("the greedy baseline acts by skills; compare it on a Skill or Retrieve environment")
        self._skills: Any = env.unwrapped

    def act(self, observation: Any) -> int:  # noqa: ARG002  it reads the simulation
        """The first skill in this order that has not just failed."""
        skills = self._skills
        masks = skills.action_masks(geometric=False)
        if masks[-1]:
            return len(masks) - 1
        bodies, target = skills.scene.objects, skills.scene.body(skills.target)
        near = np.argsort([np.linalg.norm(body.position[:2] - target.position[:2]) for body in bodies])
        per_object = (len(masks) - 1) // len(bodies)
        wanted = (int(i) * per_object + d for i in near for d in _FRONT_FIRST)
        return next(action for action in wanted if masks[action])
