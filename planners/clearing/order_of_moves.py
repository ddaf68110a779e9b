"""The order of moves under a shelf, found on masks before any placement is looked for.

Under a shelf all grippers come from the front: what stands before a place must go there after what stands behind. What
is in the way of taking each object where it stands, and of putting it down at its end, is worked out once, as masks of
objects where they stand and of objects at their ends. A best-first search over which objects stand where finds the
fewest moves: to an end, or aside, where an object counts as in nobody's way.
"""

from __future__ import annotations

import heapq
import itertools
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from planners.goals import Goal
from planners.grasping.candidates import GraspCandidate, GraspCandidates
from planners.placing.goal_places import beside, distances, locations_in, place_of, placed_fact
from planners.placing.locations import stand_at
from planners.scene import Body, Scene
from planners.scene.cover import needs_drive

_EXPANSIONS = 2000
"""Arrangements from which moves are looked for, before the search becomes greedy, and before it is given up."""
_WEIGHTS = (1.0, 3.0)
"""Of the moves that are left at least: exact, and greedy."""
_BESIDE = 0.004
"""[m] between an object at its end and what may stand beside it."""


class Option(NamedTuple):
    """A way to take an object, or to put it down, and what must not stand where then: see `Order`."""

    mask: int
    grasp: GraspCandidate


class Step(NamedTuple):
    """One move of the order.

    Attributes:
        name: of the object.
        is_general: whether it goes to its end, not just aside.
        ways: how it is taken, if it is not in the hand, and put down at its end.
    """

    name: str
    is_general: bool
    ways: tuple[GraspCandidate, ...]


