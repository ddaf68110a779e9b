"""Vectors as tuples of three numbers, for kernels: numba keeps them in registers."""

from __future__ import annotations

from math import cos, sin, sqrt

import numpy as np
from numpy.typing import NDArray

from irm.compilation import njit

__all__ = [
    "Vector",
    "add",
    "cross",
    "dot",
    "norm",
    "perpendicular",
    "point",
    "row",
    "scale",
    "subtract",
    "times",
    "turn",
]

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
def times(R: Floats, v: Vector) -> Vector:
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
def turn(axis: Vector, angle: float, v: Vector) -> Vector:
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
    """A vector at right angles to a unit vector; its length is at least sqrt(2/3)."""
    x, y, z = abs(v[0]), abs(v[1]), abs(v[2])
    if x <= y and x <= z:
        return 0.0, v[2], -v[1]
    if y <= z:
        return -v[2], 0.0, v[0]
    return v[1], -v[0], 0.0
