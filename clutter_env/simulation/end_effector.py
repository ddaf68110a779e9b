"""End-effector control: TCP velocities become torso and arm velocities by differential inverse kinematics with mink.

A step solves one quadratic programme of mink's: the TCP follows the wanted pose, weakly the joints keep to the home
configuration, and the limits of position, velocity and acceleration bound every joint.
"""

from __future__ import annotations

import math
from ctypes import c_int
from typing import Any

import daqp
import mink
import mujoco
import numpy as np
from numpy.typing import NDArray

from assets import RobotSpec
from clutter_env.simulation.control import CONTROL_STEP

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
_SOLVER_TOLERANCE = 1e-10
"""[rad], [m] by which a displacement may exceed its bounds."""
_LIMIT_MARGIN = 1e-6
"""[rad], [m] The start of a solve is kept this far inside the joint limits."""

_UP_AND_DOWN = np.array([[1.0], [-1.0]])


class EndEffectorController:
    """Keeps a wanted TCP pose in the base frame and follows it with the torso and the arm.

    The action moves the wanted pose. It stays within `POSITION_LEAD` and `ROTATION_LEAD` of the pose that the joint
    targets have: when the action turns back from an unreachable pose, the arm follows at once.

    Attributes:
        failures: steps since `reset` in which the solver found nothing; the arm brakes in these.
    """

    def __init__(self, robot: RobotSpec) -> None:
        model = _arm_model(robot)
        self._site = robot.tcp_site
        self._max_step = np.repeat(robot.max_tcp_velocity, 3) * CONTROL_STEP
        self._configuration = mink.Configuration(model)
        self._frame_task = mink.FrameTask(
            robot.tcp_site,
            "site",
            position_cost=1.0,
            orientation_cost=1.0,
            gain=_FRAME_GAIN,
            lm_damping=_FRAME_DAMPING,
        )
        costs = [_TORSO_COST, *[_CONFIGURATION_COST] * (len(robot.chain) - 1)]
        configuration_task = mink.PostureTask(model, cost=costs, gain=_CONFIGURATION_GAIN)
        configuration_task.set_target(np.array(robot.home))
        self._tasks = [self._frame_task, configuration_task]
        self._limit = _MotionLimit(robot)
        self._wanted = mink.SE3.identity()
        self.failures = 0

    @property
    def wanted(self) -> list[float]:
        """The wanted TCP pose in the base frame, (7,): quaternion wxyz, position [m]."""
        return self._wanted.wxyz_xyz.tolist()

    @wanted.setter
    def wanted(self, pose: list[float]) -> None:
        """Set the wanted pose, for example that of a saved state."""
        self._wanted = mink.SE3(np.array(pose))

    def reset(self, q: Vector) -> None:
        """Take the TCP pose at the joint positions (1 + n,) as the wanted pose."""
        self._wanted, self.failures = self._tcp_at(q), 0

    def joint_velocity(self, twist: Vector, q: Vector, qd: Vector) -> Vector:
        """Torso and arm velocities (1 + n,) for the next control step, zeros if the solver finds none.

        Args:
            twist: (6,) linear and angular TCP velocity in the base frame, each in [-1, 1] of the maximum.
            q: (1 + n,) the joint targets from which the step starts.
            qd: (1 + n,) their velocities.
        """
        present = self._tcp_at(q)
        step = twist * self._max_step
        # Translation and rotation apart, both along the axes of the base: not the screw motion of SE3.exp.
        position = self._wanted.translation() + step[:3]
        rotation = mink.SO3.exp(step[3:]) @ self._wanted.rotation()
        lead = position - present.translation()
        if (distance := math.hypot(*lead)) > POSITION_LEAD:
            position = present.translation() + lead * (POSITION_LEAD / distance)
        turn = (rotation @ present.rotation().inverse()).log()
        if (angle := math.hypot(*turn)) > ROTATION_LEAD:
            rotation = mink.SO3.exp(turn * (ROTATION_LEAD / angle)) @ present.rotation()
        self._wanted = mink.SE3.from_rotation_and_translation(rotation.normalize(), position)
        self._frame_task.set_target(self._wanted)
        problem = mink.build_ik(self._configuration, self._tasks, CONTROL_STEP, _SOLVER_DAMPING, limits=[])
        # `mink.solve_ik` does the same, with copies and checks that take a third of the whole.
        displacement, _, outcome, _ = daqp.solve(
            problem.P, problem.q, *self._limit.inequalities(self._configuration.q, qd), primal_tol=_SOLVER_TOLERANCE
        )
        if outcome <= 0:
            self.failures += 1
            return np.zeros_like(qd)
        velocity: Vector = displacement / CONTROL_STEP
        return velocity

    def twist_towards(self, T_base_tcp: Vector) -> Vector:
        """The (6,) part of an action that moves the wanted pose towards `T_base_tcp` (4, 4); in one step if near."""
        goal = mink.SE3.from_matrix(T_base_tcp)
        turn = (goal.rotation() @ self._wanted.rotation().inverse()).log()
        twist: Vector = np.concatenate((goal.translation() - self._wanted.translation(), turn)) / self._max_step
        return twist / max(1.0, float(np.abs(twist).max()))

    def position(self, q: Vector) -> Vector:
        """Position (3,) [m] of the TCP in the base frame at the joint positions (1 + n,)."""
        return np.asarray(self._tcp_at(q).translation())

    def _tcp_at(self, q: Vector) -> mink.SE3:
        """The TCP pose in the base frame at the joint positions (1 + n,), from which the next solve starts."""
        self._configuration.update(self._limit.inside(q))
        return self._configuration.get_transform_frame_to_world(self._site, "site")


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
        """The configuration (1 + n,) one control step later, on the path to a TCP pose (4, 4) in the base frame."""
        twist = np.clip(self._controller.twist_towards(T_base_tcp), -1.0, 1.0)
        self._qd = self._controller.joint_velocity(twist, self.q, self._qd)
        self.q = self.q + self._qd * CONTROL_STEP
        return self.q


