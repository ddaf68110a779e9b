"""The order of moves under a shelf, found on masks before any placement is searched.

Under a shelf all grippers come from the front: objects at the back go to their places before objects in front of them.
The blockers of each pick and of each put-down are computed once, as masks of objects where they stand and of objects at
their ends. A best-first search over arrangements finds the fewest moves. A move goes to an end, or aside, where an
object is assumed to block nothing.
"""

from __future__ import annotations

import heapq
import itertools
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field, replace
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
        """Create the order for objects that are to move. None if the order is free: see `needs_order`.

        Also None if an object lies or goes onto another object, or fits nowhere at its place. Areas are filled from the
        far side. `waiting` begins with the objects that can move first.
        """
        if not needs_order(scene, goal) or scene.held_names:
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
        ends = {name: body if name in waiting else scene.body(name) for name, body in self.ends.items()}
        seen = {name: body.pose.tobytes() for name, body in ends.items()}
        if seen != self._seen:
            self._at_ends.clear()
            self._seen.update(seen)
        arrangements = _Arrangements(self.candidates, scene, ends, frozenset(waiting), in_the_way, self._at_ends)
        return next(filter(None, (_best_first(arrangements, weight) for weight in _WEIGHTS)), [])


class _Arrangements:
    """Arrangements of objects, as masks, and the moves between them.

    Attributes:
        start: mask of all objects where they stand.
    """

    def __init__(
        self,
        candidates: GraspCandidates,
        scene: Scene,
        ends: Mapping[str, Body],
        waiting: frozenset[str],
        in_the_way: Mapping[str, Collection[str]],
        at_ends: dict[tuple[str, bytes, bytes], int],
    ) -> None:
        """Begin with a scene. `at_ends` keeps, by the key of a grasp, the objects that it hits at their ends."""
        self._candidates, self._scene, self._ends = candidates, scene, ends
        self._waiting, self._in_the_way, self._at_ends = waiting, in_the_way, at_ends
        self._final = scene
        for body in ends.values():
            self._final = self._final.with_body(body)
        self._names = scene.names
        self.start = scene.mask(scene.names)
        self._to_move = scene.mask(waiting)
        self._options: dict[tuple[str, bool, bool], list[Option]] = {}
        self._left: dict[int, int] = {}

    def moves(self, now: int, is_first: bool) -> Iterator[tuple[Step, int]]:
        """Possible moves, and where objects stand after them."""
        for index, name in enumerate(self._names):
            stands, end = now >> index & 1, self._end_bit(index)
            if now & end or not (stands or name in self._ends):
                continue
            left = now & ~(1 << index)
            taken = self._free(name, False, left) if stands else []
            if stands and not taken:
                continue
            if name in self._ends and (name in self._waiting or not stands):
                pair = self._taken_and_put(name, taken, left, is_first) if stands else self._put(name, left)
                if pair is not None:
                    yield Step(name, True, *pair), left | end
            if stands:
                yield Step(name, False, taken[0].grasp, None), left

    def left_over(self, now: int) -> int:
        """Estimated number of remaining moves: objects to move, and objects that must at least leave for them."""
        if now not in self._left:
            self._left[now] = self._count_left(now)
        return self._left[now]

    def _count_left(self, now: int) -> int:
        count, needed, done = 0, 0, 0
        for index, name in enumerate(self._names):
            stands = bool(now >> index & 1)
            has_end = name in self._ends
            if now & self._end_bit(index) or not (name in self._waiting if stands else has_end):
                continue
            count += 1
            if stands:
                needed |= self._fewest(name, False, now)
            if has_end:
                needed |= self._fewest(name, True, now)
        while more := needed & ~done:  # what must leave may itself need others to leave
            index = more.bit_length() - 1
            done |= 1 << index
            needed |= self._fewest(self._names[index], False, now)
        return count + (needed & ~self._to_move).bit_count()

    def _fewest(self, name: str, at_end: bool, now: int) -> int:
        """Smallest set of objects, where they stand, in the way of an object. All objects if it cannot be moved."""
        masks = (one.mask & now & self.start for one in self._options_of(name, at_end))
        return min(masks, key=int.bit_count, default=self.start)

    def _taken_and_put(
        self, name: str, taken: list[Option], left: int, is_first: bool
    ) -> tuple[GraspCandidate, GraspCandidate] | None:
        """Grasps of one pitch to take an object where it stands and to put it down at its end.

        At another pitch it would be put aside and taken again, forever.
        """
        put = self._free(name, True, left)
        pair = _of_one_pitch(taken, put)
        if pair is None and is_first and put:
            taken, put = self._free(name, False, left, of_all=True), self._free(name, True, left, of_all=True)
            pair = _of_one_pitch(taken, put)
        return pair

    def _put(self, name: str, left: int) -> tuple[None, GraspCandidate] | None:
        """Grasp that puts an object down at its end which has been put aside before."""
        put = self._free(name, True, left)
        return (None, put[0].grasp) if put else None

    def _free(self, name: str, at_end: bool, left: int, of_all: bool = False) -> list[Option]:
        """Options with nothing in the way among the objects of `left`."""
        return [one for one in self._options_of(name, at_end, of_all) if not one.mask & left]

    def _options_of(self, name: str, at_end: bool, of_all: bool = False) -> list[Option]:
        """Ways to take an object where it stands, or from its end, one for each mask and pitch.

        Families of grasps are searched until one is free, or all of them.
        """
        key = name, at_end, of_all
        if key not in self._options:
            self._options[key] = self._find_options(name, at_end, of_all)
        return self._options[key]

    def _find_options(self, name: str, at_end: bool, of_all: bool) -> list[Option]:
        scene, candidates = self._scene, self._candidates
        there = scene.with_body(self._ends[name]) if at_end else scene
        grasps = (candidates.of_all_families if of_all else candidates.for_object)(there, name)
        body = there.body(name)
        too = self._beside_end(body) if at_end else 0
        new = [grasp for grasp in grasps if grasp.key not in self._at_ends]
        among = scene.mask(set(self._ends) - {name})
        hits = candidates.hits_among(self._final.with_body(body), name, new, among)
        self._at_ends.update((grasp.key, int(hit)) for grasp, hit in zip(new, hits, strict=True))
        best: dict[tuple[int, float], Option] = {}
        for grasp in grasps:
            mask = grasp.blockers | too | (self._at_ends[grasp.key] << len(self._names))
            best.setdefault((mask, grasp.pitch), Option(mask, grasp))
        return sorted(best.values(), key=lambda one: one.mask.bit_count())

    def _beside_end(self, body: Body) -> int:
        """Objects that must have left, whatever the grasp, before an object is at its end."""
        scene = self._scene
        near = [one for one in beside(scene, scene.support_under(body), body) if one.name != body.name]
        touched = [one for one in near if distances(body.position[None, :2], one)[0] < body.radius + _BESIDE]
        return scene.mask({*(one.name for one in touched), *self._in_the_way.get(body.name, ())} - {body.name})

    def _end_bit(self, index: int) -> int:
        return 1 << (len(self._names) + index)


def _of_one_pitch(taken: list[Option], put: list[Option]) -> tuple[GraspCandidate, GraspCandidate] | None:
    """The first grasps that take an object and put it down at one pitch."""
    return next(((a.grasp, b.grasp) for a in taken for b in put if a.grasp.pitch == b.grasp.pitch), None)


def needs_order(scene: Scene, goal: Goal) -> bool:
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


def _best_first(arrangements: _Arrangements, weight: float) -> list[Step]:
    """Find a shortest sequence of moves after which none are left over, [] if none is found."""
    count, done = itertools.count(), set[int]()
    start, left_over = arrangements.start, arrangements.left_over
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
        for step, then in arrangements.moves(now, trail is None):
            if then not in done:
                # Among equally good arrangements the latest first: it is nearest to the end.
                rank = cost + 1 + weight * left_over(then), -next(count)
                heapq.heappush(queue, (*rank, cost + 1, then, (step, trail)))
    return []
