"""All configurations that reach a TCP pose at one angle of the free joint, in closed form, compiled.

The same steps as in `spherical_kernel` and `parallel_kernel`, which look for the best solution; here every one within
the limits is returned.
"""

from __future__ import annotations

from math import copysign

import numpy as np
from numpy.typing import NDArray

from irm.arm.general.spherical_kernel import SphericalGoal, spherical_goal
from irm.arm.general.structure import ParallelArm, SphericalArm
from irm.arm.general.subproblems import (
    angle_about,
    angles_to_component,
    angles_to_distance,
    angles_to_meet,
    nearest_turn,
)
from irm.arm.general.vectors import Vector, add, dot, norm, perpendicular, point, row, scale, subtract, times, turn
from irm.compilation import njit

__all__ = ["parallel_solutions", "spherical_solutions"]

Floats = NDArray[np.float64]


@njit(cache=True)
def spherical_solutions(arm: SphericalArm, R: Floats, p: Floats, free: float, found: Floats) -> int:
    """All configurations of an arm with a spherical wrist for a TCP pose, with the free joint at an angle [rad].

    Args:
        arm: see its type; if it has six joints, `free` is not used.
        R, p: (3, 3), (3,) of the TCP in the base frame, lowered by the height of the lift.
        free: angle of the free joint.
        found: (8, 1 + n) whose columns of the arm are filled.

    Returns:
        The number of solutions within the limits.
    """
    goal = spherical_goal(arm, R, p)
    free, excess = nearest_turn(free, arm.lower[0], arm.upper[0])
    if excess > arm.slack:
        return 0
    axis_1, axis_2, axis_3, axis_4 = row(arm.axes, 0), row(arm.axes, 1), row(arm.axes, 2), row(arm.axes, 3)
    pivot, shoulder, elbow = point(arm.pivot), point(arm.shoulder), point(arm.elbow)
    to_wrist = subtract(add(pivot, turn(axis_1, -free, subtract(goal.wrist, pivot))), shoulder)
    upper_arm, forearm = subtract(elbow, shoulder), subtract(point(arm.wrist), elbow)
    elbow_1, elbow_2, missed = angles_to_distance(axis_4, upper_arm, forearm, norm(to_wrist))
    if missed > arm.error:
        return 0
    angles, count = np.empty(7), 0
    angles[0] = free
    for k in range(1 if missed > 0.0 else 2):
        angles[3], excess = nearest_turn(elbow_1 if k == 0 else elbow_2, arm.lower[3], arm.upper[3])
        if excess > arm.slack:
            continue
        reach = add(upper_arm, turn(axis_4, angles[3], forearm))
        minus_q2, q3, minus_q2_other, q3_other, apart, _ease = angles_to_meet(axis_2, to_wrist, axis_3, reach)
        if apart > arm.slack:
            continue
        for i in range(1 if apart > 0.0 else 2):
            angles[1], excess = nearest_turn(-minus_q2 if i == 0 else -minus_q2_other, arm.lower[1], arm.upper[1])
            angles[2], excess_3 = nearest_turn(q3 if i == 0 else q3_other, arm.lower[2], arm.upper[2])
            if max(excess, excess_3) <= arm.slack:
                count = _with_wrist(arm, goal, angles, found, count)
    return count


@njit(cache=True)
def _with_wrist(arm: SphericalArm, goal: SphericalGoal, angles: Floats, found: Floats, count: int) -> int:
    """Write the solutions with the first four of `angles` (7,) into `found[count:]`; the new count."""
    axis_5, axis_6, axis_7 = row(arm.axes, 4), row(arm.axes, 5), row(arm.axes, 6)
    last_axis, side = goal.last_axis, goal.side
    for joint in range(4):
        axis = row(arm.axes, joint)
        last_axis, side = turn(axis, -angles[joint], last_axis), turn(axis, -angles[joint], side)
    minus_q5, q6, minus_q5_other, q6_other, apart, _ease = angles_to_meet(axis_5, last_axis, axis_6, axis_7)
    if apart > arm.slack:
        return count
    for k in range(1 if apart > 0.0 else 2):
        angles[4], excess = nearest_turn(-minus_q5 if k == 0 else -minus_q5_other, arm.lower[4], arm.upper[4])
        angles[5], excess_6 = nearest_turn(q6 if k == 0 else q6_other, arm.lower[5], arm.upper[5])
        if max(excess, excess_6) > arm.slack:
            continue
        turned = turn(axis_6, -angles[5], turn(axis_5, -angles[4], side))
        angles[6], excess = nearest_turn(angle_about(axis_7, goal.side_at_zero, turned), arm.lower[6], arm.upper[6])
        if excess > arm.slack:
            continue
        for joint in range(7):
            if arm.columns[joint] >= 0:
                found[count, arm.columns[joint]] = angles[joint]
        count += 1
    return count