class _MotionLimit:
    """Joint limits of position, velocity and acceleration, with distance left to brake; mink's limits lack the last."""

    def __init__(self, robot: RobotSpec) -> None:
        lower, upper = np.array([(link.lower, link.upper) for link in robot.chain]).T
        self._first, self._last = lower + _LIMIT_MARGIN, upper - _LIMIT_MARGIN
        self._ends = np.stack((upper, -lower))
        self._max_velocity = np.array(robot.max_velocity[3:])
        self._twice_acceleration = 2 * np.array(robot.max_acceleration[3:])
        self._change = self._twice_acceleration / 2 * CONTROL_STEP
        self._half, self._half_squared = self._change / 2, (self._change / 2) ** 2
        self._rows = np.vstack((np.eye(len(lower)), -np.eye(len(lower))))
        # DAQP's other two arguments: no lower bounds, and every row an inequality.
        self._no_bound, self._sense = np.full(len(self._rows), -1e30), np.zeros(len(self._rows), c_int)

    def inside(self, q: Vector) -> Vector:
        """The configuration (1 + n,), clipped to the joint limits less a margin."""
        return np.minimum(np.maximum(q, self._first), self._last)

    def inequalities(self, q: Vector, qd: Vector) -> tuple[NDArray[Any], ...]:
        """Bounds on a step's displacement from `q` with the velocities `qd`, as DAQP takes them.

        Rows (2 (1 + n), 1 + n), their upper and lower bounds and their kinds, each (2 (1 + n),).
        """
        # From these velocities, up and down, the joints can still stop within the distances to their limits.
        distances = np.maximum(self._ends - _UP_AND_DOWN * q, 0.0)
        braking = np.sqrt(self._half_squared + self._twice_acceleration * distances) - self._half
        upwards, downwards = np.minimum(braking, self._max_velocity)
        lowest = np.maximum(qd - self._change, -downwards)
        highest = np.maximum(np.minimum(qd + self._change, upwards), lowest)
        return self._rows, np.concatenate((highest, -lowest)) * CONTROL_STEP, self._no_bound, self._sense


def _arm_model(robot: RobotSpec) -> mujoco.MjModel:
    """The robot alone, its base, head and fingers fixed: q is torso and arm, as in `RobotSpec`."""
    spec = mujoco.MjSpec.from_file(str(robot.mjcf_path))
    for part in [*spec.actuators, *spec.equalities]:
        spec.delete(part)
    for joint in (*robot.base_joints, *robot.still_joints, *robot.finger_joints):
        spec.delete(spec.joint(joint))
    return spec.compile()
