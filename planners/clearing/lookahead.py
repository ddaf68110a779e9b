"""Planning ahead: the moves up to the goal are found before the first motion is planned.

A best-first search (A*) over scenes. From each, the lower bound says how many picks are left at least, what they take,
and what must be put aside first. These moves are made first, in thought, each with a grasp and a placement out of the
way of those that follow. Where an object finds no place, or one that is in the way, other moves are tried; the search
goes on from the scene from which the fewest picks in all may do.
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
from planners.placing.blockers import fewest_in_the_way
from planners.placing.goal_places import in_the_way, place_of, placed_fact
from planners.placing.negative_goal_region import SupportGrid, swept_mask
from planners.placing.surfaces import KeepClear
from planners.placing.swept_volume import standing_volume
from planners.scene import Scene

_GREEDY = 3.0
"""Weight of the picks that are left at least while no plan is known; then those made and those left count alike."""
_BETTER = 4
"""Of the tries, one in so many looks for a plan with fewer picks, once one is found that has more than the bound."""
_ALIKE = 2
"""Scenes looked at of those to which the same moves lead in another order."""
_OTHERS = 6
"""Objects that need not move which are put aside, at most, from one scene."""
_REJECTIONS = 100
"""Times that grasps which cannot be used are taken out before a scene counts as without a plan."""
_CELL = 0.02
"""[m] of the cells in which swept space is compared."""


_Pairs: TypeAlias = frozenset[tuple[str, str]]


@dataclass(frozen=True, eq=False)
class _Situation:
    """A scene to which moves have led, and what is left to do.

    Attributes:
        steps: what is meant to be done from here on.
        left: picks that are left at least.
        also: names of objects that must move since they are in the way of a place.
        later: pairs of objects of which the second one goes to its place after the first.
    """

    scene: Scene
    moves: tuple[Move, ...]
    steps: tuple[Step, ...]
    left: int
    also: tuple[str, ...] = ()
    later: _Pairs = frozenset()

    @property
    def picks(self) -> int:
        """Picks so far."""
        return sum(move.grasp is not None for move in self.moves)

    @property
    def put_aside(self) -> set[str]:
        """Names of the objects that have been put aside, and not where the goal wants them since."""
        last = {move.name: move.is_general for move in self.moves}
        return {name for name, is_general in last.items() if not is_general}

    @property
    def waiting(self) -> tuple[str, ...]:
        """Names of the objects that are still to be moved, in order."""
        return tuple(dict.fromkeys(step.name for step in self.steps))

    @property
    def key(self) -> object:
        """The same for situations that differ in the order of their moves alone."""
        moved = Counter((move.name, move.is_general) for move in self.moves)
        return frozenset(moved.items()), self.also, self.later


_Tries: TypeAlias = Iterator["_Situation | None"]
"""Moves tried from a situation, one after another; None where one fails."""


def look_ahead(maker: MoveMaker, scene: Scene) -> ClearancePlan | NoCommitment:
    """The moves up to the goal, or up to the first object that is to be moved again.

    Args:
        maker: makes moves for the goal.
        scene: as it is now.
    """
    search = _Search(maker, scene)
    first = search.situation(scene)
    if isinstance(first, NoCommitment):
        return first
    tries, found = maker.strategy.tries, None
    if search.is_ordered:  # the moves that the lower bound counts may do too, and be fewer
        by_bound = search.situation(scene, by_order=False)
        if isinstance(by_bound, _Situation) and by_bound.left < first.left:
            found = _best_first(search, by_bound, _GREEDY, tries // _BETTER, strictly=True)
    if found is None:
        found = _best_first(search, first, _GREEDY, tries)
    if found is not None and found.picks > first.left:
        found = _best_first(search, first, 1.0, tries // _BETTER, found.picks) or found
    if found is not None:
        return as_plan(maker.candidates, scene, found.moves)
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
    """The first situation that comes up from which nothing is left to do; None after so many tries.

    Args:
        search: makes the tries.
        first: where to begin.
        weight: of the picks that are left at least, beside those made.
        tries: how many at most.
        fewer_than: only plans with fewer picks count.
        strictly: whether only steps out of the way of all that follow are tried.
    """
    queue: list[tuple[float, int, int, _Situation, list[tuple[int, _Tries]]]] = []
    alike, count = Counter[object](), itertools.count()

    def push(one: _Situation, levels: list[tuple[int, _Tries]]) -> None:
        """Of equal promise the one with most moves comes first, of these the last found."""
        if levels and one.picks + one.left + levels[0][0] < fewer_than:
            rank = one.picks + weight * one.left + levels[0][0]
            heapq.heappush(queue, (rank, -len(one.moves), -next(count), one, levels))

    push(first, search.levels(first, strictly))
    while queue and tries and not search.maker.deadline.is_over:
        *_, now, levels = heapq.heappop(queue)
        if not now.steps:
            return now
        informed = search.informed(now)
        if informed is not now:
            if informed is not None:
                push(informed, search.levels(informed, strictly))
            continue
        tried = next(levels[0][1], _NONE_LEFT)
        push(now, levels[1:] if tried is _NONE_LEFT else levels)
        if isinstance(tried, _Situation) and alike[tried.key] < _ALIKE:
            alike[tried.key] += 1
            push(tried, search.levels(tried, strictly))
        tries -= tried is not _NONE_LEFT
    return None


_NONE_LEFT = object()


@dataclass
class _Search:
    """One search: the moves tried from each situation.

    Attributes:
        failed: how often each object found no place.
        in_the_way: of the place of an object, by its name: what stood there from the start on.
    """

    maker: MoveMaker
    start: Scene
    failed: Counter[str] = field(default_factory=Counter)
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
        """The situation in a scene, as the lower bound has it there; grasps that cannot be used are rejected.

        `by_order`: whether the moves under a shelf are those of their order.
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
        """Whether moves are ordered as under a shelf."""
        return self._order is not None

    def levels(self, now: _Situation, strictly: bool) -> list[tuple[int, _Tries]]:
        """What is tried from a situation, by the picks that it costs beyond those that are left at least."""
        return [(0, self._as_meant(now)), *([] if strictly else [(0, self._anyhow(now)), (1, self._otherwise(now))])]

    def informed(self, now: _Situation) -> _Situation | None:
        """The same situation with what has been found out elsewhere: what else must move for the places of objects."""
        moved = {move.name for move in now.moves}
        known = (name for step in now.steps if step.is_general for name in self.in_the_way.get(step.name, ()))
        new = tuple(dict.fromkeys(name for name in known if name not in moved and name not in now.waiting))
        if not new:
            return now
        found = self.situation(now.scene, now.moves, (*now.also, *new), now.later)
        return found if isinstance(found, _Situation) else None

    def _as_meant(self, now: _Situation) -> _Tries:
        """The next step, then others before it, out of the way of all that follow."""
        for step in self._ready(now):
            if self._may_hold_aside(now, step):
                yield self._held_aside(now)
            if not self._stands_on_waiting(now, step):
                yield self._made(now, step, is_strict=True)

    def _anyhow(self, now: _Situation) -> _Tries:
        """Steps to places of the goal, though they may be in the way of others."""
        for step in self._ready(now):
            if step.is_general and not (self._is_held_up(step) or self._stands_on_waiting(now, step)):
                yield self._made(now, step, is_strict=False)

    def _otherwise(self, now: _Situation) -> _Tries:
        """What costs a pick more: to put aside what is moved again; to move what need not move."""
        ready = self._ready(now)
        yield from self._out_of_places(now)
        for step in ready:
            if not (self._is_held_up(step) or step.name in now.put_aside):
                yield self._made(now, step if not step.is_general else Step(step.name, False, step.taken), False)
        for name in itertools.islice(self._others(now), _OTHERS):
            yield self._made(now, Step(name, False), is_strict=False)
        yield from self._out_of_hand_again(now)

    def _ready(self, now: _Situation) -> list[Step]:
        """Steps that may come next: the first one of each object; what is in a hand before all others."""
        goal, waiting = self.maker.goal, now.waiting
        steps = [next(step for step in now.steps if step.name == name) for name in waiting]
        if in_hand := [step for step in steps if step.name in now.scene.held_names]:
            return in_hand[:1]
        steps = [step for step in steps if not any(b == step.name and a in waiting for a, b in goal.order)]
        is_last = set(waiting) <= set(goal.held)
        return [step for step in steps if not self._is_held_up(step) or is_last]

    def _is_held_up(self, step: Step) -> bool:
        """Whether a step is to hold what the goal wants held."""
        return step.is_general and step.name in self.maker.goal.held

    def _stands_on_waiting(self, now: _Situation, step: Step) -> bool:
        """Whether a step puts an object on another one that is still to be moved, and would have to leave it again."""
        fact = placed_fact(self.maker.goal, step.name) if step.is_general else None
        return fact is not None and fact.where in now.waiting

    def _made(self, now: _Situation, step: Step, is_strict: bool) -> _Situation | None:
        """The situation after a step; None if it cannot be made.

        Strictly, it is out of the way of all that follow, so that these steps stay as they are meant. Otherwise what
        is left is found out anew.
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
            return None
        moves = (*now.moves, moved)
        if is_strict and (rest or not must_move(moved.after, goal, maker.start)):
            left = now.left - (moved.grasp is not None)
            return _Situation(moved.after, moves, rest, max(left, 1) if rest else 0, now.also, now.later)
        found = self.situation(moved.after, moves, [one for one in now.also if one != name], now.later)
        return found if isinstance(found, _Situation) else None

    def _choices(
        self, now: _Situation, step: Step, rest: tuple[Step, ...], is_strict: bool
    ) -> Iterator[tuple[tuple[Step, ...], list[KeepClear]]]:
        """What an object keeps clear of, and what is meant to follow then.

        Strictly: of all grasps that follow; then of others of the same objects that together sweep little space.
        Otherwise: of those of the next half, of the next one, or of none.
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
        """The regions of these steps: NGR1 of what is to be held, NGR2 of what is moved before."""
        held = [one.taken for one in steps if one.taken is not None and one.name in self.maker.goal.held]
        if held and self.maker.strategy.region == "ngr1":
            return KeepClear(held[0])
        others = [grasp for one in steps if one.name not in self.maker.goal.held for grasp in one.grasps]
        return KeepClear(held[0] if held else None, tuple(others))

    def _sweeping_little(self, now: _Situation, moving: str, rest: tuple[Step, ...]) -> tuple[Step, ...]:
        """The same steps through grasps that together sweep little space, from the last one backwards.

        Each takes, of the grasps that are free by its turn, the one that adds the fewest cells to what the later ones
        sweep anyway: the smaller the Negative Goal Region, the more space for what is put aside.
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
        """The cells of the space in which objects stand that the robot occupies at a grasp, as bits.

        It stands for what the grasp sweeps, which would take too long to work out for all grasps that are compared.
        """
        if grasp.key not in self._cells:
            volume = standing_volume(self.maker.candidates.compiled.world(scene), grasp)
            tallest = max(body.top - body.bottom for body in scene.objects)
            grids = [SupportGrid.over(support, _CELL) for support in self.maker.placements.supports_in(scene)]
            cells = np.concatenate([swept_mask(grid, volume, tallest).ravel() for grid in grids])
            self._cells[grasp.key] = int.from_bytes(np.packbits(cells).tobytes(), "big")
        return self._cells[grasp.key]

    def _out_of_places(self, now: _Situation) -> _Tries:
        """What stands in the way of a place, or of the robot there, moves too; or, moved already, goes there later."""
        goal, waiting = self.maker.goal, now.waiting
        if now.scene.held_names:
            return
        facts = [fact for name in waiting if (fact := placed_fact(goal, name))]
        for fact in (one for one in facts if one.where not in waiting):
            place = place_of(now.scene, fact)
            found = in_the_way(now.scene, now.scene.body(fact.object), place, waiting)
            yield self._moving_these_too(now, fact.object, found or self._in_the_way_of_robot(now, fact))

    def _out_of_hand_again(self, now: _Situation) -> _Tries:
        """What is to be held in the end is put aside before, since others go to their places first."""
        goal, waiting = self.maker.goal, now.waiting
        if now.scene.held_names or not any(placed_fact(goal, name) for name in waiting):
            return
        for name in waiting:
            if name in goal.held and name not in now.put_aside:
                yield self._made(now, Step(name, False), is_strict=False)

    def _in_the_way_of_robot(self, now: _Situation, fact: On | Inside | At) -> tuple[str, ...]:
        """What keeps the robot from putting an object down at its place once those that wait have left."""
        name, waiting, maker = fact.object, now.waiting, self.maker
        refuted = tuple(one for one in self._refuted_by(now, name) if one not in waiting)
        if refuted or not self.failed[name]:  # to ask takes as long as to look for a placement
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
        """Whether no motion puts an object at its place as it is held, or as long as something stands where it does."""
        is_in_vain = name in now.scene.held_names and name in self.maker.not_placed.blockers
        return is_in_vain or bool(self._refuted_by(now, name))

    def _refuted_by(self, now: _Situation, name: str) -> tuple[str, ...]:
        """What was in the way when no motion put an object at its place, and has not been moved since."""
        known = self.maker.not_placed.blockers.get(name, frozenset())
        return tuple(sorted(known.difference(move.name for move in now.moves)))

    def _moving_these_too(self, now: _Situation, name: str, found: Collection[str]) -> _Situation | None:
        """The situation in which these move, for a place of an object: from the start on, if they went there before."""
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
        """Names of objects that need not move, but are in the way of grasps of those that wait, most often first."""
        scene, candidates, waiting = now.scene, self.maker.candidates, now.waiting
        if scene.held_names:
            return
        masks = [mask for name in waiting if name not in scene.held_names for mask in candidates.blockers(scene, name)]
        often = Counter(name for mask in masks for name in scene.names_of(mask))
        for name, _ in often.most_common():
            if name not in waiting and any(not mask for mask in candidates.blockers(scene, name)):
                yield name

    def _may_hold_aside(self, now: _Situation, step: Step) -> bool:
        """Whether only one obstacle is left, which may stay in one gripper while another one takes the target."""
        is_last = len(now.steps) == 2 and now.steps[1].name in self.maker.goal.held and step is now.steps[0]
        return self.maker.holds_aside and is_last and not step.is_general and not now.scene.held_names

    def _held_aside(self, now: _Situation) -> _Situation | None:
        """The end: the last obstacle is held while another arm takes the target; None if that is not found."""
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
        """The fewest moves under a shelf, where what stands at its place may be in the way of others."""
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
    """The moves that the lower bound counts, each of what is free by its turn, the nearest first."""
    goal, waits, gone = maker.goal, waits_for(scene, maker.goal, to_move), set[str]()
    base, in_hand = scene.state.base[:2], scene.held_names
    first = dict.fromkeys((*in_hand, *bound.objects))
    again: list[str] = []  # objects that have been put aside, and go to their places

    def grasps_of(name: str) -> list[GraspCandidate]:
        """Grasps of an object that is not held, and has not been moved, that are free now."""
        mask = scene.mask(gone)
        found = () if name in in_hand else maker.candidates.for_object(scene, name)
        return [grasp for grasp in found if not grasp.blockers & ~mask]

    def is_too_early(name: str) -> bool:
        """Whether the goal, or what was found out before, wants another object to be moved before."""
        pending = {*first, *again}
        if name in goal.held and not (name in first and name in (*in_hand, *bound.aside)):
            return not pending <= set(goal.held)
        before = [a for a, b in (*goal.order, *later) if b == name]
        return any(one in pending and one != name for one in before)

    def place_is_free(name: str) -> bool:
        """Whether what must have left before has, and what it is to stand on is where that is to stand."""
        fact = placed_fact(goal, name)
        is_missing = fact is not None and (fact.where in first or fact.where in again)
        return not is_missing and not waits.get(name, frozenset()) - gone - {name}

    while first or again:
        ready = [name for name in again if place_is_free(name) and not is_too_early(name)]
        if ready or not first:  # or, if the rest wait for each other, the first of these
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
