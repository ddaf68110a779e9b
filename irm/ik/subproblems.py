"""Subproblems of inverse kinematics, compiled: rotation angles about known axes that move one vector to another.

Subproblems 1 to 4 of Elias & Wen, "IK-Geo: unified robot inverse kinematics using subproblem decomposition" (2022). The
first three are those of Paden and Kahan. Axes have unit length. A subproblem without a solution returns the nearest
angles and its error, so that its answer is continuous.

Vectors are tuples of three numbers, which numba keeps in registers.
"""

from __future__ import annotations

from math import acos, atan2, cos, floor, pi, sin, sqrt

import numpy as np
from numpy.typing import NDArray

from irm.compilation import njit

Floats = NDArray[np.float64]
Vector = tuple[float, float, float]


@njit(cache=True, inline="always")
def row(array: Floats, k: int) -> Vector:
    """A row of an array (n, 3)."""
    return array[k, 0], array[k, 1], array[k, 2]


@njit(cache=True)
def point(array: Floats) -> Vector:
    """The three numbers of an array (3,)."""
    return array[0], array[1], array[2]


@njit(cache=True)
def matvec(R: Floats, v: Vector) -> Vector:
    """R v, for R (3, 3)."""
    return (
        R[0, 0] * v[0] + R[0, 1] * v[1] + R[0, 2] * v[2],
        R[1, 0] * v[0] + R[1, 1] * v[1] + R[1, 2] * v[2],
        R[2, 0] * v[0] + R[2, 1] * v[1] + R[2, 2] * v[2],
    )


@njit(cache=True, inline="always")
def dot(a: Vector, b: Vector) -> float:
    """Scalar product."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@njit(cache=True, inline="always")
def norm(a: Vector) -> float:
    """Length."""
    return sqrt(a[0] * a[0] + a[1] * a[1] + a[2] * a[2])


@njit(cache=True, inline="always")
def cross(a: Vector, b: Vector) -> Vector:
    """Vector product."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@njit(cache=True, inline="always")
def add(a: Vector, b: Vector) -> Vector:
    """Sum."""
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@njit(cache=True, inline="always")
def subtract(a: Vector, b: Vector) -> Vector:
    """Difference a - b."""
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@njit(cache=True, inline="always")
def scale(factor: float, a: Vector) -> Vector:
    """A multiple."""
    return factor * a[0], factor * a[1], factor * a[2]


@njit(cache=True)
def rotate(axis: Vector, angle: float, v: Vector) -> Vector:
    """Rot(axis, angle) v."""
    c, s = cos(angle), sin(angle)
    along = (1.0 - c) * dot(axis, v)
    w = cross(axis, v)
    return (
        c * v[0] + s * w[0] + along * axis[0],
        c * v[1] + s * w[1] + along * axis[1],
        c * v[2] + s * w[2] + along * axis[2],
    )


@njit(cache=True)
def perpendicular(v: Vector) -> Vector:
    """A vector at right angles to a unit vector, of length at least sqrt(2/3)."""
    x, y, z = abs(v[0]), abs(v[1]), abs(v[2])
    if x <= y and x <= z:
        return 0.0, v[2], -v[1]
    if y <= z:
        return -v[2], 0.0, v[0]
    return v[1], -v[0], 0.0


_TINY = 1e-12
"""Length below which a vector has no direction."""


@njit(cache=True)
def angle_about(axis: Vector, start: Vector, end: Vector) -> float:
    """Subproblem 1: the angle for which Rot(axis, angle) start is nearest to `end` [rad]."""
    return atan2(dot(axis, cross(start, end)), dot(start, end) - dot(axis, start) * dot(axis, end))


