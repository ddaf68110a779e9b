"""Planning ahead: find all moves up to the goal before the first motion is planned.

A best-first search (A*) over scenes. In each scene, the lower bound gives the fewest remaining picks, their objects,
and the objects to put aside first. The search simulates these moves first, each with a grasp and a placement that keeps
clear of later moves. If an object finds no placement, or only one in the way of others, other moves are tried. The
search continues from the scene with the fewest picks in total.
"""

from __future__ import annotations

import heapq
import itertools
import math
from collections import Counter
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, field
from typing import TypeAlias

import numpy as np

from planners.cause import Cause
from planners.clearing.clearance_plan import ClearancePlan, as_plan
from planners.clearing.commitments import NoCommitment, grasped
from planners.clearing.goal_bound import LowerBound, fewest_picks, must_move, waits_for, with_what_stands_on
from planners.clearing.moves import Move, MoveMaker
from planners.clearing.order_of_moves import Order, Step
from planners.clearing.quickest import holding_aside
from planners.goals import At, Inside, On
from planners.grasping.candidates import GraspCandidate
from planners.placing.blockers import can_be_released, fewest_in_the_way
from planners.placing.goal_places import in_the_way, place_of, placed_fact
from planners.placing.negative_goal_region import SupportGrid, swept_mask
from planners.placing.surfaces import KeepClear
from planners.placing.swept_volume import standing_volume
from planners.scene import Scene

_GREEDY = 3.0
"""Weight of the remaining picks while no plan is known. Afterwards picks made and picks remaining have the same
weight."""
_BETTER = 4
"""Divisor of the tries for a search that only accepts a plan with fewer picks."""
_ALIKE = 2
"""Most scenes to expand among those that the same moves reach in different orders."""
_OTHERS = 6
"""Most objects to put aside from one scene that need not move."""
_REJECTIONS = 100
"""Rounds of removing unusable grasps before a scene is regarded as without a plan."""
_FAILED_OFTEN = 3
"""Tries without a placement after which it is asked whether any hand can release the object at its place."""
_CELL = 0.02
"""Cell size [m] for comparing swept volumes."""


_Pairs: TypeAlias = frozenset[tuple[str, str]]


@dataclass(frozen=True, eq=False)
class _Situation:
    """A scene that moves have led to, and the remaining steps.

    Attributes:
        steps: the steps to make from here on.
        left: lower bound of the remaining picks.
        also: names of objects that must move because they block a place.
        later: pairs of objects. The second one goes to its place after the first.
    """

    scene: Scene
    moves: tuple[Move, ...]
    steps: tuple[Step, ...]
    left: int
    also: tuple[str, ...] = ()
    later: _Pairs = frozenset()

    @property
    def picks(self) -> int:
        """Number of picks so far."""
        return sum(move.grasp is not None for move in self.moves)

    @property
    def put_aside(self) -> set[str]:
        """Names of the objects that were put aside and have not reached their goal places since."""
        last = {move.name: move.is_general for move in self.moves if move.name not in self.scene.held_names}
        return {name for name, is_general in last.items() if not is_general}

    @property
    def free_hands(self) -> int:
        """Number of hands that hold nothing."""
        return len(self.scene.robot.acting_arms) - len(self.scene.held_names)

    @property
    def waiting(self) -> tuple[str, ...]:
        """Names of the objects still to move, in order."""
        return tuple(dict.fromkeys(step.name for step in self.steps))

    @property
    def key(self) -> object:
        """Key that is equal for situations that differ only in the order of their moves.

        What is in a hand may have been taken with another grasp: that decides where it can be put down.
        """
        kept = [move.grasp if move.placement is None and not move.is_general else None for move in self.moves]
        keys = [grasp and grasp.key for grasp in kept]
        moved = Counter((move.name, move.is_general, key) for move, key in zip(self.moves, keys, strict=True))
        return frozenset(moved.items()), self.also, self.later


_Tries: TypeAlias = Iterator["_Situation | None"]
"""Moves tried from a situation, one after another, with None for a failed try."""


