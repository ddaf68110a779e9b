"""Interfaces of the expert: the environments that it can control, and the planners that it can use."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Protocol

import mujoco
import numpy as np
from numpy.typing import NDArray

from assets.robots import RobotSpec
from planners.expert.config import ExpertError
from planners.grasping.families import Grasps
from planners.motion.tcp_following import TcpFollower
from planners.placing.surfaces import Supports
from planners.planner import Planner
from planners.scene import Scene
from planners.strategies import Strategy
from planners.tamp.solution import Infeasible, Solution

Array = NDArray[np.float64]

ACTIONS = {"joint": ("joint_action",), "ee": ("ee_action", "tcp_follower")}
"""Methods for each control mode: joint targets, or TCP poses that the environment's controller turns into joint
targets."""


class ControlledEnv(Protocol):
    """Interface of an environment (`env.unwrapped`) for the expert. `ControlledWorld` makes one from a `Controller`.

    One step is one control step of 0.05 s, or of its attribute `dt` [s]. With a true attribute `waits_for_tcp`, the
    expert waits for a lagging arm, as it does in control mode "ee". Only the action method of its own control mode is
    called. If the robot's knowledge of the world is inexact or late, `perceived` has the `model` and `data` to read in
    place of the true ones. `pose_accuracy` [m] is then the expected error of object poses, and `latency` the number of
    steps until a command shows.

    Attributes:
        model: the simulated world, which the expert only reads.
        data: the state of the simulated world, which the expert only reads.
        robot: the robot in `model`.
        control_mode: kind of the actions, a key of `ACTIONS`: "joint" calls for `joint_action`, "ee" for
            `ee_action`.
        object_names: names of the bodies that the robot may move, in the order of the bodies of `model`.
        support_name: name of the geom that the objects stand on.
        target: name of the object to retrieve. It raises a ValueError before the environment's first `reset`. In its
            place, an environment may have a `planners.goals.Goal` as its `planning_goal` or `goal`, and the `regions`
            of this goal.
        lift_height: height [m] of the target's lowest point above its former support, from which on it is lifted.
    """

    model: mujoco.MjModel
    data: mujoco.MjData
    robot: RobotSpec
    control_mode: str
    object_names: tuple[str, ...]
    support_name: str
    target: str
    lift_height: float

    def joint_action(self, q_target: Array, gripper_width: float | Array) -> Array:
        """Action that moves the robot to a whole-body configuration.

        Args:
            q_target: (4 + n,) base x, y [m], yaw [rad], torso [m], arm [rad]. A robot that acts with several arms has
                the other arms after these, in the order of `robot.acting_arms`.
            gripper_width: distance [m] of the finger pads, one number for each arm of such a robot.
        """
        ...

    def ee_action(self, base_target: Array, T_world_tcp: Array, gripper_width: float) -> Array:
        """Action that moves base and TCP to poses.

        Args:
            base_target: (3,) x, y [m], yaw [rad].
            T_world_tcp: (4, 4).
            gripper_width: distance [m] of the finger pads.
        """
        ...

    def tcp_follower(self) -> TcpFollower:
        """Model of the joint angles that the controller chooses in control mode "ee"."""
        ...


class ScenePlanner(Protocol):
    """A planner that the expert can use, such as `planners.Planner`."""

    def solve(
        self,
        scene: Scene,
        goal: Any,
        strategy: Strategy,
        rng: np.random.Generator,
        time_limit: float | None,
        /,
    ) -> Solution | Infeasible:
        """Plan for a goal: the name of the object to take, or a `planners.goals.Goal` for anything else."""
        ...


def controlled_env(env: Any) -> ControlledEnv:
    """Unwrap an environment and check that the expert can control it.

    Args:
        env: a Gymnasium environment, wrapped or not, or any object with the `ControlledEnv` protocol.

    Raises:
        ExpertError: a vector environment, an environment without the protocol, or a wrapper that changes the action
            space.
    """
    if hasattr(env, "num_envs"):
        raise ExpertError(f"{type(env).__name__} is a vector environment; make one TampExpert for each of its parts")
    inner = getattr(env, "unwrapped", env)
    members = (*ControlledEnv.__annotations__, *ACTIONS.get(getattr(inner, "control_mode", ""), ()))
    if hasattr(type(inner), "goal"):
        members = tuple(name for name in members if name != "target")
    # Properties are looked up in the class without evaluation: `target` is defined after `reset` only.
    missing = [
        name for name in members if not hasattr(type(inner), name) and name not in getattr(inner, "__dict__", ())
    ]
    if missing:
        raise ExpertError(
            f"{type(inner).__name__} cannot be controlled, it lacks {', '.join(missing)}; TampExpert controls "
            "clutter_env/Retrieve-o{N}-v0 and environments with the ControlledEnv protocol"
        )
    if inner.control_mode not in ACTIONS:
        valid = ", ".join(map(repr, ACTIONS))
        raise ExpertError(f"control_mode={inner.control_mode!r} of {type(inner).__name__} is not one of {valid}")
    outer_space, inner_space = getattr(env, "action_space", None), getattr(inner, "action_space", None)
    if outer_space != inner_space:
        raise ExpertError(
            f"a wrapper changes the action space from {inner_space} to {outer_space}; remove that wrapper "
            "(RescaleAction, ClipAction, ...): the expert's actions are those of the environment itself"
        )
    return inner


def planner_for(
    env: ControlledEnv, planner: Any, grasps: Grasps | None, supports: Supports, **choices: bool | None
) -> Any:
    """Planner for an environment. Arguments and errors are those of `TampExpert`.

    An option of None leaves the planner's own. In control mode "ee", a `Planner` without a `follower` gets the
    environment's, since its motions are followed through TCP poses.
    """
    follower = env.tcp_follower() if env.control_mode == "ee" else None
    if planner is None:
        planner = Planner(env.robot, follower=follower)
    if isinstance(planner, type) or not callable(getattr(planner, "solve", None)):
        raise ExpertError(
            f"planner={planner!r} is not valid; it must be a Planner or an object with the method "
            "solve(scene, target, strategy, rng, time_limit)"
        )
    wanted = {"grasps": grasps, "supports": supports, **choices}
    chosen: dict[str, Any] = {name: choice for name, choice in wanted.items() if choice is not None}
    if not isinstance(planner, Planner):
        for name, choice in chosen.items():
            raise ExpertError(f"{name}={choice!r} is for a Planner, not for {type(planner).__name__}")
        return planner
    if planner.robot != env.robot:
        raise ExpertError(f"the planner is for robot {planner.robot.name!r}, the environment has {env.robot.name!r}")
    return replace(planner, follower=planner.follower or follower, **chosen)