@njit(cache=True)
def angles_to_meet(
    axis_1: Vector, start_1: Vector, axis_2: Vector, start_2: Vector
) -> tuple[float, float, float, float, float, float]:
    """Subproblem 2: angles for which Rot(axis_1, a) start_1 and Rot(axis_2, b) start_2 have the same direction.

    Returns:
        a and b of the first solution, and a and b of the second. The angle by which the two cones fail to meet [rad].
        The distance of the common direction from the plane of the axes, 0 to 1. Near 0 both angles change fast.
    """
    u, v = scale(1.0 / max(norm(start_1), _TINY), start_1), scale(1.0 / max(norm(start_2), _TINY), start_2)
    between, c1, c2 = dot(axis_1, axis_2), dot(axis_1, u), dot(axis_2, v)
    square = 1.0 - between * between
    if square < _TINY:
        b = angle_about(axis_2, v, u)
        return 0.0, b, 0.0, b, abs(acos(_cosine(c1)) - acos(_cosine(c2))), 1.0
    alpha, beta = (c1 - between * c2) / square, (c2 - between * c1) / square
    rest = 1.0 - alpha * alpha - beta * beta - 2.0 * alpha * beta * between
    normal = cross(axis_1, axis_2)
    gamma = sqrt(max(rest, 0.0) / square)
    missed = 0.0
    if rest < 0.0:
        half_1, half_2, apart = acos(_cosine(c1)), acos(_cosine(c2)), acos(_cosine(between))
        missed = max(abs(half_1 - half_2) - apart, apart - half_1 - half_2, apart + half_1 + half_2 - 2.0 * pi, 0.0)
    middle = add(scale(alpha, axis_1), scale(beta, axis_2))
    first, second = add(middle, scale(gamma, normal)), add(middle, scale(-gamma, normal))
    return (
        angle_about(axis_1, u, first),
        angle_about(axis_2, v, first),
        angle_about(axis_1, u, second),
        angle_about(axis_2, v, second),
        missed,
        sqrt(max(rest, 0.0)),
    )


@njit(cache=True)
def angles_to_distance(axis: Vector, fixed: Vector, moved: Vector, distance: float) -> tuple[float, float, float]:
    """Subproblem 3: angles for which |fixed + Rot(axis, angle) moved| = distance.

    Returns:
        Both angles [rad], and the length by which the distance is out of range [m].
    """
    along = dot(axis, fixed) * dot(axis, moved)
    a, b = norm(cross(axis, fixed)), norm(cross(axis, moved))
    constant = dot(fixed, fixed) + dot(moved, moved) + 2.0 * along
    longest, shortest = sqrt(max(constant + 2.0 * a * b, 0.0)), sqrt(max(constant - 2.0 * a * b, 0.0))
    missed = max(distance - longest, shortest - distance, 0.0)
    middle = angle_about(axis, moved, fixed)
    half = acos(_cosine((distance * distance - constant) / max(2.0 * a * b, _TINY)))
    return middle + half, middle - half, missed


@njit(cache=True)
def angles_to_component(direction: Vector, axis: Vector, moved: Vector, value: float) -> tuple[float, float, float]:
    """Subproblem 4: angles for which direction · Rot(axis, angle) moved = value.

    Returns:
        Both angles [rad], and the length by which the value is out of range [m], or [1] for unit vectors.
    """
    along = dot(direction, axis) * dot(axis, moved)
    a, b = dot(direction, moved) - along, dot(direction, cross(axis, moved))
    radius = sqrt(a * a + b * b)
    half = acos(_cosine((value - along) / max(radius, _TINY)))
    middle = atan2(b, a)
    return middle + half, middle - half, max(abs(value - along) - radius, 0.0)


@njit(cache=True, inline="always")
def nearest_turn(angle: float, lower: float, upper: float) -> tuple[float, float]:
    """Turn an angle to within half a turn of the middle of its limits. Returns the angle and its excess over the limits
    [rad]."""
    middle = 0.5 * (lower + upper)
    away = angle - middle
    away -= 2.0 * pi * floor((away + pi) / (2.0 * pi))
    return middle + away, max(0.0, abs(away) - 0.5 * (upper - lower))


@njit(cache=True, inline="always")
def _cosine(value: float) -> float:
    return min(1.0, max(-1.0, value))
