"""Ranges of joint angles, compiled: all solutions of a subproblem whose vectors are known up to an error.

The module covers the subproblems of `irm.ik.subproblems` that serve to prove NO. A range is a middle and half of its
width [rad]. It contains the solutions for all input values within their errors. A half width of π or more means every
angle, a negative half width none. Near a singularity a range grows with the square root of the error, or becomes every
angle. So no proof relies on an angle that the pose hardly determines.
"""

from __future__ import annotations

from math import acos, asin, atan2, copysign, cos, floor, pi, sin, sqrt
from typing import NamedTuple

from irm.compilation import WITHOUT_REFERENCE_COUNTS, njit
from irm.ik.subproblems import Vector, angle_about, cross, dot, norm, perpendicular, scale

TOLERANCE = 1e-8
"""[m], [rad] Error of a pose and of a limit: rounding of numbers, of axes in a file, and of the angles here (less than
1e-12)."""
_SHORTEST = 1e-9
"""Length [m], or squared length, below which a vector or an angle is undetermined."""
_ROUNDING = 1e-12
"""Rounding error of a cosine."""


@njit(cache=True, inline="always")
def turned_by(chord: float, length: float) -> float:
    """Largest change of direction of a vector with a given length, if its end moves by a chord [rad]."""
    return asin(chord / length) if chord < length else pi


@njit(cache=True, **WITHOUT_REFERENCE_COUNTS)
def within(middle: float, half: float, lower: float, upper: float) -> tuple[float, float]:
    """Intersection of a range with joint limits, modulo 2π.

    An intersection of two parts yields the range that contains both.
    """
    centre, room = 0.5 * (lower + upper), 0.5 * (upper - lower) + TOLERANCE
    away = middle - centre
    away -= 2.0 * pi * floor((away + pi) / (2.0 * pi))
    if half < 0.0 or abs(away) - half > room:
        return centre, -1.0
    if half >= pi or room >= pi:
        return (centre, min(pi, room)) if half >= pi else (centre + away, half)
    if abs(away) + half >= 2.0 * pi - room:
        return centre + away, half
    low, high = max(away - half, -room), min(away + half, room)
    return centre + 0.5 * (low + high), 0.5 * (high - low)


@njit(cache=True, **WITHOUT_REFERENCE_COUNTS)
def distance_range(axis: Vector, fixed: Vector, moved: Vector, low: float, high: float) -> tuple[float, float, float]:
    """Range of the angles with |fixed + Rot(axis, angle) moved| from `low` to `high` [m], see subproblem 3.

    Returns:
        A middle, and the least and largest distance of the angles from it on both sides [rad]. The latter is negative
        for none.
    """
    along = dot(axis, fixed) * dot(axis, moved)
    twice = 2.0 * norm(cross(axis, fixed)) * norm(cross(axis, moved))
    if twice < _SHORTEST:
        return 0.0, 0.0, pi
    constant = dot(fixed, fixed) + dot(moved, moved) + 2.0 * along
    largest, smallest = (high * high - constant) / twice, (low * low - constant) / twice
    return angle_about(axis, moved, fixed), *_between(smallest, largest)


@njit(cache=True, **WITHOUT_REFERENCE_COUNTS)
def component_range(
    direction: Vector, axis: Vector, moved: Vector, value: float, error: float
) -> tuple[float, float, float]:
    """Range of the angles with direction · Rot(axis, angle) moved within an error of a value, as in `distance_range`:
    subproblem 4."""
    along = dot(direction, axis) * dot(axis, moved)
    a, b = dot(direction, moved) - along, dot(direction, cross(axis, moved))
    radius = sqrt(a * a + b * b)
    if radius < _SHORTEST:
        return 0.0, 0.0, pi if abs(value - along) <= error + _SHORTEST else -1.0
    largest, smallest = (value - along + error) / radius, (value - along - error) / radius
    return atan2(b, a), *_between(smallest, largest)


@njit(cache=True, inline="always")
def _between(smallest: float, largest: float) -> tuple[float, float]:
    """Smallest and largest angle from 0 to π with a cosine in a range. The latter is negative for none."""
    if smallest > 1.0 + _ROUNDING or largest < -1.0 - _ROUNDING:
        return 0.0, -1.0
    return acos(max(-1.0, min(1.0, largest + _ROUNDING))), acos(max(-1.0, min(1.0, smallest - _ROUNDING)))


class Direction(NamedTuple):
    """A direction relative to an axis: angle `far` from the axis and `azimuth` from a reference, each with its error
    [rad]."""

    far: float
    far_error: float
    azimuth: float
    azimuth_error: float


