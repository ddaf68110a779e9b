"""The order of moves under a shelf, found on masks before any placement is searched.

Under a shelf all grippers come from the front: objects at the back go to their places before objects in front of them.
The blockers of each pick and of each put-down are computed once, as masks of objects where they stand and of objects at
their ends. A best-first search over arrangements finds the fewest moves. A move goes to an end, or aside, where an
object is assumed to block nothing.
"""

from __future__ import annotations

import heapq
import itertools
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cache
from typing import NamedTuple, TypeAlias

import numpy as np

from planners.goals import Goal
from planners.grasping.candidates import GraspCandidate, GraspCandidates
from planners.placing.goal_places import beside, distances, locations_in, place_of
from planners.placing.locations import stand_at
from planners.scene import Body, Scene
from planners.scene.cover import needs_drive

_EXPANSIONS = 8000
"""Arrangements to expand in each search: first the exact one, then the greedy one."""
_WEIGHTS = (1.0, 3.0)
"""Weights of the estimated remaining moves: exact search, greedy search."""
_BESIDE = 0.004
"""Clearance [m] between an object at its end and its neighbours."""


class Option(NamedTuple):
    """A grasp to take an object or to put it down, and the mask of objects that must be gone: see `Order`."""

    mask: int
    grasp: GraspCandidate


class Step(NamedTuple):
    """A planned move.

    Attributes:
        name: name of the object.
        is_general: whether it goes to its end, not just aside.
        taken: the grasp that takes it. None if it is in a hand, or has been put aside by then.
        put: the grasp that puts it down at its end, if known. None if it is put aside.
    """

    name: str
    is_general: bool
    taken: GraspCandidate | None = None
    put: GraspCandidate | None = None

    @property
    def grasps(self) -> tuple[GraspCandidate, ...]:
        """Grasps that other objects keep clear of until then."""
        return tuple(grasp for grasp in (self.taken, self.put) if grasp is not None)


