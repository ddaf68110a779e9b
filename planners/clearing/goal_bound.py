"""Lower bound of the picks of any plan for a goal, for a declared set of grasp options.

Take the objects that a plan has moved by its end, each with an option whose blockers were gone. They form a
self-clearable set (see `planners.clearing.lower_bound`) for one more, imaginary object: the goal. All objects that must
move block the goal.

An object that goes straight to its place also waits for the objects that stand there. It waits for the objects that the
robot hits at the release, too. An object that is put aside first does not wait for them, but is picked twice: it adds
one more member to the set. Some objects block a put-down in every way to release the object. The goal waits for them
through one more imaginary member, which is no pick.

So the size of the smallest set gives the number of picks, including the buffers of swaps and cyclic shifts. Plans that
move objects in other ways need no fewer picks.

With several hands, an object may wait in one of them and is not picked twice. The smallest set without members for
objects put aside is then the lower bound. It is exact if an order of its picks is found for which the hands suffice.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from graphlib import CycleError, TopologicalSorter

import numpy as np

from planners.cause import Cause
from planners.clearing.lower_bound import MAX_EXPANSIONS, Blockers, self_clearable_sets
from planners.clock import NO_DEADLINE, Deadline
from planners.goals import Clear, Goal, On, occupants
from planners.grasping.candidates import GraspCandidates
from planners.grasping.scan_kernel import Few
from planners.placing.blockers import PutDownMasks, can_be_released, is_put_down_free, put_down_masks
from planners.placing.goal_places import Place, in_the_way, must_go_first, place_of, without_room
from planners.placing.locations import stand_at
from planners.placing.placements import PlacementSearch
from planners.placing.why_not import never_fits
from planners.scene import MAX_OBJECTS, Scene
from planners.scene.cover import is_covered

_GOAL, _ASIDE, _PUT = "\0goal", "\0aside ", "\0put "
"""Prefixes of imaginary objects. No real name contains a null character."""
_ARRANGEMENTS = 4000
"""Arrangements to look at for an order of picks with several hands."""


@dataclass(frozen=True)
class LowerBound:
    """Lower bound of the picks of any plan for a goal, for the declared grasps.

    Like a `ClearanceFloor` it is about a sample of directions, base poses and arm configurations.

    Attributes:
        picks: fewest picks. None if planning is impossible (see `cause`). Without a proof, the picks of the best set
            found.
        objects: the objects to pick, in an order in which they can be taken.
        aside: objects that must be picked twice. They are put aside first, since others wait for them to leave.
        proved: whether `picks` is exact for the places where objects stand. If not, only `least` is proved. So it
            is if an object goes under a shelf and no hand is found that fits there beside the objects that stay.
        least: no plan has fewer picks.
        cause: "", or why planning is impossible: "unreachable", "no self-clearable set", "time limit" or "no clearance
            location". With the last one, the objects are too many or too large for their places, or no hand has room to
            release one in its container.
        expansions: search nodes visited.
    """

    picks: int | None
    objects: tuple[str, ...]
    aside: tuple[str, ...]
    proved: bool
    least: int
    cause: str = ""
    expansions: int = 0

    def met_by(self, picks: int) -> LowerBound:
        """The bound once a plan with that many picks is known: if it meets the bound, the bound is exact."""
        is_known = self.proved or picks != self.least
        return self if is_known else replace(self, picks=picks, proved=True)


def fewest_picks(
    scene: Scene,
    goal: Goal,
    candidates: GraspCandidates,
    start: Scene | None = None,
    *,
    also: Collection[str] = (),
    search: PlacementSearch | None = None,
    buffers: bool = True,
    is_exact: bool = True,
    fewer_than: float = math.inf,
    expansions: int = MAX_EXPANSIONS,
    deadline: Deadline = NO_DEADLINE,
) -> LowerBound:
    """Find the lower bound of the picks for a goal in a scene.

    Args:
        scene: the scene as it is.
        goal: the goal.
        candidates: the grasps of each object, with their blockers.
        start: the scene before anything was moved, if it differs.
        also: names of further objects to move.
        search: finds base poses for put-downs. With None, the blockers of put-downs are ignored.
        buffers: whether objects put aside are put down, and so picked again. False if they may stay in a hand.
        is_exact: whether to look for hands, which may take seconds. Without it, less is proved: nothing under a shelf,
            and not that no hand fits at a place or in a container.
        fewer_than: plans with that many picks, of which one is known, or more count as none. This is found sooner.
        expansions: limit of search nodes for the proof.
        deadline: when to stop.
    """
    to_move = with_what_stands_on(goal, (*must_move(scene, goal, start), *also))
    if not to_move:
        return LowerBound(0, (), (), True, 0)
    if nowhere := without_room(scene, goal, to_move)[0]:
        return LowerBound(None, nowhere, (), True, 0, Cause.NO_CLEARANCE_LOCATION)
    few = None if math.isinf(fewer_than) else Few(scene.mask(set(to_move) - set(scene.held_names)), int(fewer_than))
    to_take = [name for name in to_move if few is None and name not in scene.held_names]
    stuck = tuple(name for name in to_take if not candidates.blockers(scene, name))
    waiting_for = waits_for(scene, goal, to_move)
    puts = _put_downs(scene, goal, to_move, waiting_for, candidates, search) if search and buffers else {}
    stuck = stuck or tuple(name for name, masks in puts.items() if not masks.ever)
    if search and is_exact and few is None and not stuck:
        moving = [fact for fact in goal.placed if fact.object in to_move and fact.where not in to_move]
        stuck = tuple(
            fact.object
            for fact in moving
            if not can_be_released(search, candidates, scene, fact.object, place_of(scene, fact))
        )
        placed = [] if stuck else [fact for fact in goal.placed if fact.object in to_move]
        kept_out = [one.object for one in placed if never_fits(candidates, scene, one.object, place_of(scene, one))]
        if kept_out:
            return LowerBound(None, tuple(kept_out), (), True, 0, Cause.NO_CLEARANCE_LOCATION)
    if stuck:
        return LowerBound(None, stuck, (), True, 0, Cause.UNREACHABLE)
    table = PickTable(
        scene.names,
        partial(candidates.blockers, scene) if few is None else partial(candidates.minimal_blockers, scene, few=few),
        to_move,
        {name: scene.mask(names) for name, names in waiting_for.items()},
        puts,
        {fact.object: fact.where for fact in goal.placed if fact.where in to_move},
        goal.order,
        goal.held,
        scene.held_names,
        len(scene.robot.acting_arms),
        buffers,
        None if few is None else partial(candidates.hit_by_gripper, scene),
    )
    found = table.fewest(expansions, deadline, fewer_than)
    if not found.proved or found.picks is None:
        return found
    is_unknown = _may_be_in_the_way(scene, goal, to_move, waiting_for) or _may_be_blocked_under_a_shelf(
        scene, goal, to_move, waiting_for, candidates, search if is_exact else None
    )
    return replace(found, proved=not is_unknown)


@dataclass(frozen=True)
class PickTable:
    """Blockers of picks and put-downs: bit i of a mask is object i where it stands.

    Objects that were put aside or stand at their ends block nothing and can always be taken.

    Attributes:
        names: names of the objects.
        takes: blocker masks of the grasps of an object, by its name. Evaluated when needed.
        to_move: names of the objects that must move.
        waits: masks of the objects that must leave before an object goes straight to its end, by name. Only objects
            with an end.
        puts: blockers of the release of an object at its end, by name. Only blocked objects.
        on: name of the moving object that an object is to stand on, by its name.
        order: pairs of names. The last move of the first object comes before the first move of the second.
        hold: names of the objects to hold in the end, after all other moves.
        held: names of the objects in a hand.
        hands: number of hands.
        buffers: whether objects put aside are put down, and so picked again.
        hits: masks of which each blocker mask of `takes` contains one, sooner computed. None for none.
    """

    names: Sequence[str]
    takes: Blockers
    to_move: Sequence[str]
    waits: Mapping[str, int] = field(default_factory=dict)
    puts: Mapping[str, PutDownMasks] = field(default_factory=dict)
    on: Mapping[str, str] = field(default_factory=dict)
    order: Sequence[tuple[str, str]] = ()
    hold: Sequence[str] = ()
    held: Sequence[str] = ()
    hands: int = 1
    buffers: bool = True
    hits: Blockers | None = None

    def _below(self, name: str) -> Iterator[str]:
        """Names of the objects below an object at its end."""
        while name in self.on:
            name = self.on[name]
            yield name

    def fewest(
        self, expansions: int = MAX_EXPANSIONS, deadline: Deadline = NO_DEADLINE, fewer_than: float = math.inf
    ) -> LowerBound:
        """Find the fewest picks after which every object that must move is at its end. See `fewest_picks`.

        With several hands, an object may stay in one of them until its place is free. A plan that never puts anything
        aside needs the fewest picks. If no order of such moves is found, the fewest picks are only proved to be between
        that number and the one with everything put aside.
        """
        if self.hands < 2 or not self.buffers:
            return self._fewest(expansions, deadline, self.buffers, fewer_than)
        aside = self._fewest(expansions, deadline, True)
        if aside.picks is None:
            return aside
        in_hand = self._fewest(expansions, deadline, False)
        if in_hand.picks is None or in_hand.least >= aside.picks:
            return aside
        order = self._order_in_hands(in_hand.objects)
        if order:
            return replace(in_hand, objects=order)
        return replace(aside, least=min(in_hand.least, aside.least), proved=False)

    def _order_in_hands(self, names: Sequence[str]) -> tuple[str, ...]:
        """Objects in an order of picks in which every one is picked once, and stays in a hand until its place is free.

        () if none is found, or if objects are held at the start or in the end: hands are missing then.
        """
        if self.hold or self.held:
            return ()
        bit = {name: 1 << index for index, name in enumerate(self.names)}
        moving = [name for name in self.names if name in names]

        def is_free(masks: Iterable[int], stand: int) -> bool:
            return any(not mask & stand for mask in masks)

        def may_put(name: str, stand: int, final: frozenset[str], is_straight: bool) -> bool:
            """Whether an object in a hand can be put at its end. One without an end can always be put aside."""
            masks = self.puts.get(name, PutDownMasks())
            waits = self.waits.get(name, 0) & (stand | (bit[name] if is_straight else 0))
            is_on = any(below in moving and below not in final for below in self._below(name))
            return not (waits or is_on) and is_free(masks.straight if is_straight else masks.ever, stand)

        def may_take(name: str, stand: int, final: frozenset[str]) -> bool:
            late = any(b == name and a in moving and a not in final for a, b in self.order)
            early = any(a == name and not stand & bit[b] for a, b in self.order)
            return not (late or early) and is_free(self.takes(name), stand)

        # Objects that stand, that are in a hand, that have made their moves, and the one that was taken last.
        start = (sum(bit.values()), frozenset[str](), frozenset[str](), "")
        came: dict[tuple[int, frozenset[str], frozenset[str], str], tuple[str, ...]] = {start: ()}
        stack = [start]
        while stack and len(came) < _ARRANGEMENTS:
            stand, held, final, last = here = stack.pop()
            if len(final) == len(moving):
                return came[here]
            puts = [name for name in held if may_put(name, stand, final, name == last)]
            takes = [name for name in moving if stand & bit[name] and may_take(name, stand, final)]
            after = [((stand & ~bit[name], held | {name}, final, name), (*came[here], name)) for name in takes]
            after = after if len(held) < self.hands else []
            for state, order in (*after, *(((stand, held - {name}, final | {name}, ""), came[here]) for name in puts)):
                if state not in came:
                    came[state] = order
                    stack.append(state)
        return ()

    def _fewest(self, expansions: int, deadline: Deadline, buffers: bool, fewer_than: float = math.inf) -> LowerBound:
        """Find the fewest picks if objects that are put aside are picked again (`buffers`), or never are."""
        waits, puts = self.waits, self.puts
        names_of = {name: [one for k, one in enumerate(self.names) if mask >> k & 1] for name, mask in waits.items()}
        if circle := circle_of(self.to_move, names_of, self.order, self.held):
            return LowerBound(None, circle, (), True, 0, Cause.NO_SELF_CLEARABLE_SET)
        twice = [name for name, mask in waits.items() if buffers and (mask or name in puts)]
        first = [a for a, _ in self.order if a in waits and a not in self.hold]
        blocked = list(dict.fromkeys((*first, *(name for name, masks in puts.items() if 0 not in masks.ever))))
        room = MAX_OBJECTS - len(self.names) - 1
        twice, blocked = twice[:room], blocked[: max(room - len(twice), 0)]
        names = (*self.names, *(f"{_ASIDE}{name}" for name in twice), *(f"{_PUT}{name}" for name in blocked), _GOAL)
        bit = {name: 1 << index for index, name in enumerate(names)}
        held, wanted = (sum(bit[name] for name in some) for some in (self.held, self.to_move))
        for name in set(self.to_move) - set(self.hold):
            # An object at its place implies that the objects it waits for have left.
            wanted |= waits.get(name, 0)
        put = {name: bit[f"{_PUT}{name}"] for name in blocked}
        earlier = {name: wanted & sum(bit[a] for a, b in self.order if b == name) for name in self.names}
        for a, b in self.order:
            earlier[b] |= put.get(a, 0)

        def options(takes: Blockers, name: str) -> Sequence[int]:
            """Blockers of each option, with the objects that the object waits for."""
            if name == _GOAL:
                return [wanted & ~held | sum(put.values())]
            if name.startswith(_ASIDE):
                return [0]
            if name.startswith(_PUT):
                return put_down(name.removeprefix(_PUT))
            masks = [(mask | earlier[name]) & ~held for mask in takes(name)]
            if name not in twice:
                return masks
            hit = puts.get(name, PutDownMasks()).straight if not waits[name] & bit[name] else ()
            # An object to hold comes after all others. An object that stands on another one comes after that one.
            after = [*put] if name in self.hold else [*self._below(name)]
            last = sum({put.get(one, 0) for one in after})
            straight = [mask | (waits[name] | other) & ~held | last for mask in masks for other in hit]
            return straight + [mask | bit[f"{_ASIDE}{name}"] for mask in masks]

        def put_down(name: str) -> list[int]:
            """Masks of the moves before an object stands at its end, one for each way to release it there."""
            before = waits[name] & ~bit[name] & ~held | sum({put.get(one, 0) for one in self._below(name)})
            return [mask & ~held | before for mask in puts.get(name, PutDownMasks()).ever]

        # A held object is picked again if the hand is needed for others, or if the object's place is not free.
        rest = set(self.to_move) - set(self.held) - (set(self.hold) if len(self.hold) <= self.hands else set())
        in_vain = [name for name in self.held if waits.get(name, 0) & ~held or name in puts]
        again = sum(name in in_vain or (name in self.hold and bool(rest)) for name in self.held)
        more = (again if buffers else 0) - len(blocked)
        sets = self_clearable_sets(
            partial(options, self.takes),
            _GOAL,
            names,
            fewer_than=fewer_than - more,
            at_least=None if self.hits is None else partial(options, self.hits),
            expansions=expansions,
            deadline=deadline,
        )
        found = next(sets)
        if found.count is None:
            cause = found.cause if found.cause == Cause.TIME_LIMIT else Cause.NO_SELF_CLEARABLE_SET
            least = max(found.lower_bound + more, 0)
            return LowerBound(None, tuple(self.to_move), (), found.proved, least, cause, found.expansions)
        objects = tuple(name for name in found.objects if name in self.names)
        aside = tuple(name.removeprefix(_ASIDE) for name in found.objects if name.startswith(_ASIDE))
        count, least = found.count + more, found.lower_bound + more
        # The order of the goal is ignored for objects that need not move. If such an object moves, the bound may be too
        # low.
        is_exact = not any(a in objects and a not in self.to_move for a, _ in self.order)
        return LowerBound(count, objects, aside, found.proved and is_exact, least, "", found.expansions)


def _may_be_in_the_way(
    scene: Scene, goal: Goal, to_move: Collection[str], waiting_for: Mapping[str, Collection[str]]
) -> bool:
    """Whether objects may block a place of the goal although no proof says that they must leave."""
    return any(
        in_the_way(scene, scene.body(fact.object), place_of(scene, fact), waiting_for[fact.object])
        for fact in goal.placed
        if fact.object in to_move and not (isinstance(fact, On) and fact.place in to_move)
    )


def _may_be_blocked_under_a_shelf(
    scene: Scene,
    goal: Goal,
    to_move: Collection[str],
    waiting_for: Mapping[str, Collection[str]],
    candidates: GraspCandidates,
    search: PlacementSearch | None,
) -> bool:
    """Whether objects may block a put-down under a shelf, where the bound does not count them.

    They do not if a hand fits with its drive in and out, both while the others stand where they are and once they stand
    at their ends. That is not known on top of objects that move.
    """
    moving = {fact.object: fact for fact in goal.placed if fact.object in to_move}
    # An object that goes onto a moving one comes to where that one goes.
    lowest = {name: place_of(scene, fact) for name, fact in moving.items() if fact.where not in moving}
    covered = {name: place for name, place in lowest.items() if _is_covered(scene, place)}
    if not covered:
        return False
    if search is None or len(lowest) < len(moving):
        return True
    ends = {
        name: np.array([*place.location, place.face.top])
        for name, place in lowest.items()
        if place.location is not None
    }
    for name, place in covered.items():
        leaving, after = waiting_for[name], scene
        for other in (one for one in ends if one != name):
            after = after.with_body(stand_at(scene.body(other), ends[other]))
        for view, gone in ((scene, leaving), (after, set(leaving) - ends.keys())):
            if not is_put_down_free(search, candidates, view, name, place, gone):
                return True
    return False


def _is_covered(scene: Scene, place: Place) -> bool:
    point = place.location if place.area is None else place.area.centre
    assert point is not None
    return is_covered(scene, (*point, place.face.top))


def _put_downs(
    scene: Scene,
    goal: Goal,
    to_move: Collection[str],
    waiting_for: Mapping[str, Collection[str]],
    candidates: GraspCandidates,
    search: PlacementSearch,
) -> dict[str, PutDownMasks]:
    """Blockers of each put-down at a place known beforehand, by name. Objects with an unblocked put-down are left out.

    The object below a place may be moved too, to where nothing blocks the put-down.
    """
    found: dict[str, PutDownMasks] = {}
    for fact in goal.placed:
        if fact.object in to_move and fact.where not in to_move:
            place = place_of(scene, fact)
            masks = put_down_masks(search, candidates, scene, fact.object, place, waiting_for[fact.object])
            if 0 not in masks.straight:
                below = (scene.mask([place.below]),) if place.below else ()
                found[fact.object] = PutDownMasks(masks.straight + below, masks.ever + below)
    return found


def must_move(scene: Scene, goal: Goal, start: Scene | None = None) -> tuple[str, ...]:
    """Names of the objects that must move for the unmet facts, the objects to hold last."""
    unmet = goal.unmet(scene, start)
    placed = {fact.object for fact in goal.placed}
    names = [name for fact in unmet if (name := getattr(fact, "object", "")) in placed]
    for fact in unmet:
        names += occupants(scene, fact.region) if isinstance(fact, Clear) else ()
    names += [name for name in goal.held if name not in scene.held_names]
    return tuple(dict.fromkeys(names))


def with_what_stands_on(goal: Goal, names: Collection[str]) -> tuple[str, ...]:
    """Names of moving objects, and of the objects that the goal wants on them. These must leave and come back."""
    found = dict.fromkeys(names)
    while more := [fact.object for fact in goal.placed if fact.where in found and fact.object not in found]:
        found |= dict.fromkeys(more)
    return tuple(found)


def order_circle(scene: Scene, goal: Goal, to_move: Collection[str]) -> tuple[str, ...]:
    """Names of objects that wait for each other in a circle by the goal's order and `waits_for`, () for none."""
    waits = waits_for(scene, goal, to_move) if goal.order else {}
    return circle_of(to_move, waits, goal.order, scene.held_names)


