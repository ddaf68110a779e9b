"""One step of differential inverse kinematics: the joint velocities that bring the TCP towards a pose.

Two routes to the same quadratic programme, which has two tasks: the TCP pose, and weakly the home configuration. The
joints' limits of position, velocity and acceleration are its bounds. `MinkIK` states it with mink's tasks; it is the
reference. `DirectIK` writes the same Hessian down directly, in a fifth of the time.
"""

from __future__ import annotations

from ctypes import c_int
from typing import Protocol

import daqp
import mink
import mujoco
import numpy as np
from numpy.typing import NDArray

from assets import RobotSpec
from clutter_env.simulation.control import CONTROL_STEP
from clutter_env.simulation.pose_arithmetic import (
    Quaternion,
    Vector3,
    inverse_left_jacobian,
    pose_difference,
    quaternion_of_matrix,
)

__all__ = ["DifferentialIK", "DirectIK", "MinkIK", "differential_ik"]

Vector = NDArray[np.float64]

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


class DifferentialIK(Protocol):
    """Solves for the joint velocities of one control step."""

    def tcp_at(self, q: Vector) -> tuple[Vector3, Quaternion]:
        """Position [m] and quaternion of the TCP in the base frame at the joint positions (1 + n,)."""

    def velocity(self, position: Vector3, rotation: Quaternion, qd: Vector) -> Vector:
        """Joint velocities (1 + n,) from the configuration of the last `tcp_at` towards a TCP pose in the base frame.

        Args:
            position: of the wanted TCP pose [m].
            rotation: its quaternion.
            qd: (1 + n,) the present velocities.

        Returns:
            Zeros where the solver finds nothing.
        """


class DirectIK:
    """Jacobian, Hessian and bounds without intermediate objects, solved by daqp."""

    def __init__(self, robot: RobotSpec) -> None:
        self._model = _arm_model(robot)
        self._data = mujoco.MjData(self._model)
        self._site = self._model.site(robot.tcp_site).id
        count = len(robot.chain)
        self._limit = _MotionLimit(robot)
        self._home = np.array(robot.home)
        weight = _configuration_costs(robot) ** 2
        self._pull = _CONFIGURATION_GAIN * weight
        self._diagonal = weight + _SOLVER_DAMPING
        self._jacobian = np.zeros((6, count))
        self._twist_map = np.eye(6)
        self._no_rows = np.zeros((0, count))
        self._sense = np.zeros(count, dtype=c_int)
        self._position: Vector3 = (0.0, 0.0, 0.0)
        self._rotation: Quaternion = (1.0, 0.0, 0.0, 0.0)
        self._q = np.zeros(count)

    def tcp_at(self, q: Vector) -> tuple[Vector3, Quaternion]:
        """Position and quaternion of the TCP; see `DifferentialIK`."""
        data = self._data
        self._q = self._limit.inside(q)
        data.qpos[:] = self._q
        mujoco.mj_kinematics(self._model, data)
        x, y, z = data.site_xpos[self._site].tolist()
        self._position, self._rotation = (x, y, z), quaternion_of_matrix(data.site_xmat[self._site])
        return self._position, self._rotation

    def velocity(self, position: Vector3, rotation: Quaternion, qd: Vector) -> Vector:
        """Joint velocities towards a TCP pose; see `DifferentialIK`."""
        q = self._q
        linear, angular = pose_difference(self._position, self._rotation, position, rotation)
        error = np.array((*linear, *angular))
        task = self._task_jacobian(linear, angular)
        damping = _FRAME_DAMPING * _FRAME_GAIN**2 * float(error @ error)
        hessian = task.T @ task
        hessian.ravel()[:: len(q) + 1] += self._diagonal + damping
        gradient = self._pull * (q - self._home) - _FRAME_GAIN * (error @ task)
        lowest, highest = self._limit.bounds(q, qd)
        step, _, flag, _ = daqp.solve(
            hessian,
            gradient,
            self._no_rows,
            highest * CONTROL_STEP,
            lowest * CONTROL_STEP,
            self._sense,
            primal_tol=_SOLVER_TOLERANCE,
        )
        if flag <= 0:
            return np.zeros_like(q)
        velocity: Vector = step / CONTROL_STEP
        return velocity

    def _task_jacobian(self, linear: Vector3, angular: Vector3) -> Vector:
        """How the pose difference shrinks with the joints, (6, 1 + n): inverse left Jacobian times TCP Jacobian."""
        jacobian = self._jacobian
        mujoco.mj_comPos(self._model, self._data)
        mujoco.mj_jacSite(self._model, self._data, jacobian[:3], jacobian[3:], self._site)
        to_tcp = self._data.site_xmat[self._site].reshape(3, 3).T
        in_tcp: Vector = (to_tcp @ jacobian.reshape(2, 3, -1)).reshape(6, -1)
        rows = inverse_left_jacobian(linear, angular)
        if rows is None:
            return in_tcp
        blocks = np.array(rows)
        twist_map = self._twist_map
        twist_map[:3, :3] = twist_map[3:, 3:] = blocks[:3]
        twist_map[:3, 3:] = blocks[3:]
        return twist_map @ in_tcp


