"""One simulated move: an object is taken with a free grasp, and put down at a placement or held.

A move has a grasp, and a placement with a base pose and an arm configuration, both without collision. An object that is
put down keeps clear of the grasps of objects still to move: of the Negative Goal Region (eq. 1-3 of Lee & Kim 2019).
"""

from __future__ import annotations

import itertools
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from planners.clearing.commitments import grasped
from planners.clearing.quickest import move_time, quickest_first
from planners.clock import NO_DEADLINE, Deadline
from planners.goals import At, Goal, Holding, Inside, On
from planners.grasping.candidates import GraspCandidate, GraspCandidates
from planners.motion.approaches import can_take, fewest_blockers
from planners.motion.arm import tcp_pose
from planners.placing.goal_places import Place, of_same_area, place_of, placed_fact, reserved_regions, stacked_on
from planners.placing.locations import in_hand
from planners.placing.placements import Placement, PlacementSearch, is_under_shelf
from planners.placing.surfaces import KeepClear
from planners.scene import RobotState, Scene
from planners.strategies import Strategy

_TRIED = 24
"""Grasps of an object to check for approach and retreat, for each kind of search: one family, all families."""
_COMPARED = 3
"""Moves of an object to compare for the quickest one."""
_KEPT = 4
"""Grasps of an object to try if it stays in its hand: with some of them it cannot be put down where it goes later."""
_SAME_HOLD = 2
"""Decimals to which gripper poses are compared."""


@dataclass(frozen=True)
class Move:
    """One object taken, then put down or held.

    Attributes:
        name: name of the object.
        grasp: the grasp to take it. None if it is held already.
        placement: where it is put. None if it stays in the hand. With several hands, a later move may put it down.
        is_general: whether it goes where the goal wants it, not just aside.
        after: the scene after the move.
        choice: index of the keep-clear choice that the move was made with.
    """

    name: str
    grasp: GraspCandidate | None
    placement: Placement | None
    is_general: bool
    after: Scene
    choice: int = 0


@dataclass(frozen=True)
class NotPlaced:
    """Objects for whose goal places no motion was found.

    Attributes:
        blockers: names of the objects in the way, by object. The object in the hand is put aside, and goes to its place
            once they have moved.
        pitches: pitches [rad] of the grasps that had taken them. Other grasps take them next.
    """

    blockers: Mapping[str, frozenset[str]] = field(default_factory=dict)
    pitches: Mapping[str, frozenset[float]] = field(default_factory=dict)

    def having(self, name: str, blockers: frozenset[str], pitch: float | None) -> NotPlaced:
        """Add an object that was taken with a grasp of that pitch [rad], None if it was already in the hand."""
        refused = {} if pitch is None else {name: self.pitches.get(name, frozenset()) | {pitch}}
        return NotPlaced({**self.blockers, name: blockers}, {**self.pitches, **refused})

    def without_blocker(self, moved: str) -> NotPlaced:
        """Remove a blocker after its move. Objects without other blockers are dropped: their places may be free."""
        left = {name: names - {moved} for name, names in self.blockers.items()}
        return NotPlaced({name: names for name, names in left.items() if names}, self.pitches)


