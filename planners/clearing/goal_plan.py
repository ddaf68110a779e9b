"""Planning ahead for a goal with places: the moves are simulated one after another before the first motion is planned.

Each object that must move goes straight to its place as soon as it can be taken and its place is free. Where none can,
the lower bound of the situation says what else must be cleared, or which object of a circle is put aside first: that is
where the plan ends for the time being, and the rest is chosen anew once that object stands there.
"""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from planners.cause import Cause
from planners.clearing.commitments import ClearingProblem, Commitments, NoCommitment, grasped
from planners.clearing.goal_bound import LowerBound, fewest_picks, must_move
from planners.clearing.lookahead import ClearancePlan
from planners.clearing.order_of_moves import Order, Step
from planners.clearing.saving_time import with_blockers
from planners.goals import TOLERANCE, At, Goal, Holding, Inside, On
from planners.grasping.candidates import GraspCandidate
from planners.motion.approaches import can_take, fewest_blockers
from planners.motion.arm import tcp_pose
from planners.placing.blockers import fewest_in_the_way
from planners.placing.goal_places import Place, in_the_way, of_same_area, place_of, placed_fact, reserved_regions
from planners.placing.locations import in_hand
from planners.placing.placements import Placement, is_under_shelf
from planners.placing.surfaces import KeepClear
from planners.scene import RobotState, Scene

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
        is_general: whether it is put where the goal wants it, not just aside.
    """

    name: str
    grasp: GraspCandidate | None
    placement: Placement | None
    is_general: bool = False


@dataclass(frozen=True)
class NotPlaced:
    """Objects for whose places no motion was found.

    Attributes:
        blockers: names of what is in the way of that, by object. What is in the hand is put aside, and goes to its
            place once they have moved.
        pitches: [rad] of the grasps through which they had been taken; they are taken through others next.
    """

    blockers: Mapping[str, frozenset[str]]
    pitches: Mapping[str, Collection[float]]


@dataclass
class _Simulation:
    """The scene as the moves so far leave it, and what is still to be moved.

    Attributes:
        to_move: names of what is moved from the present scene on.
        last: names of those that go to their ends after all others, in whose way they would be there.
        waiting: names of what has not been moved yet.
    """

    problem: ClearingProblem
    goal: Goal
    start: Scene
    not_placed: NotPlaced
    to_move: tuple[str, ...]
    last: frozenset[str] = frozenset()
    moves: list[Move] = field(default_factory=list)
    failures: Counter[str] = field(default_factory=Counter)
    reserve: dict[str, GraspCandidate] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.scene, self.candidates, self.waiting = self.problem.scene, self.problem.candidates, list(self.to_move)


def goal_plan(
    problem: ClearingProblem, goal: Goal, start: Scene, not_placed: NotPlaced
) -> ClearancePlan | NoCommitment:
    """The moves up to the goal, or up to the first object that is put aside to be moved again.

    Args:
        problem: its target does not matter.
        goal: what it is to be.
        start: the scene before anything was moved.
        not_placed: what motion planning refuted before.
    """
    to_move = dict.fromkeys((*problem.scene.held_names, *must_move(problem.scene, goal, start)))
    sim = _Simulation(problem, goal, start, not_placed, tuple(to_move))
    order = Order.of(problem.scene, goal, to_move, problem.candidates)
    in_vain, is_strict = set[tuple[str, bool]](), True
    while sim.waiting:
        if problem.deadline.is_over:
            return NoCommitment(Cause.TIME_LIMIT, tuple(sim.waiting))
        if order is not None:
            refuted = {name: _refuted_by(sim, name) for name in sim.waiting}
            step, *later = order.steps(sim.scene, sim.waiting, refuted, in_vain) or (None,)
            if step is not None and any(move.name == step.name for move in sim.moves):
                return _as_plan(sim, sim.moves[-1].name)
            if step is not None and _moved_as(sim, order, step, later, is_strict):
                if not step.is_general and step.name in order.ends:
                    return _as_plan(sim, step.name)
                in_vain, is_strict = set(), True
                continue
            if step is not None:
                in_vain.add((step.name, step.is_general))
                continue
            if is_strict and in_vain:
                in_vain, is_strict = set(), False
                continue
        held_in_vain = [name for name in sim.scene.held_names if name in not_placed.blockers]
        if any(_moved(sim, name) for name in _in_turn(sim) if name not in held_in_vain and not _refuted_by(sim, name)):
            continue
        in_the_way = _in_the_way(sim)
        if not in_the_way:
            provisional = _put_aside(sim)
            return _as_plan(sim, provisional) if provisional else _refusal(sim)
        with_these = _moving_these_too(sim, in_the_way)
        if with_these is None:
            return _refusal(sim)
        sim = with_these
    return _as_plan(sim, "")


def _moved_as(sim: _Simulation, order: Order, step: Step, later: Sequence[Step], is_strict: bool) -> bool:
    """Move an object as the order says, if it can be, out of the way of all later steps.

    Of some where it is not strict, or where the object goes to its end, which the order has counted with.
    """
    grasps: list[GraspCandidate] = []
    for one in later:
        for grasp, body in ((one.taken, sim.scene.body(one.name)), (one.put, order.ends.get(one.name))):
            if grasp is not None and body is not None:
                world = sim.candidates.compiled.world(sim.scene.with_body(body))
                sim.problem.placements.volume(world, grasp)  # known from now on
                grasps.append(grasp)
    some = ((len(grasps) + 1) // 2, 0)
    counts = (len(grasps), *some) if step.is_general else (len(grasps),) if is_strict else some
    return _taken_and_put(sim, step.name, step.is_general, [KeepClear(None, tuple(grasps[:count])) for count in counts])


def _refuted_by(sim: _Simulation, name: str) -> frozenset[str]:
    """What was in the way when no motion put an object at its place, and has not been moved since."""
    return sim.not_placed.blockers.get(name, frozenset()).difference(move.name for move in sim.moves)


def _in_turn(sim: _Simulation) -> list[str]:
    """What may be moved next: what is in the hand, else what need not wait by order, the nearest first.

    What could not be moved before comes after that.
    """
    if sim.scene.held_names:
        return list(sim.scene.held_names[:1])
    goal, base = sim.goal, sim.scene.state.base[:2]
    free = _free_by_order(sim)
    if set(sim.waiting) - set(goal.held):
        free = [name for name in free if name not in goal.held]
    if set(sim.waiting) - set(goal.held) - sim.last:
        free = [name for name in free if name not in sim.last]
    away = {name: float(np.linalg.norm(sim.scene.body(name).position[:2] - base)) for name in free}
    return sorted(free, key=lambda name: (sim.failures[name], away[name]))


def _free_by_order(sim: _Simulation) -> list[str]:
    """What waits to be moved, and need not wait for another by the goal's order."""
    return [name for name in sim.waiting if not any(b == name and a in sim.waiting for a, b in sim.goal.order)]


