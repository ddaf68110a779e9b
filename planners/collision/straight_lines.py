"""Straight lines of the TCP with constant orientation on a standing base. Collisions are not checked here."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from irm.compilation import njit
from irm.kernel_arguments import copy_row, leaf_kernel
from irm.kinematics import arm_jacobian, fk_frames
from planners.collision.scene_arrays import RobotArrays
from planners.collision.world import CollisionWorld

Array = NDArray[np.float64]
POSITION_TOLERANCE = 1e-4
"""[m] of the TCP."""
ROTATION_TOLERANCE = 1e-3
"""[rad] of the TCP."""
_ITERATIONS = 12
_DAMPING = 1e-4
"""Added to the diagonal of J W Jᵀ, of order 0.1-1 with these weights."""
LINE_STEP = 0.01
"""[m] between samples of a straight line."""
LINE_JUMP = 0.15
"""[rad] Largest turn of a joint between samples. A larger turn means a singularity."""
_VERTICAL = 1e-9
"""Tolerance of a vertical direction's z component."""


@leaf_kernel
def _error(R: Array, p: Array, R_goal: Array, p_goal: Array, error: Array) -> None:
    """Twist (6,) from the TCP (last frame) to the goal: linear, then angular (small angles)."""
    n = p.shape[0] - 1
    for i in range(3):
        error[i] = p_goal[i] - p[n, i]
        error[3 + i] = 0.0
    for k in range(3):
        for i in range(3):
            a, b = (i + 1) % 3, (i + 2) % 3
            error[3 + i] += 0.5 * (R[n, a, k] * R_goal[b, k] - R[n, b, k] * R_goal[a, k])


@njit(cache=True)
def solve_near(robot: RobotArrays, R_goal: Array, p_goal: Array, speed: Array, q: Array) -> bool:  # noqa: C901  compiled: one loop over one state
    """Move `q` (n,) to the nearest configuration whose TCP is at a pose in the base frame.

    Damped least squares. Joints move in proportion to their `speed` (n,), and those at a limit stay there. The robot is
    packed.

    Returns:
        Whether the pose was reached within the tolerances. If not, `q` is the end of the search.
    """
    n = q.shape[0]
    R, p = np.empty((n + 1, 3, 3)), np.empty((n + 1, 3))
    arm, J, free = np.empty((6, n - 1)), np.empty((6, n)), np.empty(n)
    error, A = np.empty(6), np.empty((6, 6))
    for _ in range(_ITERATIONS):
        fk_frames(robot.offsets, robot.axes, robot.tip, q, R, p)
        _error(R, p, R_goal, p_goal, error)
        if (
            error[0] ** 2 + error[1] ** 2 + error[2] ** 2 < POSITION_TOLERANCE**2
            and error[3] ** 2 + error[4] ** 2 + error[5] ** 2 < ROTATION_TOLERANCE**2
        ):
            return True
        arm_jacobian(robot.axes, R, p, arm)
        for i in range(6):
            J[i, 0] = 1.0 if i == 2 else 0.0
            for k in range(1, n):
                J[i, k] = arm[i, k - 1]
        for k in range(n):
            free[k] = 1.0
        for _pass in range(n):
            for i in range(6):
                for j in range(6):
                    total = _DAMPING if i == j else 0.0
                    for k in range(n):
                        total += J[i, k] * J[j, k] * speed[k] * speed[k] * free[k]
                    A[i, j] = total
            force = np.linalg.solve(A, error)
            is_inside = True
            for k in range(n):
                move = 0.0
                for i in range(6):
                    move += J[i, k] * force[i]
                move *= speed[k] * speed[k] * free[k]
                if free[k] > 0.0 and not robot.lower[k] <= q[k] + move <= robot.upper[k]:
                    free[k] = 0.0
                    is_inside = False
            if is_inside:
                break
        for k in range(n):
            move = 0.0
            for i in range(6):
                move += J[i, k] * force[i]
            q[k] = min(max(q[k] + move * speed[k] * speed[k] * free[k], robot.lower[k]), robot.upper[k])
    return False


@njit(cache=True)
def follow_line(
    robot: RobotArrays, q_start: Array, direction: Array, distance: float, step: float, jump: float, speed: Array
) -> Array:
    """Find configurations (k, n) along a straight line of the TCP, every `step` [m] or less, `q_start` (n,) included.

    `direction` (3,) is a unit vector in the base frame, `jump` the greatest change of a joint [m, rad] per sample. The
    joints share the motion by their `speed` (n,). The robot is packed.

    Returns:
        The part that can be followed: fewer than `ceil(distance / step) + 1` rows at a joint limit or a singularity.
    """
    n = q_start.shape[0]
    parts = max(1, math.ceil(distance / step - 1e-9))
    path = np.empty((parts + 1, n))
    R, p = np.empty((n + 1, 3, 3)), np.empty((n + 1, 3))
    fk_frames(robot.offsets, robot.axes, robot.tip, q_start, R, p)
    R_goal, origin, goal, q = R[n].copy(), p[n].copy(), np.empty(3), q_start.copy()
    copy_row(q_start, path[0])
    for i in range(1, parts + 1):
        for axis in range(3):
            goal[axis] = origin[axis] + direction[axis] * distance * i / parts
        if not solve_near(robot, R_goal, goal, speed, q):
            return path[:i]
        for k in range(n):
            if abs(q[k] - path[i - 1, k]) > jump:
                return path[:i]
        copy_row(q, path[i])
    return path


def trace_straight(
    world: CollisionWorld, base: Array, q_start: Array, direction: ArrayLike, distance: float
) -> Array | None:
    """Find waypoints (n, 8) of torso and arm along a straight line from `q_start` (8,). None if it cannot be followed.

    `direction` (3,): unit vector in the world. `distance`: [m]. `base` (3,): base pose.
    """
    along = np.asarray(direction, dtype=float)
    c, s = math.cos(base[2]), math.sin(base[2])
    in_base = np.array([c * along[0] + s * along[1], c * along[1] - s * along[0], along[2]])
    speed, start = np.array(world.scene.robot.max_velocity[3:]), np.array(q_start, dtype=float)
    path = follow_line(world.robot, start, in_base, distance, LINE_STEP, LINE_JUMP, speed)
    return np.asarray(path) if len(path) == _samples(distance) else None


def trace_by_torso(
    world: CollisionWorld, _base: Array, q_start: Array, direction: ArrayLike, distance: float
) -> Array | None:
    """As `trace_straight`, for a vertical line by the torso alone, within its limits, for any arm configuration."""
    robot, along = world.robot, np.asarray(direction, dtype=float)
    end = q_start[0] + distance * along[2]
    if abs(along[2]) < 1.0 - _VERTICAL or not robot.lower[0] <= end <= robot.upper[0]:
        return None
    waypoints = np.tile(q_start, (_samples(distance), 1))
    waypoints[:, 0] = np.linspace(q_start[0], end, len(waypoints))
    return waypoints


def _samples(distance: float) -> int:
    """Number of samples of a line, both ends included."""
    return max(1, math.ceil(distance / LINE_STEP - 1e-9)) + 1
