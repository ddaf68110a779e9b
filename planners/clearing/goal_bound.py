"""The fewest picks of any plan for a goal, for a declared set of grasp options.

The objects that a plan has moved by its end, each taken through an option whose blockers were gone, form a
self-clearable set (see `planners.clearing.lower_bound`) for one more, imaginary object: the goal, which all objects
block that must be moved. An object that goes straight to its place also waits for what stands there, and for what the
robot hits when it lets go there; one that is put aside first does not, but is picked twice: that is one more member of
the set. What is in the way of gripper and object however they come is waited for by the goal, through a member that
does not count. So the smallest set counts the picks, and the buffers of swaps and cyclic shifts with them. Plans that
move objects about otherwise need no fewer.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from graphlib import CycleError, TopologicalSorter

from planners.cause import Cause
from planners.clearing.lower_bound import MAX_EXPANSIONS, Blockers, self_clearable_sets
from planners.clock import NO_DEADLINE, Deadline
from planners.goals import Clear, Goal, On, occupants
from planners.grasping.candidates import GraspCandidates
from planners.placing.blockers import PutDownMasks, put_down_masks
from planners.placing.goal_places import in_the_way, must_go_first, place_of, without_room
from planners.placing.placements import PlacementSearch
from planners.scene import MAX_OBJECTS, Scene

_GOAL, _ASIDE, _PUT = "\0goal", "\0aside ", "\0put "
"""Names of the imaginary objects; no other one has a null."""


@dataclass(frozen=True)
class LowerBound:
    """The fewest picks of any plan for a goal, for the declared grasps.

    Attributes:
        picks: how many; None if no plan exists (see `cause`). Without a proof, of the best set found.
        objects: the objects to be picked, in an order in which they can be taken.
        aside: those of them that must be picked twice: put aside first, since others wait for them to leave.
        proved: whether `picks` is exact for the places where objects stand; if not, `least` is what is proved.
        least: no plan has fewer picks.
        cause: "" or why there is no plan: "unreachable", "no self-clearable set", "no clearance location" where
            objects have no room at their places, whatever else moves, or "time limit" if it was aborted.
        expansions: search nodes visited.
    """

    picks: int | None
    objects: tuple[str, ...]
    aside: tuple[str, ...]
    proved: bool
    least: int
    cause: str = ""
    expansions: int = 0


def fewest_picks(
    scene: Scene,
    goal: Goal,
    candidates: GraspCandidates,
    start: Scene | None = None,
    *,
    also: Collection[str] = (),
    search: PlacementSearch | None = None,
    buffers: bool = True,
    expansions: int = MAX_EXPANSIONS,
    deadline: Deadline = NO_DEADLINE,
) -> LowerBound:
    """The lower bound for a goal in a scene.

    Args:
        scene: the world.
        goal: what it is to be.
        candidates: the grasps of each object, and what is in their way.
        start: the scene before anything was moved, if that is another one.
        also: names of objects that are moved besides those that must.
        search: where the base may stand to put objects down; None: what is in the way of that does not count.
        buffers: whether what is put aside must be put down, and so be picked again; not where it may stay in a hand.
        expansions: search nodes after which the proof is given up.
        deadline: when to stop.
    """
    to_move = with_what_stands_on(goal, (*must_move(scene, goal, start), *also))
    if not to_move:
        return LowerBound(0, (), (), True, 0)
    if nowhere := without_room(scene, goal, to_move)[0]:
        return LowerBound(None, nowhere, (), True, 0, Cause.NO_CLEARANCE_LOCATION)
    stuck = tuple(name for name in to_move if name not in scene.held_names and not candidates.blockers(scene, name))
    waiting_for = waits_for(scene, goal, to_move)
    puts = _put_downs(scene, goal, to_move, waiting_for, candidates, search) if search and buffers else {}
    stuck = stuck or tuple(name for name, masks in puts.items() if not masks.ever)
    if stuck:
        return LowerBound(None, stuck, (), True, 0, Cause.UNREACHABLE)
    table = PickTable(
        scene.names,
        lambda name: candidates.blockers(scene, name),
        to_move,
        {name: scene.mask(names) for name, names in waiting_for.items()},
        puts,
        {fact.object: fact.where for fact in goal.placed if fact.where in to_move},
        goal.order,
        goal.held,
        scene.held_names,
        len(scene.robot.acting_arms),
        buffers,
    )
    found = table.fewest(expansions, deadline)
    is_exact = found.picks is None or not _may_be_in_the_way(scene, goal, to_move, waiting_for)
    return replace(found, proved=found.proved and is_exact)


@dataclass(frozen=True)
class PickTable:
    """What is in the way of what: bit i of a mask is object i where it stands.

    What is put aside is in nobody's way, nor is what stands at its end; both are free to be taken.

    Attributes:
        names: of the objects.
        takes: masks of what is in the way of each grasp of an object, by its name; asked for as they are needed.
        to_move: names of the objects that must move.
        waits: masks of what must have left before an object goes straight to its end, by name, of those with an end.
        puts: what is in the way where an object is let go at its end, if anything is, by name.
        on: name of the object that an object is to stand on, by its name, of those that move.
        order: pairs of names: the last move of the first object comes before the first one of the second.
        hold: names of what is to be held in the end, after all other moves.
        held: names of what is in a hand.
        hands: how many there are.
        buffers: whether what is put aside must be put down, and so be picked again.
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

    def _below(self, name: str) -> Iterator[str]:
        """Names of what is below an object at its end."""
        while name in self.on:
            name = self.on[name]
            yield name

    def fewest(self, expansions: int = MAX_EXPANSIONS, deadline: Deadline = NO_DEADLINE) -> LowerBound:
        """The fewest picks after which all that must move is where it is to be."""
        waits, puts, buffers = self.waits, self.puts, self.buffers
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
            wanted |= waits.get(name, 0)
        put = {name: bit[f"{_PUT}{name}"] for name in blocked}
        earlier = {name: wanted & sum(bit[a] for a, b in self.order if b == name) for name in self.names}
        for a, b in self.order:
            earlier[b] |= put.get(a, 0)

        def options(name: str) -> Sequence[int]:
            """The blockers of each option, what the object waits for among them."""
            if name == _GOAL:
                return [wanted & ~held | sum(put.values())]
            if name.startswith(_ASIDE):
                return [0]
            if name.startswith(_PUT):
                return put_down(name.removeprefix(_PUT))
            masks = [(mask | earlier[name]) & ~held for mask in self.takes(name)]
            if name not in twice:
                return masks
            hit = puts.get(name, PutDownMasks()).straight if not waits[name] & bit[name] else ()
            # What is held in the end comes after all others, what stands on another one after that one.
            after = [*put] if name in self.hold else [*self._below(name)]
            last = sum({put.get(one, 0) for one in after})
            straight = [mask | (waits[name] | other) & ~held | last for mask in masks for other in hit]
            return straight + [mask | bit[f"{_ASIDE}{name}"] for mask in masks]

        def put_down(name: str) -> list[int]:
            """What must have happened before an object stands at its end, for each way to let go of it there."""
            before = waits[name] & ~bit[name] & ~held | sum({put.get(one, 0) for one in self._below(name)})
            return [mask & ~held | before for mask in puts.get(name, PutDownMasks()).ever]

        found = next(self_clearable_sets(options, _GOAL, names, expansions=expansions, deadline=deadline))
        if found.count is None:
            cause = found.cause if found.cause == Cause.TIME_LIMIT else Cause.NO_SELF_CLEARABLE_SET
            return LowerBound(None, tuple(self.to_move), (), found.proved, found.lower_bound, cause, found.expansions)
        # What is in a hand but not at its end yet is picked again if the hand is needed, or its place is not free.
        rest = set(self.to_move) - set(self.held) - (set(self.hold) if len(self.hold) <= self.hands else set())
        in_vain = [name for name in self.held if waits.get(name, 0) & ~held or name in puts]
        again = sum(name in in_vain or (name in self.hold and bool(rest)) for name in self.held)
        more = (again if buffers else 0) - len(blocked)
        objects = tuple(name for name in found.objects if name in self.names)
        aside = tuple(name.removeprefix(_ASIDE) for name in found.objects if name.startswith(_ASIDE))
        count, least = found.count + more, found.lower_bound + more
        # If an object need not move, but does, and by the order of the goal before another one: that does not count.
        is_exact = not any(a in objects and a not in self.to_move for a, _ in self.order)
        return LowerBound(count, objects, aside, found.proved and is_exact, least, "", found.expansions)