def _moved(sim: _Simulation, name: str) -> bool:
    """Move an object to its end, if it can be taken now and its place is free."""
    scene, fact = sim.scene, placed_fact(sim.goal, name)
    if name in sim.goal.held:
        grasp = None
        if name not in scene.held_names:
            grasp = _grasp_to_hold(sim, name)
            if grasp is None:
                return False
        elif len(sim.waiting) > 1:
            return False
        _advance(sim, Move(name, grasp, None), scene if grasp is None else grasped(scene, grasp))
        return True
    if isinstance(fact, On) and fact.place in sim.waiting:
        return False
    if fact is not None and in_the_way(scene, scene.body(name), place_of(scene, fact), ()):
        return False
    return _taken_and_put(sim, name, is_general=fact is not None)


def _grasp_to_hold(sim: _Simulation, name: str) -> GraspCandidate | None:
    """The first free grasp from which the object can be held at its point, if it has one; else the first free one."""
    point = next(fact.point for fact in sim.goal.facts if isinstance(fact, Holding))
    free = list(_free_grasps(sim, name)) if point else list(itertools.islice(_free_grasps(sim, name), 1))
    for grasp in free if point else ():
        world = sim.candidates.compiled.world(grasped(sim.scene, grasp))
        if next(sim.problem.placements.holding_at(world, np.array(point)), None) is not None:
            return grasp
    return next(iter(free), None)


def _taken_and_put(sim: _Simulation, name: str, is_general: bool, tiers: Sequence[KeepClear] = ()) -> bool:
    """Take an object and put it where the goal wants it, or aside; through another grasp where one does not fit."""
    scene, goal = sim.scene, sim.goal
    fact = placed_fact(goal, name) if is_general else None
    reserved = reserved_regions(scene, goal, name if is_general else "")
    is_held = name in scene.held_names
    refused = sim.not_placed.pitches.get(name, ()) if is_general else ()
    is_exact = isinstance(fact, At) and fact.yaw is not None
    grasps: Iterable[GraspCandidate] = _free_grasps(sim, name, is_exact)  # looked for when they are asked for
    shares_area = fact is not None and not is_held and of_same_area(scene, goal, name, sim.waiting)
    if fact is not None and shares_area and is_under_shelf(scene, place := place_of(scene, fact)):
        grasps = _deepest_first(sim, grasps, place)
    for grasp in (None,) if is_held else grasps:
        if grasp is not None and grasp.pitch in refused:
            continue
        with_it = scene.holding(name) if grasp is None else grasped(scene, grasp)
        assert with_it is not None
        failed: list[NDArray[np.float64]] = []
        for keep in tiers or _tiers(sim, name):
            keep = replace(keep, reserved=reserved)
            found = placements_of(sim.problem, goal, sim.start, with_it, fact, keep, sim.waiting, failed)
            placement = next(found, None)
            if placement is not None:
                state = RobotState(placement.base, with_it.state.q, with_it.state.finger_position)
                after = with_it.with_held(None).with_body(placement.body).with_state(state)
                _advance(sim, Move(name, grasp, placement, is_general), after)
                return True
    sim.failures[name] += 1
    return False


