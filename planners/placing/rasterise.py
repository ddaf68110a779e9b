"""Shapes in space as cells of a grid on the table, compiled. Every cell that a shape touches is marked.

The part of a shape between two heights is projected onto the plane. All shapes are convex, so each covers one interval
in a row of cells. Intervals are marked at their ends, and one pass over the grid turns the marks into cells.
"""

from __future__ import annotations

import math
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from irm.compilation import njit

Array: TypeAlias = NDArray[np.float64]
Marks: TypeAlias = NDArray[np.int32]

_MAX_POINTS = 40
"""Corners of a box cut by two planes: 8 of its own and 2 on each of its 12 edges, rounded up."""


@njit(cache=True)
def _mark_interval(marks: Marks, row: int, low: float, high: float) -> None:
    """Mark the cells of a row between two positions [cells]."""
    columns = marks.shape[1] - 1
    first = max(math.floor(low), 0)
    last = min(math.floor(high), columns - 1)
    if first <= last:
        marks[row, first] += 1
        marks[row, last + 1] -= 1


@njit(cache=True)
def mark_discs(marks: Marks, discs: Array, x0: float, y0: float, resolution: float) -> None:
    """Mark discs (k, 3): x, y, radius [m]."""
    for k in range(discs.shape[0]):
        x, y, radius = (discs[k, 0] - x0) / resolution, (discs[k, 1] - y0) / resolution, discs[k, 2] / resolution
        first = max(math.floor(x - radius), 0)
        last = min(math.floor(x + radius), marks.shape[0] - 1)
        for row in range(first, last + 1):
            nearest = max(row - x, x - (row + 1), 0.0)
            reach = math.sqrt(max(radius * radius - nearest * nearest, 0.0))
            _mark_interval(marks, row, y - reach, y + reach)


@njit(cache=True)
def mark_boxes(
    marks: Marks,
    centres: Array,
    axes: Array,
    half_extents: Array,
    z_low: float,
    z_high: float,
    x0: float,
    y0: float,
    resolution: float,
) -> None:
    """Mark the parts of oriented boxes between two heights.

    `centres` (k, 3), `axes` (k, 3, 3) with a box's axes as columns, `half_extents` (k, 3), all in [m].
    """
    corners = np.empty((8, 3))
    points = np.empty((_MAX_POINTS, 2))
    hull = np.empty((2 * _MAX_POINTS, 2))
    for k in range(centres.shape[0]):
        for corner in range(8):
            for i in range(3):
                corners[corner, i] = centres[k, i]
                for axis in range(3):
                    sign = 1.0 if corner >> axis & 1 else -1.0
                    corners[corner, i] += sign * half_extents[k, axis] * axes[k, i, axis]
        count = _cut(corners, z_low, z_high, points)
        for i in range(count):
            points[i, 0] = (points[i, 0] - x0) / resolution
            points[i, 1] = (points[i, 1] - y0) / resolution
        _mark_hull(marks, points[:count], hull)


@njit(cache=True)
def _cut(corners: Array, z_low: float, z_high: float, points: Array) -> int:
    """Write plan positions of the corners of a box between two heights to `points`, and return their number."""
    count = 0
    for a in range(8):
        if z_low <= corners[a, 2] <= z_high:
            points[count, 0] = corners[a, 0]
            points[count, 1] = corners[a, 1]
            count += 1
        for axis in range(3):
            b = a ^ (1 << axis)
            if b < a:
                continue
            for plane in (z_low, z_high):
                below = corners[a, 2] - plane
                above = corners[b, 2] - plane
                if below * above < 0.0:
                    share = below / (below - above)
                    points[count, 0] = corners[a, 0] + share * (corners[b, 0] - corners[a, 0])
                    points[count, 1] = corners[a, 1] + share * (corners[b, 1] - corners[a, 1])
                    count += 1
    return count


@njit(cache=True)
def _is_right_turn(a: Array, b: Array, c: Array) -> bool:
    """Whether the turn from a over b to c is to the right or straight."""
    return bool((b[0] - a[0]) * (c[1] - a[1]) <= (b[1] - a[1]) * (c[0] - a[0]))


@njit(cache=True)
def _hull(points: Array, hull: Array) -> int:
    """Write the corners of the convex hull of points (n, 2) to `hull`, in order, and return their number.

    Andrew's monotone chain. The points are sorted in place.
    """
    count = points.shape[0]
    for i in range(1, count):
        x, y = points[i, 0], points[i, 1]
        j = i - 1
        while j >= 0 and (points[j, 0] > x or (points[j, 0] == x and points[j, 1] > y)):
            points[j + 1] = points[j]
            j -= 1
        points[j + 1, 0], points[j + 1, 1] = x, y
    size = 0
    for direction in (1, -1):
        start = size
        for i in range(count):
            point = points[i if direction == 1 else count - 1 - i]
            while size >= start + 2 and _is_right_turn(hull[size - 2], hull[size - 1], point):
                size -= 1
            hull[size] = point
            size += 1
        size -= 1
    return max(size, 1)


@njit(cache=True)
def _mark_hull(marks: Marks, points: Array, hull: Array) -> None:
    """Mark the cells that the convex hull of points (n, 2) [cells] touches.

    Within a row, the hull extends to its corners there and to the crossings of its sides with the row's two edges.
    """
    if points.shape[0] == 0:
        return
    count = _hull(points, hull)
    first = max(math.floor(hull[:count, 0].min()), 0)
    last = min(math.floor(hull[:count, 0].max()), marks.shape[0] - 1)
    for row in range(first, last + 1):
        low, high = math.inf, -math.inf
        for a in range(count):
            x, y = hull[a, 0], hull[a, 1]
            if row <= x <= row + 1:
                low, high = min(low, y), max(high, y)
            b = a + 1 if a + 1 < count else 0
            for edge in (row, row + 1):
                if (x - edge) * (hull[b, 0] - edge) < 0.0:
                    crossing = y + (edge - x) / (hull[b, 0] - x) * (hull[b, 1] - y)
                    low, high = min(low, crossing), max(high, crossing)
        _mark_interval(marks, row, low, high)


@njit(cache=True)
def cells_of_marks(marks: Marks) -> NDArray[np.bool_]:
    """The marked cells of a grid (n, m), from marks (n, m + 1)."""
    cells = np.empty((marks.shape[0], marks.shape[1] - 1), np.bool_)
    for row in range(cells.shape[0]):
        open_intervals = 0
        for column in range(cells.shape[1]):
            open_intervals += marks[row, column]
            cells[row, column] = open_intervals > 0
    return cells


@njit(cache=True)
def free_discs(
    mask: NDArray[np.bool_], locations: Array, radius: float, x0: float, y0: float, resolution: float
) -> NDArray[np.bool_]:
    """Whether each disc lies within the grid and touches no set cell: exact distance from centre to cell."""
    free = np.zeros(locations.shape[0], np.bool_)
    reach = radius / resolution
    for k in range(locations.shape[0]):
        x = (locations[k, 0] - x0) / resolution
        y = (locations[k, 1] - y0) / resolution
        if x < reach or y < reach or x > mask.shape[0] - reach or y > mask.shape[1] - reach:
            continue
        free[k] = True
        for i in range(max(int(x - reach), 0), min(int(x + reach) + 1, mask.shape[0])):
            across = max(i - x, x - (i + 1), 0.0)
            for j in range(max(int(y - reach), 0), min(int(y + reach) + 1, mask.shape[1])):
                along = max(j - y, y - (j + 1), 0.0)
                if mask[i, j] and across * across + along * along < reach * reach:
                    free[k] = False
    return free
