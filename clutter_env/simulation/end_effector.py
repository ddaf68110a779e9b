"""End-effector control: TCP velocities become torso and arm velocities by differential inverse kinematics with mink.

Each step solves one quadratic programme of mink. The TCP follows the desired pose, and with a small weight the joints
stay near the home configuration. Limits of position, velocity and acceleration bound every joint, and the robot avoids
self-collision.

MuJoCo multiplies the matrices. NumPy's products use a BLAS, and some NumPy functions use vector code. Their last bits
differ between processors, so recorded actions would not have the same result on another processor.
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
from clutter_env.simulation.self_avoidance import SelfAvoidance

Vector = NDArray[np.float64]

POSITION_LEAD, ROTATION_LEAD = 0.05, 0.25
"""[m], [rad]: largest lead of the desired TCP pose over the TCP pose of the joint targets."""
_CONFIGURATION_COST = 1e-2
"""Relative to 1 for the TCP: enough to choose among redundant configurations, too small to move the TCP noticeably."""
_TORSO_COST = 0.1
"""The same for the torso lift. The lift stays up, which keeps the elbow above the table."""
_FRAME_GAIN, _CONFIGURATION_GAIN = 0.6, 0.05
"""Share of the error to remove in one step. Joints with limited acceleration overshoot if asked for the whole error."""
_FRAME_DAMPING = 1e-3
_SOLVER_DAMPING = 1e-6
_SOLVER_TOLERANCE = 1e-10
"""[rad], [m] by which a displacement may exceed its bounds."""
_LIMIT_MARGIN = 1e-6
"""[rad], [m] The start of a solve is kept this far inside the joint limits."""

_SOFT = 8
"""DAQP's flag of a soft inequality, which is violated if no displacement satisfies all of them."""

_TWIST = 6
"""Length of the TCP's twist."""
_NO_TWIST = np.zeros(_TWIST).tobytes()
_IDENTITY = np.eye(_TWIST)


