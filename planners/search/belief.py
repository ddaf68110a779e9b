"""Where the target can still be: cells of the supports that no view has shown to be empty, large enough for it.

Over each support there is a grid as high as the target. Every view clears the cells in front of what it shows. The
target may stand, with equal probability, wherever it lies wholly within cells that are left. So a place is given up
only when some part of the target would have been seen through: what hides behind what does not matter.
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
"""[m] sides of a cell along the support, and its height."""
_MARGIN = 0.01
"""[m] by which a cell must be in front of what is seen there; more with noise."""
_FINE = 0.02
"""[m] width of a pixel from which on all pixels around a cell must show it to be empty: 2.5 m away in 192 pixels a
side of Fetch's head camera."""
_SHARES = (0.5, 0.9)
"""Of the target's height: it is in sight where a point there is."""
_FIT_ERROR = 0.008
"""[m] by which the footprints of perceived objects may be too large."""


def beside(
    grid: SupportGrid, furniture: Sequence[StaticObstacle], bottom: float, top: float, margin: float = 0.0
) -> NDArray[np.bool_]:
    """Cells within a margin [m] of the boxes around furniture that reaches between two heights [m]."""
    (x, y), found = np.moveaxis(grid.centres(), -1, 0), grid.empty()
    for one in furniture:
        if one.lower[2] < top and one.top > bottom:
            low, high = one.lower[:2] - margin, one.upper[:2] + margin
            found |= (x > low[0]) & (x < high[0]) & (y > low[1]) & (y < high[1])
    return found


@dataclass(eq=False)
class _Level:
    """One support: its grid, which of its cells (nx, ny, nz) are unseen, and where (nx, ny) the target can still be.

    What is put down makes cells unseen again, but the target does not move: where it was not, it is not.
    """

    grid: SupportGrid
    is_unseen: NDArray[np.bool_]
    is_possible: NDArray[np.bool_]


@dataclass(eq=False)
class Belief:
    """What has not been seen on the supports of a scene.

    Attributes:
        target: what is looked for.
    """

    target: Description
    _levels: dict[str, _Level] = field(default_factory=dict)

    @classmethod
    def begin(cls, scene: Scene, target: Description) -> Belief:
        """Nothing seen yet; the target stands on one of the scene's supports."""
        layers = max(int((target.height - _MARGIN) / LAYER), 1)
        levels = {}
        for name in scene.supports:
            grid = SupportGrid.over(scene.support_named(name), CELL)
            levels[name] = _Level(grid, np.ones((*grid.shape, layers), np.bool_), np.ones(grid.shape, np.bool_))
        return cls(target, levels)

    def update(self, view: View, noise: float = 0.0) -> None:
        """Clear what a view shows to be empty. `noise` [m] is that of its depth."""
        T_camera_world, cell = np.linalg.inv(view.T_world_camera), np.array((CELL, CELL, LAYER))
        coarse = min(2 * self.target.radius, self.target.height)  # the target may lie between wider pixels
        for level in self._levels.values():
            origin = np.array((level.grid.x0, level.grid.y0, level.grid.height))
            margin = _MARGIN + 3 * noise
            carve(level.is_unseen, origin, cell, view.depth, view.K, T_camera_world, margin, _FINE, coarse)
            level.is_possible &= level.is_unseen.all(axis=2)

    def emptied(self, body: Body) -> float:
        """Share of the cells inside an object that have been seen to be empty: near 1 if it is no longer there."""
        for level in self._levels.values():
            inside = footprint_mask(level.grid, [body], -_FIT_ERROR)
            if abs(level.grid.height - body.bottom) < 2 * LAYER and inside.any():
                return float(1 - level.is_unseen[inside].mean())
        return 0.0

    def move(self, before: Body, after: Body, sigma: float = 0.0) -> None:
        """Take in that an object has been moved: the target was not in it, and around it nothing is seen any more.

        `sigma` [m] is the standard deviation of where it was.
        """
        for level in self._levels.values():
            if abs(level.grid.height - before.bottom) < 2 * LAYER:
                level.is_possible &= ~footprint_mask(level.grid, [before], -_FIT_ERROR - sigma)
            if abs(level.grid.height - after.bottom) < 2 * LAYER:
                level.is_unseen[footprint_mask(level.grid, [after], CELL)] = True

    def slid(self, supports: Collection[str], by: Array) -> Belief:
        """The belief after some supports have slid by (3,) [m], with what is seen and unseen on them; cells are shared.

        A door does not slide, and carries nothing: what it hides is unseen where it is.
        """
        levels = dict(self._levels)
        for name in levels.keys() & set(supports):
            grid = levels[name].grid
            x, y, z = (float(value) for value in by)
            there = replace(grid, x0=grid.x0 + x, y0=grid.y0 + y, height=grid.height + z)
            levels[name] = replace(levels[name], grid=there)
        return Belief(self.target, levels)

    def restart(self) -> None:
        """Take the target for wherever nothing is seen at present: it has been seen, and is lost."""
        for level in self._levels.values():
            level.is_possible = np.asarray(level.is_unseen.all(axis=2))

    def places(self, known: Sequence[Body], furniture: Sequence[StaticObstacle] = ()) -> dict[str, NDArray[np.bool_]]:
        """The places (nx, ny) of each support at which the target's centre can be, among known objects and furniture.

        The target is taken to be narrower by half a cell's diagonal than it is, so that none of its places is missed.
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
        """(m, n, 3) [m] points of the target at each of its m places, at `_SHARES` of its height."""
        found = [
            np.column_stack((level.grid.centres()[places[name]], np.full(places[name].sum(), level.grid.height)))
            for name, level in self._levels.items()
            if name in places
        ]
        up = np.outer(_SHARES, (0.0, 0.0, self.target.height))
        return np.asarray(np.concatenate(found)[:, None] + up)

    def grid(self, support: str) -> SupportGrid:
        """The cells of a support."""
        return self._levels[support].grid

    def unseen(self, support: str) -> NDArray[np.bool_]:
        """Cells (nx, ny) of a support above which something has not been seen."""
        return np.asarray(self._levels[support].is_unseen.any(axis=2))