@dataclass(frozen=True)
class MoveMaker:
    """Maker of moves for one goal.

    Attributes:
        goal: the goal.
        start: the scene before anything was moved. Objects that stood there are to stand, even if they have fallen
            since.
        strategy: the region to keep clear, and the order in which locations are tried.
        candidates, placements: grasps and placements, with earlier results about them.
        not_placed: objects whose put-downs motion planning refuted before.
        holds_aside: whether the last obstacle may stay in one gripper while another one takes the object to hold.
        saves_time: whether quick grasps are preferred.
        hurries: whether a few moves of an object that is put down are compared, and the quickest one is taken.
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
    hurries: bool = False

    def hold(self, scene: Scene, name: str) -> Move | None:
        """Take an object such that it can be held where the goal wants it. None if every grasp is blocked."""
        if name in scene.held_names:
            return Move(name, None, None, True, scene)
        point = next(fact.point for fact in self.goal.facts if isinstance(fact, Holding) and fact.object == name)
        free = self.free_grasps(scene, name)
        grasp = next(free, None)
        if point is not None and grasp is not None:
            fits = (one for one in itertools.chain((grasp,), free) if self._holds_at(scene, one, np.array(point)))
            grasp = next(fits, grasp)
        return None if grasp is None else Move(name, grasp, None, True, grasped(scene, grasp))

    def take(self, scene: Scene, name: str, following: str = "") -> Iterator[Move]:
        """Find ways to take an object that stays in its hand while another one moves others, by every free arm.

        Args:
            scene: the scene before the move.
            name: name of the object.
            following: name of the object that is taken next, "" for none.
        """
        found = self._grasps_to_put(scene, name, placed_fact(self.goal, name), (), following)
        grasps = list(itertools.islice(found, _KEPT))
        missing = {*scene.robot.acting_arms} - {*scene.arms_that_hold} - {grasp.arm for grasp in grasps}
        others = [one for one in self.candidates.for_object(scene, name) if one.arm in missing and not one.blockers]
        more = itertools.islice((one for one in others if self.can_take(scene, one)), _KEPT - 1)
        for grasp in (*grasps[:1], *more, *grasps[1:]):
            yield Move(name, grasp, None, False, grasped(scene, grasp))

    def put(
        self,
        scene: Scene,
        name: str,
        is_general: bool,
        choices: Sequence[KeepClear],
        waiting: Collection[str],
        following: str = "",
    ) -> Move | None:
        """Take an object and put it where the goal wants it, or aside. None if all grasps or placements fail.

        Args:
            scene: the scene before the move. The object may be held.
            name: name of the object.
            is_general: whether it goes where the goal wants it.
            choices: regions to keep clear of, in order of preference. The first choice with a placement is used.
            waiting: names of the objects still to move, which need clearance too.
            following: name of the object that moves next, "" for none.
        """
        moves = self._puts(scene, name, is_general, choices, waiting, following)
        if not self.hurries:
            return next(moves, None)

        def time(move: Move) -> tuple[int, float]:
            assert move.placement is not None
            end = move.placement
            return move.choice, move_time(scene, move.grasp, end.base, end.q, self._is_first(scene))

        return min(itertools.islice(moves, _COMPARED), key=time, default=None)

    def _puts(
        self,
        scene: Scene,
        name: str,
        is_general: bool,
        choices: Sequence[KeepClear],
        waiting: Collection[str],
        following: str,
    ) -> Iterator[Move]:
        """Find moves of an object, one for each grasp with a placement. Arguments as for `put`."""
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
                    yield Move(name, grasp, placement, is_general, after, choice)
                    break

    def places(
        self,
        scene: Scene,
        fact: On | Inside | At | None,
        keep: KeepClear,
        waiting: Collection[str] = (),
        failed: list[NDArray[np.float64]] | None = None,
    ) -> Iterator[Placement]:
        """Find placements of the held object: where a fact of the goal wants it, or, with None, aside.

        Args:
            scene: the scene with the object in hand.
            fact: the place that the goal wants.
            keep: the regions to keep clear.
            waiting: names of the objects still to move, which need clearance too.
            failed: locations of the place to skip, as for `PlacementSearch.find_at`.
        """
        world = self.candidates.compiled.world(scene)
        if fact is None:
            return self.placements.find(world, keep, self.strategy, self.rng, self.deadline)
        if self.start.body(fact.object).is_upright and not in_hand(scene)[1].is_upright:
            return iter(())
        place, others = place_of(scene, fact), of_same_area(scene, self.goal, fact.object, waiting)
        above = () if place.area is None else stacked_on(scene, self.goal, fact.object)
        return self.placements.find_at(world, place, keep, waiting, others, failed, self.deadline, above)

    def free_grasps(
        self, scene: Scene, name: str, is_exact: bool = False, following: str = ""
    ) -> Iterator[GraspCandidate]:
        """Find unblocked grasps of all pitches with a collision-free approach and retreat.

        If `is_exact`, for a place with an exact yaw or an object of pieces, several grasps of each pitch follow, since
        a grasp from another side may fit there. Blockers found on the way are remembered for the scene.
        """
        seen: set[object] = set()
        candidates, holding = self.candidates, scene.arms_that_hold
        if self.saves_time:
            sorted_by_time = quickest_first(candidates, scene, name, following, self._is_first(scene))
            quickest = (one for one in sorted_by_time if one.arm not in holding)
            by_kind: dict[tuple[str, float], GraspCandidate] = {}
            count = _COMPARED if self.hurries else 1
            for grasp in itertools.islice((one for one in quickest if self.can_take(scene, one)), count):
                if by_kind.setdefault((grasp.arm, grasp.pitch), grasp) is grasp:
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
        """Whether the gripper can approach a grasp and leave it again.

        In the open, other objects are ignored: they can be moved. Under a shelf, the grasp's blockers must include
        every object in the way.
        """
        world = self.candidates.compiled.world(scene)
        if not grasp.drives:
            return self.placements.approach(world, grasp) is not None
        blockers = fewest_blockers(world.for_arm(grasp.arm), grasp.base, grasp.q, grasp.object)
        return blockers is not None and not blockers & ~grasp.blockers

    def reject(self, scene: Scene, grasp: GraspCandidate) -> None:
        """Add the objects in the way of a grasp's straight lines to its blockers, or exclude the grasp."""
        self.candidates.unusable += 1
        world = self.candidates.compiled.world(scene).for_arm(grasp.arm)
        blockers = fewest_blockers(world, grasp.base, grasp.q, grasp.object)
        if blockers is not None and blockers & ~grasp.blockers:
            self.candidates.obstruct(scene, grasp, blockers)
        else:
            self.candidates.ban(scene, grasp)

    def can_take(self, scene: Scene, grasp: GraspCandidate) -> bool:
        """Whether approach and retreat with the object are collision-free."""
        world = self.candidates.compiled.world(scene.using(grasp.arm))
        return can_take(world, grasp.base, grasp.q, grasp.object)

    def _is_first(self, scene: Scene) -> bool:
        """Whether nothing has been moved yet."""
        return not scene.moved_since(self.start)

    def _holds_at(self, scene: Scene, grasp: GraspCandidate, point: NDArray[np.float64]) -> bool:
        world = self.candidates.compiled.world(grasped(scene, grasp))
        return next(self.placements.holding_at(world, point), None) is not None

    def _grasps_to_put(
        self, scene: Scene, name: str, fact: On | Inside | At | None, waiting: Collection[str], following: str
    ) -> Iterable[GraspCandidate]:
        """Find free grasps, on demand, for an object that goes to its place or aside."""
        refused = () if fact is None else self.not_placed.pitches.get(name, ())
        # Of an object of pieces, another rim or side in the hand may fit where the first one does not.
        has_sides = scene.body(name).shape == "pieces"
        is_exact = isinstance(fact, At) and (fact.yaw is not None or has_sides)
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
        """Grasps for a place between walls, from above first: there the hand has the most clearance.

        Grasps from all sides follow.
        """
        found = sorted(grasps, key=lambda one: -one.pitch)
        yield from found
        known = {_hold(scene, one) for one in found}
        yield from (one for one in self.free_grasps(scene, name, True, following) if _hold(scene, one) not in known)

    def _deepest_first(self, scene: Scene, grasps: Iterable[GraspCandidate], place: Place) -> list[GraspCandidate]:
        """Grasps sorted by how deep they bring the object under a shelf: at the back it blocks fewer others."""

        def depth(grasp: GraspCandidate) -> float:
            return self.placements.depth(self.candidates.compiled.world(grasped(scene, grasp)), place)[1]

        return sorted(grasps, key=depth, reverse=True)


def _hold(scene: Scene, grasp: GraspCandidate) -> bytes:
    """Gripper pose at the grasp, rounded. It does not depend on base pose or arm configuration."""
    T = tcp_pose(scene.using(grasp.arm).robot, RobotState(grasp.base, grasp.q, 0.0))
    return bytes(np.round(T, _SAME_HOLD).tobytes())
