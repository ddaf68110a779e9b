"""Contenders that need no training: what a learner must beat."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import gymnasium as gym
import numpy as np

from clutter_env.learning.errors import LearningError

__all__ = ["BASELINES", "greedy_agent", "random_agent"]

BASELINES = ("random", "greedy")
_FRONT_FIRST = (0, 1, 5, 2, 4, 3)
"""Directions, those from the robot's side first."""


def random_agent(env: gym.Env, seed: int) -> Callable[[Any], Any]:
    """Any action; of skills, any that is worth trying."""
    rng = np.random.default_rng(seed)
    space = env.action_space

    def act(_: Any) -> Any:
        if isinstance(space, gym.spaces.Box):
            return rng.uniform(space.low, space.high).astype(np.float32)
        masks = env.get_wrapper_attr("action_masks")(geometric=False)
        return int(rng.choice(np.flatnonzero(masks)))

    return act


def greedy_agent(env: gym.Env) -> Callable[[Any], Any]:
    """Take the target; while that fails, clear what stands nearest to it, from the robot's side first.

    Raises:
        LearningError: the environment has no skills.
    """
    if not isinstance(env.action_space, gym.spaces.Discrete):
        raise LearningError("the greedy baseline acts by skills; compare it on a Skill or Retrieve environment")
    skills = env.unwrapped

    def act(_: Any) -> int:
        masks = skills.action_masks(geometric=False)  # type: ignore[attr-defined]
        if masks[-1]:
            return len(masks) - 1
        bodies = skills.scene.objects  # type: ignore[attr-defined]
        target = skills.scene.body(skills.target)  # type: ignore[attr-defined]
        near = np.argsort([np.linalg.norm(body.position[:2] - target.position[:2]) for body in bodies])
        per_object = (len(masks) - 1) // len(bodies)
        wanted = (int(i) * per_object + d for i in near for d in _FRONT_FIRST)
        return next(action for action in wanted if masks[action])

    return act
