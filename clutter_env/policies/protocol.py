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

Then `clutter-env evaluate --suite side-15-v3 --policy mine:MyPolicy`. A function without arguments that returns
a policy may be named in place of the class.

Policies belong to one of two tracks. In the observations track they see observations, the info of the reset and
`PublicInfo`.
`evaluate` runs them in another process, which contains no environment. In the privileged track a policy also receives
the environment: it sets `is_privileged = True` and has `reset(info, env)`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol, TypeAlias

import gymnasium as gym

from assets import RobotSpec
from clutter_env.errors import ClutterEnvError
from clutter_env.scene.layout import Layout
from clutter_env.task import family

SKILLS = 20
"""Budget of an episode, in skills of a policy that acts by skills. A skill is a pick with its place. A policy of two
levels has this many picks, and as many places."""

FREE_KEYWORDS = ("control_mode", "obs_mode", "image_size", "cameras", "frame_every", "reward_mode", "instruction")
"""Keyword arguments of the environment that a policy may choose: they change neither the scenes nor the success. (In
Search the scenes depend on the cameras, and `evaluate` refuses a policy that chooses them.)"""
EE_ACTIONS = 10
"""Numbers in an action of "ee" control: base, twist of the gripper, fingers."""


class PolicyError(ClutterEnvError):
    """No such policy, or a policy that cannot play this environment. The message lists the valid values."""


@dataclass(frozen=True)
class PublicInfo:
    """Public information on an episode besides its observations.

    Attributes:
        robot: the robot's data, including its MJCF file.
        layout: the furniture.
        object_names: names of the objects, in the order of their rows in the observation.
        control_mode: "joint" or "ee".
        action_space, observation_space: of the environment.
        acts_by_skills: whether it is the Skill environment.
        family: of the environment, such as "retrieve".
    """

    robot: RobotSpec
    layout: Layout
    object_names: tuple[str, ...]
    control_mode: str
    action_space: gym.Space[Any]
    observation_space: gym.Space[Any]
    acts_by_skills: bool
    family: str

    @classmethod
    def of(cls, env: gym.Env[Any, Any]) -> PublicInfo:
        """That of an environment that has been reset."""
        outer: Any = env.unwrapped
        inner = getattr(outer, "physics_env", outer)  # Skill contains one
        return cls(
            robot=inner.robot,
            layout=inner.layout,
            object_names=tuple(inner.world.names),
            control_mode=inner.control_mode,
            action_space=env.action_space,
            observation_space=env.observation_space,
            acts_by_skills=inner is not outer,
            family=family(env.spec.id) if env.spec else "",
        )


class Policy(Protocol):
    """Acts on observations. Its actions in an episode must not depend on earlier episodes.

    Optional attributes:
        env_keywords: keyword arguments of the environment, among `FREE_KEYWORDS`.
        grasps: "side" or "all" (the default): results are broken down by the lower bounds for these grasps.
        acts_by_skills: true for a policy that plays the Skill environment of the scenes.
        done: true after the policy has finished or given up. `failure` is then the reason, "" without one.
        check(public): receives `PublicInfo` before each episode, and raises `PolicyError` if the policy does not
            support it.
    """

    def reset(self, info: Mapping[str, Any]) -> None:
        """Start an episode. `info` is that of the environment's reset."""

    def act(self, observation: Any) -> Any:
        """The next action."""


class PrivilegedPolicy(Protocol):
    """A policy that also reads the simulation."""

    is_privileged: bool

    def reset(self, info: Mapping[str, Any], env: gym.Env[Any, Any]) -> None:
        """Start an episode. `env` has been reset and returned `info`."""

    def act(self, observation: Any) -> Any:
        """The next action."""


AnyPolicy: TypeAlias = Policy | PrivilegedPolicy


def begin_episode(policy: Any, info: Mapping[str, Any], env: gym.Env[Any, Any]) -> None:
    """Start an episode of a policy, privileged or not, in an environment that has been reset and returned `info`.

    Raises:
        PolicyError: the policy is not made for this environment.
    """
    check_public(policy, PublicInfo.of(env))
    if getattr(policy, "is_privileged", False):
        policy.reset(info, env)
    else:
        policy.reset(info)


def check_public(policy: Any, public: PublicInfo) -> None:
    """Give a policy with `check` the public information of the next episode. Raise its `PolicyError`."""
    check = getattr(policy, "check", None)
    if check is not None:
        check(public)
