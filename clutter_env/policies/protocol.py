"""The protocol of policies: `reset(info)` starts an episode, `act(observation)` returns the next action.

Add my policy, in a file `mine.py`:

    import numpy as np

    class MyPolicy:
        '''Drives to the table and closes the gripper.'''

        env_keywords = {"control_mode": "joint"}  # optional: how its environment is made
        grasps = "side"  # optional: results are broken down by the lower bounds for these grasps

        def reset(self, info):
            self.target = info["target"]  # name of the object to be lifted
            self.steps = 0

        def act(self, observation):
            self.steps += 1
            action = np.zeros(12, np.float32)
            action[0], action[-1] = 0.2, -1.0  # forward, fingers closed
            return action

Then `clutter-env evaluate --suite side-15-v1 --policy mine:MyPolicy`; a function without arguments that returns
a policy may be named in place of the class.

A privileged policy also receives the environment: it sets `is_privileged = True` and has `reset(info, env)`.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol, TypeAlias

import gymnasium as gym

from clutter_env.errors import ClutterEnvError


class PolicyError(ClutterEnvError):
    """No such policy, or one that cannot play this environment; the message says what is valid."""


class Policy(Protocol):
    """Acts on observations. What it does in an episode must not depend on earlier episodes.

    Optional attributes:
        env_keywords: keyword arguments of the environment among control_mode, obs_mode, image_size and reward_mode.
        grasps: "side" or "all" (the default): the grasps by whose lower bounds its results are broken down.
        acts_by_skills: true for one that plays the Skill environment of the scenes.
        done: true once the policy has finished or given up; `failure`, then the reason, "" without one.
        check(env): raises `PolicyError` for an environment that it is not made for; called before each episode.
    """

    def reset(self, info: Mapping[str, Any]) -> None:
        """Start an episode; `info` is that of the environment's reset."""

    def act(self, observation: Any) -> Any:
        """The next action."""


class PrivilegedPolicy(Protocol):
    """Also reads the simulation; otherwise as `Policy`."""

    is_privileged: bool

    def reset(self, info: Mapping[str, Any], env: gym.Env[Any, Any]) -> None:
        """Start an episode; `env` has been reset and returned `info`."""

    def act(self, observation: Any) -> Any:
        """The next action."""


AnyPolicy: TypeAlias = Policy | PrivilegedPolicy


def begin_episode(policy: Any, info: Mapping[str, Any], env: gym.Env[Any, Any]) -> None:
    """Start an episode of a policy, privileged or not, in an environment that has been reset and returned `info`.

    Raises:
        PolicyError: the policy is not made for this environment.
    """
    check = getattr(policy, "check", None)
    if check is not None:
        check(env)
    if getattr(policy, "is_privileged", False):
        policy.reset(info, env)
    else:
        policy.reset(info)
