"""The top faces of supports, and where on them an object may not be put."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from planners.collision.world import CollisionWorld
from planners.grasping.candidates import GraspCandidate
from planners.placing.negative_goal_region import SupportGrid, footprint_mask, is_free, swept_mask
from planners.placing.static_footprint import static_mask
from planners.placing.swept_volume import grasp_volume
from planners.scene import Body, Scene, StaticObstacle

__all__ = ["Supports", "Surface", "UnknownSupport", "find_supports", "keep_clear_mask"]

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


def keep_clear_mask(
    world: CollisionWorld, grid: SupportGrid, grasps: Sequence[GraspCandidate], height: float
) -> NDArray[np.bool_]:
    """Cells where an object `height` [m] tall would stand in the way of these grasps."""
    if not grasps:
        return grid.empty()
    return swept_mask(grid, grasp_volume(world, grasps), height)


@dataclass(frozen=True, eq=False)
class Surface:
    """The top face of a support, as one object may use it.

    Attributes:
        support: the support.
        grid: cells of its plane.
        forbidden: cells that later steps need free.
        occupied: cells taken by standing objects and static obstacles, a margin included.
    """

    support: StaticObstacle
    grid: SupportGrid
    forbidden: NDArray[np.bool_]
    occupied: NDArray[np.bool_]

    @classmethod
    def of(
        cls,
        world: CollisionWorld,
        support: StaticObstacle,
        body: Body,
        height: float,
        keep_clear: Sequence[GraspCandidate],
    ) -> Surface:
        """The surface of a support for an object.

        Args:
            world: the scene, compiled.
            support: whose top face is meant.
            body: the object to be put down.
            height: [m] of the object, and what it needs above it.
            keep_clear: grasps whose volume the object must stay out of.
        """
        scene, grid = world.scene, SupportGrid.over(support)
        standing = [other for other in scene.objects if other.name != body.name]
        occupied = footprint_mask(grid, standing, _MARGIN) | static_mask(scene, support, grid, height, _MARGIN)
        return cls(support, grid, keep_clear_mask(world, grid, keep_clear, height), occupied)

    def free(self, locations: Array, radius: float) -> Array:
        """Those of locations (n, 2) at which a disc of that radius [m] lies on free cells alone: (m, 3) [m]."""
        inside = is_free(self.grid, self.forbidden | self.occupied, locations, radius)
        return np.column_stack((locations[inside], np.full(np.count_nonzero(inside), self.support.top)))
