"""Distance tests between convex solids by GJK, compiled.

A solid is a *core* grown by a radius. The core is an oriented box, cylinder, ellipsoid or convex hull. A capsule is a
segment (a box without width) grown by its radius. GJK decides whether two solids come closer than a threshold (Gilbert,
Johnson & Keerthi, "A fast procedure for computing the distance between complex objects in three-dimensional space",
1988). The simplex is an upper bound of the distance, its separating plane a lower bound. The answer is "free" only when
the plane proves it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from irm.compilation import njit
from irm.kernel_arguments import inlined_kernel, leaf_kernel

Array = NDArray[np.float64]
_NO_VERTICES, _NO_HULLS = np.zeros((0, 3)), np.zeros(0, dtype=np.int64)

BOX, CYLINDER, ELLIPSOID, HULL = 0, 1, 2, 3
"""Kinds of cores. `half` (3,) has the half extents of a box, (radius, radius, half height) of a cylinder along its z
axis, the semi-axes of an ellipsoid, or the half extents of the box around a hull."""

_MAX_ITERATIONS = 40
"""GJK usually needs 3 to 8 iterations, about 20 for round solids. An undecided pair is taken to touch."""
_RELATIVE_GAP = 1e-7
"""Relative gap at which upper and lower bound of the squared distance are equal."""
_TOUCHING = 1e-7
"""[m] Nearer than this, cores intersect."""
_NO_VERTEX = np.int64(0)
_FIRST, _SECOND, _THIRD = np.int64(0), np.int64(1), np.int64(2)
"""Vertices of a simplex. They are typed, so that kernels are not compiled again for constants."""


class Solids(NamedTuple):
    """n solids in the world. Lengths in metres.

    Attributes:
        core: (n,) BOX, CYLINDER, ELLIPSOID or HULL, with half extents `half` (n, 3), grown by `radius` (n,).
        bound: (n,) radius of the bounding sphere about the solid's centre.
        position: (n, 3), `rotation` (n, 3, 3).
        vertices: (v, 3) corners of all hulls, each relative to its position and along its own axes.
        first: (n + 1,) start of each hull's corners: hull i has those from `first[i]` up to `first[i + 1]`. Empty
            without hulls.
    """

    core: NDArray[np.int64]
    half: Array
    radius: Array
    bound: Array
    position: Array
    rotation: Array
    vertices: Array = _NO_VERTICES
    first: NDArray[np.int64] = _NO_HULLS


Support: TypeAlias = Callable[[Solids, int, float, float, float], tuple[float, float, float]]
"""The farthest point of a core in a direction."""


@inlined_kernel
def _along_axes(R: Array, i: int, x: float, y: float, z: float) -> tuple[float, float, float]:
    """The components of a world vector along the axes of solid i."""
    return (
        R[i, 0, 0] * x + R[i, 1, 0] * y + R[i, 2, 0] * z,
        R[i, 0, 1] * x + R[i, 1, 1] * y + R[i, 2, 1] * z,
        R[i, 0, 2] * x + R[i, 1, 2] * y + R[i, 2, 2] * z,
    )


@inlined_kernel
def _in_world(solids: Solids, i: int, a: float, b: float, c: float) -> tuple[float, float, float]:
    """The point in the world that is at (a, b, c) in the frame of solid i."""
    R = solids.rotation
    return (
        solids.position[i, 0] + R[i, 0, 0] * a + R[i, 0, 1] * b + R[i, 0, 2] * c,
        solids.position[i, 1] + R[i, 1, 0] * a + R[i, 1, 1] * b + R[i, 1, 2] * c,
        solids.position[i, 2] + R[i, 2, 0] * a + R[i, 2, 1] * b + R[i, 2, 2] * c,
    )


@inlined_kernel
def _support(solids: Solids, i: int, x: float, y: float, z: float) -> tuple[float, float, float]:
    """The farthest point of core i, a box or cylinder, in the direction (x, y, z)."""
    half = solids.half
    a, b, c = _along_axes(solids.rotation, i, x, y, z)
    if solids.core[i] == BOX:
        a = half[i, 0] if a > 0.0 else -half[i, 0]
        b = half[i, 1] if b > 0.0 else -half[i, 1]
    else:
        norm = math.sqrt(a * a + b * b)
        scale = half[i, 0] / norm if norm > 0.0 else 0.0
        a *= scale
        b *= scale
    c = half[i, 2] if c > 0.0 else -half[i, 2]
    return _in_world(solids, i, a, b, c)


@leaf_kernel
def _farthest_point(solids: Solids, i: int, x: float, y: float, z: float) -> tuple[float, float, float]:
    """The farthest point of core i, of any kind, in the direction (x, y, z)."""
    if solids.core[i] <= CYLINDER:
        return _support(solids, i, x, y, z)
    half, vertices, best = solids.half, solids.vertices, solids.first[i]
    a, b, c = _along_axes(solids.rotation, i, x, y, z)
    if solids.core[i] == ELLIPSOID:
        a, b, c = half[i, 0] * a, half[i, 1] * b, half[i, 2] * c
        norm = math.sqrt(a * a + b * b + c * c)
        scale = 1.0 / norm if norm > 0.0 else 0.0
        a, b, c = half[i, 0] * a * scale, half[i, 1] * b * scale, half[i, 2] * c * scale
    else:
        farthest = -math.inf
        for k in range(solids.first[i], solids.first[i + 1]):
            along = a * vertices[k, 0] + b * vertices[k, 1] + c * vertices[k, 2]
            if along > farthest:
                farthest, best = along, k
        a, b, c = vertices[best, 0], vertices[best, 1], vertices[best, 2]
    return _in_world(solids, i, a, b, c)


@leaf_kernel
def height(solids: Solids, i: int) -> float:
    """[m] from the centre of solid i up to its highest point."""
    return float(solids.radius[i] + _farthest_point(solids, i, 0.0, 0.0, 1.0)[2] - solids.position[i, 2])


@leaf_kernel
def core_distance(solids: Solids, i: int, x: float, y: float, z: float) -> float:
    """[m] from a point to the oriented box around core i: a lower bound of the distance to the core."""
    half = solids.half
    x, y, z = x - solids.position[i, 0], y - solids.position[i, 1], z - solids.position[i, 2]
    a, b, c = _along_axes(solids.rotation, i, x, y, z)
    a, b, c = max(abs(a) - half[i, 0], 0.0), max(abs(b) - half[i, 1], 0.0), max(abs(c) - half[i, 2], 0.0)
    return math.sqrt(a * a + b * b + c * c)


@leaf_kernel
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


@leaf_kernel
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
    return best[0], best[1], best[2], best[3]


@leaf_kernel
def _is_beyond(simplex: Array, i: int, j: int, k: int, inside: int) -> bool:
    """Whether a face separates the origin from the fourth vertex, or the simplex is flat."""
    ax, ay, az = simplex[i, 0], simplex[i, 1], simplex[i, 2]
    bx, by, bz = simplex[j, 0] - ax, simplex[j, 1] - ay, simplex[j, 2] - az
    cx, cy, cz = simplex[k, 0] - ax, simplex[k, 1] - ay, simplex[k, 2] - az
    nx, ny, nz = by * cz - bz * cy, bz * cx - bx * cz, bx * cy - by * cx
    origin = -(ax * nx + ay * ny + az * nz)
    fourth = (simplex[inside, 0] - ax) * nx + (simplex[inside, 1] - ay) * ny + (simplex[inside, 2] - az) * nz
    return bool(origin * fourth <= 0.0)


@leaf_kernel
def _reduce_tetrahedron(simplex: Array) -> tuple[float, float, float, int]:
    """Closest point to the origin in the full simplex. All four bits are set if it contains the origin."""
    best = (0.0, 0.0, 0.0, 15)
    least = math.inf
    for face in ((0, 1, 2, 3), (0, 1, 3, 2), (0, 2, 3, 1), (1, 2, 3, 0)):
        if _is_beyond(simplex, face[0], face[1], face[2], face[3]):
            candidate = _reduce_triangle(simplex, face[0], face[1], face[2])
            squared = candidate[0] ** 2 + candidate[1] ** 2 + candidate[2] ** 2
            if squared < least:
                least, best = squared, candidate
    return best


@leaf_kernel
def _add_vertex(simplex: Array, count: int, x: float, y: float, z: float) -> tuple[float, float, float, int]:
    """Add a vertex to a simplex of `count` vertices, and drop vertices that do not span its closest point to the
    origin.

    Returns this point and the number of vertices that remain: 0 if the simplex contains the origin.
    """
    simplex[count, 0], simplex[count, 1], simplex[count, 2] = x, y, z
    if count == 0:
        return x, y, z, 1
    if count == 1:
        x, y, z, used = _reduce_segment(simplex, _FIRST, _SECOND)
    elif count == 2:
        x, y, z, used = _reduce_triangle(simplex, _FIRST, _SECOND, _THIRD)
    else:
        x, y, z, used = _reduce_tetrahedron(simplex)
        if used == 15:
            return 0.0, 0.0, 0.0, 0
    kept = 0
    for i in range(count + 1):
        if used >> i & 1:
            for axis in range(3):
                simplex[kept, axis] = simplex[i, axis]
            kept += 1
    return x, y, z, kept


@njit(inline="always")
def _are_within(support: Support, a: Solids, i: int, b: Solids, j: int, padding: float, simplex: Array) -> bool:
    """The loop of GJK, inlined with the support function of the kernel that calls it."""
    threshold = max(a.radius[i] + b.radius[j] + padding, _TOUCHING)
    x = a.position[i, 0] - b.position[j, 0]
    y = a.position[i, 1] - b.position[j, 1]
    z = a.position[i, 2] - b.position[j, 2]
    squared = x * x + y * y + z * z
    count = _NO_VERTEX
    for _ in range(_MAX_ITERATIONS):
        # The point (x, y, z) of the simplex is an upper bound of the distance ...
        if squared <= threshold * threshold:
            return True
        ax, ay, az = support(a, i, -x, -y, -z)
        bx, by, bz = support(b, j, x, y, z)
        wx, wy, wz = ax - bx, ay - by, az - bz
        # ... and the plane through w perpendicular to it a lower bound.
        bound = x * wx + y * wy + z * wz
        if bound > 0.0 and bound * bound > threshold * threshold * squared:
            return False
        if count > 0 and squared - bound <= _RELATIVE_GAP * squared:
            return True
        x, y, z, count = _add_vertex(simplex, count, wx, wy, wz)
        if count == 0:
            return True
        squared = x * x + y * y + z * z
    return True


@leaf_kernel
def are_within(a: Solids, i: int, b: Solids, j: int, padding: float, simplex: Array) -> bool:
    """Whether solid i of `a` and j of `b`, boxes or cylinders, are at most `padding` [m] apart.

    False is proved by a plane. `simplex` (4, 3) is scratch space.
    """
    return bool(_are_within(_support, a, i, b, j, padding, simplex))


@leaf_kernel
def are_any_within(a: Solids, i: int, b: Solids, j: int, padding: float, simplex: Array) -> bool:
    """As `are_within`, for solids of any kind. It takes a third longer for boxes and cylinders."""
    return bool(_are_within(_farthest_point, a, i, b, j, padding, simplex))
