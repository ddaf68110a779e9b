"""One move, carried out in thought: an object is taken through a free grasp, and put down where it may stand, or held.

A move has a grasp, and a placement with a base pose and an arm configuration, both without collision. What is put down
keeps clear of the grasps of what is still to be moved: of the Negative Goal Region (eq. 1-3 of Lee & Kim 2019).
"""

from __future__ import annotations

import itertools
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from planners.clearing.commitments import grasped
from planners.clearing.quickest import quickest_first
from planners.clock import NO_DEADLINE, Deadline
from planners.goals import At, Goal, Holding, Inside, On
from planners.grasping.candidates import GraspCandidate, GraspCandidates
from planners.motion.approaches import can_take, fewest_blockers
from planners.motion.arm import tcp_pose
from planners.placing.goal_places import Place, of_same_area, place_of, placed_fact, reserved_regions
from planners.placing.locations import in_hand
from planners.placing.placements import Placement, PlacementSearch, is_under_shelf
from planners.placing.surfaces import KeepClear
from planners.scene import RobotState, Scene
from planners.strategies import Strategy

_TRIED = 24
"""Grasps of an object for which is looked whether the gripper can come and leave, of one family and of all."""
_SAME_HOLD = 2
"""Decimals to which two poses of the gripper are the same."""


@dataclass(frozen=True)
class Move:
    """One object taken, and put down unless it is to be held.

    Attributes:
        name: of the object.
        grasp: through which it is taken; None if it is held already.
        placement: where it is put; None if it stays in the hand.
        is_general: whether it goes where the goal wants it, not just aside.
        after: the scene after the move.
        choice: which of the choices of what to keep clear of it was made with.
    """

    name: str
    grasp: GraspCandidate | None
    placement: Placement | None
    is_general: bool
    after: Scene
    choice: int = 0


@dataclass(frozen=True)
class NotPlaced:
    """Objects for whose places no motion was found.

    Attributes:
        blockers: names of what is in the way of that, by object. What is in the hand is put aside, and goes to its
            place once they have moved.
        pitches: [rad] of the grasps through which they had been taken; they are taken through others next.
    """

    blockers: Mapping[str, frozenset[str]] = field(default_factory=dict)
    pitches: Mapping[str, frozenset[float]] = field(default_factory=dict)

    def having(self, name: str, blockers: frozenset[str], pitch: float | None) -> NotPlaced:
        """The same with one more object, taken through a grasp of that pitch [rad], None if it was in the hand."""
        refused = {} if pitch is None else {name: self.pitches.get(name, frozenset()) | {pitch}}
        return NotPlaced({**self.blockers, name: blockers}, {**self.pitches, **refused})

    def without_blocker(self, moved: str) -> NotPlaced:
        """The same after an object has moved: where nothing else was in the way, its place may be free now."""
        left = {name: names - {moved} for name, names in self.blockers.items()}
        return NotPlaced({name: names for name, names in left.items() if names}, self.pitches)


