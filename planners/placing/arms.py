"""Placements of a robot that acts with several arms: an object is put down by the arm that holds it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

import numpy as np

from planners.clock import NO_DEADLINE, Deadline
from planners.collision.world import CollisionWorld
from planners.placing.placements import Placement, PlacementSearch
from planners.placing.surfaces import KeepClear
from planners.strategies import Strategy

__all__ = ["ArmPlacements"]


@dataclass(frozen=True)
class ArmPlacements(PlacementSearch):
    """Finds placements for whichever arm is active.

    Attributes:
        by_arm: the search of each arm, by its name; the other attributes are those of one of them.
    """

    by_arm: Mapping[str, PlacementSearch] = field(default_factory=lambda: MappingProxyType({}))

    @classmethod
    def of(cls, by_arm: Mapping[str, PlacementSearch]) -> ArmPlacements:
        """The searches of several arms."""
        one = next(iter(by_arm.values()))
        return cls(one.placer, one.chain, supports=one.supports, by_arm=MappingProxyType({**by_arm}))

    def find(
        self,
        world: CollisionWorld,
        keep_clear: KeepClear,
        strategy: Strategy,
        rng: np.random.Generator,
        deadline: Deadline = NO_DEADLINE,
    ) -> Iterator[Placement]:
        """As `PlacementSearch.find`."""
        return self.by_arm[world.scene.robot.arm_name].find(world, keep_clear, strategy, rng, deadline)
