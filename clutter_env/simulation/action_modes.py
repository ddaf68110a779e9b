"""What the numbers of an action mean: joint velocities, or the base's and the TCP's velocities.

Both modes end in joint velocities, which `JointController.follow` carries out. The last number of every action is the
opening of the gripper.
"""

from __future__ import annotations

from typing import Protocol, TypeGuard

import numpy as np
from numpy.typing import ArrayLike, NDArray

from assets import ActingJoints, RobotSpec
from clutter_env.errors import ActionError
from clutter_env.simulation.control import ControlState, JointController, real_array
from clutter_env.simulation.ee_control import EndEffectorController

__all__ = ["ActionMode", "EndEffectorActions", "JointActions", "action_mode"]

_BASE, _TWIST = 3, 6
"""Numbers of an "ee" action before the gripper's: base velocity, TCP velocity."""

Vector = NDArray[np.float64]


class ActionMode(Protocol):
    """One meaning of the actions."""

    size: int
    """Numbers in an action."""
    wanted_tcp: list[float] | None
    """What the mode remembers between steps: the wanted TCP pose in the base frame, (7,) wxyz and xyz, if any."""

    def reset(self, state: ControlState) -> None:
        """Start from joint targets at rest."""

    def joint_velocity(self, action: Vector, state: ControlState) -> Vector:
        """Wanted joint velocities (4 + n,) of a checked action, base x and y in the base's frame."""


class JointActions:
    """ "joint": base forward, left, yaw rate, torso and arm joint rates, each a share of the maximum, and grippers."""

    wanted_tcp: list[float] | None = None

    def __init__(self, robot: RobotSpec) -> None:
        acting = ActingJoints.of(robot)
        self._max_velocity = np.array(acting.velocity)
        self.size = len(self._max_velocity) + acting.num_grippers

    def reset(self, state: ControlState) -> None:
        """Nothing to remember."""

    def joint_velocity(self, action: Vector, state: ControlState) -> Vector:  # noqa: ARG002  the protocol's signature
        """Wanted joint velocities (4 + n,) of a checked action (5 + n,), more with several arms."""
        velocity: Vector = action[: len(self._max_velocity)] * self._max_velocity
        return velocity


class EndEffectorActions:
    """ "ee": base forward, left, yaw rate; linear and angular TCP velocity in the base frame; gripper."""

    size = _BASE + _TWIST + 1

    def __init__(self, robot: RobotSpec, ik: str) -> None:
        self._max_base_velocity = np.array(robot.max_velocity[:_BASE])
        self._controller = EndEffectorController(robot, ik)

    @property
    def wanted_tcp(self) -> list[float] | None:
        """The wanted TCP pose in the base frame, (7,) wxyz and xyz."""
        return self._controller.wanted

    @wanted_tcp.setter
    def wanted_tcp(self, pose: list[float] | None) -> None:
        """Set the wanted TCP pose, for example that of a saved state."""
        assert pose is not None
        self._controller.wanted = pose

    def reset(self, state: ControlState) -> None:
        """Take the TCP pose of the joint targets as the wanted pose."""
        self._controller.reset(state.target[_BASE:])

    def joint_velocity(self, action: Vector, state: ControlState) -> Vector:
        """Wanted joint velocities (4 + n,) of a checked action (10,)."""
        base = action[:_BASE] * self._max_base_velocity
        twist = action[_BASE : _BASE + _TWIST]
        arm = self._controller.joint_velocity(twist, state.target[_BASE:], state.velocity[_BASE:])
        return np.concatenate((base, arm))

    def action_towards(
        self,
        controller: JointController,
        base_target: ArrayLike,
        T_world_tcp: ArrayLike,
        gripper_width: float,
        is_loaded: bool,
    ) -> Vector:
        """The action (10,) that brings base and TCP targets to these, or as near as one step allows.

        Args:
            controller: the joint controller, which knows the present targets.
            base_target: (3,) x, y [m], yaw [rad].
            T_world_tcp: (4, 4) TCP pose in the world once the base is at its target.
            gripper_width: [m] between the pads.
            is_loaded: whether an object is held.

        Raises:
            ActionError: not finite, or the wrong shape.
        """
        base, pose = real_array(base_target), real_array(T_world_tcp)
        if not (_is_finite(base, (3,)) and _is_finite(pose, (4, 4))):
            raise ActionError("ee_action takes base_target (3,) and T_world_tcp (4, 4), all finite numbers")
        goal = np.concatenate((base, controller.state.target[_BASE:]))
        velocity = controller.velocity_towards(goal, is_loaded)[:_BASE]
        drive = np.clip(velocity / self._max_base_velocity, -1.0, 1.0)
        twist = self._controller.twist_towards(np.linalg.inv(_planar_pose(base)) @ pose)
        return np.concatenate((drive, twist, [controller.grip_action(gripper_width)]))


def action_mode(name: str, robot: RobotSpec, ik: str = "direct") -> ActionMode:
    """The mode of this name, "joint" or "ee"; `ik` is the route of the inverse kinematics, "direct" or "mink"."""
    return EndEffectorActions(robot, ik) if name == "ee" else JointActions(robot)


def _is_finite(array: Vector | None, shape: tuple[int, ...]) -> TypeGuard[Vector]:
    """Whether it is an array of this shape without NaN and infinity."""
    return array is not None and array.shape == shape and bool(np.isfinite(array).all())


def _planar_pose(base: Vector) -> Vector:
    """T_world_base (4, 4) of a base at x, y, yaw."""
    pose = np.eye(4)
    cosine, sine = np.cos(base[2]), np.sin(base[2])
    pose[:2, :2] = ((cosine, -sine), (sine, cosine))
    pose[:2, 3] = base[:2]
    return pose
