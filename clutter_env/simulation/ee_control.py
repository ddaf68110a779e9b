"""End-effector actions: TCP velocities become torso and arm velocities by differential inverse kinematics."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from assets import RobotSpec
from clutter_env.simulation.control import CONTROL_STEP
from clutter_env.simulation.differential_ik import differential_ik
from clutter_env.simulation.pose_arithmetic import (
    Quaternion,
    Vector3,
    quaternion_of_matrix,
    rotation_vector_between,
    turned_by,
)

__all__ = ["EndEffectorController", "TcpFollower"]

Vector = NDArray[np.float64]

POSITION_LEAD, ROTATION_LEAD = 0.05, 0.25
"""[m], [rad]: how far the wanted TCP pose may be ahead of the TCP pose of the joint targets."""


class EndEffectorController:
    """Keeps a wanted TCP pose in the base frame and follows it with the torso and the arm.

    The action moves the wanted pose. It stays within `POSITION_LEAD` and `ROTATION_LEAD` of the pose that the joint
    targets have: when the action turns back from an unreachable pose, the arm follows at once.
    """

    def __init__(self, robot: RobotSpec, ik: str = "direct") -> None:
        self._ik = differential_ik(ik, robot)
        linear, angular = robot.max_tcp_velocity
        self._max_step = linear * CONTROL_STEP, angular * CONTROL_STEP
        self._position: Vector3 = (0.0, 0.0, 0.0)
        self._rotation: Quaternion = (1.0, 0.0, 0.0, 0.0)

    @property
    def wanted(self) -> list[float]:
        """The wanted TCP pose in the base frame, (7,): quaternion wxyz, position [m]."""
        return [*self._rotation, *self._position]

    @wanted.setter
    def wanted(self, pose: list[float]) -> None:
        """Set the wanted pose, for example that of a saved state."""
        w, qx, qy, qz, x, y, z = pose
        self._rotation, self._position = (w, qx, qy, qz), (x, y, z)

    def reset(self, q: Vector) -> None:
        """Take the TCP pose at the joint positions (1 + n,) as the wanted pose."""
        self._position, self._rotation = self._ik.tcp_at(q)

    def joint_velocity(self, twist: Vector, q: Vector, qd: Vector) -> Vector:
        """Torso and arm velocities (1 + n,) for the next control step.

        Args:
            twist: (6,) linear and angular TCP velocity in the base frame, each in [-1, 1] of the maximum.
            q: (1 + n,) the joint targets from which the step starts.
            qd: (1 + n,) their velocities.
        """
        position, rotation = self._ik.tcp_at(q)
        self._move(twist.tolist())
        self._stay_near(position, rotation)
        return self._ik.velocity(self._position, self._rotation, qd)

    def twist_towards(self, T_base_tcp: Vector) -> Vector:
        """The (6,) part of an action that moves the wanted pose towards `T_base_tcp` (4, 4); in one step if near."""
        x, y, z = self._position
        goal_x, goal_y, goal_z = T_base_tcp[:3, 3].tolist()
        goal_rotation = quaternion_of_matrix(T_base_tcp[:3, :3])
        turn = rotation_vector_between(self._rotation, goal_rotation)
        linear, angular = self._max_step
        twist = np.array((goal_x - x, goal_y - y, goal_z - z, *turn))
        twist[:3] /= linear
        twist[3:] /= angular
        return twist / max(1.0, float(np.abs(twist).max()))

    def _move(self, twist: list[float]) -> None:
        """Move the wanted pose by one step of a twist (6,), given as shares of the maximum."""
        linear, angular = self._max_step
        vx, vy, vz, wx, wy, wz = twist
        x, y, z = self._position
        self._position = (x + vx * linear, y + vy * linear, z + vz * linear)
        self._rotation = turned_by(self._rotation, (wx * angular, wy * angular, wz * angular))

    def _stay_near(self, position: Vector3, rotation: Quaternion) -> None:
        """Draw the wanted pose towards this one until it leads by no more than the allowed distance and angle."""
        x, y, z = (wanted - present for wanted, present in zip(self._position, position, strict=True))
        share = POSITION_LEAD / max(math.sqrt(x * x + y * y + z * z), POSITION_LEAD)
        self._position = (position[0] + share * x, position[1] + share * y, position[2] + share * z)
        x, y, z = rotation_vector_between(rotation, self._rotation)
        share = ROTATION_LEAD / max(math.sqrt(x * x + y * y + z * z), ROTATION_LEAD)
        self._rotation = turned_by(rotation, (share * x, share * y, share * z))


class TcpFollower:
    """Predicts how the joints follow end-effector actions: the controller without the physics.

    For planners that must know the configuration in which an arm follows end-effector actions.
    """

    def __init__(self, robot: RobotSpec, ik: str = "direct") -> None:
        self._controller = EndEffectorController(robot, ik)
        self.q = np.array(robot.home)
        self._qd = np.zeros_like(self.q)

    def reset(self, q: Vector) -> None:
        """Start at rest in a configuration (1 + n,)."""
        self.q = np.array(q, dtype=float)
        self._qd = np.zeros_like(self.q)
        self._controller.reset(self.q)

    def step(self, T_base_tcp: Vector) -> Vector:
        """The configuration (1 + n,) one control step later, on the way to a TCP pose (4, 4) in the base frame."""
        twist = np.clip(self._controller.twist_towards(T_base_tcp), -1.0, 1.0)
        self._qd = self._controller.joint_velocity(twist, self.q, self._qd)
        self.q = self.q + self._qd * CONTROL_STEP
        return self.q
