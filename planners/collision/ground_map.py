"""Connected parts of the ground for the base, for any arm configuration and any places of the objects."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage

from assets.robots import RobotSpec
from irm.chain import BASE
from irm.free_space import BLOCKED, FreeSpace
from irm.gjk import BOX, CYLINDER
from planners.collision.scene_arrays import robot_arrays
from planners.scene import Scene, StaticObstacle

Array = NDArray[np.float64]

_CELL, _MOST_CELLS = 0.04, 600
"""[m] Edge of the cells, and the most cells side by side. Cells are larger where more would be needed."""
_AROUND = 1.5
"""[m] of ground around all obstacles: wide enough to drive around them."""
_ENDLESS = 20.0
"""[m] Half extent above which the base cannot drive around an obstacle, such as a plane."""
_UPRIGHT = 1e-6
"""Rounding of the cosine between an axis of a solid and the vertical."""
_ROUND = 0.009
"""Share of its radius by which the outline of a round obstacle is too large."""
_NEIGHBOURS = np.ones((3, 3), dtype=np.int64)


class _Core(NamedTuple):
    """Largest upright cylinder about the base's axis inside one of its solids: radius, bottom and top [m]."""

    radius: float
    bottom: float
    top: float


@dataclass(frozen=True, eq=False)
class GroundMap:
    """Cells of the ground, and the connected part of each.

    A cell belongs to a part if any point of it is free for the `_Core` of the base. So places in different parts are
    proved to be disconnected. Places in the same part may still be disconnected for the whole robot.

    Attributes:
        scene: scene with the static obstacles, the robot and its start.
    """

    scene: Scene

    @cached_property
    def _space(self) -> FreeSpace:
        """Ground around all bounded obstacles, and around the robot."""
        core, outlines, radii = _core(self.scene.robot), [], []
        for one in self.scene.static_obstacles:
            if _is_upright(one) and one.lower[2] < core.top and one.upper[2] > core.bottom:
                outlines.append(one.outline)
                radii.append(max(core.radius - (_ROUND * one.half_extents[0] if one.shape == "cylinder" else 0.0), 0.0))
        # Obstacles that the base passes below extend the map too, because the arm reaches them from there.
        around = [one.outline for one in self.scene.static_obstacles]
        points = [self.scene.state.base[None, :2], *(one for one in around if np.ptp(one, axis=0).max() < _ENDLESS)]
        low, high = np.vstack(points).min(axis=0) - _AROUND, np.vstack(points).max(axis=0) + _AROUND
        cell = max(_CELL, float((high - low).max()) / _MOST_CELLS)
        return FreeSpace.from_polygons(outlines, radii if outlines else 0.0, (*low, *high), cell)

    @property
    def origin(self) -> Array:
        """(2,) [m] corner of the first cell."""
        return np.array((self._space.raster.x0, self._space.raster.y0))

    @property
    def cell(self) -> float:
        """Edge of a cell [m]."""
        return float(self._space.raster.resolution)

    @cached_property
    def parts(self) -> NDArray[np.int64]:
        """(nx, ny) number of the connected part of each cell, 0 where the base cannot be."""
        return np.asarray(ndimage.label(self._space.raster.cells != BLOCKED, _NEIGHBOURS)[0], dtype=np.int64)

    def part_of(self, places: ArrayLike) -> NDArray[np.int64]:
        """Parts (k,) that contain places (k, 2 or more) x, y [m]. Beyond the map, the part of its nearest cell."""
        index = np.floor((np.atleast_2d(np.asarray(places, float))[:, :2] - self.origin) / self.cell).astype(int)
        i, j = index.clip(0, np.array(self.parts.shape) - 1).T
        return np.asarray(self.parts[i, j])

    def are_connected(self, start: ArrayLike, places: ArrayLike) -> NDArray[np.bool_]:
        """Whether the base may get from one place (2 or more,) to others (k, 2 or more). False is proved.

        If the start is inside an obstacle, nothing is proved.
        """
        part = self.part_of(start)[0]
        return np.asarray((part == 0) | (self.part_of(places) == part))

    def can_reach(self, bases: Array) -> NDArray[np.bool_]:
        """`are_connected` for base poses (k, 3) from the base pose of the scene's robot."""
        return self.are_connected(self.scene.state.base, bases)


def _is_upright(obstacle: StaticObstacle) -> bool:
    """Whether an obstacle has the same horizontal section, its outline, at every height."""
    is_level = np.abs(obstacle.rotation[2]) > 1 - _UPRIGHT
    return bool(is_level.any() if obstacle.shape == "box" else obstacle.shape == "cylinder" and is_level[2])


@cache
def _core(robot: RobotSpec) -> _Core:
    """The core of a base. Without an upright solid about its axis, a line without height, so that nothing is proved."""
    arrays, best = robot_arrays(robot), _Core(0.0, 0.0, 0.0)
    for i in np.flatnonzero((arrays.link == BASE) & (arrays.radius == 0.0)):
        R, half, (x, y, z) = arrays.rotation[i], arrays.half[i], arrays.position[i]
        upright = np.abs(R[2]) > 1 - _UPRIGHT
        if arrays.core[i] == CYLINDER and upright[2]:
            radius, height = half[0] - np.hypot(x, y), half[2]
        elif arrays.core[i] == BOX and upright.any():
            level = ~upright
            radius = (half - np.abs(R.T @ arrays.position[i]))[level].min()
            height = half[upright][0]
        else:
            continue
        if radius > best.radius:
            best = _Core(float(radius), float(z - height), float(z + height))
    return best
