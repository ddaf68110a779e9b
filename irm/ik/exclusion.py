"""Proofs that no configuration in a box reaches a TCP pose, compiled.

A box is a range of heights of the lift and of angles of the free joint. In a box, the pose relative to the other joints
is known up to an error. The arm is known up to an error too, because its axes meet, or are parallel, only up to the
rounding of its file. The closed form describes an arm with exact axes, whose TCP poses differ by at most the
structure's `error` and `turn`. The error passes through the closed form, joint by joint, as a range of angles
(`irm.ik.ranges`). A branch ends where a range is empty or outside the limits. If all branches end, no configuration
reaches the pose.
"""

from __future__ import annotations

from math import asin, copysign, exp, pi, sin, sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from irm.compilation import WITHOUT_REFERENCE_COUNTS, njit
from irm.ik.ranges import (
    TOLERANCE,
    Direction,
    away_and_around,
    component_range,
    direction,
    distance_range,
    meeting_ranges,
    turned_by,
    within,
)
from irm.ik.structure import ParallelArm, SphericalArm
from irm.ik.structured import ParallelGoal, SphericalGoal
from irm.ik.subproblems import (
    Vector,
    add,
    angle_about,
    cross,
    dot,
    matvec,
    norm,
    perpendicular,
    point,
    rotate,
    row,
    scale,
    subtract,
)

Floats = NDArray[np.float64]
_SHORTEST = 1e-12
"""[m] Smallest divisor."""
_UNDETERMINED = 0.3
"""[rad] Half width of a range above which an angle is undetermined."""
_STILL = (0.0, 0.0, 0.0)


class Angle(NamedTuple):
    """Range of a joint's angle: its middle, and half of its width [rad]."""

    middle: float
    half: float


@njit(cache=True, inline="always")
def _sine(axis: Vector, v: Vector) -> float:
    return norm(cross(axis, v)) / max(norm(v), _SHORTEST)


@njit(cache=True, inline="always")
def _chord(half: float) -> float:
    """Distance between two points of the unit circle that are at most `half` apart [rad]."""
    return 2.0 * sin(0.5 * min(half, pi))


@njit(cache=True, inline="always")
def _about(error: float) -> float:
    """Error of an angle about an axis at right angles to a vector, for a rotation with an error [rad]."""
    chord = _chord(error)
    return asin(chord) if chord < 1.0 else pi


@njit(cache=True, inline="always")
def _beyond(turn: float) -> float:
    """Upper bound of the error of a linearised product of rotations, for angles with the sum `turn`."""
    return exp(turn) - 1.0 - turn


@njit(cache=True, **WITHOUT_REFERENCE_COUNTS)
def _moved(axis: Vector, reference: Vector, v: Vector, motions: tuple[Vector, Vector], rest: float) -> Direction:
    """Direction of a vector about an axis, if its end may move to and fro by two motions, and by `rest` [m]."""
    length = max(norm(v), _SHORTEST)
    unit, along = scale(1.0 / length, v), rest
    away, around = away_and_around(axis, unit)
    moved_away, moved_around = 0.0, 0.0
    for k in range(2):
        along += abs(dot(unit, motions[k]))
        moved_away += abs(dot(away, motions[k]))
        moved_around += abs(dot(around, motions[k]))
    shrunk = max(length - along, _SHORTEST)
    return direction(axis, reference, unit, moved_away / shrunk, moved_around / shrunk, rest / shrunk)


