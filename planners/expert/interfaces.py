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
"""Methods for each control mode: joint targets, or TCP poses that the environment's controller turns into such."""


class ControlledEnv(Protocol):
    """All that the expert uses of an environment (`env.unwrapped`); `ControlledWorld` makes one of a `Controller`.

    One step is one control step of 0.05 s, or of its attribute `dt` [s]. A true attribute `waits_for_tcp` lets the
    expert wait for an arm that stays behind, as it does in control mode "ee". Only the actions of its own control mode
    are asked for. Where the world is not known exactly and at once, `perceived` has the `model` and the `data` to read
    in place of the true ones, `pose_accuracy` [m] is the error of object poses to expect, and `latency` the steps until
    a command shows.

    Attributes:
        model: the simulated world; the expert only reads it.
        data: the state of the simulated world; the expert only reads it.
        robot: the robot in `model`.
        control_mode: kind of the actions, a key of `ACTIONS`: "joint" calls for `joint_action`, "ee" for
            `ee_action`.
        object_names: of the bodies that the robot may move, in the order of the bodies of `model`.
        support_name: of the geom on whose top face the objects stand.
        target: name of the object to retrieve, unless the environment has a `planners.goals.Goal` as its
            `planning_goal` or `goal`, and the `regions` that it names; raises a ValueError before the environment's
            first `reset`.
        lift_height: [m] between the support that the target stood on and its lowest point, from which it counts as
            lifted.
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
        """The action that moves the robot to a whole-body configuration.

        Args:
            q_target: (4 + n,) base x, y [m], yaw [rad], torso [m], arm [rad]; then the other arms of a robot that acts
                with several, in the order of `robot.acting_arms`.
            gripper_width: [m] between the finger pads; one number for each arm of such a robot.
        """
        ...

    def ee_action(self, base_target: Array, T_world_tcp: Array, gripper_width: float) -> Array:
        """The action that moves base and TCP to poses.

        Args:
            base_target: (3,) x, y [m], yaw [rad].
            T_world_tcp: (4, 4).
            gripper_width: [m] between the finger pads.
        """
        ...

    def tcp_follower(self) -> TcpFollower:
        """A model of the joint angles that the controller chooses in control mode "ee"."""
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
        """Plan for a goal: the name of the object to take, or a `planners.goals.Goal` if it is anything else."""
        ...


def controlled_env(env: Any) -> ControlledEnv:
    """The environment inside its wrappers, if the expert can control it.

    Args:
        env: a Gymnasium environment, wrapped or not, or any object with the `ControlledEnv` protocol.

    Raises:
        ExpertError: a vector environment, one without the protocol, or a wrapper that changes the action space.
    """
    if hasattr(env, "num_envs"):
        raise ExpertError(f"{type(env).__name__} is a vector environment; make one TampExpert for each of its parts")
    inner = getattr(env, "unwrapped", env)
    members = (*ControlledEnv.__annotations__, *ACTIONS.get(getattr(inner, "control_mode", ""), ()))
    if hasattr(type(inner), "goal"):
        members = tuple(name for name in members if name != "target")
    # Properties are looked up in the class and not evaluated: `target` is defined after `reset` only.
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
    """The planner to use in an environment; arguments and errors are those of `TampExpert`.

    A choice that is None leaves the planner as it is. In control mode "ee" a `Planner` without a `follower` gets that
    of the environment, since its motions are followed through TCP poses.
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