def _deepest_first(sim: _Simulation, grasps: Iterable[GraspCandidate], place: Place) -> list[GraspCandidate]:
    """Grasps with which an object gets farther into a place under a shelf first: there it is out of the others' way."""

    def depth(grasp: GraspCandidate) -> float:
        return sim.problem.placements.depth(sim.candidates.compiled.world(grasped(sim.scene, grasp)), place)[1]

    return sorted(grasps, key=depth, reverse=True)


def placements_of(
    problem: ClearingProblem,
    goal: Goal,
    start: Scene,
    scene: Scene,
    fact: On | Inside | At | None,
    keep: KeepClear,
    waiting: Collection[str] = (),
    failed: list[NDArray[np.float64]] | None = None,
) -> Iterator[Placement]:
    """Placements of the held object: where a fact wants it, or aside.

    Args:
        problem: where placements come from.
        goal: the whole one.
        start: the scene before anything was moved: what stood there is to stand, even if it has fallen since.
        scene: with the object in hand.
        fact: of the goal; None to put the object aside.
        keep: what it must not stand in the way of.
        waiting: names of the objects that are still to be moved, for which room is left.
        failed: locations of the place to pass over, as for `PlacementSearch.find_at`.
    """
    world = problem.candidates.compiled.world(scene)
    if fact is None:
        return problem.placements.find(world, keep, problem.strategy, problem.rng, problem.deadline)
    if start.body(fact.object).is_upright and not in_hand(scene)[1].is_upright:
        return iter(())
    place, others = place_of(scene, fact), of_same_area(scene, goal, fact.object, waiting)
    return problem.placements.find_at(world, place, keep, waiting, others, failed, problem.deadline)


