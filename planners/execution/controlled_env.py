"""The environments that the expert can control."""

from __future__ import annotations

from typing import Any, Protocol

import mujoco
import numpy as np
from numpy.typing import NDArray

from assets.robots import RobotSpec
from planners.execution.errors import ExpertError
from planners.motion.tcp_following import TcpFollower

__all__ = ["CONTROL_MODES", "ControlledEnv", "controlled_env", "num_disturbances"]

Array = NDArray[np.float64]

CONTROL_MODES = ("joint", "ee")
"""Joint targets, or TCP poses that the environment's controller turns into joint targets."""

_MEMBERS = (
    "model",
    "data",
    "robot",
    "control_mode",
    "object_names",
    "support_name",
    "target",
    "lift_height",
    "joint_action",
    "ee_action",
    "tcp_follower",
)
_ADVICE = "TampExpert controls clutter_env/Retrieve-o{N}-v0 and environments with the ControlledEnv protocol"


class ControlledEnv(Protocol):
    """All that the expert uses of an environment (`env.unwrapped`). One step is one control step of 0.05 s."""

    @property
    def model(self) -> mujoco.MjModel:
        """The simulated world; the expert only reads it."""
        ...

    @property
    def data(self) -> mujoco.MjData:
        """The state of the simulated world; the expert only reads it."""
        ...

    @property
    def robot(self) -> RobotSpec:
        """The robot in `model`."""
        ...

    @property
    def control_mode(self) -> str:
        """What the actions are, one of `CONTROL_MODES`: "joint" calls for `joint_action`, "ee" for `ee_action`."""
        ...

    @property
    def object_names(self) -> tuple[str, ...]:
        """Names of the bodies that the robot may move, in the order of the bodies of `model`."""
        ...

    @property
    def support_name(self) -> str:
        """Name of the geom on whose top face the objects stand."""
        ...

    @property
    def target(self) -> str:
        """Name of the object to retrieve; raises a ValueError before the environment's first `reset`."""
        ...

    @property
    def lift_height(self) -> float:
        """[m] between the support that the target stood on and its lowest point, from which it counts as lifted."""
        ...

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
    missing = [name for name in _MEMBERS if not _has(inner, name)]
    if missing:
        raise ExpertError(f"{type(inner).__name__} cannot be controlled, it lacks {', '.join(missing)}; {_ADVICE}")
    if inner.control_mode not in CONTROL_MODES:
        valid = ", ".join(map(repr, CONTROL_MODES))
        raise ExpertError(f"control_mode={inner.control_mode!r} of {type(inner).__name__} is not one of {valid}")
    outer_space, inner_space = getattr(env, "action_space", None), getattr(inner, "action_space", None)
    if outer_space != inner_space:
        raise ExpertError(
            f"a wrapper changes the action space from {inner_space} to {outer_space}; remove that wrapper "
            "(RescaleAction, ClipAction, ...): the expert's actions are those of the environment itself"
        )
    return inner


def num_disturbances(env: ControlledEnv) -> int | None:
    """Objects that have fallen plus objects that have been disturbed, as the environment counts them.

    Args:
        env: counts if it has a property `info` with `num_fallen` and `num_disturbed`, as `clutter_env`'s have.

    Returns:
        The sum, in which an object may be counted twice; None if the environment does not count.
    """
    info = getattr(env, "info", None)
    if info is None or not {"num_fallen", "num_disturbed"} <= info.keys():
        return None
    return int(info["num_fallen"]) + int(info["num_disturbed"])


def _has(env: object, name: str) -> bool:
    """Whether an environment has a member; properties are not evaluated, since some are defined after `reset` only."""
    return hasattr(type(env), name) or name in getattr(env, "__dict__", ())