@njit(cache=True, **WITHOUT_REFERENCE_COUNTS)
def may_reach_spherical(
    arm: SphericalArm, goal: SphericalGoal, lift: float, free: Angle, fifth: Angle, error: float, angles: Floats
) -> bool:
    """Whether an arm with a wrist may reach a pose with lift and two joints in ranges. False is proved.

    Args:
        arm, goal: see their types. The goal belongs to the middle of the lift's range.
        lift: half width of this range [m].
        free: range of the free joint. Without a free joint any middle, with a half width of 0.
        fifth: range of the fifth joint.
        error: of the goal's wrist at this height [m].
        angles: (1, 7) filled with the middles of the first remaining branch, in the order of solving [rad].
    """
    axis_1, axis_2, axis_3, axis_4 = row(arm.axes, 0), row(arm.axes, 1), row(arm.axes, 2), row(arm.axes, 3)
    pivot, shoulder, elbow = point(arm.pivot), point(arm.shoulder), point(arm.elbow)
    about_pivot = rotate(axis_1, -free.middle, subtract(goal.wrist, pivot))
    to_wrist = subtract(add(pivot, about_pivot), shoulder)
    tangent, distance = cross(axis_1, about_pivot), norm(to_wrist)
    radius, offset = norm(tangent), norm(cross(axis_1, subtract(shoulder, pivot)))
    # Range of the squared distance, by its slopes and largest curvatures in the free angle, in the lift, and in both.
    upward, slant = rotate(axis_1, -free.middle, goal.upward), norm(cross(axis_1, goal.upward))
    spread = 2.0 * abs(dot(tangent, to_wrist)) * free.half + (radius + slant * lift) * offset * free.half * free.half
    spread += (2.0 * abs(dot(upward, to_wrist)) + lift) * lift
    spread += 2.0 * slant * (distance + norm(about_pivot) + 2.0 * lift + radius * free.half) * lift * free.half
    low = max(0.0, sqrt(max(0.0, distance * distance - spread)) - error)
    high = sqrt(distance * distance + spread) + error
    offset_5, axis_5 = point(arm.offset), row(arm.axes, 4)
    bent = subtract(rotate(axis_5, fifth.middle, offset_5), offset_5)
    error_bent = norm(offset_5) * _chord(fifth.half)
    upper_arm, forearm = subtract(elbow, shoulder), add(subtract(point(arm.wrist), elbow), bent)
    low, high = max(0.0, low - error_bent), high + error_bent
    middle, least, most = distance_range(axis_4, upper_arm, forearm, low, high)
    if most < 0.0:
        return False
    # The wrist moves along the tangent and upward, up to the curvature.
    rest = error + (0.5 * radius * free.half + slant * lift) * free.half
    seen = _moved(axis_2, axis_3, to_wrist, (scale(free.half, tangent), scale(lift, upward)), rest)
    across = norm(cross(axis_4, forearm))
    for k in range(2):
        side = 0.5 * (least + most) if k == 0 else -0.5 * (least + most)
        q4, half_4 = within(middle + side, 0.5 * (most - least), arm.lower[3], arm.upper[3])
        if half_4 < 0.0:
            continue
        turned = rotate(axis_4, q4, forearm)
        reach, along = add(upper_arm, turned), scale(half_4, cross(axis_4, turned))
        rest = error_bent + 0.5 * across * half_4 * half_4
        meeting = meeting_ranges(axis_2, seen, axis_3, _moved(axis_3, axis_2, reach, (along, _STILL), rest))
        for i in range(2):
            sign = 1.0 if i == 0 else -1.0
            middle_2 = meeting.azimuth_1 - sign * meeting.side_1
            q2, half_2 = within(middle_2, meeting.half_1, arm.lower[1], arm.upper[1])
            if half_2 < 0.0:
                continue
            middle_3 = -meeting.azimuth_2 - sign * meeting.side_2
            q3, half_3 = within(middle_3, meeting.half_2, arm.lower[2], arm.upper[2])
            if half_3 < 0.0:
                continue
            first = free, Angle(q2, half_2), Angle(q3, half_3), Angle(q4, half_4)
            if _may_turn_wrist(arm, goal, first, fifth, angles):
                return True
    return False