@dataclass(frozen=True)
class MoveMaker:
    """Makes moves for one goal.

    Attributes:
        goal: what is wanted.
        start: the scene before anything was moved: what stood there is to stand, even if it has fallen since.
        strategy: which region is kept clear, and in which order locations are tried.
        candidates, placements: grasps and placements, with what is known of them.
        not_placed: what motion planning refuted before.
        holds_aside: whether the last obstacle may stay in one gripper while another one takes what is to be held.
        saves_time: whether grasps are chosen that take less time.
    """

    goal: Goal
    start: Scene
    strategy: Strategy
    candidates: GraspCandidates
    placements: PlacementSearch
    rng: np.random.Generator
    deadline: Deadline = NO_DEADLINE
    not_placed: NotPlaced = NotPlaced()
    holds_aside: bool = False
    saves_time: bool = False

    def hold(self, scene: Scene, name: str) -> Move | None:
        """Take an object so that it can be held where the goal wants it; None if no grasp is free."""
        if name in scene.held_names:
            return Move(name, None, None, True, scene)
        point = next(fact.point for fact in self.goal.facts if isinstance(fact, Holding) and fact.object == name)
        free = self.free_grasps(scene, name)
        grasp = next(free, None)
        if point is not None and grasp is not None:
            fits = (one for one in itertools.chain((grasp,), free) if self._holds_at(scene, one, np.array(point)))
            grasp = next(fits, grasp)
        return None if grasp is None else Move(name, grasp, None, True, grasped(scene, grasp))

    def put(
        self,
        scene: Scene,
        name: str,
        is_general: bool,
        choices: Sequence[KeepClear],
        waiting: Collection[str],
        following: str = "",
    ) -> Move | None:
        """Take an object and put it where the goal wants it, or aside; None if no free grasp leads to a placement.

        Args:
            scene: before the move; the object may be held.
            name: of the object.
            is_general: whether it goes where the goal wants it.
            choices: what it keeps clear of; the first with which a placement is found counts.
            waiting: names of the objects that are still to be moved, for which room is left.
            following: name of the object that is moved next, "" for none.
        """
        fact = placed_fact(self.goal, name) if is_general else None
        reserved = reserved_regions(scene, self.goal, name if is_general else "")
        for grasp in (
            (None,) if name in scene.held_names else self._grasps_to_put(scene, name, fact, waiting, following)
        ):
            with_it = scene.holding(name) if grasp is None else grasped(scene, grasp)
            assert with_it is not None
            failed: list[NDArray[np.float64]] = []
            for choice, keep in enumerate(choices):
                found = self.places(with_it, fact, replace(keep, reserved=reserved), waiting, failed)
                placement = next(found, None)
                if placement is not None:
                    state = RobotState(placement.base, with_it.state.q, with_it.state.finger_position)
                    after = with_it.with_held(None).with_body(placement.body).with_state(state)
                    return Move(name, grasp, placement, is_general, after, choice)
        return None

    def places(
        self,
        scene: Scene,
        fact: On | Inside | At | None,
        keep: KeepClear,
        waiting: Collection[str] = (),
        failed: list[NDArray[np.float64]] | None = None,
    ) -> Iterator[Placement]:
        """Placements of the held object: where a fact of the goal wants it, or, with None, aside.

        Args:
            scene: with the object in hand.
            fact: where it is to be.
            keep: what it must not stand in the way of.
            waiting: names of the objects that are still to be moved, for which room is left.
            failed: locations of the place to pass over, as for `PlacementSearch.find_at`.
        """
        world = self.candidates.compiled.world(scene)
        if fact is None:
            return self.placements.find(world, keep, self.strategy, self.rng, self.deadline)
        if self.start.body(fact.object).is_upright and not in_hand(scene)[1].is_upright:
            return iter(())
        place, others = place_of(scene, fact), of_same_area(scene, self.goal, fact.object, waiting)
        return self.placements.find_at(world, place, keep, waiting, others, failed, self.deadline)

    def free_grasps(
        self, scene: Scene, name: str, is_exact: bool = False, following: str = ""
    ) -> Iterator[GraspCandidate]:
        """Grasps with nothing in their way, to which the gripper can come and from which it can leave, of all pitches.

        Then, if the object is to come to rest at an exact yaw, several of each pitch: one from another side may fit
        there. What is found in the way of others is remembered for the scene.
        """
        seen: set[object] = set()
        candidates, holding = self.candidates, scene.arms_that_hold
        if self.saves_time:
            quickest = (one for one in quickest_first(candidates, scene, name, following) if one.arm not in holding)
            for grasp in itertools.islice((one for one in quickest if self.can_take(scene, one)), 1):
                seen |= {grasp.pitch, _hold(scene, grasp)}
                yield grasp
        finds = [
            (candidates.for_object, False),
            (candidates.of_all_families, False),
            (candidates.of_all_families, True),
        ]
        for find, by_hold in finds[: 3 if is_exact else 2]:
            for _ in range(_TRIED):
                unblocked = (one for one in find(scene, name) if not one.blockers and one.arm not in holding)
                free = (one for one in unblocked if (_hold(scene, one) if by_hold else one.pitch) not in seen)
                found = next(free, None)
                if found is None:
                    break
                if self.can_take(scene, found):
                    seen |= {found.pitch, _hold(scene, found)}
                    yield found
                else:
                    self.reject(scene, found)

    def is_usable(self, scene: Scene, grasp: GraspCandidate) -> bool:
        """Whether the gripper can leave a grasp again; under a shelf also whether it knows all that is in its way.

        In the open, other objects do not count: they can be moved.
        """
        world = self.candidates.compiled.world(scene)
        if not grasp.drives:
            return self.placements.approach(world, grasp) is not None
        blockers = fewest_blockers(world.for_arm(grasp.arm), grasp.base, grasp.q, grasp.object)
        return blockers is not None and not blockers & ~grasp.blockers

    def reject(self, scene: Scene, grasp: GraspCandidate) -> None:
        """Add to a grasp what is in the way of its straight lines, or do not offer it again."""
        self.candidates.unusable += 1
        world = self.candidates.compiled.world(scene).for_arm(grasp.arm)
        blockers = fewest_blockers(world, grasp.base, grasp.q, grasp.object)
        if blockers is not None and blockers & ~grasp.blockers:
            self.candidates.obstruct(scene, grasp, blockers)
        else:
            self.candidates.ban(scene, grasp)

    def can_take(self, scene: Scene, grasp: GraspCandidate) -> bool:
        """Whether the gripper can come to a grasp and leave with the object without hitting anything."""
        world = self.candidates.compiled.world(scene.using(grasp.arm))
        return can_take(world, grasp.base, grasp.q, grasp.object)

    def _holds_at(self, scene: Scene, grasp: GraspCandidate, point: NDArray[np.float64]) -> bool:
        world = self.candidates.compiled.world(grasped(scene, grasp))
        return next(self.placements.holding_at(world, point), None) is not None

    def _grasps_to_put(
        self, scene: Scene, name: str, fact: On | Inside | At | None, waiting: Collection[str], following: str
    ) -> Iterable[GraspCandidate]:
        """Free grasps of an object that is put at its place, or aside, looked for when they are asked for."""
        refused = () if fact is None else self.not_placed.pitches.get(name, ())
        is_exact = isinstance(fact, At) and fact.yaw is not None
        free = (one for one in self.free_grasps(scene, name, is_exact, following) if one.pitch not in refused)
        if fact is not None and place_of(scene, fact).hollow is not None:
            return self._from_above_first(scene, name, free, following)
        if fact is None or not of_same_area(scene, self.goal, name, waiting):
            return free
        place = place_of(scene, fact)
        return self._deepest_first(scene, free, place) if is_under_shelf(scene, place) else free

    def _from_above_first(
        self, scene: Scene, name: str, grasps: Iterable[GraspCandidate], following: str
    ) -> Iterator[GraspCandidate]:
        """Grasps of an object for a place between walls: there a hand from above has most room; then from all sides."""
        found = sorted(grasps, key=lambda one: -one.pitch)
        yield from found
        known = {_hold(scene, one) for one in found}
        yield from (one for one in self.free_grasps(scene, name, True, following) if _hold(scene, one) not in known)

    def _deepest_first(self, scene: Scene, grasps: Iterable[GraspCandidate], place: Place) -> list[GraspCandidate]:
        """Grasps with which an object gets farther into a place under a shelf first: there it is out of others' way."""

        def depth(grasp: GraspCandidate) -> float:
            return self.placements.depth(self.candidates.compiled.world(grasped(scene, grasp)), place)[1]

        return sorted(grasps, key=depth, reverse=True)


def _hold(scene: Scene, grasp: GraspCandidate) -> bytes:
    """Where the gripper is when the fingers close, wherever the base stands and however the arm is bent."""
    T = tcp_pose(scene.using(grasp.arm).robot, RobotState(grasp.base, grasp.q, 0.0))
    return bytes(np.round(T, _SAME_HOLD).tobytes())