def look_ahead(maker: MoveMaker, scene: Scene) -> ClearancePlan | NoCommitment:
    """Plan the moves up to the goal, or up to the first object that must move again.

    Args:
        maker: makes moves for the goal.
        scene: the scene as it is now.
    """
    search = _Search(maker, scene)
    first = search.situation(scene)
    if isinstance(first, NoCommitment):
        return first
    tries, found = maker.strategy.tries, None
    if search.is_ordered:  # without an order under a shelf, the moves of the lower bound may be fewer
        by_bound = search.situation(scene, by_order=False)
        if isinstance(by_bound, _Situation) and by_bound.left < first.left:
            found = _best_first(search, by_bound, _GREEDY, tries // _BETTER, strictly=True)
    if found is None:
        found = _best_first(search, first, _GREEDY, tries)
    if found is not None and found.picks > first.left:
        # With several hands there are more choices: the one that waits in a hand, and its grasp.
        is_carrying = bool(maker.goal.placed) and len(scene.robot.acting_arms) > 1
        found = _best_first(search, first, 1.0, tries if is_carrying else tries // _BETTER, found.picks) or found
    if found is not None:
        return as_plan(maker.candidates, scene, found.moves)
    if search.never_placed:
        return NoCommitment(Cause.NO_CLEARANCE_LOCATION, (search.never_placed,), is_in_vain=True)
    if maker.deadline.is_over:
        return NoCommitment(Cause.TIME_LIMIT, first.waiting)
    nowhere = tuple(name for name, _ in search.failed.most_common(1))
    return NoCommitment(Cause.NO_CLEARANCE_LOCATION, nowhere or first.waiting)


def _best_first(
    search: _Search,
    first: _Situation,
    weight: float,
    tries: int,
    fewer_than: float = math.inf,
    strictly: bool = False,
) -> _Situation | None:
    """Search best-first for a situation with no steps left. None after so many tries.

    Args:
        search: makes the tries.
        first: the first situation.
        weight: weight of the remaining picks, relative to the picks made.
        tries: limit of the tries.
        fewer_than: only plans with fewer picks are accepted.
        strictly: whether only steps out of the way of all later steps are tried.
    """
    queue: list[tuple[float, int, int, _Situation, list[tuple[int, _Tries]]]] = []
    alike, count = Counter[object](), itertools.count()

    def push(one: _Situation, levels: list[tuple[int, _Tries]]) -> None:
        """Queue a situation. Among equals, those with most moves come first, then the latest."""
        if levels and one.picks + one.left + levels[0][0] < fewer_than:
            rank = one.picks + weight * one.left + levels[0][0]
            heapq.heappush(queue, (rank, -len(one.moves), -next(count), one, levels))

    push(first, search.levels(first, strictly))
    while queue and tries and not (search.maker.deadline.is_over or search.never_placed):
        *_, now, levels = heapq.heappop(queue)
        if not now.steps:
            return now
        # Other situations may have found blockers of its places since it was queued.
        informed = search.informed(now)
        if informed is not now:
            if informed is not None:
                push(informed, search.levels(informed, strictly))
            continue
        tried = next(levels[0][1], _NONE_LEFT)
        # The situation stays in the queue: its other tries may still be the best ones.
        push(now, levels[1:] if tried is _NONE_LEFT else levels)
        if isinstance(tried, _Situation) and alike[tried.key] < _ALIKE:
            alike[tried.key] += 1
            push(tried, search.levels(tried, strictly))
        tries -= tried is not _NONE_LEFT
    return None


_NONE_LEFT = object()


@dataclass
class _Search:
    """One search, with the moves tried from each situation.

    Attributes:
        failed: how often each object found no placement.
        failed_at_place: how often each object found none at its place.
        never_placed: name of an object that no hand can release at its place, "" for none known.
        in_the_way: names of the objects that stood in the way of an object's place from the start, by the object's
            name.
    """

    maker: MoveMaker
    start: Scene
    failed: Counter[str] = field(default_factory=Counter)
    failed_at_place: Counter[str] = field(default_factory=Counter)
    never_placed: str = ""
    in_the_way: dict[str, tuple[str, ...]] = field(default_factory=dict)
    _order: Order | None = None
    _cells: dict[tuple[str, bytes, bytes], int] = field(default_factory=dict)

    def situation(
        self,
        scene: Scene,
        moves: tuple[Move, ...] = (),
        also: Collection[str] = (),
        later: _Pairs = frozenset(),
        by_order: bool = True,
    ) -> _Situation | NoCommitment:
        """The situation in a scene by its lower bound, after unusable grasps are rejected.

        `by_order`: whether moves under a shelf follow their computed order.
        """
        maker = self.maker
        for _ in range(_REJECTIONS):
            if maker.deadline.is_over:
                break
            names = tuple(dict.fromkeys((*scene.held_names, *also)))
            bound = fewest_picks(scene, maker.goal, maker.candidates, maker.start, also=names, deadline=maker.deadline)
            if bound.picks is None:
                return NoCommitment(Cause(bound.cause), bound.objects or names)
            to_move = with_what_stands_on(maker.goal, (*must_move(scene, maker.goal, maker.start), *names))
            steps = tuple(_in_turn(maker, scene, bound, to_move, later))
            left = bound.least
            if by_order and (ordered := self._ordered(scene, moves, [step.name for step in steps], to_move)):
                steps, left = ordered, max(left, len(ordered))
            chosen = [step.taken for step in steps if step.taken is not None]
            unusable = [grasp for grasp in chosen if not maker.is_usable(scene, grasp)]
            if not unusable:
                return _Situation(scene, moves, steps, left, tuple(also), later)
            for grasp in unusable:
                maker.reject(scene, grasp)
        cause = Cause.TIME_LIMIT if maker.deadline.is_over else Cause.NO_SELF_CLEARABLE_SET
        return NoCommitment(cause, must_move(scene, maker.goal, maker.start))

    @property
    def is_ordered(self) -> bool:
        """Whether the moves have a computed order, as under a shelf."""
        return self._order is not None

    def levels(self, now: _Situation, strictly: bool) -> list[tuple[int, _Tries]]:
        """Iterators of tries from a situation, each with its cost in picks beyond the lower bound."""
        return [(0, self._as_meant(now)), *([] if strictly else [(0, self._anyhow(now)), (1, self._otherwise(now))])]

    def informed(self, now: _Situation) -> _Situation | None:
        """The same situation, with the objects that other situations found to block its places. They must move too."""
        moved = {move.name for move in now.moves}
        known = (name for step in now.steps if step.is_general for name in self.in_the_way.get(step.name, ()))
        new = tuple(dict.fromkeys(name for name in known if name not in moved and name not in now.waiting))
        if not new:
            return now
        found = self.situation(now.scene, now.moves, (*now.also, *new), now.later)
        return found if isinstance(found, _Situation) else None

    def _as_meant(self, now: _Situation) -> _Tries:
        """Try the next step, then other steps before it, such that each keeps clear of all later steps."""
        for step in self._ready(now):
            if self._may_hold_aside(now, step):
                yield self._held_aside(now)
            if self._may_wait_in_hand(now, step):
                yield from self._taken(now, step)
            if not self._stands_on_waiting(now, step):
                yield self._made(now, step, is_strict=True)

    def _anyhow(self, now: _Situation) -> _Tries:
        """Try steps to places of the goal, even if they are in the way of later steps."""
        for step in self._ready(now):
            if step.is_general and not (self._is_held_up(step) or self._stands_on_waiting(now, step)):
                yield self._made(now, step, is_strict=False)

    def _otherwise(self, now: _Situation) -> _Tries:
        """Tries at the cost of a pick: put aside an object that moves again later, or move one that need not move."""
        ready = self._ready(now)
        yield from self._out_of_places(now)
        for step in ready:
            if not (self._is_held_up(step) or step.name in now.put_aside):
                yield self._made(now, step if not step.is_general else Step(step.name, False, step.taken), False)
        for name in itertools.islice(self._others(now), _OTHERS):
            yield self._made(now, Step(name, False), is_strict=False)
        yield from self._before_held_up(now)

    def _ready(self, now: _Situation) -> list[Step]:
        """Steps that may come next: the first step of each object, held objects before all others."""
        goal, waiting = self.maker.goal, now.waiting
        steps = [next(step for step in now.steps if step.name == name) for name in waiting]
        in_hand = [step for step in steps if step.name in now.scene.held_names]
        if in_hand and not now.free_hands:
            return in_hand[:1]
        steps = [step for step in steps if not any(b == step.name and a in waiting for a, b in goal.order)]
        is_last = set(waiting) <= set(goal.held)
        return [step for step in steps if not self._is_held_up(step) or is_last]

    def _is_held_up(self, step: Step) -> bool:
        """Whether a step takes an object that the goal wants held."""
        return step.is_general and step.name in self.maker.goal.held

    def _stands_on_waiting(self, now: _Situation, step: Step) -> bool:
        """Whether a step puts an object on another one that must still move: it would have to leave again."""
        fact = placed_fact(self.maker.goal, step.name) if step.is_general else None
        return fact is not None and fact.where in now.waiting

    def _made(self, now: _Situation, step: Step, is_strict: bool) -> _Situation | None:
        """Make a step. None if it cannot be made.

        A strict step keeps clear of all later steps, so that they stay as planned. After any other step the remaining
        steps are computed again.
        """
        maker, name, goal = self.maker, step.name, self.maker.goal
        rest = tuple(one for one in now.steps if one is not step)
        moved: Move | None = None
        if self._is_held_up(step):
            moved = maker.hold(now.scene, name)
        elif not (step.is_general and self._is_refuted(now, name)):
            waiting = tuple(dict.fromkeys(one.name for one in rest))
            following = next((one for one in waiting if one != name), "")
            for kept, choices in self._choices(now, step, rest, is_strict):
                rest = kept
                moved = maker.put(now.scene, name, step.is_general, choices, waiting, following)
                if moved is not None:
                    break
        if moved is None:
            self.failed[name] += 1
            if step.is_general:
                self._ask_for_a_hand(now.scene, name)
            return None
        moves = (*now.moves, moved)
        if is_strict and (rest or not must_move(moved.after, goal, maker.start)):
            left = now.left - (moved.grasp is not None)
            to_pick = any(one.name not in moved.after.held_names for one in rest)
            return _Situation(moved.after, moves, rest, max(left, 1) if to_pick else 0, now.also, now.later)
        found = self.situation(moved.after, moves, [one for one in now.also if one != name], now.later)
        return found if isinstance(found, _Situation) else None

    def _ask_for_a_hand(self, scene: Scene, name: str) -> None:
        """After many failures, end the search if no hand can release an object at its place, whatever else moves."""
        fact, maker = placed_fact(self.maker.goal, name), self.maker
        self.failed_at_place[name] += 1
        if fact is None or self.failed_at_place[name] != _FAILED_OFTEN:
            return
        if not can_be_released(maker.placements, maker.candidates, scene, name, place_of(scene, fact)):
            self.never_placed = name

    def _choices(
        self, now: _Situation, step: Step, rest: tuple[Step, ...], is_strict: bool
    ) -> Iterator[tuple[tuple[Step, ...], list[KeepClear]]]:
        """Pairs of the remaining steps and the choices of grasps to keep clear of.

        Strict: all later grasps, then other grasps of the same objects that together sweep little volume. Otherwise:
        the grasps of the next half of the steps, of the next step, of none.
        """
        if self.maker.strategy.region == "none":
            yield rest, [KeepClear()]
            return
        others = [one for one in rest if one.name != step.name and one.grasps]
        if not is_strict:
            counts = dict.fromkeys(((len(others) + 1) // 2, 1, 0))
            choices = [self._clear_of(others[:count]) for count in counts if count < len(others)]
            if choices or not step.is_general:
                yield rest, choices or [KeepClear()]
            return
        yield rest, [self._clear_of(others)]
        if others and not step.is_general:
            rest = self._sweeping_little(now, step.name, rest)
            yield rest, [self._clear_of([one for one in rest if one.name != step.name])]

    def _clear_of(self, steps: Sequence[Step]) -> KeepClear:
        """Regions of these steps: NGR1 for the object to hold, NGR2 for the objects moved before."""
        held = [one.taken for one in steps if one.taken is not None and one.name in self.maker.goal.held]
        if held and self.maker.strategy.region == "ngr1":
            return KeepClear(held[0])
        others = [grasp for one in steps if one.name not in self.maker.goal.held for grasp in one.grasps]
        return KeepClear(held[0] if held else None, tuple(others))

    def _sweeping_little(self, now: _Situation, moving: str, rest: tuple[Step, ...]) -> tuple[Step, ...]:
        """The same steps with grasps that together sweep little volume, chosen from the last step backwards.

        Each step takes a grasp that is free at its turn and adds the fewest cells to the volume that later grasps
        sweep. A smaller Negative Goal Region leaves more space for objects that are put aside.
        """
        scene, chosen, swept = now.scene, list(rest), 0
        for index in reversed(range(len(rest))):
            step = rest[index]
            gone = scene.mask({moving, *(one.name for one in rest[:index])})
            may = step.taken is not None and step.put is None and step.name != moving
            found = self.maker.candidates.for_object(scene, step.name) if may else ()
            free = [grasp for grasp in found if not grasp.blockers & ~gone]
            if free:
                cells = [swept | self._swept_cells(scene, grasp) for grasp in free]
                best = min(range(len(free)), key=lambda k: (cells[k].bit_count(), -free[k].quality))
                chosen[index], swept = step._replace(taken=free[best]), cells[best]
        return tuple(chosen)

    def _swept_cells(self, scene: Scene, grasp: GraspCandidate) -> int:
        """Cells that the robot occupies at a grasp, within the heights where objects stand, as bits.

        They stand in for the swept volume of the grasp, which would take too long to compute for every grasp.
        """
        if grasp.key not in self._cells:
            volume = standing_volume(self.maker.candidates.compiled.world(scene), grasp)
            tallest = max(body.top - body.bottom for body in scene.objects)
            grids = [SupportGrid.over(support, _CELL) for support in self.maker.placements.supports_in(scene)]
            cells = np.concatenate([swept_mask(grid, volume, tallest).ravel() for grid in grids])
            self._cells[grasp.key] = int.from_bytes(np.packbits(cells).tobytes(), "big")
        return self._cells[grasp.key]

    def _out_of_places(self, now: _Situation) -> _Tries:
        """Move the blockers of a place too. A blocker that was already placed there goes there later instead."""
        goal, waiting = self.maker.goal, now.waiting
        if now.scene.held_names:
            return
        facts = [fact for name in waiting if (fact := placed_fact(goal, name))]
        for fact in (one for one in facts if one.where not in waiting):
            place = place_of(now.scene, fact)
            found = in_the_way(now.scene, now.scene.body(fact.object), place, waiting)
            yield self._moving_these_too(now, fact.object, found or self._in_the_way_of_robot(now, fact))

    def _before_held_up(self, now: _Situation) -> _Tries:
        """Put an object aside that is to be held in the end: others go to their places first."""
        goal, waiting = self.maker.goal, now.waiting
        if now.scene.held_names or not any(placed_fact(goal, name) for name in waiting):
            return
        for name in waiting:
            if name in goal.held and name not in now.put_aside:
                yield self._made(now, Step(name, False), is_strict=False)

    def _in_the_way_of_robot(self, now: _Situation, fact: On | Inside | At) -> tuple[str, ...]:
        """Objects that keep the robot from putting an object down at its place, once those still to move have left."""
        name, waiting, maker = fact.object, now.waiting, self.maker
        refuted = tuple(one for one in self._refuted_by(now, name) if one not in waiting)
        if refuted or not self.failed[name]:  # to compute this takes as long as to search for a placement
            return refuted
        fewest: tuple[str, ...] = ()
        for grasp in maker.free_grasps(now.scene, name):
            world = maker.candidates.compiled.world(grasped(now.scene, grasp))
            leaving = [one for one in waiting if one != name]
            found = fewest_in_the_way(maker.placements, world, place_of(now.scene, fact), leaving)
            if found == 0:
                return ()
            names = () if found is None else now.scene.names_of(found)
            fewest = min((one for one in (fewest, names) if one), key=len, default=())
        return fewest

    def _is_refuted(self, now: _Situation, name: str) -> bool:
        """Whether the put-down at the goal place was refuted: for the object as it is held, or with the present
        blockers."""
        is_in_vain = name in now.scene.held_names and name in self.maker.not_placed.blockers
        return is_in_vain or bool(self._refuted_by(now, name))

    def _refuted_by(self, now: _Situation, name: str) -> tuple[str, ...]:
        """Objects that blocked every motion to an object's place and have not moved since."""
        known = self.maker.not_placed.blockers.get(name, frozenset())
        return tuple(sorted(known.difference(move.name for move in now.moves)))

    def _moving_these_too(self, now: _Situation, name: str, found: Collection[str]) -> _Situation | None:
        """Move these objects too, for a place. If they went there too early, begin again with another order."""
        too_early = {(name, move.name) for move in now.moves if move.is_general and move.name in found}
        new = tuple(one for one in found if one not in now.waiting)
        if too_early and not too_early <= now.later:
            also = [one for one in new if (name, one) not in too_early]
            again = self.situation(self.start, (), (*now.also, *also), now.later | too_early)
        elif new and not too_early:
            self.in_the_way[name] = new
            again = self.situation(now.scene, now.moves, (*now.also, *new), now.later)
        else:
            return None
        return again if isinstance(again, _Situation) else None

    def _others(self, now: _Situation) -> Iterator[str]:
        """Names of objects that need not move but block grasps of waiting objects, the most frequent first."""
        scene, candidates, waiting = now.scene, self.maker.candidates, now.waiting
        if scene.held_names:
            return
        masks = [mask for name in waiting if name not in scene.held_names for mask in candidates.blockers(scene, name)]
        often = Counter(name for mask in masks for name in scene.names_of(mask))
        for name, _ in often.most_common():
            if name not in waiting and any(not mask for mask in candidates.blockers(scene, name)):
                yield name

    def _may_wait_in_hand(self, now: _Situation, step: Step) -> bool:
        """Whether an object whose place is not free yet may stay in a hand meanwhile."""
        goal, in_hand = self.maker.goal, now.scene.held_names
        if now.free_hands < 2 or step.name in in_hand or not placed_fact(goal, step.name):
            return False
        return bool(waits_for(now.scene, goal, now.waiting)[step.name] - {*in_hand})

    def _taken(self, now: _Situation, step: Step) -> _Tries:
        """Take an object that stays in its hand while another hand moves others."""
        following = next((name for name in now.waiting if name != step.name), "")
        also = [name for name in now.also if name != step.name]
        for moved in self.maker.take(now.scene, step.name, following):
            found = self.situation(moved.after, (*now.moves, moved), also, now.later)
            yield found if isinstance(found, _Situation) else None

    def _may_hold_aside(self, now: _Situation, step: Step) -> bool:
        """Whether the last obstacle may stay in one gripper while another one takes the target."""
        is_last = len(now.steps) == 2 and now.steps[1].name in self.maker.goal.held and step is now.steps[0]
        return self.maker.holds_aside and is_last and not step.is_general and not now.scene.held_names

    def _held_aside(self, now: _Situation) -> _Situation | None:
        """End the plan with the last obstacle in one gripper and the target in another. None if the search fails."""
        obstacle, target = (step.taken for step in now.steps)
        if obstacle is None or target is None:
            return None
        found = holding_aside(self.maker.candidates, now.scene, obstacle, target, self.maker.can_take)
        if found is None:
            return None
        first = grasped(now.scene, found[0])
        both = grasped(first, found[1])
        ends = (Move(obstacle.object, found[0], None, False, first), Move(target.object, found[1], None, True, both))
        return _Situation(both, (*now.moves, *ends), (), 0)

    def _ordered(
        self, scene: Scene, moves: tuple[Move, ...], in_turn: Sequence[str], to_move: Sequence[str]
    ) -> tuple[Step, ...]:
        """The fewest moves under a shelf, where an object at its place may block others."""
        maker = self.maker
        if self._order is None and not moves:
            waiting = [name for name in dict.fromkeys((*in_turn, *to_move)) if name in to_move]
            self._order = Order.of(scene, maker.goal, waiting, maker.candidates)
        if self._order is None or scene.held_names:
            return ()
        known = maker.not_placed.blockers
        refuted = {name: known.get(name, frozenset()) - {move.name for move in moves} for name in to_move}
        return tuple(self._order.steps(scene, to_move, refuted))


def _in_turn(
    maker: MoveMaker, scene: Scene, bound: LowerBound, to_move: Collection[str], later: _Pairs
) -> Iterator[Step]:
    """Steps of the lower bound, the nearest object with a free grasp first."""
    base, in_hand = scene.state.base[:2], scene.held_names
    goal, waits, gone = maker.goal, waits_for(scene, maker.goal, to_move), set[str]()
    has_free_hand = len(in_hand) < len(scene.robot.acting_arms)
    first = dict.fromkeys((*in_hand, *bound.objects))
    again: list[str] = []  # objects that were put aside, or wait in a hand, and still go to their places

    def grasps_of(name: str) -> list[GraspCandidate]:
        """Grasps of an object that are free now. Empty for held objects."""
        mask = scene.mask(gone)
        found = () if name in in_hand else maker.candidates.for_object(scene, name)
        return [grasp for grasp in found if not grasp.blockers & ~mask]

    def is_too_early(name: str) -> bool:
        """Whether another object must move first, by the goal or by earlier findings."""
        pending = {*first, *again}
        if name in goal.held and not (name in first and name in (*in_hand, *bound.aside)):
            return not pending <= set(goal.held)
        before = [a for a, b in (*goal.order, *later) if b == name]
        return any(one in pending and one != name for one in before)

    def place_is_free(name: str) -> bool:
        """Whether the objects in the way have left, and the object below the place is where it belongs."""
        fact = placed_fact(goal, name)
        is_missing = fact is not None and (fact.where in first or fact.where in again)
        return not is_missing and not waits.get(name, frozenset()) - gone - {name}

    if in_hand and has_free_hand:
        gone |= {*in_hand}
        again += [name for name in in_hand if placed_fact(goal, name) and not place_is_free(name)]
        first = {name: None for name in first if name not in again}
    while first or again:
        ready = [name for name in again if place_is_free(name) and not is_too_early(name)]
        if ready or not first:  # or, if the remaining objects wait for each other, take the first one
            name = (ready or again)[0]
            again.remove(name)
            yield Step(name, True)
            continue
        free = {name: grasps_of(name) for name in first if not is_too_early(name)}
        may = [name for name, grasps in free.items() if grasps or name in in_hand]
        straight = [name for name in may if name in bound.aside or place_is_free(name)]
        ready = straight or may or [*first]
        if held_now := [name for name in ready if name in in_hand]:
            ready = held_now
        name = min(ready, key=lambda one: float(np.linalg.norm(scene.body(one).position[:2] - base)))
        del first[name]
        is_wanted = name in goal.held or placed_fact(goal, name) is not None
        is_general = {*first, *again} <= set(goal.held) if name in goal.held else is_wanted and place_is_free(name)
        if is_wanted and not is_general:
            again.append(name)
        grasp = max(free.get(name, ()), key=lambda grasp: grasp.quality, default=None)
        base = base if grasp is None else grasp.base[:2]
        gone.add(name)
        yield Step(name, is_general, grasp)
