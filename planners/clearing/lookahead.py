"""Planning ahead: the whole sequence is chosen before the first motion: which objects, grasps, order and placements.

Strategies that do not plan ahead commit to grasps only. Planning ahead simulates the clearances one after another, puts
each object where it obstructs nothing that remains to be done, and turns to other grasps, another order or another set
of objects where some object finds no placement.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from planners.cause import Cause
from planners.clearing.commitments import (
    ClearingProblem,
    Commitments,
    NoCommitment,
    grasped,
    greedy_commitments,
    smallest_commitments,
    varied_commitments,
)
from planners.clearing.saving_time import held_aside, with_blockers, with_less_time
from planners.grasping.candidates import GraspCandidate
from planners.placing.negative_goal_region import SupportGrid, swept_mask
from planners.placing.placements import Placement
from planners.placing.surfaces import KeepClear
from planners.placing.swept_volume import standing_volume
from planners.scene import RobotState, Scene
from planners.strategies import Strategy

_CELL = 0.02
"""[m] of the cells in which swept space is compared."""


@dataclass(frozen=True)
class ClearancePlan:
    """Commitments, and a placement for each object to clear; no placements for strategies that do not plan ahead.

    Attributes:
        commitments: a grasp for the target and for every object that must go before it.
        placements: where objects are put.
        provisional: the object that is put where it will be in the way later; once it stands there, commitments are
            chosen anew. "" for none.
        moves: put-downs until the target can be taken, as far as they are planned.
        aside: the object that stays in a gripper while another one takes the target, "" for none.
        general: objects that are put down for the goal, where it wants them.
        until: objects in the order in which they are moved, for goals that name places.
    """

    commitments: Commitments
    placements: Mapping[str, Placement] = field(default_factory=lambda: MappingProxyType({}))
    provisional: str = ""
    moves: int = 0
    aside: str = ""
    general: frozenset[str] = frozenset()
    until: tuple[str, ...] = ()

    def without(self, name: str) -> ClearancePlan:
        """The plan that remains once that object has been cleared."""
        kept = MappingProxyType({other: place for other, place in self.placements.items() if other != name})
        moves = max(self.moves - 1, 0)
        return replace(self, commitments=self.commitments.without(name), placements=kept, moves=moves)


class Turn(NamedTuple):
    """Before a clearance: the scene, and the commitments to what remains to be done."""

    scene: Scene
    remaining: Commitments


def commitments_for(problem: ClearingProblem, rejections: int | None = None) -> ClearancePlan | NoCommitment:
    """The first commitments of the strategy, or, planned ahead, the first whose objects all find placements.

    Args:
        problem: grasps that cannot be used are rejected on the way, and commitments looked for anew.
        rejections: how often at most; None for no limit.
    """
    for _ in itertools.count() if rejections is None else range(rejections):
        found = _plan_or_unusable(problem)
        if not isinstance(found, tuple):
            return found
        for grasp in found:
            problem.reject(problem.scene, grasp)
    return NoCommitment(Cause.NO_SELF_CLEARABLE_SET, (problem.target,))


def _plan_or_unusable(problem: ClearingProblem) -> ClearancePlan | NoCommitment | tuple[GraspCandidate, ...]:
    """The plan, why there is none, or those grasps of the first commitments that cannot be used."""
    without_placement = problem.target
    for commitments in alternatives(problem):
        if problem.deadline.is_over:
            break
        if isinstance(commitments, NoCommitment):
            return commitments
        grasps = commitments.grasps.values()
        if unusable := tuple(grasp for grasp in grasps if not problem.is_usable(problem.scene, grasp)):
            return unusable
        if not problem.strategy.plans_ahead:
            return ClearancePlan(commitments)
        commitments = problem.order_by_task_plan(commitments)
        plan = _simulate_clearances(problem, commitments)
        if problem.holds_aside and (isinstance(plan, str) or plan.moves) and not problem.scene.held_names:
            aside = _simulate_holding_aside(problem, commitments)
            if aside is not None and (isinstance(plan, str) or aside.moves < plan.moves):
                return aside
        if not isinstance(plan, str):
            return plan
        without_placement = plan
    if problem.deadline.is_over:
        return NoCommitment(Cause.TIME_LIMIT, (problem.target,))
    return NoCommitment(Cause.NO_CLEARANCE_LOCATION, (without_placement,))


def alternatives(problem: ClearingProblem) -> Iterator[Commitments | NoCommitment]:
    """Commitments to one set of objects after another, each followed by other orders and grasps for the same objects.

    Greedy strategies yield one.
    """
    strategy = problem.strategy
    sets: Iterator[Commitments | NoCommitment]
    sets = iter((greedy_commitments(problem),)) if strategy.grasps == "greedy" else smallest_commitments(problem)
    swept_cells = _swept_cells(problem)
    for commitments in itertools.islice(sets, strategy.sets):
        yield commitments
        if isinstance(commitments, Commitments) and commitments.order:
            for _ in range(strategy.variations):
                yield varied_commitments(problem, commitments, swept_cells)


def _swept_cells(problem: ClearingProblem) -> Callable[[GraspCandidate], int]:
    """Cells of the space that objects stand in which the robot occupies at each grasp, as bits; cached.

    It stands for what the grasp sweeps, which would take too long to work out for all grasps that are compared.
    """
    world = problem.candidates.compiled.world(problem.scene)
    grids = [SupportGrid.over(support, _CELL) for support in problem.placements.supports_in(problem.scene)]
    tallest = max(body.top - body.bottom for body in problem.scene.objects)
    known: dict[tuple[str, bytes, bytes], int] = {}

    def swept_cells(grasp: GraspCandidate) -> int:
        """The cells that one grasp sweeps."""
        if grasp.key not in known:
            volume = standing_volume(world, grasp)
            cells = np.concatenate([swept_mask(grid, volume, tallest).ravel() for grid in grids])
            known[grasp.key] = int.from_bytes(np.packbits(cells).tobytes(), "big")
        return known[grasp.key]

    return swept_cells


def keep_clear(strategy: Strategy, commitments: Commitments, moving: str) -> KeepClear:
    """The grasps that a cleared object must keep clear of: those of NGR1, of NGR1 + NGR2, or none (eq. 1-3)."""
    if strategy.region == "none":
        return KeepClear()
    target = commitments.grasps.get(commitments.target)
    if strategy.region == "ngr1":
        return KeepClear(target)
    others = (grasp for name, grasp in commitments.grasps.items() if name not in (moving, commitments.target))
    return KeepClear(target, tuple(others))


def simulate_until_stuck(
    problem: ClearingProblem, commitments: Commitments, names: Sequence[str]
) -> tuple[list[Turn], dict[str, Placement]]:
    """Clear objects in order, up to the first that finds no location.

    Args:
        problem: where placements come from.
        commitments: at the start.
        names: of the objects.

    Returns:
        the turns, one more than there are placements; the placements, in order.
    """
    turns = [Turn(problem.scene, commitments)]
    placements: dict[str, Placement] = {}
    for name in names:
        scene, remaining = turns[-1]
        if problem.saves_time and name in remaining.order:
            remaining = with_less_time(problem, scene, remaining, name)
            turns[-1] = Turn(scene, remaining)
        done = simulate_clearance(problem, scene, remaining, name, keep_clear(problem.strategy, remaining, name))
        if done is None:
            break
        placements[name] = done[0]
        turns.append(Turn(done[1], remaining.without(name)))
    return turns, placements


def simulate_clearance(
    problem: ClearingProblem, scene: Scene, commitments: Commitments, name: str, keep: KeepClear
) -> tuple[Placement, Scene] | None:
    """The first placement of an object that is taken through the grasp committed to, and the scene after it.

    Args:
        problem: where placements come from.
        scene: before the clearance; the object may be held already.
        commitments: its grasp is one of them.
        name: of the object.
        keep: what the object must not stand in the way of.
    """
    if name in problem.homeless:
        return None
    held = scene.holding(name)
    in_hand = held or grasped(scene, commitments.grasps[name])
    world = problem.candidates.compiled.world(in_hand)
    find = partial(problem.placements.find, strategy=problem.strategy, rng=problem.rng, deadline=problem.deadline)
    placement = next(find(world, keep), None)
    if placement is None:
        if held is not None and scene is problem.scene and next(find(world, KeepClear()), None) is None:
            problem.homeless.add(name)  # so no other commitments help
        return None
    state = RobotState(placement.base, in_hand.state.q, in_hand.state.finger_position)
    return placement, in_hand.with_held(None).with_body(placement.body).with_state(state)


def _simulate_clearances(problem: ClearingProblem, commitments: Commitments) -> ClearancePlan | str:
    """A placement for every object to clear, found by simulating the clearances in order; or the object without one."""
    names = (*problem.scene.held_names, *commitments.order)
    turns, placements = simulate_until_stuck(problem, commitments, names)
    if len(placements) < len(names):
        return names[len(placements)]
    if problem.saves_time:
        last = with_less_time(problem, turns[-1].scene, commitments, commitments.target)
        commitments = _as_taken(problem, commitments, turns, last.grasps[commitments.target])
        names = (*problem.scene.held_names, *commitments.order)
        placements = {name: placements[name] for name in names}
    return ClearancePlan(commitments, MappingProxyType(placements), moves=len(placements))


def _simulate_holding_aside(problem: ClearingProblem, commitments: Commitments) -> ClearancePlan | None:
    """A plan in which the last obstacle is held while another arm takes the target; None if none is found."""
    *first, last = commitments.order
    turns, placements = simulate_until_stuck(problem, commitments, first)
    if len(placements) < len(first):
        return None
    held = held_aside(problem, *turns[-1])
    if held is None:
        return None
    commitments = _as_taken(problem, commitments, turns, *held.grasps.values())
    placements = {name: placements[name] for name in first if name in commitments.order}
    return ClearancePlan(commitments, MappingProxyType(placements), moves=len(placements), aside=last)


def _as_taken(
    problem: ClearingProblem, commitments: Commitments, turns: Sequence[Turn], *others: GraspCandidate
) -> Commitments:
    """The commitments with the grasps chosen turn by turn and others, to those objects that are in the way of these.

    What is in the way is worked out for the present scene: grasps chosen later may need fewer objects cleared.
    """
    taken = dict(commitments.grasps)
    for turn in turns:
        taken |= turn.remaining.grasps
    taken |= {grasp.object: grasp for grasp in others}
    known = {grasp.object: grasp for grasp in with_blockers(problem, taken.values())}
    kept, frontier = {commitments.target}, [commitments.target]
    while frontier:
        blockers = set(problem.scene.names_of(known[frontier.pop()].blockers)) - kept
        kept |= blockers
        frontier += sorted(blockers)
    order = tuple(name for name in commitments.order if name in kept)
    grasps = MappingProxyType({name: grasp for name, grasp in known.items() if name in kept})
    return Commitments(commitments.target, order, grasps)
