"""The top faces of supports, and where on them an object may not be put: in the region, on others, over the edge."""

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
"""Choice of supports: names, "floor" among them; "all" that the scene declares; or None for the first alone."""

_MARGIN = 0.006
"""[m] kept between the object put down and whatever stands around."""
_INSET = 1e-6
"""[m] Obstacles are taken to be smaller by this, so that a wall flush with the edge of a table covers none of it."""
_FLUSH = 0.001
"""[m] An obstacle that rises less above the support is level with it."""


class UnknownSupport(ValueError):
    """A choice of supports that the scene does not declare; the message lists those that it does."""


def find_supports(scene: Scene, choice: Supports) -> tuple[str, ...]:
    """The names that a choice of supports stands for.

    Raises:
        UnknownSupport: not None, "all" or names of supports; the message lists the scene's.
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
    """The grasps that an object must not stand in the way of.

    Attributes:
        target: through which the target is taken in the end, the source of NGR1; None if nothing is kept clear.
        obstacles: through which the objects still to be cleared are taken, the sources of NGR2.
        reserved: regions of the goal, which are for other objects.
    """

    target: GraspCandidate | None = None
    obstacles: tuple[GraspCandidate, ...] = ()
    reserved: tuple[Region, ...] = ()

    @property
    def grasps(self) -> tuple[GraspCandidate, ...]:
        """All of them."""
        return self.obstacles if self.target is None else (self.target, *self.obstacles)


@dataclass(frozen=True, eq=False)
class Surface:
    """The top face of a support, as one object may use it.

    Attributes:
        support: the support.
        grid: cells of its plane.
        region: the Negative Goal Region: cells that later steps sweep (eq. 1-3).
        occupied: cells taken by standing objects and static obstacles, a margin included.
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
        """The surface of a support for an object to be put down, which keeps out of the volumes of later grasps.

        `height` [m] is the object's own, and what it needs above it. Regions that are `reserved` count as occupied.
        """
        grid = SupportGrid.over(support)
        beside = (other for other in scene.objects if other.bottom < support.top + height and other.top > support.top)
        standing = [other for other in beside if other.name != body.name]
        occupied = footprint_mask(grid, standing, _MARGIN) | static_mask(scene, support, grid, height, _MARGIN)
        for region in (one for one in reserved if one.support == support.name):
            near = grid.cells_about(region.corners)
            occupied[near] |= region.contains_points(grid.centres(near))
        return cls(support, grid, negative_goal_region(grid, height, target, obstacles), occupied)

    @property
    def blocked(self) -> NDArray[np.bool_]:
        """Cells that the object must not touch."""
        return self.region.mask | self.occupied

    def free(self, locations: Array, radius: float) -> Array:
        """The locations, of (n, 2 or 3), at which a disc of that radius [m] lies on free cells alone: (m, 3) [m]."""
        inside = is_free(self.grid, self.blocked, locations[:, :2], radius)
        return np.column_stack((locations[inside, :2], np.full(np.count_nonzero(inside), self.support.top)))


def static_mask(
    scene: Scene, support: StaticObstacle, grid: SupportGrid, height: float, clearance: float = 0.0
) -> NDArray[np.bool_]:
    """Cells of the grid over a support where an object would touch a static obstacle, or stand on nothing.

    Each obstacle counts as the box around it along its own axes, grown by `clearance` [m]; obstacles that hang higher
    than the object's `height` [m] do not count.
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
    # Only cells count of which all four corners lie on the top face.
    x = grid.x0 + np.arange(grid.shape[0] + 1) * grid.resolution
    y = grid.y0 + np.arange(grid.shape[1] + 1) * grid.resolution
    corners = support.is_under(np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1))
    return covered | ~(corners[:-1, :-1] & corners[1:, :-1] & corners[:-1, 1:] & corners[1:, 1:])
