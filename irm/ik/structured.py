"""Inverse kinematics of arms with a structure of `irm.ik.structure`, compiled.

Spherical wrist: the distance from the shoulder to the wrist gives the elbow (subproblem 3). Its direction gives the two
joints of the shoulder (subproblem 2). The orientation gives the three joints of the wrist (subproblems 2 and 1).

The *excess* of the best solution measures how far it misses the goal or the limits. It is a continuous function of the
free angle, and 0 where a solution exists.

Six joints whose second to fourth axes are parallel (UR arms): the height of the wrist along the parallel axes gives the
first joint (subproblem 4). The component of the last axis along them gives the fifth joint (subproblem 4). The sixth
joint and the sum of the parallel joints follow (subproblem 1), then the elbow from a distance (subproblem 3).
"""

from __future__ import annotations

from math import copysign, sin
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from irm.compilation import WITHOUT_REFERENCE_COUNTS, njit
from irm.ik.structure import ParallelArm, SphericalArm
from irm.ik.subproblems import (
    Vector,
    add,
    angle_about,
    angles_to_component,
    angles_to_distance,
    angles_to_meet,
    cross,
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
"""Weight of a missing length, relative to the motion of the wrist with the free joint."""
_SHORTEST = 1e-3
"""[m] Smallest divisor of these measures."""
_PARALLEL = 1e-6
"""Sine of the angle below which two axes are parallel."""
_ANY = 1e9
"""[rad] More than any excess."""
_NONE = np.int64(0)
"""No solution yet. A literal 0 would make numba compile its callees twice."""


class SphericalGoal(NamedTuple):
    """A pose to reach: the `wrist`, and the images of the last axis and of a `side` of it under its orientation.
    `side_at_zero`: the side at zero. `upward`: direction in which the wrist moves when the lift goes down."""

    wrist: Vector
    last_axis: Vector
    side_at_zero: Vector
    side: Vector
    upward: Vector


@njit(cache=True)
def spherical_goal(arm: SphericalArm, R: Floats, p: Floats) -> SphericalGoal:
    """The goal of a TCP at `R` (3, 3), `p` (3,), in the frame that the arm is solved from."""
    upward = (0.0, 0.0, 1.0)
    if arm.reversed:
        R = np.ascontiguousarray(R.T)
        p = -(R @ p)
        upward = -R[0, 2], -R[1, 2], -R[2, 2]
    moved = R @ arm.R_tool.T
    last = row(arm.axes, 6)
    side = perpendicular(last)
    wrist = add(point(p), matvec(moved, subtract(point(arm.wrist), point(arm.tool))))
    return SphericalGoal(wrist, matvec(moved, last), side, matvec(moved, side), upward)


@njit(cache=True, **WITHOUT_REFERENCE_COUNTS)
def spherical_excess(arm: SphericalArm, goal: SphericalGoal, free: float, best: Floats) -> float:
    """Excess of the best solution for a `free` angle beyond the goal or the limits [rad].

    Zero if a solution is within the limits. The excess is a continuous function of the free angle. Near a singularity
    some joints move fast when the free joint turns. Their excess is then measured by the motion of the vectors that
    they turn, so that the slope of this function is bounded. Writes the solution's angles into `best` (1, 7).
    """
    return _search_spherical(arm, goal, free, _ANY, best)[1]


@njit(cache=True)
def spherical_solutions(arm: SphericalArm, R: Floats, p: Floats, free: float, found: Floats) -> int:
    """Find all configurations of an arm with a spherical wrist for a TCP pose, with a given angle of the free joint
    [rad].

    Args:
        arm: see its type. With six joints, `free` is not used.
        R, p: (3, 3), (3,) of the TCP in the base frame, lowered by the height of the lift.
        free: angle of the free joint.
        found: (8, 1 + n), filled in the columns of the arm.

    Returns:
        The number of solutions within the limits.
    """
    free, _excess = nearest_turn(free, arm.lower[0], arm.upper[0])
    rows = np.empty((8, 7))
    count, _enough = _search_spherical(arm, spherical_goal(arm, R, p), free, arm.slack, rows)
    kept = 0
    for k in range(count):
        if _is_within(arm, rows[k]):
            for joint in range(7):
                if arm.columns[joint] >= 0:
                    found[kept, arm.columns[joint]] = rows[k, joint]
            kept += 1
    return kept


@njit(cache=True, **WITHOUT_REFERENCE_COUNTS)
def _is_within(arm: SphericalArm, angles: Floats) -> bool:
    """Whether every joint is within its limits, up to the slack. The excess alone is no proof near a singularity, where
    it is reduced."""
    excess = 0.0
    for joint in range(7):
        excess = max(excess, nearest_turn(angles[joint], arm.lower[joint], arm.upper[joint])[1])
    return excess <= arm.slack


@njit(cache=True, inline="always")
def _search_spherical(
    arm: SphericalArm, goal: SphericalGoal, free: float, enough: float, rows: Floats
) -> tuple[np.int64, float]:
    """Find solutions for a `free` angle with an excess, see `spherical_excess`, below `enough`.

    Writes them into `rows`: all if it is (8, 7), only the best if it is (1, 7).

    Returns:
        The number of solutions (for `rows` with room for all), and the excess of the best (for a single row).
    """
    axis_1, axis_2, axis_3, axis_4 = row(arm.axes, 0), row(arm.axes, 1), row(arm.axes, 2), row(arm.axes, 3)
    pivot, shoulder, elbow = point(arm.pivot), point(arm.shoulder), point(arm.elbow)
    to_wrist = subtract(add(pivot, rotate(axis_1, -free, subtract(goal.wrist, pivot))), shoulder)
    distance = max(norm(to_wrist), _SHORTEST)
    upper_arm, forearm = subtract(elbow, shoulder), subtract(point(arm.wrist), elbow)
    elbow_1, elbow_2, missed = angles_to_distance(axis_4, upper_arm, forearm, distance)
    free, own_excess = nearest_turn(free, arm.lower[0], arm.upper[0])
    weight = _LENGTH_WEIGHT / max(norm(cross(axis_1, subtract(goal.wrist, pivot))), _SHORTEST)
    shared = max(own_excess, weight * max(0.0, missed - arm.error))
    if shared >= enough:
        return _NONE, enough
    bend = min(1.0, weight * norm(cross(axis_4, upper_arm)) * norm(cross(axis_4, forearm)) / distance)
    ease_4 = bend * abs(sin(0.5 * (elbow_1 - elbow_2)))
    count = _NONE
    for k in range(1 if missed > 0.0 else 2):
        q4, excess_4 = nearest_turn(elbow_1 if k == 0 else elbow_2, arm.lower[3], arm.upper[3])
        excess_4 = _motion(excess_4, bend, ease_4)
        if max(shared, excess_4) >= enough:
            continue
        reach = add(upper_arm, rotate(axis_4, q4, forearm))
        minus_q2, q3, minus_q2_other, q3_other, apart, ease = angles_to_meet(axis_2, to_wrist, axis_3, reach)
        sine_2, sine_3 = _sine(axis_2, to_wrist), _sine(axis_3, reach)
        for i in range(1 if apart > 0.0 else 2):
            q2, excess_2 = nearest_turn(-minus_q2 if i == 0 else -minus_q2_other, arm.lower[1], arm.upper[1])
            angle_3, excess_3 = nearest_turn(q3 if i == 0 else q3_other, arm.lower[2], arm.upper[2])
            excess = max(shared, excess_4, apart, _motion(excess_2, sine_2, ease), _motion(excess_3, sine_3, ease))
            if excess < enough:
                count, enough = _with_wrist(arm, goal, (free, q2, angle_3, q4), excess, enough, rows, count)
    return count, enough


@njit(cache=True, inline="always")
def _sine(axis: Vector, v: Vector) -> float:
    """Sine of the angle between an axis and a vector."""
    return norm(cross(axis, v)) / max(norm(v), _SHORTEST)


@njit(cache=True, inline="always")
def _motion(excess: float, sine: float, ease: float) -> float:
    """Motion of a vector that turns the joint that meets it by `excess` [rad].

    `sine` belongs to the angle between the axis and the vector. Where `ease`, see `angles_to_meet`, is 0, two solutions
    coincide, and the joint turns with the square root of the motion.
    """
    return min(sine * excess, ease * excess + 0.5 * sine * excess * excess)


@njit(cache=True, **WITHOUT_REFERENCE_COUNTS)
def _with_wrist(
    arm: SphericalArm,
    goal: SphericalGoal,
    first: tuple[float, float, float, float],
    others: float,
    enough: float,
    rows: Floats,
    count: np.int64,
) -> tuple[np.int64, float]:
    """Write the solutions with the `first` four angles, which have the excess `others`, into `rows[count:]`.

    Returns:
        The new `count` and `enough`, see `_search_spherical`.
    """
    axis_5, axis_6, axis_7 = row(arm.axes, 4), row(arm.axes, 5), row(arm.axes, 6)
    axis_1, axis_2, axis_3, axis_4 = row(arm.axes, 0), row(arm.axes, 1), row(arm.axes, 2), row(arm.axes, 3)
    q1, q2, q3, q4 = first
    last_axis = rotate(axis_4, -q4, rotate(axis_3, -q3, rotate(axis_2, -q2, rotate(axis_1, -q1, goal.last_axis))))
    minus_q5, q6, minus_q5_other, q6_other, apart, ease = angles_to_meet(axis_5, last_axis, axis_6, axis_7)
    if apart >= enough:
        return count, enough
    side = rotate(axis_4, -q4, rotate(axis_3, -q3, rotate(axis_2, -q2, rotate(axis_1, -q1, goal.side))))
    sine = _sine(axis_5, last_axis)
    ease_6 = ease / max(sine, _SHORTEST)
    for k in range(1 if apart > 0.0 else 2):
        q5, excess_5 = nearest_turn(-minus_q5 if k == 0 else -minus_q5_other, arm.lower[4], arm.upper[4])
        angle_6, excess_6 = nearest_turn(q6 if k == 0 else q6_other, arm.lower[5], arm.upper[5])
        excess = max(others, apart, _motion(excess_5, sine, ease), _motion(excess_6, 1.0, ease_6))
        if excess >= enough:
            continue
        turned = rotate(axis_6, -angle_6, rotate(axis_5, -q5, side))
        q7, excess_7 = nearest_turn(angle_about(axis_7, goal.side_at_zero, turned), arm.lower[6], arm.upper[6])
        excess = max(excess, _motion(excess_7, sine, ease))
        if excess >= enough:
            continue
        rows[count, 0], rows[count, 1], rows[count, 2], rows[count, 3] = first
        rows[count, 4], rows[count, 5], rows[count, 6] = q5, angle_6, q7
        if len(rows) == 1:
            enough = excess
        else:
            count += 1
    return count, enough


class ParallelGoal(NamedTuple):
    """A pose to reach. `moved` (3, 3): its rotation since zero. `to_tool` (3, 3): the inverse. `last_axis`: the last
    axis. `to_meeting`: vector from the first axis to the meeting point of the last two."""

    moved: Floats
    to_tool: Floats
    last_axis: Vector
    to_meeting: Vector


@njit(cache=True)
def parallel_goal(arm: ParallelArm, R: Floats, p: Floats) -> ParallelGoal:
    """The goal of a TCP at `R` (3, 3), `p` (3,), in the base frame lowered by the height of the lift."""
    moved = R @ arm.R_tool.T
    first, meeting = row(arm.points, 0), row(arm.points, 4)
    to_meeting = subtract(add(point(p), matvec(moved, subtract(meeting, point(arm.tool)))), first)
    return ParallelGoal(moved, np.ascontiguousarray(moved.T), matvec(moved, row(arm.axes, 5)), to_meeting)


@njit(cache=True, **WITHOUT_REFERENCE_COUNTS)
def parallel_excess(arm: ParallelArm, goal: ParallelGoal, best: Floats) -> float:
    """Excess of the best solution beyond a goal or the limits [rad]. Writes its joint angles into `best` (1, 6).

    Zero if a solution is within the limits.
    """
    return _search_parallel(arm, goal, _ANY, best)[1]


@njit(cache=True)
def parallel_solutions(arm: ParallelArm, R: Floats, p: Floats, found: Floats) -> int:
    """Write all configurations within the limits for a TCP pose into the last six columns of `found` (8, 7). Returns
    their number."""
    rows = np.empty((8, 6))
    count, _enough = _search_parallel(arm, parallel_goal(arm, R, p), arm.slack, rows)
    found[:count, 1:] = rows[:count]
    return int(count)


@njit(cache=True, **WITHOUT_REFERENCE_COUNTS)
def _search_parallel(arm: ParallelArm, goal: ParallelGoal, enough: float, rows: Floats) -> tuple[np.int64, float]:
    """Find solutions with an excess below `enough`. Writes all into `rows` (8, 6), or only the best into (1, 6).

    Returns:
        The number of solutions (for `rows` with room for all), and the excess of the best (for a single row).
    """
    to_meeting = goal.to_meeting
    axis_1, along, axis_5, axis_6 = row(arm.axes, 0), row(arm.axes, 1), row(arm.axes, 4), row(arm.axes, 5)
    height = dot(along, subtract(row(arm.points, 4), row(arm.points, 0)))
    q1, q1_other, missed_1 = angles_to_component(along, scale(-1.0, axis_1), to_meeting, height)
    count = _NONE
    for i in range(1 if missed_1 > 0.0 else 2):
        angle_1, excess_1 = nearest_turn(q1 if i == 0 else q1_other, arm.lower[0], arm.upper[0])
        last = rotate(axis_1, -angle_1, goal.last_axis)
        q5, q5_other, missed_5 = angles_to_component(along, axis_5, axis_6, dot(along, last))
        back = matvec(goal.to_tool, rotate(axis_1, angle_1, along))
        for j in range(1 if missed_5 > 0.0 else 2):
            angle_5, excess_5 = nearest_turn(q5 if j == 0 else q5_other, arm.lower[4], arm.upper[4])
            turned = rotate(axis_5, -angle_5, along)
            q6 = angle_about(scale(-1.0, axis_6), turned, back)
            angle_6, excess_6 = nearest_turn(q6, arm.lower[5], arm.upper[5])
            # Where the last axis is parallel to the others, its joint may have any angle. Only the earlier joints
            # determine the excess.
            is_any = norm(cross(turned, axis_6)) < _PARALLEL + arm.slack
            excess = max(_LENGTH_WEIGHT * missed_1, missed_5, excess_1, excess_5, 0.0 if is_any else excess_6)
            if excess < enough:
                others = angle_1, angle_5, angle_6
                count, enough = _with_elbow(arm, goal.moved, to_meeting, others, is_any, excess, enough, rows, count)
    return count, enough


@njit(cache=True, **WITHOUT_REFERENCE_COUNTS)
def _with_elbow(
    arm: ParallelArm,
    moved: Floats,
    to_meeting: Vector,
    others: Vector,
    is_any: bool,
    others_excess: float,
    enough: float,
    rows: Floats,
    count: np.int64,
) -> tuple[np.int64, float]:
    """Write the solutions with given angles of the first and the last two joints into `rows[count:]`.

    Returns:
        The new `count` and `enough`, see `_search_parallel`.
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
        excess = others_excess if is_any else max(others_excess, _LENGTH_WEIGHT * missed, excess_2, excess_3, excess_4)
        if excess >= enough:
            continue
        rows[count, 0], rows[count, 1], rows[count, 2] = angle_1, angle_2, angle_3
        rows[count, 3], rows[count, 4], rows[count, 5] = angle_4, angle_5, angle_6
        if len(rows) == 1:
            enough = excess
        else:
            count += 1
    return count, enough
