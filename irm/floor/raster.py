"""The free floor as arrays, and compiled look-ups."""

from __future__ import annotations

from math import hypot, inf, sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from irm.compilation import njit

__all__ = [
    "BLOCKED",
    "FREE",
    "MIXED",
    "Raster",
    "are_outside",
    "classify_cells",
    "floor_distance",
    "floor_gap",
    "floor_kind",
    "is_outside",
    "outline_distance",
    "point_is_free",
]

Floats = NDArray[np.float64]
Bytes = NDArray[np.uint8]

BLOCKED, FREE, MIXED = 0, 1, 2


class Raster(NamedTuple):
    """Free space as arrays for kernels.

    `cells` (nx, ny) of BLOCKED, FREE, MIXED; `distance` (nx, ny) from a cell's centre to the nearest centre of a cell
    that is not blocked [m]; polygons as `vertices` (v, 2) with `starts` (m + 1,), each grown
    by its `radii` (m,) [m]. No cells at all: free everywhere.
    """

    cells: Bytes
    distance: NDArray[np.float32]
    x0: float
    y0: float
    x1: float
    y1: float
    resolution: float
    vertices: Floats
    starts: NDArray[np.int64]
    radii: Floats


@njit(cache=True)
def outline_distance(vertices: Floats, first: int, last: int, x: float, y: float) -> float:
    """Distance from a point to a polygon's outline, negative inside [m]."""
    nearest = inf
    inside = False
    for k in range(first, last):
        ax, ay = vertices[k, 0], vertices[k, 1]
        b = k + 1 if k + 1 < last else first
        bx, by = vertices[b, 0], vertices[b, 1]
        ex, ey = bx - ax, by - ay
        length = ex * ex + ey * ey
        t = ((x - ax) * ex + (y - ay) * ey) / length if length > 0.0 else 0.0
        t = min(1.0, max(0.0, t))
        dx, dy = x - ax - t * ex, y - ay - t * ey
        nearest = min(nearest, dx * dx + dy * dy)
        if (ay > y) != (by > y) and x < ax + (y - ay) / (by - ay) * ex:
            inside = not inside
    nearest = sqrt(nearest)
    return -nearest if inside else nearest


@njit(cache=True)
def is_outside(vertices: Floats, starts: NDArray[np.int64], radii: Floats, x: float, y: float) -> bool:
    """Whether a point is farther than its radius from every outline: `outline_distance` without its square roots."""
    for m in range(starts.shape[0] - 1):
        limit = radii[m] * radii[m]
        inside = False
        ax, ay = x - vertices[starts[m + 1] - 1, 0], y - vertices[starts[m + 1] - 1, 1]
        for k in range(starts[m], starts[m + 1]):
            bx, by = x - vertices[k, 0], y - vertices[k, 1]
            ex, ey = ax - bx, ay - by
            along, length = ax * ex + ay * ey, ex * ex + ey * ey
            if along <= 0.0 or length == 0.0:
                near = ax * ax + ay * ay
            elif along >= length:
                near = bx * bx + by * by
            else:
                cross = ax * ey - ay * ex
                near = cross * cross / length
            if near <= limit:
                return False
            if (ay < 0.0) != (by < 0.0) and (ax * by - ay * bx > 0.0) == (by < ay):
                inside = not inside
            ax, ay = bx, by
        if inside:
            return False
    return True


@njit(cache=True)
def are_outside(vertices: Floats, starts: NDArray[np.int64], radii: Floats, x: Floats, y: Floats) -> NDArray[np.bool_]:
    """`is_outside` of many points (n,)."""
    outside = np.empty(x.shape[0], np.bool_)
    for k in range(x.shape[0]):
        outside[k] = is_outside(vertices, starts, radii, x[k], y[k])
    return outside


@njit(cache=True, inline="always")
def floor_kind(raster: Raster, x: float, y: float) -> int:
    """BLOCKED, FREE or MIXED: the cell of a finite point, on a raster that has cells.

    The function has no branch, so that numba does not count references to the arrays in a loop: that would take ten
    times as long as the look-up itself.
    """
    inverse = 1.0 / raster.resolution
    inside = (x >= raster.x0) & (x <= raster.x1) & (y >= raster.y0) & (y <= raster.y1)
    i = min(max(int((x - raster.x0) * inverse), 0), raster.cells.shape[0] - 1)
    j = min(max(int((y - raster.y0) * inverse), 0), raster.cells.shape[1] - 1)
    return int(raster.cells[i, j] * inside)