class EndEffectorController:
    """Keeps a desired TCP pose in the base frame and follows it with the torso and the arm.

    The action moves the desired pose. This pose stays within `POSITION_LEAD` and `ROTATION_LEAD` of the TCP pose of the
    joint targets. So when the action turns back from an unreachable pose, the arm follows at once.

    Attributes:
        failures: steps since `reset` in which the solver found no solution. The arm brakes in these steps.
    """

    def __init__(self, robot: RobotSpec) -> None:
        model = _arm_model(robot)
        self._site = model.site(robot.tcp_site).id
        self._max_step = np.repeat(robot.max_tcp_velocity, 3) * CONTROL_STEP
        self._configuration = _TcpConfiguration(model)
        self._frame_task = mink.FrameTask(
            self._site,
            "site",
            position_cost=1.0,
            orientation_cost=1.0,
            gain=_FRAME_GAIN,
            lm_damping=_FRAME_DAMPING,
        )
        self._home, self._costs = np.array(robot.home), np.full(model.nv, _CONFIGURATION_COST)
        self._costs[0] = _TORSO_COST
        self._stiffness = self._costs**2
        self._pull = _CONFIGURATION_GAIN * self._stiffness
        # Arrays of a step, allocated once.
        hessian, (linear, angular), own = np.empty((model.nv,) * 2), np.empty((2, 3, model.nv)), np.empty((6, model.nv))
        self._jacobians = linear, angular, own, own[:3], own[3:]
        self._arrays = np.empty((_TWIST, model.nv)), hessian, np.empty(model.nv), hessian.reshape(-1)[:: model.nv + 1]
        self._limit, self._avoidance = _MotionLimit(robot), SelfAvoidance(model, robot)
        self._wanted = mink.SE3.identity().wxyz_xyz.copy()
        self.failures = 0
        self._last: tuple[tuple[bytes, ...], Vector] = (), np.zeros(model.nv)

    @property
    def wanted(self) -> list[float]:
        """Desired TCP pose in the base frame, (7,): quaternion wxyz, position [m]."""
        return self._wanted.tolist()

    @wanted.setter
    def wanted(self, pose: list[float]) -> None:
        """Set the desired pose, for example that of a saved state."""
        self._wanted = np.array(pose)

    def reset(self, q: Vector) -> None:
        """Make the TCP pose at the joint positions (1 + n,) the desired pose."""
        self._wanted, self.failures = self._tcp_at(q), 0

    def joint_velocity(self, twist: Vector, q: Vector, qd: Vector) -> Vector:
        """Torso and arm velocities (1 + n,) for the next control step, zeros if the solver finds none.

        Args:
            twist: (6,) linear and angular TCP velocity in the base frame, each in [-1, 1] of the maximum.
            q: (1 + n,) the joint targets from which the step starts.
            qd: (1 + n,) their velocities.
        """
        given = (q.tobytes(), qd.tobytes(), self._wanted.tobytes()) if twist.tobytes() == _NO_TWIST else None
        if given is not None and given == self._last[0]:  # an arm at rest: the problem and its solution are unchanged
            return self._last[1].copy()
        present = self._tcp_at(q)
        step = twist * self._max_step
        # Translation and rotation are separate, both along the axes of the base, unlike the screw motion of SE3.exp.
        self._wanted[:4] = _turned(self._wanted[:4], step[3:])
        self._wanted[4:] += step[:3]
        lead = self._wanted[4:] - present[4:]
        if (distance := math.hypot(*lead.tolist())) > POSITION_LEAD:
            self._wanted[4:] = present[4:] + lead * (POSITION_LEAD / distance)
        turn = _rotation_between(present[:4], self._wanted[:4])
        if (angle := math.hypot(*turn.tolist())) > ROTATION_LEAD:
            self._wanted[:4] = _turned(present[:4], turn * (ROTATION_LEAD / angle))
        mujoco.mju_normalize4(self._wanted[:4])
        self._frame_task.set_target(mink.SE3(self._wanted))
        q = self._configuration.q
        lowest, highest = self._limit.bounds(q, qd)
        near, approach = self._avoidance.inequalities(self._configuration.data, qd, lowest, highest)
        # `mink.solve_ik` does the same, with copies and checks that take more than half of its time.
        displacement, _, outcome, _ = daqp.solve(
            *self._objective(q),
            *self._limit.inequalities(lowest, highest, near, approach),
            primal_tol=_SOLVER_TOLERANCE,
        )
        if outcome <= 0:
            self.failures += 1
            return np.zeros_like(qd)
        velocity: Vector = displacement / CONTROL_STEP
        if given is not None and given[2] == self._wanted.tobytes():
            self._last = given, velocity.copy()
        return velocity

    def twist_towards(self, T_base_tcp: Vector) -> Vector:
        """Action part (6,) that moves the desired pose towards `T_base_tcp` (4, 4). A near pose is reached in one
        step."""
        goal = mink.SE3.from_matrix(T_base_tcp).wxyz_xyz
        turn = _rotation_between(self._wanted[:4], goal[:4])
        twist: Vector = np.concatenate((goal[4:] - self._wanted[4:], turn)) / self._max_step
        return twist / max(1.0, float(np.abs(twist).max()))

    def position(self, q: Vector) -> Vector:
        """Position (3,) [m] of the TCP in the base frame at the joint positions (1 + n,)."""
        return self._tcp_at(q)[4:]

    def _tcp_at(self, q: Vector) -> Vector:
        """TCP pose in the base frame at the joint positions (1 + n,). The next solve starts from this configuration."""
        self._configuration.update(self._limit.inside(q))
        return self._configuration.get_transform_frame_to_world(self._site, "site").wxyz_xyz

    def _objective(self, q: Vector) -> tuple[Vector, Vector]:
        """Quadratic and linear parts of the cost of a displacement from `q`, as in `mink.build_ik`."""
        configuration, task = self._configuration, self._frame_task
        error, (jacobian, hessian, gradient, diagonal) = task.compute_error(configuration), self._arrays
        mujoco.mju_mulMatMat(jacobian, task.compute_jacobian(configuration), self._tcp_jacobian())
        mujoco.mju_mulMatTMat(hessian, jacobian, jacobian)
        mujoco.mju_mulMatTVec(gradient, jacobian, error)
        damping = _SOLVER_DAMPING + _FRAME_DAMPING * _FRAME_GAIN**2 * mujoco.mju_dot(error, error)
        diagonal += self._stiffness + damping
        return hessian, _FRAME_GAIN * gradient + self._pull * (q - self._home)

    def _tcp_jacobian(self) -> Vector:
        """Jacobian (6, 1 + n) of the TCP's twist with respect to the joints, in the frame of the TCP."""
        data, (linear, angular, own, own_linear, own_angular) = self._configuration.data, self._jacobians
        mujoco.mj_jacSite(self._configuration.model, data, linear, angular, self._site)
        rotation = data.site_xmat[self._site].reshape(3, 3)
        mujoco.mju_mulMatTMat(own_linear, rotation, linear)
        mujoco.mju_mulMatTMat(own_angular, rotation, angular)
        return own


class _TcpConfiguration(mink.Configuration):  # type: ignore[misc]  # mink is not typed for mypy
    """A configuration whose frame tasks use the Jacobian with respect to the frame's own twist. The joints' Jacobian is
    applied separately."""

    def get_frame_jacobian(self, frame_name: str | int, frame_type: str) -> Vector:  # noqa: ARG002
        """Identity (6, 6), the Jacobian of a twist with respect to itself. mink's product with it is exact in any
        BLAS."""
        return _IDENTITY


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
        """Configuration (1 + n,) one control step later, on the path to a TCP pose (4, 4) in the base frame."""
        twist = np.clip(self._controller.twist_towards(T_base_tcp), -1.0, 1.0)
        self._qd = self._controller.joint_velocity(twist, self.q, self._qd)
        self.q = self.q + self._qd * CONTROL_STEP
        return self.q


