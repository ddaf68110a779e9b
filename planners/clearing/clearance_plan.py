"""What is chosen before the first motion: for what, from what, and the plan of clearances that comes of it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import NamedTuple, TypeAlias

import numpy as np

from planners.clearing.commitments import CandidateSource, Commitments
from planners.clearing.minimum_clearances import FloorLimits
from planners.clearing.saving_time import Grasps
from planners.clock import NO_DEADLINE, Deadline
from planners.collision.world import CompiledScenes
from planners.grasping.candidates import GraspCandidate
from planners.placing.placements import Placement, PlacementSearch
from planners.scene import Scene
from planners.strategies import Strategy

__all__ = ["ClearancePlan", "ClearingProblem", "IsUsable", "OrderByTaskPlan", "RejectedGrasps", "Turn"]

OrderByTaskPlan: TypeAlias = Callable[[Commitments], Commitments]
"""Puts the objects to clear in the order in which a task plan clears them."""
IsUsable: TypeAlias = Callable[[Scene, GraspCandidate], bool]
"""Whether a grasp in a scene can be used at all: whether the gripper can leave again."""


@dataclass(frozen=True)
class ClearingProblem:
    """What commitments are chosen for, and what they are chosen from.

    Attributes:
        strategy: how to commit, and what locations must keep clear of.
        scene: where everything is.
        target: the object wanted.
        candidates: grasps.
        placements: finds where to put objects.
        compiled: scenes compiled so far.
        rng: for variations and finer grids of locations.
        limits: of the search for the smallest sets.
        deadline: when to give up.
        saves_time: whether grasps are exchanged for such that take less time.
        holds_aside: whether the last obstacle may stay in one gripper while another one takes the target.
    """

    strategy: Strategy
    scene: Scene
    target: str
    candidates: CandidateSource
    placements: PlacementSearch
    compiled: CompiledScenes
    rng: np.random.Generator
    limits: FloorLimits | None = None
    deadline: Deadline = NO_DEADLINE
    saves_time: bool = False
    holds_aside: bool = False

    @property
    def grasps(self) -> Grasps:
        """Where grasps come from."""
        return Grasps(self.candidates, self.compiled)


@dataclass(frozen=True)
class RejectedGrasps:
    """Grasps that commitments would be made to, but that cannot be used."""

    grasps: tuple[GraspCandidate, ...]


@dataclass(frozen=True)
class ClearancePlan:
    """Commitments, and a placement for each object to clear; no placements for strategies that do not plan ahead.

    Attributes:
        commitments: a grasp for the target and for every object that must go before it.
        placements: where objects are put.
        provisional: the object that is put where it will be in the way later; once it stands there, commitments are
            chosen anew. "" for none.
        moves: put-downs until the target can be taken, as far as they are planned.
        aside: the object that stays in a gripper while another one takes the target, "" for none.
    """

    commitments: Commitments
    placements: Mapping[str, Placement] = field(default_factory=lambda: MappingProxyType({}))
    provisional: str = ""
    moves: int = 0
    aside: str = ""

    def without(self, name: str) -> ClearancePlan:
        """What remains once that object has been cleared."""
        placements = {other: placement for other, placement in self.placements.items() if other != name}
        kept = MappingProxyType(placements)
        moves = max(self.moves - 1, 0)
        return ClearancePlan(self.commitments.without(name), kept, self.provisional, moves, self.aside)


class Turn(NamedTuple):
    """Before a clearance: the scene, and the commitments to what remains to be done."""

    scene: Scene
    remaining: Commitments
