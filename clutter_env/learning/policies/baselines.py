"""Policies without training, with which learnt ones are compared."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import gymnasium as gym
import numpy as np

from clutter_env.envs.retrieve import RetrieveEnv
from clutter_env.learning.demonstrations.scripted import bulldoze
from clutter_env.learning.errors import LearningError

__all__ = ["BASELINES", "bulldozer_agent", "greedy_agent", "random_agent"]

BASELINES = ("random", "greedy", "bulldozer")
_FRONT_FIRST = (0, 1, 5, 2, 4, 3)
"""Indices of the approach directions, those from the robot's side first."""


def random_agent(env: gym.Env, seed: int) -> Callable[[Any], Any]:
    """A policy that draws actions uniformly; in Skill, among those that have not just failed."""
    rng = np.random.default_rng(seed)
    space = env.action_space

    def act(_: Any) -> Any:
        """A random action."""
        if isinstance(space, gym.spaces.Box):
            return rng.uniform(space.low, space.high).astype(np.float32)
        masks = env.get_wrapper_attr("action_masks")(geometric=False)
        return int(rng.choice(np.flatnonzero(masks)))

    return act


def bulldozer_agent(env: gym.Env) -> Callable[[Any], Any]:
    """A policy that goes straight for the target at full speed, through whatever stands in between.

    It knows the exact poses; see `scripted.bulldoze`.

    Raises:
        LearningError: not a Retrieve environment with `control_mode="ee"`.
    """
    retrieve_env = env.unwrapped
    if not isinstance(retrieve_env, RetrieveEnv) or retrieve_env.control_mode != "ee":
        raise LearningError("the bulldozer acts in Retrieve environments with control_mode='ee'")
    return lambda _: bulldoze(retrieve_env)[1]


def greedy_agent(env: gym.Env) -> Callable[[Any], Any]:
    """A policy that takes the target; while that fails, it clears the nearest object, from the robot's side first.

    Raises:
        LearningError: the environment has no skills.
    """
    if not isinstance(env.action_space, gym.spaces.Discrete):
        raise LearningError("the greedy baseline acts by skills; compare it on a Skill or Retrieve environment")
    skills: Any = env.unwrapped

    def act(_: Any) -> int:
        """The first skill in this order that has not just failed."""
        masks = skills.action_masks(geometric=False)
        if masks[-1]:
            return len(masks) - 1
        bodies = skills.scene.objects
        target = skills.scene.body(skills.target)
        near = np.argsort([np.linalg.norm(body.position[:2] - target.position[:2]) for body in bodies])
        per_object = (len(masks) - 1) // len(bodies)
        wanted = (int(i) * per_object + d for i in near for d in _FRONT_FIRST)
        return next(action for action in wanted if masks[action])

    return act
