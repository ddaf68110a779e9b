"""The top faces of supports, and where on them an object may not be put."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from planners.collision.world import CollisionWorld
from planners.grasping.candidates import GraspCandidate
from planners.placing.negative_goal_region import (
    NegativeGoalRegion,
    SupportGrid,
    SweptVolume,
    footprint_mask,
    is_free,
    negative_goal_region,
)
from planners.placing.static_footprint import static_mask
from planners.placing.swept_volume import GraspVolumes
from planners.scene import Body, Scene, StaticObstacle

__all__ = ["KeepClear", "Supports", "Surface", "UnknownSupport", "find_supports"]

Array: TypeAlias = NDArray[np.float64]
Supports: TypeAlias = Literal["all"] | Sequence[str] | None
"""Where objects may be put: names of supports, "all" that the scene declares, or None for the first alone."""

_MARGIN = 0.006
"""[m] kept between the object put down and whatever stands around."""


class UnknownSupport(ValueError):
    """A choice of supports that the scene does not declare; the message lists those that it does."""


def find_supports(scene: Scene, choice: Supports) -> tuple[str, ...]:
    """The names that a choice of supports stands for.

    Raises:
        UnknownSupport: not None, "all" or names of supports; the message lists the scene's.
    """
    if choice is None:
        return (scene.support.name,)
    names = scene.supports if choice == "all" else (choice,) if isinstance(choice, str) else tuple(choice)
    unknown = [name for name in names if name not in scene.supports]
    if unknown or not names:
        raise UnknownSupport(
            f"supports={choice!r} is not valid; it must be None, 'all' or some of {', '.join(scene.supports)}"
        )
    return tuple(dict.fromkeys(names))


@dataclass(frozen=True)
class KeepClear:
    """The grasps that an object must not stand in the way of.

    Attributes:
        target: through which the target is taken in the end, the source of NGR1; None if nothing is kept clear.
        obstacles: through which the objects still to be cleared are taken, the sources of NGR2.
    """

    target: GraspCandidate | None = None
    obstacles: tuple[GraspCandidate, ...] = ()


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
        world: CollisionWorld,
        support: StaticObstacle,
        body: Body,
        height: float,
        keep_clear: KeepClear,
        volumes: GraspVolumes,
    ) -> Surface:
        """The surface of a support for an object.

        Args:
            world: the scene, compiled.
            support: whose top face is meant.
            body: the object to be put down.
            height: [m] of the object, and what it needs above it.
            keep_clear: grasps that the object must not stand in the way of.
            volumes: what grasps sweep, as far as it is known already.
        """
        scene, grid = world.scene, SupportGrid.over(support)
        beside = (other for other in scene.objects if other.bottom < support.top + height and other.top > support.top)
        standing = [other for other in beside if other.name != body.name]
        occupied = footprint_mask(grid, standing, _MARGIN) | static_mask(scene, support, grid, height, _MARGIN)
        target = SweptVolume() if keep_clear.target is None else volumes.of(world, keep_clear.target)
        obstacles = [volumes.of(world, grasp) for grasp in keep_clear.obstacles]
        return cls(support, grid, negative_goal_region(grid, height, target, obstacles), occupied)

    @property
    def blocked(self) -> NDArray[np.bool_]:
        """Cells that the object must not touch."""
        return self.region.mask | self.occupied

    def free(self, locations: Array, radius: float) -> Array:
        """Those of locations (n, 2) at which a disc of that radius [m] lies on free cells alone: (m, 3) [m]."""
        inside = is_free(self.grid, self.blocked, locations, radius)
        return np.column_stack((locations[inside], np.full(np.count_nonzero(inside), self.support.top)))
