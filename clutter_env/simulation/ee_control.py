"""End-effector actions: TCP velocities become torso and arm velocities through mink on a robot-only model."""

from __future__ import annotations

import mink
import mujoco
import numpy as np
from numpy.typing import NDArray

from assets.robots import RobotSpec
from clutter_env.simulation.control import CONTROL_STEP

__all__ = ["EndEffectorController", "TcpFollower"]

Vector = NDArray[np.float64]

POSITION_LEAD, ROTATION_LEAD = 0.05, 0.25
"""[m], [rad]: how far the wanted TCP pose may be ahead of the TCP pose of the joint targets."""
_CONFIGURATION_COST = 1e-2
"""Against 1 for the TCP: enough to choose among redundant configurations, too small to move the TCP noticeably."""
_TORSO_COST = 0.1
"""The same for the torso lift: it stays up, which keeps the elbow above the table."""
_FRAME_GAIN, _CONFIGURATION_GAIN = 0.6, 0.05
"""Share of the error to remove in one step; joints of limited acceleration overshoot when asked for all of it."""
_FRAME_DAMPING = 1e-3
_SOLVER_DAMPING = 1e-6
_LIMIT_MARGIN = 1e-6
"""[rad], [m] The start of a solve is kept this far inside the joint limits."""


class EndEffectorController:
    """Keeps a wanted TCP pose in the base frame and follows it with the torso and the arm.

    The action moves the wanted pose. It stays within `POSITION_LEAD` and `ROTATION_LEAD` of the pose that the joint
    targets have: when the action turns back from an unreachable pose, the arm follows at once.
    """

    def __init__(self, robot: RobotSpec) -> None:
        self._model = _arm_model(robot)
        self._robot = robot
        self._configuration = mink.Configuration(self._model)
        self._frame_task = mink.FrameTask(
            robot.tcp_site,
            "site",
            position_cost=1.0,
            orientation_cost=1.0,
            gain=_FRAME_GAIN,
            lm_damping=_FRAME_DAMPING,
        )
        costs = np.array([_TORSO_COST, *[_CONFIGURATION_COST] * (len(robot.chain) - 1)])
        configuration_task = mink.PostureTask(self._model, cost=costs, gain=_CONFIGURATION_GAIN)
        configuration_task.set_target(np.array(robot.home))
        self._tasks = [self._frame_task, configuration_task]
        self._limit = _MotionLimit(robot)
        self._speed = np.repeat(robot.max_tcp_velocity, 3)
        self._lower = np.array([link.lower for link in robot.chain]) + _LIMIT_MARGIN
        self._upper = np.array([link.upper for link in robot.chain]) - _LIMIT_MARGIN
        self.wanted = np.array([1.0, 0, 0, 0, 0, 0, 0])

    def reset(self, q: Vector) -> None:
        """Take the TCP pose at the joint positions (1 + n,) as the wanted pose."""
        self.wanted = self._tcp_at(q).wxyz_xyz.copy()

    def joint_velocity(self, twist: Vector, q: Vector, qd: Vector) -> Vector:
        """Torso and arm velocities (1 + n,) for the next control step.

        Args:
            twist: (6,) linear and angular TCP velocity in the base frame, each in [-1, 1] of the maximum.
            q: (1 + n,) the joint targets from which the step starts.
            qd: (1 + n,) their velocities.
        """
        present = self._tcp_at(q)
        moved = _moved(mink.SE3(self.wanted), twist * self._speed * CONTROL_STEP)
        self.wanted = _near(present, moved).wxyz_xyz.copy()
        self._frame_task.set_target(mink.SE3(self.wanted))
        self._limit.velocity = qd
        try:
            velocity = mink.solve_ik(
                self._configuration,
                self._tasks,
                CONTROL_STEP,
                solver="daqp",
                damping=_SOLVER_DAMPING,
                limits=[self._limit],
            )
        except mink.NoSolutionFound:
            return np.zeros_like(q)
        return np.asarray(velocity)

    def twist_towards(self, T_base_tcp: Vector) -> Vector:
        """The (6,) part of an action that moves the wanted pose towards `T_base_tcp` (4, 4); in one step if near."""
        goal, wanted = mink.SE3.from_matrix(T_base_tcp), mink.SE3(self.wanted)
        linear = goal.translation() - wanted.translation()
        angular = (goal.rotation() @ wanted.rotation().inverse()).log()
        twist = np.concatenate((linear, angular)) / (self._speed * CONTROL_STEP)
        return twist / max(1.0, float(np.abs(twist).max()))

    def _tcp_at(self, q: Vector) -> mink.SE3:
        self._configuration.update(np.clip(q, self._lower, self._upper))
        return self._configuration.get_transform_frame_to_world(self._robot.tcp_site, "site")


