"""Distance between convex primitives, compiled.

A primitive is a *core*, an oriented box or cylinder, grown by a radius: a capsule is a segment (a box without width)
grown by its radius. Whether two of them come closer than a threshold is decided by GJK (Gilbert, Johnson & Keerthi,
"A fast procedure for computing the distance between complex objects in three-dimensional space", 1988): the simplex
bounds the distance from above, its separating plane from below, and "free" is answered only when the plane proves it.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

__all__ = ["BOX", "CYLINDER", "are_within", "core_height", "sphere_near_box"]

BOX, CYLINDER = 0, 1
"""Kinds of cores. A box has half extents (3,); a cylinder along its z axis has (radius, radius, half height)."""

_MAX_ITERATIONS = 40
"""GJK needs 3-8 as a rule; undecided pairs count as touching."""
_RELATIVE_GAP = 1e-7
"""Upper and lower bound of the squared distance count as equal when this close."""
_TOUCHING = 1e-7
"""[m] Nearer than this, cores intersect."""

Array = NDArray[np.float64]


@njit(cache=True)
def _support(
    kind: int, half: Array, position: Array, rotation: Array, x: float, y: float, z: float
) -> tuple[float, float, float]:
    """The core's farthest point in the world direction (x, y, z)."""
    a = rotation[0, 0] * x + rotation[1, 0] * y + rotation[2, 0] * z
    b = rotation[0, 1] * x + rotation[1, 1] * y + rotation[2, 1] * z
    c = rotation[0, 2] * x + rotation[1, 2] * y + rotation[2, 2] * z
    if kind == 0:
        a = half[0] if a > 0.0 else -half[0]
        b = half[1] if b > 0.0 else -half[1]
    else:
        norm = math.sqrt(a * a + b * b)
        scale = half[0] / norm if norm > 0.0 else 0.0
        a *= scale
        b *= scale
    c = half[2] if c > 0.0 else -half[2]
    return (
        position[0] + rotation[0, 0] * a + rotation[0, 1] * b + rotation[0, 2] * c,
        position[1] + rotation[1, 0] * a + rotation[1, 1] * b + rotation[1, 2] * c,
        position[2] + rotation[2, 0] * a + rotation[2, 1] * b + rotation[2, 2] * c,
    )


@njit(cache=True)
def core_height(kind: int, half: Array, rotation: Array) -> float:
    """[m] from a core's centre up to its highest point."""
    if kind == 0:
        return abs(rotation[2, 0]) * half[0] + abs(rotation[2, 1]) * half[1] + abs(rotation[2, 2]) * half[2]
    lying = math.sqrt(rotation[2, 0] * rotation[2, 0] + rotation[2, 1] * rotation[2, 1])
    return lying * half[0] + abs(rotation[2, 2]) * half[2]


@njit(cache=True)
def sphere_near_box(x: float, y: float, z: float, reach: float, lower: Array, upper: Array) -> bool:
    """Whether a point is nearer than `reach` [m] to an axis-aligned box given by two corners (3,)."""
    dx = max(lower[0] - x, 0.0, x - upper[0])
    dy = max(lower[1] - y, 0.0, y - upper[1])
    dz = max(lower[2] - z, 0.0, z - upper[2])
    return dx * dx + dy * dy + dz * dz < reach * reach


@njit(cache=True)
def _reduce_segment(simplex: Array, i: int, j: int) -> tuple[float, float, float, int]:
    """Closest point to the origin on an edge of the simplex, and the vertices (bits) that span it."""
    ax, ay, az = simplex[i, 0], simplex[i, 1], simplex[i, 2]
    dx, dy, dz = simplex[j, 0] - ax, simplex[j, 1] - ay, simplex[j, 2] - az
    length = dx * dx + dy * dy + dz * dz
    along = -(ax * dx + ay * dy + az * dz)
    if along <= 0.0 or length == 0.0:
        return ax, ay, az, 1 << i
    if along >= length:
        return ax + dx, ay + dy, az + dz, 1 << j
    s = along / length
    return ax + s * dx, ay + s * dy, az + s * dz, 1 << i | 1 << j