@njit(cache=True, **WITHOUT_REFERENCE_COUNTS)
def _may_turn_wrist(
    arm: SphericalArm, goal: SphericalGoal, first: tuple[Angle, Angle, Angle, Angle], fifth: Angle, angles: Floats
) -> bool:
    """Whether the wrist may have the goal's orientation with the `first` four angles and the `fifth` in ranges."""
    axis_5, axis_6, axis_7 = row(arm.axes, 4), row(arm.axes, 5), row(arm.axes, 6)
    v, side = goal.last_axis, goal.side
    # The four axes after all four joints are turned back. The rotation has an error about each.
    seen = row(arm.axes, 0), row(arm.axes, 1), row(arm.axes, 2), row(arm.axes, 3)
    for k in range(4):
        axis, angle = row(arm.axes, k), -first[k].middle
        angles[0, k] = first[k].middle
        v, side = rotate(axis, angle, v), rotate(axis, angle, side)
        if k > 0:
            seen_1 = rotate(axis, angle, seen[0])
            seen_2 = rotate(axis, angle, seen[1]) if k > 1 else seen[1]
            seen_3 = rotate(axis, angle, seen[2]) if k > 2 else seen[2]
            seen = seen_1, seen_2, seen_3, seen[3]
    half_1, half_2, half_3, half_4 = first[0].half, first[1].half, first[2].half, first[3].half
    low, high, loose = fifth.middle - fifth.half, fifth.middle + fifth.half, TOLERANCE
    if half_3 > _UNDETERMINED:
        # Where the third axis lies along the fifth, only the sum of their angles is determined. A turn about the third
        # axis equals the same turn about the fifth, up to twice the angle between them. The fourth then turns in
        # between.
        loose += 2.0 * asin(min(1.0, norm(cross(seen[2], axis_5)))) + half_4
        low, high, half_3, half_4 = low - half_3, high + half_3, 0.0, 0.0
    halves = half_1, half_2, half_3, half_4
    turn = half_1 + half_2 + half_3 + half_4 + loose
    rest = loose + _beyond(turn)
    away, around = away_and_around(axis_5, v)
    moved_away, moved_around = 0.0, 0.0
    for k in range(4):
        motion = cross(seen[k], v)
        moved_away += abs(dot(away, motion)) * halves[k]
        moved_around += abs(dot(around, motion)) * halves[k]
    shrunk = max(1.0 - rest, _SHORTEST)
    start = direction(axis_5, axis_6, v, moved_away / shrunk, moved_around / shrunk, rest / shrunk)
    meeting = meeting_ranges(axis_5, start, axis_6, direction(axis_6, axis_5, axis_7, 0.0, 0.0, 0.0))
    for i in range(2):
        sign = 1.0 if i == 0 else -1.0
        q5, half_5 = within(meeting.azimuth_1 - sign * meeting.side_1, meeting.half_1, low, high)
        if half_5 < 0.0:
            continue
        middle_6 = -meeting.azimuth_2 - sign * meeting.side_2
        q6, half_6 = within(middle_6, meeting.half_2, arm.lower[5], arm.upper[5])
        if half_6 < 0.0:
            continue
        turned = rotate(axis_6, -q6, rotate(axis_5, -q5, side))
        # Only the components of the errors along the last axis turn the last joint.
        after_6 = rotate(axis_6, q6, axis_7)
        after_5 = rotate(axis_5, q5, after_6)
        error = loose + abs(dot(after_6, axis_5)) * half_5 + abs(dot(axis_7, axis_6)) * half_6
        for k in range(4):
            error += abs(dot(after_5, seen[k])) * halves[k]
        beyond = _beyond(turn + half_5 + half_6)
        half_7 = (error + beyond) / (1.0 - beyond) if beyond < 0.9 else pi
        q7, half_7 = within(angle_about(axis_7, goal.side_at_zero, turned), half_7, arm.lower[6], arm.upper[6])
        if half_7 >= 0.0:
            angles[0, 4], angles[0, 5], angles[0, 6] = q5, q6, q7
            return True
    return False


@njit(cache=True, **WITHOUT_REFERENCE_COUNTS)
def may_reach_parallel(arm: ParallelArm, goal: ParallelGoal, error: float) -> bool:
    """Whether an arm with three parallel axes may reach a pose whose position has an error [m]. False is proved."""
    axis_1, along, axis_5, axis_6 = row(arm.axes, 0), row(arm.axes, 1), row(arm.axes, 4), row(arm.axes, 5)
    height, turn = dot(along, subtract(row(arm.points, 4), row(arm.points, 0))), TOLERANCE + arm.turn
    middle, least, most = component_range(along, scale(-1.0, axis_1), goal.to_meeting, height, error)
    for i in range(2):
        side = 0.5 * (least + most) if i == 0 else -0.5 * (least + most)
        q1, half_1 = within(middle + side, 0.5 * (most - least), arm.lower[0], arm.upper[0])
        if most < 0.0 or half_1 < 0.0:
            continue
        last = rotate(axis_1, -q1, goal.last_axis)
        moved = min(2.0, turn + _sine(axis_1, last) * half_1)
        # A component changes by the motion times the sine of its angle, and by half of the squared motion.
        change = _sine(along, last) * moved + 0.5 * moved * moved
        middle_5, least_5, most_5 = component_range(along, axis_5, axis_6, dot(along, last), change)
        for j in range(2):
            side = 0.5 * (least_5 + most_5) if j == 0 else -0.5 * (least_5 + most_5)
            q5, half_5 = within(middle_5 + side, 0.5 * (most_5 - least_5), arm.lower[4], arm.upper[4])
            if most_5 < 0.0 or half_5 < 0.0:
                continue
            if _may_bend(arm, goal, Angle(q1, half_1), Angle(q5, half_5), error):
                return True
    return False