def _may_be_in_the_way(
    scene: Scene, goal: Goal, to_move: Collection[str], waiting_for: Mapping[str, Collection[str]]
) -> bool:
    """Whether an object does not fit at its place beside what stands there, though nothing proves that this must go."""
    return any(
        in_the_way(scene, scene.body(fact.object), place_of(scene, fact), waiting_for[fact.object])
        for fact in goal.placed
        if fact.object in to_move and not (isinstance(fact, On) and fact.place in to_move)
    )


def _put_downs(
    scene: Scene,
    goal: Goal,
    to_move: Collection[str],
    waiting_for: Mapping[str, Collection[str]],
    candidates: GraspCandidates,
    search: PlacementSearch,
) -> dict[str, PutDownMasks]:
    """What is in the way of putting down each object that must move, if anything is, at a place known beforehand.

    What it is to stand on may be moved too, to where nothing is in the way.
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
    """Names of the objects that must move for the facts that do not hold; those to be held last."""
    unmet = goal.unmet(scene, start)
    placed = {fact.object for fact in goal.placed}
    names = [name for fact in unmet if (name := getattr(fact, "object", "")) in placed]
    for fact in unmet:
        names += occupants(scene, fact.region) if isinstance(fact, Clear) else ()
    names += [name for name in goal.held if name not in scene.held_names]
    return tuple(dict.fromkeys(names))


def with_what_stands_on(goal: Goal, names: Collection[str]) -> tuple[str, ...]:
    """Names of objects that move, and of those that the goal wants on one of these: they leave it, and come back."""
    found = dict.fromkeys(names)
    while more := [fact.object for fact in goal.placed if fact.where in found and fact.object not in found]:
        found |= dict.fromkeys(more)
    return tuple(found)


def order_circle(scene: Scene, goal: Goal, to_move: Collection[str]) -> tuple[str, ...]:
    """Names of objects whose moves the order of a goal puts in a circle with what must leave before them, if any."""
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
        to_move: names of what must move.
        waits: names of what must have left before an object goes straight to its end, by its name.
        order: pairs of objects: the last move of the first one comes before the first move of the second.
        held: names of what is in a hand: it has made its first move.
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
    """Names of the objects that must have left before an object can go straight to its end, by its name.

    What stands on another object comes after that one's last move, which waits for objects of its own; what is to be
    held comes after all. Where an object waits for itself, it cannot go straight to its end.
    """
    below = {fact.object: fact.where for fact in goal.placed if fact.where in to_move}
    own = {fact.object: must_go_first(scene, scene.body(fact.object), fact) for fact in goal.placed}

    def before(name: str) -> frozenset[str]:
        """What must have left before that object stands where it is to stand."""
        found = frozenset(own.get(name, ()))
        return found | before(below[name]) | {below[name]} if name in below else found

    found = {name: before(name) for name in own}
    placed = frozenset(to_move) - set(goal.held)
    return found | {name: placed.union(*(found.get(one, ()) for one in placed)) for name in goal.held}