@njit(cache=True, inline="always")
def point_is_free(raster: Raster, x: float, y: float) -> bool:
    """Whether the base's centre may be at a point."""
    free = False
    if raster.cells.size == 0:
        free = x == x and y == y
    elif x >= raster.x0 and x <= raster.x1 and y >= raster.y0 and y <= raster.y1:
        inverse = 1.0 / raster.resolution
        i = min(int((x - raster.x0) * inverse), raster.cells.shape[0] - 1)
        j = min(int((y - raster.y0) * inverse), raster.cells.shape[1] - 1)
        kind = raster.cells[np.uint64(i), np.uint64(j)]
        free = kind == FREE
        if kind == MIXED:
            free = is_outside(raster.vertices, raster.starts, raster.radii, x, y)
    return free


@njit(cache=True, inline="always")
def floor_distance(raster: Raster, x: float, y: float) -> float:
    """A lower bound of the distance from a point to the nearest free point [m].

    Outside the raster it is the distance to the nearest point of its rectangle, or that point's own bound if larger.
    """
    inside_x, inside_y = min(raster.x1, max(raster.x0, x)), min(raster.y1, max(raster.y0, y))
    inverse = 1.0 / raster.resolution
    i = min(int((inside_x - raster.x0) * inverse), raster.cells.shape[0] - 1)
    j = min(int((inside_y - raster.y0) * inverse), raster.cells.shape[1] - 1)
    outside = 0.0 if x == inside_x and y == inside_y else hypot(x - inside_x, y - inside_y)
    return max(outside, raster.distance[i, j] - 1.4143 * raster.resolution)


@njit(cache=True)
def floor_gap(raster: Raster, x: float, y: float) -> float:
    """A tighter bound than `floor_distance` near furniture: a free point is outside every grown outline."""
    gap = floor_distance(raster, x, y)
    if gap > 0.0:
        vertices, starts = raster.vertices, raster.starts
        for m in range(starts.shape[0] - 1):
            gap = max(gap, raster.radii[m] - outline_distance(vertices, starts[m], starts[m + 1], x, y))
    return gap


@njit(cache=True)
def _extent(vertices: Floats, first: int, last: int) -> tuple[float, float, float, float]:
    """Smallest x and y, and largest x and y of a polygon [m]."""
    low_x, low_y, high_x, high_y = inf, inf, -inf, -inf
    for k in range(first, last):
        low_x, high_x = min(low_x, vertices[k, 0]), max(high_x, vertices[k, 0])
        low_y, high_y = min(low_y, vertices[k, 1]), max(high_y, vertices[k, 1])
    return low_x, low_y, high_x, high_y


@njit(cache=True)
def classify_cells(
    cells: Bytes,
    x0: float,
    y0: float,
    resolution: float,
    vertices: Floats,
    starts: NDArray[np.int64],
    radii: Floats,
) -> None:
    """Classify every cell by its centre's distance to each outline, plus or minus half the cell's diagonal.

    `cells` are all FREE before.
    """
    width, depth = cells.shape
    slack = 0.7072 * resolution
    for m in range(starts.shape[0] - 1):
        low_x, low_y, high_x, high_y = _extent(vertices, starts[m], starts[m + 1])
        radius, grown = radii[m], radii[m] + resolution
        first_x = max(0, int((low_x - grown - x0) / resolution) - 1)
        last_x = min(width, int((high_x + grown - x0) / resolution) + 2)
        first_y = max(0, int((low_y - grown - y0) / resolution) - 1)
        last_y = min(depth, int((high_y + grown - y0) / resolution) + 2)
        for i in range(first_x, last_x):
            x = x0 + (i + 0.5) * resolution
            for j in range(first_y, last_y):
                if cells[i, j] == BLOCKED:
                    continue
                y = y0 + (j + 0.5) * resolution
                distance = outline_distance(vertices, starts[m], starts[m + 1], x, y)
                if distance <= radius - slack:
                    cells[i, j] = BLOCKED
                elif distance <= radius + slack:
                    cells[i, j] = MIXED