@dataclass(frozen=True)
class Order:
    """The order of moves for a goal.

    In its masks, bit i is object i of n where it stands, bit n + i is object i at its end.

    Attributes:
        candidates: source of grasps. A put-down is regarded as a pick from the object's end, in reverse.
        ends: the objects of the goal at their goal poses, by name.
    """

    candidates: GraspCandidates
    ends: Mapping[str, Body]
    _at_ends: dict[tuple[str, bytes, bytes], int] = field(default_factory=dict, repr=False)
    _seen: dict[str, bytes] = field(default_factory=dict, repr=False)  # the ends that the masks of _at_ends belong to

    @classmethod
    def of(cls, scene: Scene, goal: Goal, waiting: Collection[str], candidates: GraspCandidates) -> Order | None:
        """Create the order for objects that are to move. None if the order is free: see `is_under_shelf`.

        Also None if an object lies or goes onto another object, or fits nowhere at its place. Areas are filled from the
        far side. `waiting` begins with the objects that can move first.
        """
        if not is_under_shelf(scene, goal) or scene.held_names:
            return None
        ends = {fact.object: scene.body(fact.object) for fact in goal.placed if fact.object not in waiting}
        turn_of = {name: turn for turn, name in enumerate(waiting)}
        facts = [fact for fact in goal.placed if fact.object in waiting]
        for fact in sorted(facts, key=lambda fact: turn_of[fact.object]):
            place, body = place_of(scene, fact), scene.body(fact.object)
            if place.below or not body.is_upright:
                return None
            alone = replace(scene, objects=tuple(ends.values()))
            found = next(locations_in(alone, body, place, (), (), lambda points: np.ones(len(points), np.bool_)), None)
            if found is None:
                return None
            point, (yaw, *_) = found
            turn = 0.0 if yaw is None else yaw - body.yaw
            ends[body.name] = stand_at(body, np.array([*point, place.face.top]), turn)
        return cls(candidates, ends)

    def steps(
        self,
        scene: Scene,
        waiting: Collection[str],
        in_the_way: Mapping[str, Collection[str]],
    ) -> list[Step]:
        """Find the moves from a scene on, [] if none are found.

        Args:
            scene: where objects stand.
            waiting: names of the objects to move.
            in_the_way: names of further objects that must leave before an object is put down at its end, by its name.
        """
        names, n = scene.names, len(scene.names)
        ends = {name: body if name in waiting else scene.body(name) for name, body in self.ends.items()}
        final, seen = scene, {name: body.pose.tobytes() for name, body in ends.items()}
        for body in ends.values():
            final = final.with_body(body)
        if seen != self._seen:
            self._at_ends.clear()
            self._seen.update(seen)
        start, to_move = scene.mask(names), scene.mask(waiting)

        @cache
        def options(name: str, at_end: bool, of_all: bool = False) -> list[Option]:
            """Ways to take an object where it stands, or from its end, one for each mask and pitch.

            Families of grasps are searched until one is free, or all of them.
            """
            there = scene.with_body(ends[name]) if at_end else scene
            find = self.candidates.of_all_families if of_all else self.candidates.for_object
            grasps, body, too = find(there, name), there.body(name), 0
            if at_end:
                near = (one for one in beside(scene, scene.support_under(body), body) if one.name != name)
                touched = (one for one in near if distances(body.position[None, :2], one)[0] < body.radius + _BESIDE)
                too = scene.mask({*(one.name for one in touched), *in_the_way.get(name, ())} - {name})
            new = [grasp for grasp in grasps if grasp.key not in self._at_ends]
            among = scene.mask(set(ends) - {name})
            hits = self.candidates.hits_among(final.with_body(body), name, new, among)
            self._at_ends.update((grasp.key, int(hit)) for grasp, hit in zip(new, hits, strict=True))
            best: dict[tuple[int, float], Option] = {}
            for grasp in grasps:
                mask = grasp.blockers | too | self._at_ends[grasp.key] << n
                best.setdefault((mask, grasp.pitch), Option(mask, grasp))
            return sorted(best.values(), key=lambda one: one.mask.bit_count())

        def same_pitch(taken: list[Option], put: list[Option]) -> tuple[GraspCandidate | None, GraspCandidate] | None:
            """Grasps of one pitch to take an object and to put it down."""
            return next(((a.grasp, b.grasp) for a in taken for b in put if a.grasp.pitch == b.grasp.pitch), None)

        def moves(now: int, is_first: bool) -> Iterator[tuple[Step, int]]:
            """Possible moves, and where objects stand after them."""
            for index, name in enumerate(names):
                stands, end = now >> index & 1, 1 << n + index
                if now & end or not (stands or name in ends):
                    continue
                left = now & ~(1 << index)
                taken = [one for one in options(name, False) if not one.mask & left] if stands else []
                if stands and not taken:
                    continue
                if name in ends and not (stands and name not in waiting):
                    put = [one for one in options(name, True) if not one.mask & left]
                    if stands:
                        # An object that is put aside only to be taken again at another pitch would be moved forever.
                        pair = same_pitch(taken, put)
                        if pair is None and is_first and put:
                            every = (
                                [one for one in options(name, at_end, True) if not one.mask & left]
                                for at_end in (False, True)
                            )
                            pair = same_pitch(*every)
                    else:
                        pair = (None, put[0].grasp) if put else None
                    if pair is not None:
                        yield Step(name, True, pair[0], pair[1]), left | end
                if stands:
                    yield Step(name, False, taken[0].grasp, None), left

        @cache
        def left_over(now: int) -> int:
            """Estimated number of remaining moves: objects to move, and objects that must at least leave for them."""
            rest, needed, done = [], 0, 0
            for index, name in enumerate(names):
                stands = now >> index & 1
                if not now >> n + index & 1 and (name in waiting if stands else name in ends):
                    rest.append(name)
                    kinds = [False] * stands + [True] * (name in ends)
                    for kind in kinds:
                        needed |= fewest(name, kind, now)
            while more := needed & ~done:
                index = more.bit_length() - 1
                done |= 1 << index
                needed |= fewest(names[index], False, now)
            return len(rest) + (needed & ~to_move).bit_count()

        def fewest(name: str, at_end: bool, now: int) -> int:
            """Smallest set of objects, where they stand, in the way of an object. All objects if it cannot be moved."""
            masks = (one.mask & now & start for one in options(name, at_end))
            return min(masks, key=int.bit_count, default=start)

        return next(filter(None, (_best_first(start, moves, left_over, weight) for weight in _WEIGHTS)), [])


def is_under_shelf(scene: Scene, goal: Goal) -> bool:
    """Whether the moves need an order: an object of the goal stands, or is to stand, under a shelf.

    Goals with an order or an object to hold need none, nor do robots that act with several arms.
    """
    if goal.order or goal.held or len(scene.robot.acting_arms) > 1:
        return False
    points = [scene.body(fact.object).foot for fact in goal.placed]
    for place in (place_of(scene, fact) for fact in goal.placed):
        middle = place.location if place.area is None else np.array(place.area.centre)
        points += [] if middle is None else [np.append(middle, place.face.top)]
    return any(needs_drive(scene, point) for point in points)


_Trail: TypeAlias = "tuple[Step, _Trail] | None"


def _best_first(
    start: int,
    moves: Callable[[int, bool], Iterator[tuple[Step, int]]],
    left_over: Callable[[int], int],
    weight: float,
) -> list[Step]:
    """Find a shortest sequence of moves after which none are left over, [] if none is found."""
    count, done = itertools.count(), set[int]()
    queue: list[tuple[float, int, int, int, _Trail]] = [(weight * left_over(start), 0, 0, start, None)]
    while queue and len(done) < _EXPANSIONS:
        _, _, cost, now, trail = heapq.heappop(queue)
        if now in done:
            continue
        done.add(now)
        if left_over(now) == 0:
            steps: list[Step] = []
            while trail is not None:
                step, trail = trail
                steps.insert(0, step)
            return steps
        for step, then in moves(now, trail is None):
            if then not in done:
                # Among equally good arrangements the latest first: it is nearest to the end.
                rank = cost + 1 + weight * left_over(then), -next(count)
                heapq.heappush(queue, (*rank, cost + 1, then, (step, trail)))
    return []