class TcpFollower:
    """Predicts how the joints follow end-effector actions: the controller without the physics.

    For planners that must know the configuration in which an arm follows end-effector actions.
    """

    def __init__(self, robot: RobotSpec) -> None:
        self._controller = EndEffectorController(robot)
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


class _MotionLimit(mink.Limit):  # type: ignore[misc]  # mink has no types that mypy follows
    """Joint velocities that keep the limits of position, velocity and acceleration, and leave room to brake."""

    def __init__(self, robot: RobotSpec) -> None:
        chain = robot.chain
        self._lower = np.array([link.lower for link in chain])
        self._upper = np.array([link.upper for link in chain])
        self._max_velocity = np.array(robot.max_velocity[3:])
        self._max_acceleration = np.array(robot.max_acceleration[3:])
        self._rows = np.vstack((np.eye(len(chain)), -np.eye(len(chain))))
        self.velocity = np.zeros(len(chain))

    def compute_qp_inequalities(self, configuration: mink.Configuration, dt: float) -> mink.Constraint:
        """Bounds on the displacement, (2 (1 + n), 1 + n) and (2 (1 + n),)."""
        change = self._max_acceleration * dt
        highest = np.minimum(self.velocity + change, self._fastest(self._upper - configuration.q, dt))
        lowest = np.maximum(self.velocity - change, -self._fastest(configuration.q - self._lower, dt))
        return mink.Constraint(self._rows, np.concatenate((np.maximum(highest, lowest), -lowest)) * dt)

    def _fastest(self, distance: Vector, dt: float) -> Vector:
        """The velocity from which the joint can still stop within this distance."""
        half = self._max_acceleration * dt / 2
        braking = np.sqrt(half**2 + 2 * self._max_acceleration * np.maximum(distance, 0.0)) - half
        fastest: Vector = np.minimum(braking, self._max_velocity)
        return fastest


def _moved(pose: mink.SE3, step: Vector) -> mink.SE3:
    """The pose after a displacement (6,) of its origin [m] and a rotation vector [rad], both in the base frame."""
    rotation = mink.SO3.exp(step[3:]) @ pose.rotation()
    return mink.SE3.from_rotation_and_translation(rotation, pose.translation() + step[:3])


def _near(present: mink.SE3, wanted: mink.SE3) -> mink.SE3:
    """`wanted`, drawn towards `present` until it leads by no more than the allowed distance and angle."""
    linear = wanted.translation() - present.translation()
    angular = (wanted.rotation() @ present.rotation().inverse()).log()
    linear *= min(1.0, POSITION_LEAD / max(float(np.linalg.norm(linear)), POSITION_LEAD))
    angular *= min(1.0, ROTATION_LEAD / max(float(np.linalg.norm(angular)), ROTATION_LEAD))
    return _moved(present, np.concatenate((linear, angular)))


def _arm_model(robot: RobotSpec) -> mujoco.MjModel:
    """The robot alone, its base, head and fingers fixed: q is torso and arm, as in `RobotSpec`."""
    spec = mujoco.MjSpec.from_file(str(robot.mjcf_path))
    for part in [*spec.actuators, *spec.equalities]:
        spec.delete(part)
    for joint in (*robot.base_joints, *robot.head_joints, *robot.finger_joints):
        spec.delete(spec.joint(joint))
    return spec.compile()
