"""What many configurations, straight motions and whole paths hit, compiled: loops around `configuration_hits`."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from planners.collision.configuration_kernel import Attached, Obstacles, Workspace, configuration_hits, make_workspace
from planners.collision.robot_model import RobotArrays

__all__ = ["edge_hits", "edge_samples", "many_hits", "path_hits"]

Array = NDArray[np.float64]

_NONE = np.uint64(0)


@njit(cache=True)
def many_hits(
    robot: RobotArrays,
    obstacles: Obstacles,
    attached: Attached,
    base: Array,
    Q: Array,
    opening: float,
    active: np.uint64,
    padding: float,
) -> NDArray[np.uint64]:
    """`configuration_hits` of each row of `Q` (k, n) at one base pose: (k,)."""
    work = make_workspace(robot, attached)
    hits = np.empty(Q.shape[0], np.uint64)
    for row in range(Q.shape[0]):
        hits[row] = configuration_hits(robot, obstacles, work, base, Q[row], opening, active, padding, False)
    return hits


@njit(cache=True)
def edge_samples(work: Workspace, start: Array, end: Array, step: float) -> int:
    """Into how many parts a straight motion must be cut so that no point moves more than `step` [m] in one."""
    length = math.hypot(end[0] - start[0], end[1] - start[1])
    for joint in range(2, start.shape[0]):
        length += abs(end[joint] - start[joint]) * work.reach[joint]
    return max(1, math.ceil(length / step))


@njit(cache=True)
def edge_hits(
    robot: RobotArrays,
    obstacles: Obstacles,
    work: Workspace,
    start: Array,
    end: Array,
    opening: float,
    active: np.uint64,
    padding: float,
    step: float,
    first_only: bool,
) -> np.uint64:
    """What a straight motion between two whole-body configurations (3 + n,) hits; `start` itself is not looked at.

    No point of the robot moves more than `step` [m] between two checks, so nothing deeper than `step / 2 - padding`
    is missed. The end comes first, then ever finer subdivisions: a blocked edge is refused early.
    """
    parts = edge_samples(work, start, end, step)
    x = end.copy()
    hits = configuration_hits(robot, obstacles, work, x[:3], x[3:], opening, active, padding, first_only)
    stride = 1
    while 2 * stride < parts:
        stride *= 2
    while stride >= 1 and not (first_only and hits != _NONE):
        for i in range(stride, parts, 2 * stride):
            for joint in range(x.shape[0]):
                x[joint] = start[joint] + (end[joint] - start[joint]) * i / parts
            hits |= configuration_hits(robot, obstacles, work, x[:3], x[3:], opening, active, padding, first_only)
            if first_only and hits != _NONE:
                return np.uint64(hits)
        stride //= 2
    return np.uint64(hits)


@njit(cache=True)
def path_hits(
    robot: RobotArrays,
    obstacles: Obstacles,
    attached: Attached,
    X: Array,
    opening: float,
    active: np.uint64,
    padding: float,
    step: float,
    first_only: bool,
) -> np.uint64:
    """What a piecewise straight motion through whole-body configurations `X` (k, 3 + n) hits, both ends included."""
    work = make_workspace(robot, attached)
    hits = configuration_hits(robot, obstacles, work, X[0, :3], X[0, 3:], opening, active, padding, first_only)
    for row in range(1, X.shape[0]):
        if first_only and hits != _NONE:
            break
        hits |= edge_hits(robot, obstacles, work, X[row - 1], X[row], opening, active, padding, step, first_only)
    return np.uint64(hits)
