"""Choosing the whole sequence before the first motion: which objects, through which grasps, to which places.

The strategies that do not look ahead commit to grasps only. Looking ahead walks through the clearances in thought,
places each object where nothing that remains to be done is obstructed, and turns to another set of objects, grasps or
another order where some object finds no place.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import TypeAlias

import numpy as np

from planners.cause import Cause
from planners.clearing.commitments import (
    CandidateSource,
    Commitments,
    NoCommitment,
    greedy_commitments,
    never,
    smallest_commitments,
    varied_commitments,
)
from planners.clearing.minimum_clearances import FloorLimits
from planners.collision.world import CollisionWorld
from planners.grasping.candidates import GraspCandidate
from planners.motion.arm import tcp_pose
from planners.placing.negative_goal_region import SupportGrid
from planners.placing.placements import Placement, PlacementSearch, keep_clear_mask
from planners.scene import HeldObject, RobotState, Scene
from planners.strategies import Strategy

__all__ = ["ClearancePlan", "OrderByTaskPlan", "commitments_for", "grasped", "keep_clear"]

_CELL = 0.02
"""[m] of the cells in which swept space is compared."""
OrderByTaskPlan: TypeAlias = Callable[[Commitments], Commitments]
"""Puts the objects to clear in the order in which a task plan clears them."""


@dataclass(frozen=True)
class RejectedGrasps:
    """Grasps that commitments would be made to, but that cannot be used."""

    grasps: tuple[GraspCandidate, ...]


@dataclass(frozen=True)
class ClearancePlan:
    """Commitments, and where each object to clear will be put; no places for strategies that do not look ahead."""

    commitments: Commitments
    places: Mapping[str, Placement] = field(default_factory=lambda: MappingProxyType({}))

    def without(self, name: str) -> ClearancePlan:
        """What remains once that object has been cleared."""
        places = {other: place for other, place in self.places.items() if other != name}
        return ClearancePlan(self.commitments.without(name), MappingProxyType(places))


def commitments_for(
    strategy: Strategy,
    source: CandidateSource,
    search: PlacementSearch,
    scene: Scene,
    target: str,
    arrange: OrderByTaskPlan,
    rng: np.random.Generator,
    limits: FloorLimits | None = None,
    usable: Callable[[GraspCandidate], bool] = lambda _: True,
    is_timed_out: Callable[[], bool] = never,
) -> ClearancePlan | NoCommitment | RejectedGrasps:
    """The best way to go about it; where there is none, or none whose objects all find places, the reason.

    Args:
        strategy: how to commit, and what places must keep clear of.
        source: grasps.
        search: places.
        scene: where everything is.
        target: the object wanted.
        arrange: puts commitments in the order in which the task planner will carry them out.
        rng: for variations and finer grids of places.
        limits: of the search for the smallest sets.
        usable: whether a grasp can be used at all. It is asked about few, before places are looked for; the source is
            to offer those named in `RejectedGrasps` no more before this function is called again.
        is_timed_out: whether time is up.
    """
    without_place = target
    for commitments in _alternatives(strategy, source, scene, target, rng, limits, is_timed_out):
        if is_timed_out():
            break
        if isinstance(commitments, NoCommitment):
            return commitments
        if unusable := tuple(grasp for grasp in commitments.grasps.values() if not usable(grasp)):
            return RejectedGrasps(unusable)
        if not strategy.plans_ahead:
            return ClearancePlan(commitments)
        commitments = arrange(commitments)
        places = _places(strategy, search, scene, commitments, rng)
        if not isinstance(places, str):
            return ClearancePlan(commitments, places)
        without_place = places
    if is_timed_out():
        return NoCommitment(Cause.TIME_LIMIT, (target,), proved=False)
    return NoCommitment(Cause.NO_CLEARANCE_LOCATION, (without_place,), proved=False)


def _alternatives(
    strategy: Strategy,
    source: CandidateSource,
    scene: Scene,
    target: str,
    rng: np.random.Generator,
    limits: FloorLimits | None,
    is_timed_out: Callable[[], bool],
) -> Iterator[Commitments | NoCommitment]:
    """Sets of objects as they are found, each followed by other orders and grasps for the same objects."""
    sets: Iterator[Commitments | NoCommitment]
    if strategy.grasps == "greedy":
        sets = iter((greedy_commitments(source, scene, target, is_timed_out),))
    else:
        sets = smallest_commitments(source, scene, target, slack=strategy.slack, limits=limits)
    volume = _volumes(scene) if strategy.variations else None
    for commitments in itertools.islice(sets, strategy.sets):
        yield commitments
        if volume is not None and isinstance(commitments, Commitments) and commitments.order:
            for _ in range(strategy.variations):
                yield varied_commitments(source, scene, commitments, rng, volume)


def _volumes(scene: Scene) -> Callable[[GraspCandidate], int]:
    """What each grasp sweeps of the space that objects stand in, as bits, one per cell of the table; remembered."""
    world = CollisionWorld.from_scene(scene)
    grid = SupportGrid.over(scene.support, _CELL)
    tallest = max(body.top for body in scene.objects) - scene.support.top
    known: dict[tuple[str, bytes, bytes], int] = {}

    def volume(grasp: GraspCandidate) -> int:
        if grasp.key not in known:
            mask = keep_clear_mask(world, grid, [grasp], tallest)
            known[grasp.key] = int.from_bytes(np.packbits(mask).tobytes(), "big")
        return known[grasp.key]

    return volume


def keep_clear(strategy: Strategy, commitments: Commitments, moving: str) -> list[GraspCandidate]:
    """The grasps whose volume an object put aside must stay out of: NGR1, NGR1 + NGR2, or nothing (eq. 1-3)."""
    if strategy.region == "none":
        return []
    if strategy.region == "ngr1":
        return [commitments.grasps[commitments.target]]
    return [grasp for name, grasp in commitments.grasps.items() if name != moving]


def grasped(scene: Scene, grasp: GraspCandidate) -> Scene:
    """The scene once that grasp has been taken: object in hand, robot at its base pose in the home configuration."""
    hand = tcp_pose(scene.robot, RobotState(grasp.base, grasp.q, 0.0))
    T_tcp_object = np.linalg.inv(hand) @ scene.body(grasp.object).pose
    state = RobotState(grasp.base, np.array(scene.robot.home), scene.state.finger_position)
    return scene.with_state(state).with_held(HeldObject(grasp.object, T_tcp_object))


def _places(
    strategy: Strategy, search: PlacementSearch, scene: Scene, commitments: Commitments, rng: np.random.Generator
) -> Mapping[str, Placement] | str:
    """A place for every object to clear, found by walking through the order; or the one that finds none."""
    places: dict[str, Placement] = {}
    remaining = commitments
    held = () if scene.held is None else (scene.held.name,)
    for name in (*held, *commitments.order):
        in_hand = scene if name in held else grasped(scene, commitments.grasps[name])
        place = next(search.find(in_hand, keep_clear(strategy, remaining, name), strategy, rng), None)
        if place is None:
            return name
        places[name] = place
        remaining = remaining.without(name)
        state = RobotState(place.base, in_hand.state.q, in_hand.state.finger_position)
        scene = in_hand.with_held(None).with_body(place.body).with_state(state)
    return MappingProxyType(places)
