"""Top faces of supports, with the cells that an object must avoid: keep-out regions, other objects, edges."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from planners.grasping.candidates import GraspCandidate
from planners.placing.negative_goal_region import (
    NegativeGoalRegion,
    SupportGrid,
    SweptVolume,
    footprint_mask,
    is_free,
    negative_goal_region,
    swept_mask,
)
from planners.regions import Region
from planners.scene import FLOOR, Body, Scene, StaticObstacle

Array: TypeAlias = NDArray[np.float64]
Supports: TypeAlias = Literal["all"] | Sequence[str] | None
"""Choice of supports: names, "floor" among them, "all" that the scene declares, or None for the first one alone."""

MARGIN = 0.006
"""Clearance [m] between the object put down and its surroundings."""
_INSET = 1e-6
"""Shrinkage of obstacles [m], so that a wall flush with the edge of a table covers none of it."""
_FLUSH = 0.001
"""Height [m] above the support below which an obstacle is level with it."""


class UnknownSupport(ValueError):
    """A choice of supports that the scene does not declare. The message lists the scene's supports."""


def find_supports(scene: Scene, choice: Supports) -> tuple[str, ...]:
    """Resolve a choice of supports to names.

    Raises:
        UnknownSupport: the choice is something else than None, "all" or names of supports. The message lists the
            scene's supports.
    """
    if choice is None:
        return (scene.support.name,)
    if choice == "all":
        names = scene.supports or (FLOOR,)
    else:
        names = tuple(choice) if isinstance(choice, Iterable) and not isinstance(choice, str) else (choice,)
    unknown = [name for name in names if name not in (*scene.supports, FLOOR)]
    if unknown or not names:
        raise UnknownSupport(
            f"supports={choice!r} is not valid; it must be None, 'all' or some of {', '.join((*scene.supports, FLOOR))}"
        )
    return tuple(dict.fromkeys(names))


@dataclass(frozen=True)
class KeepClear:
    """The grasps that an object must not block.

    Attributes:
        target: the grasp that takes the target in the end, the source of NGR1. None for an empty region.
        obstacles: the grasps of the objects still to clear, the sources of NGR2.
        reserved: regions of the goal for other objects.
    """

    target: GraspCandidate | None = None
    obstacles: tuple[GraspCandidate, ...] = ()
    reserved: tuple[Region, ...] = ()

    @property
    def grasps(self) -> tuple[GraspCandidate, ...]:
        """All grasps to keep clear."""
        return self.obstacles if self.target is None else (self.target, *self.obstacles)


@dataclass(frozen=True, eq=False)
class Surface:
    """The top face of a support, with the cells that one object must avoid.

    Attributes:
        support: the support.
        grid: cells of its plane.
        region: the Negative Goal Region: cells under the swept volumes of later steps (eq. 1-3).
        occupied: cells of standing objects and static obstacles, with a margin.
    """

    support: StaticObstacle
    grid: SupportGrid
    region: NegativeGoalRegion
    occupied: NDArray[np.bool_]

    @classmethod
    def of(
        cls,
        scene: Scene,
        support: StaticObstacle,
        body: Body,
        height: float,
        target: SweptVolume,
        obstacles: Iterable[SweptVolume],
        reserved: Iterable[Region] = (),
    ) -> Surface:
        """Build the surface of a support for an object to put down, outside the volumes of later grasps.

        `height` [m] is the object's height plus the clearance above it. Regions that are `reserved` are regarded as
        occupied.
        """
        grid = SupportGrid.over(support)
        beside = (other for other in scene.objects if other.bottom < support.top + height and other.top > support.top)
        standing = [other for other in beside if other.name != body.name]
        occupied = footprint_mask(grid, standing, MARGIN) | static_mask(scene, support, grid, height, MARGIN)
        for region in (one for one in reserved if one.support == support.name):
            near = grid.cells_about(region.corners)
            occupied[near] |= region.contains_points(grid.centres(near))
        return cls(support, grid, negative_goal_region(grid, height, target, obstacles), occupied)

    @property
    def blocked(self) -> NDArray[np.bool_]:
        """Cells that the object must not touch."""
        return self.region.mask | self.occupied

    def free(self, locations: Array, radius: float) -> Array:
        """Locations, of (n, 2 or 3), where a disc of that radius [m] lies on free cells only: (m, 3) [m]."""
        inside = is_free(self.grid, self.blocked, locations[:, :2], radius)
        return np.column_stack((locations[inside, :2], np.full(np.count_nonzero(inside), self.support.top)))


def static_mask(
    scene: Scene, support: StaticObstacle, grid: SupportGrid, height: float, clearance: float = 0.0
) -> NDArray[np.bool_]:
    """Cells of the grid over a support where an object would touch a static obstacle, or lack support.

    Each obstacle is replaced by the box around it along its own axes, grown by `clearance` [m]. Obstacles that hang
    higher than the object's `height` [m] are ignored.
    """
    near = [
        one
        for one in scene.static_obstacles
        if one.name != support.name
        and grid.height + _FLUSH < one.upper[2]
        and one.lower[2] < grid.height + height
        and ((one.lower + _INSET < support.upper) & (support.lower + _INSET < one.upper))[:2].all()
    ]
    volume = SweptVolume(
        box_centres=np.array([one.position for one in near]).reshape(-1, 3),
        box_axes=np.array([one.rotation for one in near]).reshape(-1, 3, 3),
        box_half_extents=np.array([one.half_extents + clearance - _INSET for one in near]).reshape(-1, 3),
    )
    covered = swept_mask(grid, volume, height) if near else grid.empty()
    if support.shape == "box" and support.is_axis_aligned:
        return covered
    # A cell is on the top face only if all its four corners are.
    x = grid.x0 + np.arange(grid.shape[0] + 1) * grid.resolution
    y = grid.y0 + np.arange(grid.shape[1] + 1) * grid.resolution
    corners = support.is_under(np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1))
    return covered | ~(corners[:-1, :-1] & corners[1:, :-1] & corners[:-1, 1:] & corners[1:, 1:])