@njit(cache=True)
def _reduce_triangle(simplex: Array, i: int, j: int, k: int) -> tuple[float, float, float, int]:
    """Closest point to the origin on a face of the simplex, and the vertices (bits) that span it."""
    ax, ay, az = simplex[i, 0], simplex[i, 1], simplex[i, 2]
    bx, by, bz = simplex[j, 0] - ax, simplex[j, 1] - ay, simplex[j, 2] - az
    cx, cy, cz = simplex[k, 0] - ax, simplex[k, 1] - ay, simplex[k, 2] - az
    bb, bc, cc = bx * bx + by * by + bz * bz, bx * cx + by * cy + bz * cz, cx * cx + cy * cy + cz * cz
    ab, ac = -(ax * bx + ay * by + az * bz), -(ax * cx + ay * cy + az * cz)
    area = bb * cc - bc * bc
    u, v = cc * ab - bc * ac, bb * ac - bc * ab
    if area > 0.0 and u > 0.0 and v > 0.0 and u + v < area:
        s, t = u / area, v / area
        return ax + s * bx + t * cx, ay + s * by + t * cy, az + s * bz + t * cz, 1 << i | 1 << j | 1 << k
    best = _reduce_segment(simplex, i, j)
    for other in (_reduce_segment(simplex, i, k), _reduce_segment(simplex, j, k)):
        if other[0] ** 2 + other[1] ** 2 + other[2] ** 2 < best[0] ** 2 + best[1] ** 2 + best[2] ** 2:
            best = other
    return best


@njit(cache=True)
def _is_beyond(simplex: Array, i: int, j: int, k: int, inside: int) -> bool:
    """Whether the origin lies on the far side of a face, seen from the fourth vertex (or the simplex is flat)."""
    ax, ay, az = simplex[i, 0], simplex[i, 1], simplex[i, 2]
    bx, by, bz = simplex[j, 0] - ax, simplex[j, 1] - ay, simplex[j, 2] - az
    cx, cy, cz = simplex[k, 0] - ax, simplex[k, 1] - ay, simplex[k, 2] - az
    nx, ny, nz = by * cz - bz * cy, bz * cx - bx * cz, bx * cy - by * cx
    origin = -(ax * nx + ay * ny + az * nz)
    fourth = (simplex[inside, 0] - ax) * nx + (simplex[inside, 1] - ay) * ny + (simplex[inside, 2] - az) * nz
    return origin * fourth <= 0.0


@njit(cache=True)
def _reduce_tetrahedron(simplex: Array) -> tuple[float, float, float, int]:
    """Closest point to the origin in the full simplex; all four bits are set when it contains the origin."""
    best = (0.0, 0.0, 0.0, 15)
    least = math.inf
    for face in ((0, 1, 2, 3), (0, 1, 3, 2), (0, 2, 3, 1), (1, 2, 3, 0)):
        if _is_beyond(simplex, face[0], face[1], face[2], face[3]):
            candidate = _reduce_triangle(simplex, face[0], face[1], face[2])
            squared = candidate[0] ** 2 + candidate[1] ** 2 + candidate[2] ** 2
            if squared < least:
                least, best = squared, candidate
    return best


@njit(cache=True)
def _keep(simplex: Array, count: int, used: int) -> int:
    """Drop the vertices whose bits are not set; how many remain."""
    kept = 0
    for i in range(count):
        if used >> i & 1:
            for axis in range(3):
                simplex[kept, axis] = simplex[i, axis]
            kept += 1
    return kept


@njit(cache=True)
def are_within(
    kind_a: int,
    half_a: Array,
    position_a: Array,
    rotation_a: Array,
    kind_b: int,
    half_b: Array,
    position_b: Array,
    rotation_b: Array,
    threshold: float,
    simplex: Array,
) -> bool:
    """Whether two cores are at most `threshold` [m] apart; False is proved by a separating plane.

    Positions (3,) and rotations (3, 3) are world poses of the cores; `simplex` (4, 3) is scratch space.
    """
    threshold = max(threshold, _TOUCHING)
    x, y, z = position_a[0] - position_b[0], position_a[1] - position_b[1], position_a[2] - position_b[2]
    squared = x * x + y * y + z * z
    count = 0
    for _ in range(_MAX_ITERATIONS):
        if squared <= threshold * threshold:
            return True
        ax, ay, az = _support(kind_a, half_a, position_a, rotation_a, -x, -y, -z)
        bx, by, bz = _support(kind_b, half_b, position_b, rotation_b, x, y, z)
        wx, wy, wz = ax - bx, ay - by, az - bz
        bound = x * wx + y * wy + z * wz
        if bound > 0.0 and bound * bound > threshold * threshold * squared:
            return False
        if count > 0 and squared - bound <= _RELATIVE_GAP * squared:
            return True
        simplex[count, 0], simplex[count, 1], simplex[count, 2] = wx, wy, wz
        count += 1
        if count == 1:
            x, y, z = wx, wy, wz
        else:
            if count == 2:
                x, y, z, used = _reduce_segment(simplex, 0, 1)
            elif count == 3:
                x, y, z, used = _reduce_triangle(simplex, 0, 1, 2)
            else:
                x, y, z, used = _reduce_tetrahedron(simplex)
                if used == 15:
                    return True
            count = _keep(simplex, count, used)
        squared = x * x + y * y + z * z
    return True
