"""The free floor: outlines of furniture grown by the base's footprint, in a raster with look-ups in O(1).

A cell of the raster is free if every point of it is free, blocked if every point is blocked, and mixed otherwise. For a
point in a mixed cell the distance to the outlines is computed. So every answer is exact, also in narrow strips.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from math import cos, sin

import numpy as np
from numpy.typing import ArrayLike, NDArray

from irm.errors import QueryError
from irm.floor.distance_transform import distance_to_seeds
from irm.floor.raster import BLOCKED, FREE, MIXED, Raster, are_outside, classify_cells, point_is_free

__all__ = ["EVERYWHERE", "FreeSpace"]

Floats = NDArray[np.float64]

DEFAULT_MARGIN = 2.0
"""[m] of floor kept around the outlines when no bounds are given: more than any arm's reach."""

_MAX_CELLS = 25_000_000


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
                `irm.floor.robot_radius` for the radius that contains a robot at the heights of an obstacle.
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
        shape_rule = "a polygon is an array (v, 2) of at least 3 corners"
        outlines = [_numbers(polygon, shape_rule) for polygon in polygons]
        if any(outline.ndim != 2 or outline.shape[1] != 2 or len(outline) < 3 for outline in outlines):
            raise QueryError(shape_rule)
        vertices = np.concatenate([np.empty((0, 2)), *outlines])
        radii = _radii(radius, len(outlines))
        if not np.isfinite(vertices).all():
            raise QueryError("the corners of all outlines must be finite numbers")
        starts = np.cumsum([0] + [len(outline) for outline in outlines])
        x0, y0, x1, y1 = _bounds(vertices, float(radii.max(initial=0.0)), bounds)
        resolution = _resolution(resolution)
        shape = (int(np.ceil((x1 - x0) / resolution)), int(np.ceil((y1 - y0) / resolution)))
        if shape[0] * shape[1] > _MAX_CELLS:
            raise QueryError(
                f"{shape[0]} × {shape[1]} cells are too many; choose smaller bounds or a coarser resolution"
            )
        for array in (vertices, starts, radii):
            array.setflags(write=False)
        cells = np.full(shape, FREE, np.uint8)
        classify_cells(cells, x0, y0, resolution, vertices, starts, radii)
        distance = distance_to_seeds(cells != BLOCKED, resolution)
        for array in (cells, distance):
            array.setflags(write=False)
        return FreeSpace(Raster(cells, distance, x0, y0, x1, y1, resolution, vertices, starts, radii))

    def is_free(self, x: float, y: float) -> bool:
        """Whether the base's centre may be at a point [m]; points outside the bounds and NaN are not free.

        Raises:
            QueryError: not two numbers.
        """
        at = _numbers((x, y), f"a point on the floor is two numbers [m], not {x!r}, {y!r}")
        return bool(point_is_free(self.raster, float(at[0]), float(at[1])))

    def are_free(self, x: Floats, y: Floats) -> NDArray[np.bool_]:
        """`is_free` of many points; `x` and `y` have the same shape, and so has the answer."""
        raster = self.raster
        if raster.cells.size == 0:
            return np.asarray(np.isfinite(x) & np.isfinite(y))
        i = ((x - raster.x0) * (1.0 / raster.resolution)).astype(np.int64)
        j = ((y - raster.y0) * (1.0 / raster.resolution)).astype(np.int64)
        inside = (x >= raster.x0) & (x <= raster.x1) & (y >= raster.y0) & (y <= raster.y1)
        width, depth = raster.cells.shape
        kind = raster.cells.ravel()[np.clip(i, 0, width - 1) * depth + np.clip(j, 0, depth - 1)]
        free: NDArray[np.bool_] = (kind == FREE) & inside
        mixed = (kind == MIXED) & inside
        free[mixed] = are_outside(raster.vertices, raster.starts, raster.radii, x[mixed], y[mixed])
        return free

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


def _radii(radius: ArrayLike, outlines: int) -> Floats:
    """(k,) how far the base must stay away from each outline [m]."""
    radii = _numbers(radius, f"radius is a number ≥ 0 [m], or one for each outline, not {radius!r}")
    if radii.shape not in ((), (outlines,)) or not np.isfinite(radii).all() or np.any(radii < 0):
        raise QueryError(f"radius is a finite number ≥ 0 [m], or one for each of {outlines} outlines, not {radius!r}")
    return np.array(np.broadcast_to(radii, (outlines,)))


def _resolution(resolution: float) -> float:
    """A positive number [m]."""
    number = _numbers(resolution, f"resolution must be a positive number [m], not {resolution!r}")
    if number.shape != () or not (np.isfinite(number) and number > 0):
        raise QueryError(f"resolution must be a positive number [m], not {resolution!r}")
    return float(number)


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


def _everywhere() -> FreeSpace:
    """A floor without cells; its arrays are read-only like all others, so that kernels are compiled only once."""
    cells, distance = np.empty((0, 0), np.uint8), np.empty((0, 0), np.float32)
    vertices, starts, radii = np.empty((0, 2)), np.zeros(1, np.int64), np.empty(0)
    for array in (cells, distance, vertices, starts, radii):
        array.setflags(write=False)
    return FreeSpace(Raster(cells, distance, 0.0, 0.0, 0.0, 0.0, 1.0, vertices, starts, radii))


EVERYWHERE = _everywhere()
"""A floor without furniture or walls."""