class _MotionLimit:
    """Joint limits of position, velocity and acceleration that keep braking distance. mink's limits do not keep it."""

    def __init__(self, robot: RobotSpec) -> None:
        lower, upper = np.array([(link.lower, link.upper) for link in robot.chain]).T
        self._first, self._last = lower + _LIMIT_MARGIN, upper - _LIMIT_MARGIN
        half, double = np.array(robot.max_acceleration[3:]) * CONTROL_STEP / 2, 2 * np.array(robot.max_acceleration[3:])
        of_joints = lower, upper, robot.max_velocity[3:], 2 * half, half, half**2, double
        self._joints: list[tuple[float, ...]] = np.column_stack(of_joints).tolist()
        self._rows = np.vstack((np.eye(len(lower)), -np.eye(len(lower))))
        # DAQP's other two arguments: no lower bounds, and every row an inequality.
        self._no_bound, self._sense = np.full(len(self._rows), -1e30), np.zeros(len(self._rows), c_int)

    def inside(self, q: Vector) -> Vector:
        """Configuration (1 + n,), clipped to the joint limits with a margin."""
        return np.minimum(np.maximum(q, self._first), self._last)

    def bounds(self, q: Vector, qd: Vector) -> tuple[Vector, Vector]:
        """Lowest and highest displacement (1 + n,) of a step from `q` with the velocities `qd`."""
        # The loop treats each joint separately. NumPy's functions on such short vectors take twice as long.
        lowest, highest = list[float](), list[float]()
        for bounds, position, speed in zip(self._joints, q.tolist(), qd.tolist(), strict=True):
            lower, upper, fastest, change, half, half_squared, double = bounds
            # At these speeds, up and down, the joint can still stop within the distances to its limits.
            up = math.sqrt(half_squared + double * max(upper - position, 0.0)) - half
            down = math.sqrt(half_squared + double * max(position - lower, 0.0)) - half
            least = max(speed - change, -min(down, fastest))
            lowest.append(least * CONTROL_STEP)
            highest.append(max(min(speed + change, up, fastest), least) * CONTROL_STEP)
        return np.array(lowest), np.array(highest)

    def inequalities(self, lowest: Vector, highest: Vector, rows: Vector, most: Vector) -> tuple[NDArray[Any], ...]:
        """Bounds on a step's displacement in DAQP's form: those of `bounds`, and `rows` (k, 1 + n) times it.

        Return rows (2 (1 + n) + k, 1 + n), their upper and lower bounds and their kinds.
        """
        if not len(rows):
            return self._rows, np.concatenate((highest, -lowest)), self._no_bound, self._sense
        return (
            np.concatenate((self._rows, rows)),
            np.concatenate((highest, -lowest, most)),
            np.full(len(self._rows) + len(rows), -1e30),
            np.concatenate((self._sense, np.full(len(rows), _SOFT, c_int))),
        )


def _turned(quaternion: Vector, turn: Vector) -> Vector:
    """The quaternion wxyz, turned by a rotation vector (3,) [rad] about the fixed axes."""
    axis, rotation, turned = turn.copy(), np.empty(4), np.empty(4)
    mujoco.mju_axisAngle2Quat(rotation, axis, mujoco.mju_normalize3(axis))
    mujoco.mju_mulQuat(turned, rotation, quaternion)
    return turned


def _rotation_between(start: Vector, end: Vector) -> Vector:
    """The rotation vector (3,) [rad] about the fixed axes from one quaternion wxyz to another."""
    inverse, difference, turn = np.empty(4), np.empty(4), np.empty(3)
    mujoco.mju_negQuat(inverse, start)
    mujoco.mju_mulQuat(difference, end, inverse)
    mujoco.mju_quat2Vel(turn, difference, 1.0)
    return turn


def _arm_model(robot: RobotSpec) -> mujoco.MjModel:
    """Model of the robot alone, with base, head, idle arms and fingers fixed. q is torso and arm, as in `RobotSpec`."""
    spec = mujoco.MjSpec.from_file(str(robot.mjcf_path))
    for name, position in zip(robot.still_joints, robot.still_configuration, strict=True):
        _hold(spec.joint(name), position)
    for part in [*spec.actuators, *spec.equalities]:
        spec.delete(part)
    for joint in (*robot.base_joints, *robot.still_joints, *robot.finger_joints):
        spec.delete(spec.joint(joint))
    return spec.compile()


def _hold(joint: Any, position: float) -> None:
    """Move a joint's body to its pose at this joint position, so that the joint can be deleted."""
    body, turn, rotation = joint.parent, np.empty(4), np.empty(9)
    axis = np.array(joint.axis) / np.linalg.norm(joint.axis)
    mujoco.mju_quat2Mat(rotation, body.quat)
    if joint.type == mujoco.mjtJoint.mjJNT_SLIDE:
        body.pos = body.pos + rotation.reshape(3, 3) @ axis * position
        return
    mujoco.mju_axisAngle2Quat(turn, axis, position)
    swing, quaternion = np.empty(9), np.empty(4)
    mujoco.mju_quat2Mat(swing, turn)
    body.pos = body.pos + rotation.reshape(3, 3) @ (joint.pos - swing.reshape(3, 3) @ joint.pos)
    mujoco.mju_mulQuat(quaternion, body.quat, turn)
    body.quat = quaternion