def _tiers(sim: _Simulation, name: str) -> Iterator[KeepClear]:
    """What a put-down keeps clear of: the grasps of all that is still to be moved, of the next half, or nothing."""
    if sim.problem.strategy.region != "none":
        for other in sim.waiting:
            if other not in sim.reserve and other not in sim.scene.held_names:
                for option in sim.candidates.for_object(sim.scene, other)[:1]:
                    sim.reserve[other] = option
        later = [sim.reserve[other] for other in sim.waiting if other != name and other in sim.reserve]
        for count in dict.fromkeys((len(later), (len(later) + 1) // 2)):
            if count:
                yield KeepClear(None, tuple(later[:count]))
    yield KeepClear()


def _free_grasps(sim: _Simulation, name: str, is_exact: bool = False) -> Iterator[GraspCandidate]:
    """Grasps with nothing in their way, to which the gripper can come and from which it can leave, of several pitches.

    Then, if the object is to come to rest at an exact yaw, several of each pitch: one from another side may fit there.
    What is found in the way of others is remembered for the scene.
    """
    seen: set[object] = set()
    candidates, scene = sim.candidates, sim.scene
    finds = [(candidates.for_object, False), (candidates.of_all_families, False), (candidates.of_all_families, True)]
    for find, by_hold in finds[: 3 if is_exact else 2]:
        for _ in range(_TRIED):
            unblocked = (one for one in find(scene, name) if not one.blockers)
            free = (one for one in unblocked if (_hold(scene, one) if by_hold else one.pitch) not in seen)
            grasp = next(free, None)
            if grasp is None:
                break
            world = candidates.compiled.world(scene.using(grasp.arm))
            if can_take(world, grasp.base, grasp.q, name):
                seen |= {grasp.pitch, _hold(scene, grasp)}
                yield grasp
                continue
            blockers = fewest_blockers(world, grasp.base, grasp.q, name)
            if blockers:
                candidates.obstruct(scene, grasp, blockers)
            else:
                candidates.ban(scene, grasp)


def _hold(scene: Scene, grasp: GraspCandidate) -> bytes:
    """Where the gripper is when the fingers close, wherever the base stands and however the arm is bent."""
    T = tcp_pose(scene.using(grasp.arm).robot, RobotState(grasp.base, grasp.q, 0.0))
    return bytes(np.round(T, _SAME_HOLD).tobytes())


def _advance(sim: _Simulation, move: Move, scene: Scene) -> None:
    sim.moves.append(move)
    sim.scene, sim.waiting = scene, [name for name in sim.waiting if name != move.name]


def _in_the_way(sim: _Simulation) -> tuple[str, ...]:
    """What is not waiting to be moved, and is in the way: of an object at its place, of the robot there, of a grasp."""
    if sim.scene.held_names:
        return ()
    scene, facts = sim.scene, [fact for name in sim.waiting if (fact := placed_fact(sim.goal, name))]
    there = (in_the_way(scene, scene.body(fact.object), place_of(scene, fact), sim.waiting) for fact in facts)
    found = next(filter(None, itertools.chain(there, (_in_the_way_of_put_down(sim, fact) for fact in facts))), ())
    return found or tuple(name for name in _bound(sim).objects if name not in sim.waiting)


def _in_the_way_of_put_down(sim: _Simulation, fact: On | Inside | At) -> tuple[str, ...]:
    """What keeps the robot from putting an object down at its place, once those that wait have left."""
    if isinstance(fact, On) and fact.place in sim.waiting:
        return ()
    name = fact.object
    refuted_by = tuple(sorted(_refuted_by(sim, name).difference(sim.waiting)))
    if refuted_by or not sim.failures[name]:  # to ask takes as long as to look for a placement
        return refuted_by
    leaving, fewest = [one for one in sim.waiting if one != name], tuple[str, ...]()
    for grasp in _free_grasps(sim, name):
        world = sim.candidates.compiled.world(grasped(sim.scene, grasp))
        found = fewest_in_the_way(sim.problem.placements, world, place_of(sim.scene, fact), leaving)
        if found == 0:
            return ()
        names = () if found is None else sim.scene.names_of(found)
        fewest = min((one for one in (fewest, names) if one), key=len, default=())
    return fewest


def _moving_these_too(sim: _Simulation, names: Collection[str]) -> _Simulation | None:
    """The simulation in which these are moved besides; None if they are in the way wherever they go.

    What was moved too early is moved anew, now that it is known what else must be. If that was known before, it is in
    the way where it is to stand, and goes there last.
    """
    again = {move.name for move in sim.moves if move.name in names}
    if not again:
        sim.waiting += names
        return sim
    if again <= sim.last:
        return None
    to_move = tuple(dict.fromkeys((*sim.to_move, *sim.waiting, *names)))
    last = sim.last | again if len(to_move) == len(sim.to_move) else sim.last
    return _Simulation(sim.problem, sim.goal, sim.start, sim.not_placed, to_move, last)


def _bound(sim: _Simulation) -> LowerBound:
    also, deadline = sim.waiting, sim.problem.deadline
    return fewest_picks(sim.scene, sim.goal, sim.candidates, sim.start, also=also, deadline=deadline)


def _put_aside(sim: _Simulation) -> str:
    """Put aside one object that is to be moved again: its name, "" if none can be.

    What is in the hand; else those of the lower bound come first, then those that go to their ends last, and at the end
    those that left their places before: they may stand aside already.
    """
    names = sim.scene.held_names[:1]
    if not names:
        moved = {name: sim.scene.body(name).position - sim.start.body(name).position for name in sim.waiting}
        free = sorted(_free_by_order(sim), key=lambda name: bool(np.linalg.norm(moved[name]) > TOLERANCE))
        first = [name for name in (*_bound(sim).aside, *sorted(sim.last)) if name in free]
        names = tuple(dict.fromkeys((*first, *free)))
    return next((name for name in names if _taken_and_put(sim, name, is_general=False)), "")


def _refusal(sim: _Simulation) -> NoCommitment:
    """Why nothing can be moved: by the grasps alone, if the lower bound proves that nothing ever can."""
    if not sim.moves and not sim.scene.held_names:
        bound = _bound(sim)
        if bound.picks is None:
            return NoCommitment(Cause(bound.cause), bound.objects or tuple(sim.waiting))
    return NoCommitment(Cause.NO_CLEARANCE_LOCATION, tuple(sim.waiting))


def _as_plan(sim: _Simulation, provisional: str) -> ClearancePlan:
    """The moves as commitments; what is in the way of a grasp is worked out for the scene as it is."""
    moves = {move.name: move for move in sim.moves}
    grasps = with_blockers(sim.problem, (move.grasp for move in sim.moves if move.grasp is not None))
    target = next((move.name for move in sim.moves if move.placement is None), "")
    placements = {name: move.placement for name, move in moves.items() if move.placement is not None}
    return ClearancePlan(
        Commitments(
            target,
            tuple(name for name in moves if name != target),
            MappingProxyType({grasp.object: grasp for grasp in grasps}),
        ),
        MappingProxyType(placements),
        provisional,
        len(placements),
        general=frozenset(name for name, move in moves.items() if move.is_general),
        until=tuple(moves),
    )