@njit(cache=True, inline="always")
def away_and_around(axis: Vector, v: Vector) -> tuple[Vector, Vector]:
    """Unit vectors perpendicular to a unit vector `v`: its directions of motion away from an axis and around it."""
    around = cross(axis, v)
    if norm(around) < _SHORTEST:
        around = perpendicular(v)
    around = scale(1.0 / norm(around), around)
    return cross(around, v), around


@njit(cache=True, **WITHOUT_REFERENCE_COUNTS)
def direction(axis: Vector, reference: Vector, v: Vector, away: float, around: float, rest: float) -> Direction:
    """Direction relative to an axis, with the azimuth from a reference.

    Args:
        axis, reference, v: unit vectors.
        away, around: largest motion of the end of `v` in the two directions of `away_and_around`.
        rest: largest additional motion in any direction.
    """
    sine = norm(cross(axis, v))
    far, azimuth = atan2(sine, dot(axis, v)), angle_about(axis, reference, v)
    total = turned_by(sqrt(away * away + around * around) + rest, 1.0)
    least = sine - away - rest  # distance from the axis
    if least <= 0.0:
        return Direction(far, total, azimuth, pi)
    # A motion around the axis increases the distance from it only by the square of the motion.
    moved = away + rest + 0.5 * (around + rest) * (around + rest) / least
    return Direction(far, min(total, turned_by(moved, 1.0)), azimuth, turned_by(around + rest, least))


class Meeting(NamedTuple):
    """Ranges of the two angles of subproblem 2 [rad]. One solution has the middles `side_1 - azimuth_1` and `-side_2 -
    azimuth_2`. The other has both sides with the opposite sign. `half_1` is negative for none."""

    azimuth_1: float
    side_1: float
    half_1: float
    azimuth_2: float
    side_2: float
    half_2: float


@njit(cache=True, **WITHOUT_REFERENCE_COUNTS)
def meeting_ranges(axis_1: Vector, start_1: Direction, axis_2: Vector, start_2: Direction) -> Meeting:
    """Ranges of the angles for which Rot(axis_1, a) start_1 and Rot(axis_2, b) start_2 have the same direction.

    Azimuths of the directions are measured from the other axis. The axes and the common direction are corners of a
    spherical triangle with three known sides: between the axes, and between each axis and its vector.
    """
    between = atan2(norm(cross(axis_1, axis_2)), dot(axis_1, axis_2))
    far_1, error_1, far_2, error_2 = start_1.far, start_1.far_error, start_2.far, start_2.far_error
    missed = max(abs(far_1 - far_2) - between, between - far_1 - far_2, far_1 + far_2 + between - 2.0 * pi)
    if missed > error_1 + error_2 + _ROUNDING:
        return Meeting(0.0, 0.0, -1.0, 0.0, 0.0, -1.0)
    c, s = cos(between), sin(between)
    side_1, half_1 = _corner(far_1, error_1, far_2, error_2, c, s)
    side_2, half_2 = _corner(far_2, error_2, far_1, error_1, c, s)
    if min(half_1, half_2) < 0.0:
        return Meeting(0.0, 0.0, -1.0, 0.0, 0.0, -1.0)
    half_1, half_2 = half_1 + start_1.azimuth_error, half_2 + start_2.azimuth_error
    return Meeting(start_1.azimuth, side_1, half_1, start_2.azimuth, side_2, half_2)


@njit(cache=True, **WITHOUT_REFERENCE_COUNTS)
def _corner(far: float, error: float, other: float, other_error: float, c: float, s: float) -> tuple[float, float]:
    """Range of a spherical triangle's angle between a side `far` and a side with cosine `c` and sine `s`, opposite to
    `other`.

    Its cosine falls as the opposite side grows. As a function of `far`, it has its extremes at the ends, or where the
    angle opposite to the fixed side is right.
    """
    low, high = far - error, far + error
    if low <= _SHORTEST or high >= pi - _SHORTEST:
        return 0.5 * pi, 0.5 * pi
    c_low, s_low, c_high, s_high = cos(low), s * sin(low), cos(high), s * sin(high)
    near, distant = cos(max(0.0, other - other_error)), cos(min(pi, other + other_error))
    smallest = min((distant - c_low * c) / s_low, (distant - c_high * c) / s_high)
    largest = max((near - c_low * c) / s_low, (near - c_high * c) / s_high)
    if c_high * abs(distant) < copysign(c, c * distant) < c_low * abs(distant):
        smallest = min(smallest, copysign(sqrt(max(0.0, distant * distant - c * c)), distant) / s)
    if c_high * abs(near) < copysign(c, c * near) < c_low * abs(near):
        largest = max(largest, copysign(sqrt(max(0.0, near * near - c * c)), near) / s)
    first, last = _between(smallest, largest)
    return 0.5 * (first + last), 0.5 * (last - first)