@njit(cache=True, **WITHOUT_REFERENCE_COUNTS)
def _may_bend(arm: ParallelArm, goal: ParallelGoal, first: Angle, fifth: Angle, error: float) -> bool:
    """Whether the other joints may reach the pose with the first and the fifth joint in ranges."""
    axis_1, along, axis_5, axis_6 = row(arm.axes, 0), row(arm.axes, 1), row(arm.axes, 4), row(arm.axes, 5)
    axis_3, axis_4, turn = row(arm.axes, 2), row(arm.axes, 3), TOLERANCE + arm.turn
    turned = rotate(axis_5, -fifth.middle, along)
    back = matvec(goal.to_tool, rotate(axis_1, first.middle, along))
    error_turned = _sine(axis_5, along) * fifth.half / max(_sine(axis_6, turned), _SHORTEST)
    error_back = (turn + _sine(axis_1, along) * first.half) / max(_sine(axis_6, back), _SHORTEST)
    if error_turned >= 1.0 or error_back >= 1.0:
        return True  # the last axis may be parallel to the others, so any of its angles is possible
    half_6 = asin(error_turned) + asin(error_back)
    middle_6 = angle_about(scale(-1.0, axis_6), turned, back)
    q6, half_6 = within(middle_6, half_6, arm.lower[5], arm.upper[5])
    if half_6 < 0.0:
        return False
    side = perpendicular(along)
    last = rotate(axis_6, -q6, rotate(axis_5, -fifth.middle, side))
    total = angle_about(along, side, rotate(axis_1, -first.middle, matvec(goal.moved, last)))
    half_total = _about(turn + first.half + fifth.half + half_6)
    second, third, fourth = row(arm.points, 1), row(arm.points, 2), row(arm.points, 3)
    hand = subtract(row(arm.points, 4), fourth)
    from_first = rotate(axis_1, -first.middle, goal.to_meeting)
    to_fourth = subtract(subtract(from_first, subtract(second, row(arm.points, 0))), rotate(along, total, hand))
    error += norm(cross(axis_1, from_first)) * _chord(first.half) + norm(cross(along, hand)) * _chord(half_total)
    distance, upper_arm, forearm = norm(to_fourth), subtract(third, second), subtract(fourth, third)
    middle_3, least, most = distance_range(axis_3, upper_arm, forearm, max(0.0, distance - error), distance + error)
    if most < 0.0:
        return False
    across, radius = norm(cross(along, forearm)), norm(cross(along, to_fourth))
    sign_3, sign_4 = copysign(1.0, dot(along, axis_3)), copysign(1.0, dot(along, axis_4))
    for k in range(2):
        bend = 0.5 * (least + most) if k == 0 else -0.5 * (least + most)
        q3, half_3 = within(middle_3 + bend, 0.5 * (most - least), arm.lower[2], arm.upper[2])
        if half_3 < 0.0:
            continue
        reach = add(upper_arm, rotate(axis_3, q3, forearm))
        middle_2 = angle_about(along, reach, to_fourth)
        half_2 = turned_by(error, radius) + turned_by(across * _chord(half_3), norm(cross(along, reach)))
        q2, half_2 = within(middle_2, half_2, arm.lower[1], arm.upper[1])
        if half_2 < 0.0:
            continue
        middle_4, half_4 = sign_4 * (total - q2 - sign_3 * q3), half_total + half_2 + half_3
        if within(middle_4, half_4, arm.lower[3], arm.upper[3])[1] >= 0.0:
            return True
    return False
