"""Belief of the target's place: cells of the supports that no view has shown to be empty, large enough for the target.

Each support has a grid as high as the target. Every view clears the cells in front of the surfaces that it shows. The
target may stand, with equal probability, wherever it lies wholly within the remaining cells. So a place is given up
only if some part of the target would have been visible in front of these surfaces.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from planners.placing.negative_goal_region import SupportGrid, footprint_mask
from planners.scene import Body, Scene, StaticObstacle
from planners.search.perception import Description, View
from planners.search.sight import carve

Array = NDArray[np.float64]

CELL, LAYER = 0.01, 0.02
"""Sides [m] of a cell along the support, and its height."""
_MARGIN = 0.01
"""Distance [m] that a cell must be in front of the visible surface. It is larger with noise."""
_FINE = 0.02
"""Pixel width [m] from which on all pixels around a cell must show it to be empty. It is reached 2.5 m away with 192
pixels a side of Fetch's head camera."""
_SHARES = (0.5, 0.9)
"""Shares of the target's height. The target is in sight if a point there is."""
_FIT_ERROR = 0.008
"""Error [m] by which the footprints of perceived objects may be too large."""


def beside(
    grid: SupportGrid, furniture: Sequence[StaticObstacle], bottom: float, top: float, margin: float = 0.0
) -> NDArray[np.bool_]:
    """Cells within a margin [m] of the boxes around furniture between two heights [m]."""
    (x, y), found = np.moveaxis(grid.centres(), -1, 0), grid.empty()
    for one in furniture:
        if one.lower[2] < top and one.top > bottom:
            low, high = one.lower[:2] - margin, one.upper[:2] + margin
            found |= (x > low[0]) & (x < high[0]) & (y > low[1]) & (y < high[1])
    return found


@dataclass(eq=False)
class _Level:
    """Grid of a support, with its unseen cells (nx, ny, nz) and the cells (nx, ny) where the target can still be.

    Placing an object hides cells again. Cells already ruled out stay ruled out: the target does not move.
    """

    grid: SupportGrid
    is_unseen: NDArray[np.bool_]
    is_possible: NDArray[np.bool_]


@dataclass(eq=False)
class Belief:
    """Unseen cells on the supports of a scene.

    Attributes:
        target: description of the target.
    """

    target: Description
    _levels: dict[str, _Level] = field(default_factory=dict)

    @classmethod
    def begin(cls, scene: Scene, target: Description) -> Belief:
        """Begin with everything unseen. The target stands on one of the scene's supports."""
        layers = max(int((target.height - _MARGIN) / LAYER), 1)
        levels = {}
        for name in scene.supports:
            grid = SupportGrid.over(scene.support_named(name), CELL)
            levels[name] = _Level(grid, np.ones((*grid.shape, layers), np.bool_), np.ones(grid.shape, np.bool_))
        return cls(target, levels)

    def update(self, view: View, noise: float = 0.0) -> None:
        """Clear the cells that a view shows to be empty. `noise` [m] is the noise of its depth."""
        T_camera_world, cell = np.linalg.inv(view.T_world_camera), np.array((CELL, CELL, LAYER))
        coarse = min(2 * self.target.radius, self.target.height)  # the target may lie between wider pixels
        for level in self._levels.values():
            origin = np.array((level.grid.x0, level.grid.y0, level.grid.height))
            margin = _MARGIN + 3 * noise
            carve(level.is_unseen, origin, cell, view.depth, view.K, T_camera_world, margin, _FINE, coarse)
            level.is_possible &= level.is_unseen.all(axis=2)

    def emptied(self, body: Body) -> float:
        """Share of the cells inside an object that have been seen empty. Near 1 if the object is no longer there."""
        for level in self._levels.values():
            inside = footprint_mask(level.grid, [body], -_FIT_ERROR)
            if abs(level.grid.height - body.bottom) < 2 * LAYER and inside.any():
                return float(1 - level.is_unseen[inside].mean())
        return 0.0

    def move(self, before: Body, after: Body, sigma: float = 0.0) -> None:
        """Update for a moved object: the target was not inside it, and the cells around its new place are unseen again.

        `sigma` [m] is the standard deviation of its former place.
        """
        for level in self._levels.values():
            if abs(level.grid.height - before.bottom) < 2 * LAYER:
                level.is_possible &= ~footprint_mask(level.grid, [before], -_FIT_ERROR - sigma)
            if abs(level.grid.height - after.bottom) < 2 * LAYER:
                level.is_unseen[footprint_mask(level.grid, [after], CELL)] = True

    def slid(self, supports: Collection[str], by: Array) -> Belief:
        """Belief after some supports have slid by (3,) [m], with all seen and unseen cells on them. Cells are shared.

        Only drawers slide. Cells behind a door stay where they are.
        """
        levels = dict(self._levels)
        for name in levels.keys() & set(supports):
            grid = levels[name].grid
            x, y, z = (float(value) for value in by)
            there = replace(grid, x0=grid.x0 + x, y0=grid.y0 + y, height=grid.height + z)
            levels[name] = replace(levels[name], grid=there)
        return Belief(self.target, levels)

    def restart(self) -> None:
        """Restart after the target was seen and lost: it may be wherever cells are unseen at present."""
        for level in self._levels.values():
            level.is_possible = np.asarray(level.is_unseen.all(axis=2))

    def places(self, known: Sequence[Body], furniture: Sequence[StaticObstacle] = ()) -> dict[str, NDArray[np.bool_]]:
        """Cells (nx, ny) of each support where the target's centre can be, among known objects and furniture.

        The target is made narrower by half a cell's diagonal, so that none of its places is missed.
        """
        found = {}
        for name, level in self._levels.items():
            top, bottom = level.grid.height + self.target.height, level.grid.height + LAYER
            objects = [one for one in known if one.bottom < top and one.top > bottom]
            free = level.is_possible & ~footprint_mask(level.grid, objects, -_FIT_ERROR)
            boxes = [one for one in furniture if one.shape == "box"]
            free &= ~beside(level.grid, boxes, bottom, top - LAYER)
            away = distance_transform_edt(np.pad(free, 1))[1:-1, 1:-1] * CELL
            found[name] = free & (away >= self.target.radius - CELL / 2**0.5)
        return found

    def points(self, places: Mapping[str, NDArray[np.bool_]]) -> Array:
        """Points (m, n, 3) [m] of the target at each of its m places, at `_SHARES` of its height."""
        found = [
            np.column_stack((level.grid.centres()[places[name]], np.full(places[name].sum(), level.grid.height)))
            for name, level in self._levels.items()
            if name in places
        ]
        up = np.outer(_SHARES, (0.0, 0.0, self.target.height))
        return np.asarray(np.concatenate(found)[:, None] + up)

    def grid(self, support: str) -> SupportGrid:
        """Grid of a support."""
        return self._levels[support].grid

    def unseen(self, support: str) -> NDArray[np.bool_]:
        """Cells (nx, ny) of a support with something unseen above."""
        return np.asarray(self._levels[support].is_unseen.any(axis=2))