@njit(cache=True)
def parallel_solutions(arm: ParallelArm, R: Floats, p: Floats, found: Floats) -> int:
    """The same for six joints of which three are parallel; there is no free joint."""
    moved = R @ arm.R_tool.T
    axis_1, along, axis_5, axis_6 = row(arm.axes, 0), row(arm.axes, 1), row(arm.axes, 4), row(arm.axes, 5)
    first, meeting = row(arm.points, 0), row(arm.points, 4)
    to_meeting = subtract(add(point(p), times(moved, subtract(meeting, point(arm.tool)))), first)
    height = dot(along, subtract(meeting, first))
    q1, q1_other, missed_1 = angles_to_component(along, scale(-1.0, axis_1), to_meeting, height)
    if missed_1 > arm.slack:
        return 0
    angles, count = np.empty(6), 0
    for i in range(1 if missed_1 > 0.0 else 2):
        angles[0], excess_1 = nearest_turn(q1 if i == 0 else q1_other, arm.lower[0], arm.upper[0])
        last = turn(axis_1, -angles[0], times(moved, axis_6))
        q5, q5_other, missed_5 = angles_to_component(along, axis_5, axis_6, dot(along, last))
        if max(excess_1, missed_5) > arm.slack:
            continue
        back = times(moved.T, turn(axis_1, angles[0], along))
        for j in range(1 if missed_5 > 0.0 else 2):
            angles[4], excess_5 = nearest_turn(q5 if j == 0 else q5_other, arm.lower[4], arm.upper[4])
            q6 = angle_about(scale(-1.0, axis_6), turn(axis_5, -angles[4], along), back)
            angles[5], excess_6 = nearest_turn(q6, arm.lower[5], arm.upper[5])
            if max(excess_5, excess_6) <= arm.slack:
                count = _with_elbow(arm, moved, turn(axis_1, -angles[0], to_meeting), angles, found, count)
    return count


@njit(cache=True)
def _with_elbow(arm: ParallelArm, moved: Floats, to_meeting: Vector, angles: Floats, found: Floats, count: int) -> int:
    """Write the solutions of the three parallel joints, the others of `angles` (6,) given, into `found[count:]`."""
    along, axis_3, axis_4 = row(arm.axes, 1), row(arm.axes, 2), row(arm.axes, 3)
    axis_1, axis_5, axis_6 = row(arm.axes, 0), row(arm.axes, 4), row(arm.axes, 5)
    second, third, fourth = row(arm.points, 1), row(arm.points, 2), row(arm.points, 3)
    side = perpendicular(along)
    turned = turn(axis_1, -angles[0], times(moved, turn(axis_6, -angles[5], turn(axis_5, -angles[4], side))))
    total = angle_about(along, side, turned)
    last = turn(along, total, subtract(row(arm.points, 4), fourth))
    to_fourth = subtract(subtract(to_meeting, subtract(second, row(arm.points, 0))), last)
    upper_arm, forearm = subtract(third, second), subtract(fourth, third)
    q3, q3_other, missed = angles_to_distance(axis_3, upper_arm, forearm, norm(to_fourth))
    sign_3, sign_4 = copysign(1.0, dot(along, axis_3)), copysign(1.0, dot(along, axis_4))
    if missed > arm.slack:
        return count
    for k in range(1 if missed > 0.0 else 2):
        angle_3, excess_3 = nearest_turn(q3 if k == 0 else q3_other, arm.lower[2], arm.upper[2])
        angle_2 = angle_about(along, add(upper_arm, turn(axis_3, angle_3, forearm)), to_fourth)
        angle_4 = sign_4 * (total - angle_2 - sign_3 * angle_3)
        angle_2, excess_2 = nearest_turn(angle_2, arm.lower[1], arm.upper[1])
        angle_4, excess_4 = nearest_turn(angle_4, arm.lower[3], arm.upper[3])
        if max(excess_2, excess_3, excess_4) > arm.slack:
            continue
        angles[1], angles[2], angles[3] = angle_2, angle_3, angle_4
        found[count, 1:] = angles
        count += 1
    return count