def circle_of(
    to_move: Collection[str],
    waits: Mapping[str, Collection[str]],
    order: Collection[tuple[str, str]],
    held: Collection[str] = (),
) -> tuple[str, ...]:
    """Names of objects whose first and last moves wait for each other, () for none.

    Args:
        to_move: names of the objects that must move.
        waits: names of the objects that must leave before an object goes straight to its end, by its name.
        order: pairs of objects. The last move of the first one comes before the first move of the second.
        held: names of the objects in a hand. Their first move is already made.
    """
    moving = {*to_move, *(one for name in to_move for one in waits.get(name, ()))} - set(held)
    graph = TopologicalSorter[tuple[str, str]]()
    for name in sorted(moving):
        graph.add((name, "last"), (name, "first"), *((one, "first") for one in sorted(moving & {*waits.get(name, ())})))
        graph.add((name, "first"), *((one, "last") for one, other in order if other == name and one in moving))
    try:
        graph.prepare()
    except CycleError as error:
        return tuple(dict.fromkeys(name for name, _ in error.args[1]))
    return ()


def waits_for(scene: Scene, goal: Goal, to_move: Collection[str]) -> dict[str, frozenset[str]]:
    """Names of the objects that must leave before an object can go straight to its end, by its name.

    An object on another one comes after the last move of that one, which waits for objects of its own. An object to
    hold comes after all others. An object that waits for itself cannot go straight to its end.
    """
    below = {fact.object: fact.where for fact in goal.placed if fact.where in to_move}
    own = {fact.object: must_go_first(scene, scene.body(fact.object), fact) for fact in goal.placed}

    def before(name: str) -> frozenset[str]:
        found = frozenset(own.get(name, ()))
        return found | before(below[name]) | {below[name]} if name in below else found

    found = {name: before(name) for name in own}
    placed = frozenset(to_move) - set(goal.held)
    return found | {name: placed.union(*(found.get(one, ()) for one in placed)) for name in goal.held}