@dataclass
class Order:
    """The order of moves for some objects.

    In its masks bit i is object i where it stands, bit n + i object i of n at its end.

    Attributes:
        candidates: where grasps come from; to put an object down counts as to take it from its end, in reverse.
        ends: where objects are to stand, by name.
    """

    candidates: GraspCandidates
    ends: Mapping[str, Body]
    _at_ends: dict[tuple[str, bytes, bytes], int] = field(default_factory=dict)

    @classmethod
    def of(cls, scene: Scene, goal: Goal, waiting: Collection[str], candidates: GraspCandidates) -> Order | None:
        """The order for objects that are to move; None if none of it is under a shelf, or more than places is asked."""
        if goal.order or goal.held or scene.held_names or not scene.robot.acting_arms[1:] == ():
            return None
        ends: dict[str, Body] = {}
        for name in waiting:
            fact = placed_fact(goal, name)
            if fact is None:
                continue
            place, body = place_of(scene, fact), scene.body(name)
            if place.below or not body.is_upright:
                return None
            alone = replace(scene, objects=(*ends.values(), body.at(body.position + [0.0, 0.0, 100.0])))
            found = locations_in(alone, body, place, (name,), (), lambda points: np.ones(len(points), np.bool_))
            point, yaws = next(found, (None, (None,)))
            if point is None:
                return None
            ends[name] = stand_at(
                body, np.array([*point, place.face.top]), 0.0 if yaws[0] is None else yaws[0] - body.yaw
            )
        bodies = (*map(scene.body, waiting), *ends.values())
        return cls(candidates, ends) if any(needs_drive(scene, body.foot) for body in bodies) else None

    def steps(
        self,
        scene: Scene,
        waiting: Collection[str],
        in_the_way: Mapping[str, Collection[str]],
        in_vain: Collection[tuple[str, bool]],
    ) -> list[Step]:
        """The moves from a scene on, () if none are found.

        Args:
            scene: where objects stand.
            waiting: names of what is to move.
            in_the_way: names of what else must have left before an object is put down at its end, by its name.
            in_vain: first moves that were refuted, and whether to the end.
        """
        n, start = len(scene.names), scene.mask(set(scene.names) - set(scene.held_names))
        ends = {scene.index(name): body for name, body in self.ends.items() if name in waiting}
        final = scene
        for name in waiting:
            final = final.with_body(self.ends[name]) if name in self.ends else final
        to_move = {scene.index(name) for name in waiting}
        known: dict[tuple[int, bool], list[Option]] = {}

        def options(index: int, at_end: bool) -> list[Option]:
            """Ways to take an object where it stands, or from its end, one for each mask and pitch."""
            if (index, at_end) not in known:
                name = scene.names[index]
                there = scene.with_body(ends[index]) if at_end else scene
                grasps = self.candidates.for_object(there, name)
                more = self._hits_at_ends(final.with_body(there.body(name)), name, grasps, scene.mask(self.ends))
                too = 0
                if at_end:
                    near = (
                        one for one in beside(scene, scene.support_under(ends[index]), ends[index]) if one.name != name
                    )
                    touched = (
                        one.name
                        for one in near
                        if distances(ends[index].position[None, :2], one)[0] < ends[index].radius + _BESIDE
                    )
                    too = scene.mask({*touched, *in_the_way.get(name, ())} - {name})
                best: dict[tuple[int, float], Option] = {}
                for grasp, hit in zip(grasps, more, strict=True):
                    mask = grasp.blockers | too | hit << n
                    best.setdefault((mask, grasp.pitch), Option(mask, grasp))
                known[index, at_end] = sorted(best.values(), key=lambda one: one.mask.bit_count())
            return known[index, at_end]

        def moves(now: int, is_first: bool) -> Iterator[tuple[Step, int]]:
            """The moves that are possible, and where objects stand after them."""
            for index in range(n):
                own, end, name = 1 << index, 1 << n + index, scene.names[index]
                if now & end or not (now & own or index in ends):
                    continue
                left = now & ~own
                taken = [one for one in options(index, False) if not one.mask & left] if now & own else [None]
                if not taken:
                    continue
                if index in ends and not (is_first and (name, True) in in_vain):
                    put = [one for one in options(index, True) if not one.mask & left]
                    pairs = ((a, b) for a in taken for b in put if a is None or a.grasp.pitch == b.grasp.pitch)
                    pair = next(pairs, None)
                    if pair is not None:
                        yield Step(name, True, tuple(one.grasp for one in pair if one is not None)), left | end
                if taken[0] is not None and not (is_first and (name, False) in in_vain):
                    yield Step(name, False, (taken[0].grasp,)), left

        others = start & ~sum(1 << index for index in to_move)

        def left_over(now: int) -> int:
            """Moves that are left at least: one for each object, and those of what is in the way of one of them."""
            rest = [index for index in to_move if not now >> n + index & 1 and (now >> index & 1 or index in ends)]
            in_way = 0
            for index in rest:
                kinds = [False] * (now >> index & 1) + [True] * (index in ends)
                fewest = [
                    min(((one.mask & now & others).bit_count() for one in options(index, kind)), default=n)
                    for kind in kinds
                ]
                in_way = max(in_way, *fewest)
            return len(rest) + in_way

        for weight in _WEIGHTS:
            found = _best_first(start, moves, left_over, weight)
            if found:
                return found
        return []

    def _hits_at_ends(self, final: Scene, name: str, grasps: Collection[GraspCandidate], among: int) -> list[int]:
        """What grasps hit among objects at their ends, the object itself left out: masks."""
        new = [grasp for grasp in grasps if grasp.key not in self._at_ends]
        if new:
            own = final.mask((name, *final.held_names))
            hits = self.candidates.hits_among(final, name, new, among & ~own)
            self._at_ends.update((grasp.key, int(mask)) for grasp, mask in zip(new, hits, strict=True))
        return [self._at_ends[grasp.key] for grasp in grasps]


def _best_first(start: int, moves, left_over, weight: float) -> list[Step]:  # type: ignore[no-untyped-def]
    """The moves of a shortest way until none are left over, [] if none is found."""
    count = itertools.count()
    queue = [(weight * left_over(start), next(count), 0, start, None)]
    done: set[int] = set()
    expanded = 0
    while queue and expanded < _EXPANSIONS:
        _, _, cost, now, trail = heapq.heappop(queue)
        if now in done:
            continue
        if left_over(now) == 0:
            steps: list[Step] = []
            while trail is not None:
                step, trail = trail
                steps.insert(0, step)
            return steps
        done.add(now)
        expanded += 1
        for step, then in moves(now, trail is None):
            if then not in done:
                heapq.heappush(
                    queue, (cost + 1 + weight * left_over(then), -next(count), cost + 1, then, (step, trail))
                )
    return []
