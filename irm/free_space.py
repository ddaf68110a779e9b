"""The free floor: outlines of furniture grown by the base's footprint, in a raster with look-ups in O(1).

A cell of the raster is free if every point of it is free, blocked if every point is blocked, and mixed otherwise. For a
point in a mixed cell the distance to the outlines is computed. So every answer is exact, also in narrow strips.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from math import cos, hypot, inf, sin, sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from irm.compilation import WITHOUT_REFERENCE_COUNTS, njit
from irm.errors import QueryError

Floats = NDArray[np.float64]
Bytes = NDArray[np.uint8]
BLOCKED, FREE, MIXED = 0, 1, 2
"""Kinds of cells."""
DEFAULT_MARGIN = 2.0
"""[m] of floor kept around the outlines when no bounds are given: more than any arm's reach."""
_MAX_CELLS = 25_000_000
_FAR = 1e9
"""[m] Distance to free floor where there is none."""


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
def outline_distance(raster: Raster, m: int, x: float, y: float) -> float:
    """Distance from a point to the outline of the m-th polygon, negative inside [m]."""
    vertices, first, last, nearest = raster.vertices, raster.starts[m], raster.starts[m + 1], inf
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
            free = True
            for m in range(raster.radii.shape[0]):
                free = free and outline_distance(raster, m, x, y) > raster.radii[m]
    return free


@njit(cache=True, **WITHOUT_REFERENCE_COUNTS)
def _points_are_free(raster: Raster, x: Floats, y: Floats, free: NDArray[np.bool_]) -> None:
    for k in range(x.size):
        free[k] = point_is_free(raster, x[k], y[k])


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
        for m in range(raster.radii.shape[0]):
            gap = max(gap, raster.radii[m] - outline_distance(raster, m, x, y))
    return gap


@njit(cache=True)
def classify_cells(raster: Raster, cells: NDArray[np.uint8]) -> None:
    """Classify every cell, all FREE before, by its centre's distance to each outline, plus or minus half the cell's
    diagonal. `cells` are the raster's own, which are read-only there."""
    x0, y0, resolution = raster.x0, raster.y0, raster.resolution
    vertices, starts, radii = raster.vertices, raster.starts, raster.radii
    width, depth = cells.shape
    slack = 0.7072 * resolution
    for m in range(starts.shape[0] - 1):
        low_x, low_y, high_x, high_y = inf, inf, -inf, -inf
        for k in range(starts[m], starts[m + 1]):
            low_x, high_x = min(low_x, vertices[k, 0]), max(high_x, vertices[k, 0])
            low_y, high_y = min(low_y, vertices[k, 1]), max(high_y, vertices[k, 1])
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
                distance = outline_distance(raster, m, x, y)
                if distance <= radius - slack:
                    cells[i, j] = BLOCKED
                elif distance <= radius + slack:
                    cells[i, j] = MIXED


