"""All choices that are as good as a plan's: several valid labels for learning high-level policies.

A grasp or release is free if nothing is hit there nor on a straight line to it and from it. To take an object is as
good as what the plan does if afterwards as few clearances are left.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planners.clearing.lower_bound import FloorLimits, smallest_set
from planners.context import PlanningContext
from planners.grasping.candidates import GraspCandidates
from planners.motion.approaches import can_take
from planners.placing.locations import placement_cells
from planners.placing.placements import PlacementSearch, held_radius
from planners.placing.surfaces import Surface
from planners.planner import Planner
from planners.scene import Scene

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

DIRECTION_CLASSES = 24
"""Classes of the gripper's yaw in the world, 15° apart; class 0 points along x."""
_LIMITS = FloorLimits(expansions=2_000)


def direction_class(yaw: float) -> int:
    """The class of a yaw [rad]: the nearest multiple of 15°."""
    return round(yaw / (2 * math.pi / DIRECTION_CLASSES)) % DIRECTION_CLASSES


@dataclass(frozen=True)
class Alternatives:
    """The canonical contacts among the static obstacles of a scene.

    Attributes:
        grasps: of objects, canonical ones first.
        placements: of the held object, canonical ones first.
    """

    grasps: GraspCandidates
    placements: PlacementSearch

    @classmethod
    def of(cls, planner: Planner, scene: Scene) -> Alternatives:
        """Those of a planner's grasps and supports, for every arrangement of the scene's objects."""
        context = PlanningContext.of(
            scene.robot, scene, grasps=planner.grasps, supports=planner.support_choice, canonical=True
        )
        return cls(context.grasps(), context.placements())

    def free_grasps(self, scene: Scene) -> Flags:
        """Which straight grasps are free: (objects, families, `DIRECTION_CLASSES`); those of a held object are not."""
        world, families = self.grasps.compiled.world(scene), self.grasps.families
        free = np.zeros((len(scene.objects), len(families), DIRECTION_CLASSES), np.bool_)
        for index, name in enumerate(scene.names):
            for number, family in enumerate(families):
                for grasp in self.grasps.free_straight(scene, name, family):
                    if can_take(world, grasp.base, grasp.q, name):
                        free[index, number, direction_class(grasp.yaw)] = True
        return free

    def as_good(self, scene: Scene, target: str, free: Flags, left: int) -> Flags:
        """Which of the free grasps leave as few clearances as a plan that has `left` to do, this one included.

        Where a plan clears more than the minimum number, those that lower the minimum.

        Args:
            scene: nothing is held.
            target: the object wanted.
            free: as `free_grasps` gives it.
            left: objects that the plan still puts down.
        """
        helps = np.zeros(len(free), np.bool_)
        wanted = scene.index(target)
        helps[wanted] = left == 0
        if left:
            most = min(left, self._clearances_without(scene, wanted)) - 1
            for index in np.flatnonzero(free.any(axis=(1, 2))):
                helps[index] = index != wanted and self._clearances_without(scene, wanted, 1 << int(index)) <= most
        return np.asarray(free & helps[:, None, None])

    def cells(self, scene: Scene) -> Array:
        """The cells (c, 3) [m] of all supports on which objects are put."""
        return np.vstack([placement_cells(support) for support in self.placements.supports_in(scene)])

    def free_cells(self, scene: Scene, surfaces: Sequence[Surface]) -> NDArray[np.int64]:
        """Class of the least turned yaw with which the held object can be put on each cell (c,); -1 for none.

        Args:
            scene: an object is held.
            surfaces: of all supports, with the regions to keep out of; see `PlacementSearch.surfaces`.
        """
        world = self.grasps.compiled.world(scene)
        found: list[int] = []
        for surface in surfaces:
            cells = placement_cells(surface.support)
            are_free = surface.are_free(cells, held_radius(scene))
            for cell, is_free in zip(cells, are_free, strict=True):
                placement = next(self.placements.straight(world, cell[None]), None) if is_free else None
                found.append(-1 if placement is None else direction_class(placement.yaw))
        return np.array(found, dtype=np.int64)

    def _clearances_without(self, scene: Scene, target: int, removed: int = 0) -> float:
        """The minimum number of clearances if some objects, as a mask, were not there; infinite if nothing frees it."""

        def masks(name: str) -> list[int]:
            """What is in the way of each grasp of an object then."""
            return [option.blockers & ~removed for option in self.grasps.for_object(scene, name)]

        count = smallest_set(masks, scene.names[target], scene.names, _LIMITS).count
        return math.inf if count is None else count
