"""Canonical placements: of all places for an object the same one in similar scenes, so that plans can be learned.

Locations are the cells of a fixed grid. Near where the object was taken and clear of what stands around is best. The
base always drives there, faces the gripper, and both have the same yaw. Only where no cell can be used so, the
placements of the paper are tried.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from planners.clock import NO_DEADLINE, Deadline
from planners.collision.world import CollisionWorld
from planners.grasping.arm_configurations import ConfigurationGrid, GripperPoses
from planners.grasping.base_placement import facing_bases, farthest_reach
from planners.placing.negative_goal_region import is_free
from planners.placing.placements import Placement, PlacementSearch
from planners.placing.surfaces import Surface
from planners.scene import Scene, StaticObstacle
from planners.strategies import Strategy

Array = NDArray[np.float64]

_SPACING = 0.05
"""[m] between the centres of the cells."""
_MARGIN = 0.045
"""[m] of the outermost cells from the edges of the support at least."""
_CLEAR, _CLEAR_WORTH = 0.03, 3.0
"""[m] of free space around the object that is worth a longer distance, and the distance that a metre of it is worth."""
_DECIMALS = 6
"""Decimals of costs: differences by rounding decide nothing."""


def placement_cells(support: StaticObstacle) -> Array:
    """The cells (n, 3) [m] of a support where a canonical plan puts objects: centres of squares, x before y."""
    half = support.extent[:2] - _MARGIN
    x, y = (_SPACING * np.arange(-(h // _SPACING), h // _SPACING + 1) for h in half)
    cells = support.position[:2] + np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)
    return np.column_stack((cells, np.full(len(cells), support.top)))


@dataclass(frozen=True)
class CanonicalPlacements(PlacementSearch):
    """Finds placements, the canonical ones first."""

    def _preferred(
        self, world: CollisionWorld, surfaces: Sequence[Surface], strategy: Strategy, deadline: Deadline
    ) -> Iterator[Placement]:
        locations = self.best_first(world.scene, surfaces)[: strategy.locations_per_level]
        return self.straight(world, locations, deadline)

    def best_first(self, scene: Scene, surfaces: Sequence[Surface]) -> Array:
        """The free cells (n, 3) [m] of some surfaces: near where the object was taken, and with free space around."""
        assert scene.held is not None
        body = scene.body(scene.held.name)
        every = [placement_cells(surface.support) for surface in surfaces]
        cells = [grid[self.are_free(scene, surface, grid)] for surface, grid in zip(surfaces, every, strict=True)]
        margins = [_margins(surface, free, self._radius(scene)) for surface, free in zip(surfaces, cells, strict=True)]
        free, margin = np.concatenate(cells), np.concatenate(margins)
        distance = np.linalg.norm(free[:, :2] - body.position[:2], axis=1)
        cost = distance + _CLEAR_WORTH * np.maximum(_CLEAR - margin, 0.0)
        return np.asarray(free[np.argsort(np.round(cost, _DECIMALS), kind="stable")])

    def are_free(self, scene: Scene, surface: Surface, locations: Array) -> NDArray[np.bool_]:
        """At which locations (n, 2 or 3) [m] on a surface the held object stands on free cells alone: (n,)."""
        return is_free(surface.grid, surface.blocked, np.ascontiguousarray(locations[:, :2]), self._radius(scene))

    def straight(
        self, world: CollisionWorld, locations: Array, deadline: Deadline = NO_DEADLINE
    ) -> Iterator[Placement]:
        """The canonical placements of the held object at locations (n, 3) [m], the base least turned first."""
        scene, arm = world.scene, self.arms[world.scene.robot.arm_name]
        grid = ConfigurationGrid.about_home(arm.chain, scene.robot.home)
        wanted = [self._gripper_poses(scene, location) for location in locations]
        yaws = wanted[0][:, 3] if wanted else np.zeros(0)  # the same at all locations
        turns = np.round(np.abs(np.remainder(yaws + np.pi, 2 * np.pi) - np.pi), _DECIMALS)
        for turn in np.unique(turns):
            for location, poses in zip(locations, wanted, strict=True):
                if deadline.is_over:
                    return
                free = self._free(world, poses[turns == turn])
                bases, index = facing_bases(arm.placer, free, farthest_reach(scene.robot))
                for base, pose in zip(bases, free[index], strict=True):
                    yield from self._configurations(world, GripperPoses(base[None], pose[None]), location[2], grid)


def _margins(surface: Surface, locations: Array, radius: float) -> Array:
    """[m] around discs of that radius at locations (n, 3) that is free too, as far as cells tell: (n,)."""
    grid, free = surface.grid, ~surface.blocked
    distance = grid.resolution * distance_transform_edt(np.pad(free, 1))[1:-1, 1:-1]
    cell = ((locations[:, :2] - (grid.x0, grid.y0)) / grid.resolution).astype(int)
    cell = np.clip(cell, 0, np.array(grid.shape) - 1)
    return np.asarray(distance[cell[:, 0], cell[:, 1]] - radius)