@dataclass(frozen=True, eq=False)
class FreeSpace:
    """The part of the floor where the base's centre may be.

    Attributes:
        raster: the arrays of the floor, read-only.

    Example:
        table = FreeSpace.from_boxes([(0.0, 0.0, 0.7, 1.0)], radius=robot_radius(FETCH, 0.0, 0.75) + 0.01)
        table.is_free(-0.8, 0.0)
    """

    raster: Raster

    @staticmethod
    def from_boxes(
        boxes: ArrayLike,
        radius: ArrayLike,
        bounds: tuple[float, float, float, float] | None = None,
        resolution: float = 0.02,
    ) -> FreeSpace:
        """Floor around boxes.

        Args:
            boxes: (k, 4) rows of centre x, y and size along x, y [m], or (k, 5) with a yaw [rad] last.
            radius: how far the base's centre must stay away from every outline [m], or (k,) from each of them. See
                `irm.robot_radius` for the radius that contains a robot at the heights of an obstacle.
            bounds: x_min, y_min, x_max, y_max of the floor the base's centre may be on; by default the boxes and
                2 m around them.
            resolution: edge of the raster's cells [m]; no effect on the answers, only on the speed.

        Raises:
            QueryError: a number is not finite, a size or the radius is negative, or the bounds are empty.
        """
        rows = _numbers(boxes, "boxes are rows of 4 or 5 columns: x, y, size x, size y and, in all rows or none, yaw")
        if rows.size and (rows.ndim != 2 or rows.shape[1] not in (4, 5)):
            raise QueryError(f"boxes have 4 or 5 columns (x, y, size x, size y, yaw), not shape {rows.shape}")
        if rows.size and np.any(rows[:, 2:4] < 0):
            raise QueryError("a box has a negative size")
        return FreeSpace.from_polygons([_box_corners(row) for row in rows], radius, bounds, resolution)

    @staticmethod
    def from_polygons(
        polygons: Sequence[ArrayLike],
        radius: ArrayLike,
        bounds: tuple[float, float, float, float] | None = None,
        resolution: float = 0.02,
    ) -> FreeSpace:
        """Floor around simple polygons, each (v, 2) corners [m] in order; otherwise like `from_boxes`."""
        from scipy.ndimage import distance_transform_edt  # a tenth of a second, which only this needs

        shape_rule = "a polygon is an array (v, 2) of at least 3 corners"
        outlines = [_numbers(polygon, shape_rule) for polygon in polygons]
        if any(outline.ndim != 2 or outline.shape[1] != 2 or len(outline) < 3 for outline in outlines):
            raise QueryError(shape_rule)
        vertices = np.concatenate([np.empty((0, 2)), *outlines])
        rule = f"radius is a finite number ≥ 0 [m], or one for each of {len(outlines)} outlines, not {radius!r}"
        radii = _numbers(radius, rule)
        if radii.shape not in ((), (len(outlines),)) or not np.isfinite(radii).all() or np.any(radii < 0):
            raise QueryError(rule)
        radii = np.array(np.broadcast_to(radii, (len(outlines),)))
        if not np.isfinite(vertices).all():
            raise QueryError("the corners of all outlines must be finite numbers")
        starts = np.cumsum([0] + [len(outline) for outline in outlines])
        x0, y0, x1, y1 = _bounds(vertices, float(radii.max(initial=0.0)), bounds)
        rule = f"resolution must be a positive number [m], not {resolution!r}"
        edge = _numbers(resolution, rule)
        if edge.shape != () or not (np.isfinite(edge) and edge > 0):
            raise QueryError(rule)
        resolution = float(edge)
        shape = (int(np.ceil((x1 - x0) / resolution)), int(np.ceil((y1 - y0) / resolution)))
        if shape[0] * shape[1] > _MAX_CELLS:
            raise QueryError(
                f"{shape[0]} × {shape[1]} cells are too many; choose smaller bounds or a coarser resolution"
            )
        cells, distance = np.full(shape, FREE, np.uint8), np.empty((0, 0), np.float32)
        raster = _read_only(Raster(cells.view(), distance, x0, y0, x1, y1, resolution, vertices, starts, radii))
        classify_cells(raster, cells)
        blocked = cells == BLOCKED
        distance = np.full(shape, _FAR) if blocked.all() else distance_transform_edt(blocked) * resolution
        return FreeSpace(_read_only(raster._replace(distance=distance.astype(np.float32))))

    def is_free(self, x: float, y: float) -> bool:
        """Whether the base's centre may be at a point [m]; points outside the bounds and NaN are not free.

        Raises:
            QueryError: not two numbers.
        """
        at = _numbers((x, y), f"a point on the floor is two numbers [m], not {x!r}, {y!r}")
        return bool(point_is_free(self.raster, float(at[0]), float(at[1])))

    def are_free(self, x: Floats, y: Floats) -> NDArray[np.bool_]:
        """`is_free` of many points; `x` and `y` have the same shape, and so has the answer."""
        free = np.empty(np.size(x), np.bool_)
        _points_are_free(self.raster, np.ravel(x), np.ravel(y), free)
        return free.reshape(np.shape(x))

    @cached_property
    def is_empty(self) -> bool:
        """Whether every cell of the raster is blocked, so that no point is free."""
        return self.raster.cells.size > 0 and not self.raster.cells.any()


def _numbers(values: ArrayLike, rule: str) -> Floats:
    """An array of numbers; for anything else a `QueryError` with the rule as its message."""
    try:
        return np.asarray(values, dtype=float)
    except (TypeError, ValueError):
        raise QueryError(rule) from None


def _box_corners(row: Floats) -> Floats:
    """(4, 2) corners of one box."""
    x, y, width, depth = row[:4]
    yaw = float(row[4]) if len(row) == 5 else 0.0
    local = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) * (width / 2, depth / 2)
    turned: Floats = local @ np.array([[cos(yaw), sin(yaw)], [-sin(yaw), cos(yaw)]]) + (x, y)
    return turned


def _bounds(
    vertices: Floats, radius: float, bounds: tuple[float, float, float, float] | None
) -> tuple[float, float, float, float]:
    if bounds is None:
        if len(vertices) == 0:
            raise QueryError("without any outline the bounds must be given; free_space=None means free everywhere")
        low, high = vertices.min(axis=0) - radius - DEFAULT_MARGIN, vertices.max(axis=0) + radius + DEFAULT_MARGIN
        return float(low[0]), float(low[1]), float(high[0]), float(high[1])
    rule = f"bounds are x_min, y_min, x_max, y_max with x_min < x_max and y_min < y_max, not {bounds!r}"
    edges = _numbers(bounds, rule)
    if edges.shape != (4,) or not (np.isfinite(edges).all() and edges[0] < edges[2] and edges[1] < edges[3]):
        raise QueryError(rule)
    return float(edges[0]), float(edges[1]), float(edges[2]), float(edges[3])


def _read_only(raster: Raster) -> Raster:
    """The raster, whose arrays are read-only like all others, so that kernels are compiled only once."""
    for array in raster:
        if isinstance(array, np.ndarray):
            array.setflags(write=False)
    return raster


_NO_CELLS, _NO_DISTANCES = np.empty((0, 0), np.uint8), np.empty((0, 0), np.float32)
_NO_OUTLINES = Raster(
    _NO_CELLS, _NO_DISTANCES, 0.0, 0.0, 0.0, 0.0, 1.0, np.empty((0, 2)), np.zeros(1, np.int64), np.empty(0)
)
EVERYWHERE = FreeSpace(_read_only(_NO_OUTLINES))
"""A floor without furniture or walls."""