class MinkIK:
    """The same step through mink's tasks and limits."""

    def __init__(self, robot: RobotSpec) -> None:
        self._robot = robot
        model = _arm_model(robot)
        self._configuration = mink.Configuration(model)
        self._frame_task = mink.FrameTask(
            robot.tcp_site,
            "site",
            position_cost=1.0,
            orientation_cost=1.0,
            gain=_FRAME_GAIN,
            lm_damping=_FRAME_DAMPING,
        )
        configuration_task = mink.PostureTask(model, cost=_configuration_costs(robot), gain=_CONFIGURATION_GAIN)
        configuration_task.set_target(np.array(robot.home))
        self._tasks = [self._frame_task, configuration_task]
        self._limit = _MotionLimit(robot)
        self._mink_limit = _MinkLimit(self._limit)

    def tcp_at(self, q: Vector) -> tuple[Vector3, Quaternion]:
        """Position and quaternion of the TCP; see `DifferentialIK`."""
        self._configuration.update(self._limit.inside(q))
        pose = self._configuration.get_transform_frame_to_world(self._robot.tcp_site, "site")
        w, qx, qy, qz, x, y, z = pose.wxyz_xyz.tolist()
        return (x, y, z), (w, qx, qy, qz)

    def velocity(self, position: Vector3, rotation: Quaternion, qd: Vector) -> Vector:
        """Joint velocities towards a TCP pose; see `DifferentialIK`."""
        self._frame_task.set_target(mink.SE3(np.array((*rotation, *position))))
        self._mink_limit.velocity = qd
        try:
            velocity = mink.solve_ik(
                self._configuration,
                self._tasks,
                CONTROL_STEP,
                solver="daqp",
                damping=_SOLVER_DAMPING,
                limits=[self._mink_limit],
                primal_tol=_SOLVER_TOLERANCE,
            )
        except mink.NoSolutionFound:
            return np.zeros_like(qd)
        return np.asarray(velocity)


def differential_ik(route: str, robot: RobotSpec) -> DifferentialIK:
    """The route of this name, "direct" or "mink"."""
    return MinkIK(robot) if route == "mink" else DirectIK(robot)


class _MotionLimit:
    """Joint velocities that keep the limits of position, velocity and acceleration, and leave room to brake."""

    def __init__(self, robot: RobotSpec) -> None:
        chain = robot.chain
        self._lower = np.array([link.lower for link in chain])
        self._upper = np.array([link.upper for link in chain])
        self._first = self._lower + _LIMIT_MARGIN
        self._last = self._upper - _LIMIT_MARGIN
        self._max_velocity = np.array(robot.max_velocity[3:])
        self._max_acceleration = np.array(robot.max_acceleration[3:])
        self._change = self._max_acceleration * CONTROL_STEP
        self._half = self._change / 2
        self._half_squared = self._half**2
        self._twice = 2 * self._max_acceleration
        self._signs = np.array(((-1.0,), (1.0,)))
        self._edges = np.stack((self._upper, -self._lower))

    def inside(self, q: Vector) -> Vector:
        """The configuration (1 + n,), clipped to the joint limits less a margin."""
        clipped: Vector = np.minimum(np.maximum(q, self._first), self._last)
        return clipped

    def bounds(self, q: Vector, qd: Vector) -> tuple[Vector, Vector]:
        """Lowest and highest velocities (1 + n,) for the next control step."""
        distance = self._signs * q + self._edges
        upwards, downwards = self._fastest(distance)
        highest = np.minimum(qd + self._change, upwards)
        lowest = np.maximum(qd - self._change, -downwards)
        return lowest, np.maximum(highest, lowest)

    def _fastest(self, distance: Vector) -> Vector:
        """The velocities from which the joints can still stop within these distances, both (2, 1 + n)."""
        braking = np.sqrt(self._half_squared + self._twice * np.maximum(distance, 0.0)) - self._half
        fastest: Vector = np.minimum(braking, self._max_velocity)
        return fastest


class _MinkLimit(mink.Limit):  # type: ignore[misc]  # mink has no types that mypy follows
    """The bounds of `_MotionLimit` as a limit of mink."""

    def __init__(self, limit: _MotionLimit) -> None:
        self._limit = limit
        self.velocity: Vector = np.zeros(0)

    def compute_qp_inequalities(self, configuration: mink.Configuration, dt: float) -> mink.Constraint:
        """Bounds on the displacement, (2 (1 + n), 1 + n) and (2 (1 + n),)."""
        lowest, highest = self._limit.bounds(configuration.q, self.velocity)
        rows = np.vstack((np.eye(len(lowest)), -np.eye(len(lowest))))
        return mink.Constraint(rows, np.concatenate((highest, -lowest)) * dt)


def _configuration_costs(robot: RobotSpec) -> Vector:
    return np.array([_TORSO_COST, *[_CONFIGURATION_COST] * (len(robot.chain) - 1)])


def _arm_model(robot: RobotSpec) -> mujoco.MjModel:
    """The robot alone, its base, head and fingers fixed: q is torso and arm, as in `RobotSpec`."""
    spec = mujoco.MjSpec.from_file(str(robot.mjcf_path))
    for part in [*spec.actuators, *spec.equalities]:
        spec.delete(part)
    for joint in (*robot.base_joints, *robot.still_joints, *robot.finger_joints):
        spec.delete(spec.joint(joint))
    return spec.compile()
