"""Policies without training, with which learnt ones are compared."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from clutter_env.envs.retrieve import RetrieveEnv
from clutter_env.learning.demonstrations.experts import MAX_SCRIPT_STEPS
from clutter_env.learning.demonstrations.scripted import bulldoze
from clutter_env.learning.errors import LearningError

__all__ = ["BASELINES", "Bulldozer", "greedy_agent", "random_agent"]

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


class Bulldozer:
    """Goes straight for the target at full speed, through whatever stands in between; see `scripted.bulldoze`.

    It knows the exact poses. A new episode begins with `reset(env, info)`, as in the protocol of
    `clutter-env evaluate --policy bulldozer`.

    Attributes:
        env_keywords: keyword arguments with which an environment must be made for it.
        grasps: it holds the gripper level.
    """

    env_keywords: Mapping[str, Any] = MappingProxyType({"control_mode": "ee"})
    grasps = "side"

    def __init__(self) -> None:
        self._env: RetrieveEnv | None = None
        self._steps = 0

    def reset(self, env: gym.Env, info: Mapping[str, Any]) -> None:  # noqa: ARG002  part of the protocol
        """Start an episode; `env` has been reset and returned `info`.

        Raises:
            LearningError: not a Retrieve environment with `control_mode="ee"`.
        """
        retrieve_env = env.unwrapped
        if not isinstance(retrieve_env, RetrieveEnv) or retrieve_env.control_mode != "ee":
            raise LearningError("the bulldozer acts in Retrieve environments with control_mode='ee'")
        self._env, self._steps = retrieve_env, 0

    @property
    def done(self) -> bool:
        """Whether it has given up: it needs less than a hundred steps, or does not get there."""
        return self._steps >= MAX_SCRIPT_STEPS

    def act(self, observation: Any) -> NDArray[Any]:  # noqa: ARG002  it reads the simulation
        """The next action."""
        assert self._env is not None
        self._steps += 1
        return bulldoze(self._env)[1]


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
