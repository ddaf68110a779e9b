"""Closed-form inverse kinematics of six joints whose second to fourth axes are parallel, compiled (UR arms).

The height of the wrist along the parallel axes gives the first joint, that of the last axis the fifth (subproblem 4).
The sixth and the sum of the parallel ones follow (subproblem 1), then the elbow from a distance (subproblem 3).
"""

from __future__ import annotations

from math import copysign

import numpy as np
from numpy.typing import NDArray

from irm.compilation import WITHOUT_REFERENCE_COUNTS, njit
from irm.ik.structure import ParallelArm
from irm.ik.subproblems import (
    Vector,
    add,
    angle_about,
    angles_to_component,
    angles_to_distance,
    dot,
    matvec,
    nearest_turn,
    norm,
    perpendicular,
    point,
    rotate,
    row,
    scale,
    subtract,
)

Floats = NDArray[np.float64]
_LENGTH_WEIGHT = 4.0
"""How much a missing length [m] counts in radians."""
_ANY = 1e9
"""[rad] More than any excess."""
_NONE = np.int64(0)
"""No solution yet; a literal 0 would compile what takes it twice."""


@njit(cache=True)
def parallel_excess(arm: ParallelArm, R: Floats, p: Floats, best: Floats) -> float:
    """By how much the best solution misses a TCP pose or the limits [rad]; its joint angles into `best` (1, 6).

    0 if there is a solution within the limits. `R` (3, 3) and `p` (3,) are the pose in the base frame.
    """
    return _search(arm, R, p, _ANY, best)[1]


@njit(cache=True)
def parallel_solutions(arm: ParallelArm, R: Floats, p: Floats, found: Floats) -> int:
    """All configurations within the limits for such a pose, into the last six columns of `found` (8, 7); how many."""
    rows = np.empty((8, 6))
    count, _enough = _search(arm, R, p, arm.slack, rows)
    found[:count, 1:] = rows[:count]
    return int(count)


@njit(cache=True)
def _search(arm: ParallelArm, R: Floats, p: Floats, enough: float, rows: Floats) -> tuple[np.int64, float]:
    """Solutions whose excess is less than `enough`: all into `rows` (8, 6), only the best one into (1, 6).

    Returns:
        The number of solutions if there is room for all; and the excess of the best one if there is room for one.
    """
    moved = R @ arm.R_tool.T
    to_tool = np.ascontiguousarray(moved.T)
    axis_1, along, axis_5, axis_6 = row(arm.axes, 0), row(arm.axes, 1), row(arm.axes, 4), row(arm.axes, 5)
    first, meeting = row(arm.points, 0), row(arm.points, 4)
    to_meeting = subtract(add(point(p), matvec(moved, subtract(meeting, point(arm.tool)))), first)
    height = dot(along, subtract(meeting, first))
    q1, q1_other, missed_1 = angles_to_component(along, scale(-1.0, axis_1), to_meeting, height)
    count = _NONE
    for i in range(1 if missed_1 > 0.0 else 2):
        angle_1, excess_1 = nearest_turn(q1 if i == 0 else q1_other, arm.lower[0], arm.upper[0])
        last = rotate(axis_1, -angle_1, matvec(moved, axis_6))
        q5, q5_other, missed_5 = angles_to_component(along, axis_5, axis_6, dot(along, last))
        back = matvec(to_tool, rotate(axis_1, angle_1, along))
        for j in range(1 if missed_5 > 0.0 else 2):
            angle_5, excess_5 = nearest_turn(q5 if j == 0 else q5_other, arm.lower[4], arm.upper[4])
            q6 = angle_about(scale(-1.0, axis_6), rotate(axis_5, -angle_5, along), back)
            angle_6, excess_6 = nearest_turn(q6, arm.lower[5], arm.upper[5])
            excess = max(_LENGTH_WEIGHT * missed_1, missed_5, excess_1, excess_5, excess_6)
            if excess < enough:
                others = angle_1, angle_5, angle_6
                count, enough = _with_elbow(arm, moved, to_meeting, others, excess, enough, rows, count)
    return count, enough


@njit(cache=True, **WITHOUT_REFERENCE_COUNTS)
def _with_elbow(
    arm: ParallelArm,
    moved: Floats,
    to_meeting: Vector,
    others: Vector,
    others_excess: float,
    enough: float,
    rows: Floats,
    count: np.int64,
) -> tuple[np.int64, float]:
    """Write the solutions with given angles of the first and the last two joints into `rows[count:]`.

    Returns:
        The new `count` and `enough`, see `_search`.
    """
    angle_1, angle_5, angle_6 = others
    along, axis_3, axis_4 = row(arm.axes, 1), row(arm.axes, 2), row(arm.axes, 3)
    axis_1, axis_5, axis_6 = row(arm.axes, 0), row(arm.axes, 4), row(arm.axes, 5)
    second, third, fourth = row(arm.points, 1), row(arm.points, 2), row(arm.points, 3)
    side = perpendicular(along)
    turned = rotate(axis_1, -angle_1, matvec(moved, rotate(axis_6, -angle_6, rotate(axis_5, -angle_5, side))))
    total = angle_about(along, side, turned)
    last = rotate(along, total, subtract(row(arm.points, 4), fourth))
    from_first = rotate(axis_1, -angle_1, to_meeting)
    to_fourth = subtract(subtract(from_first, subtract(second, row(arm.points, 0))), last)
    upper_arm, forearm = subtract(third, second), subtract(fourth, third)
    q3, q3_other, missed = angles_to_distance(axis_3, upper_arm, forearm, norm(to_fourth))
    sign_3, sign_4 = copysign(1.0, dot(along, axis_3)), copysign(1.0, dot(along, axis_4))
    for k in range(1 if missed > 0.0 else 2):
        angle_3, excess_3 = nearest_turn(q3 if k == 0 else q3_other, arm.lower[2], arm.upper[2])
        angle_2 = angle_about(along, add(upper_arm, rotate(axis_3, angle_3, forearm)), to_fourth)
        angle_4 = sign_4 * (total - angle_2 - sign_3 * angle_3)
        angle_2, excess_2 = nearest_turn(angle_2, arm.lower[1], arm.upper[1])
        angle_4, excess_4 = nearest_turn(angle_4, arm.lower[3], arm.upper[3])
        excess = max(others_excess, _LENGTH_WEIGHT * missed, excess_2, excess_3, excess_4)
        if excess >= enough:
            continue
        rows[count, 0], rows[count, 1], rows[count, 2] = angle_1, angle_2, angle_3
        rows[count, 3], rows[count, 4], rows[count, 5] = angle_4, angle_5, angle_6
        if len(rows) == 1:
            enough = excess
        else:
            count += 1
    return count, enough
