"""Plans that move an object twice, for scenes in which no monotone plan is found.

A plan is monotone if it moves each object once. Where some object finds no location that keeps clear of all that
remains to be done, an object is put aside provisionally: in the way of a later step, but not of the next ones. When it
comes to be in the way, it is moved again; by then there may be room that was needed before.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from types import MappingProxyType

from planners.clearing.commitments import Commitments
from planners.clearing.lookahead import (
    ClearancePlan,
    ClearingProblem,
    IsUsable,
    OrderByTaskPlan,
    RejectedGrasps,
    alternatives,
    commitments_for,
    simulate_clearance,
    simulate_until_stuck,
)
from planners.grasping.candidates import GraspCandidates
from planners.placing.surfaces import KeepClear
from planners.scene import Scene

__all__ = ["plan_with_second_moves"]

_TRIES = 12
"""Scenes after a provisional put-down from which a plan for the rest is looked for, in one search."""
_REJECTIONS = 8
"""Times that grasps which cannot be used are taken out before a scene counts as without a plan."""
_SETS, _VARIATIONS = 3, 2
"""Sets and variations looked at for the rest, at most."""


@dataclass
class _Context:
    """What stays the same in the scenes that are looked at, and how many more may be."""

    order_by_task_plan: OrderByTaskPlan
    is_usable: IsUsable
    new_candidates: Callable[[], GraspCandidates]
    tries: int = _TRIES


@dataclass(frozen=True)
class _FirstMoves:
    """Clearances up to one that puts an object aside provisionally, and the scene after it."""

    plan: ClearancePlan
    scene: Scene


def plan_with_second_moves(
    problem: ClearingProblem,
    order_by_task_plan: OrderByTaskPlan,
    is_usable: IsUsable,
    new_candidates: Callable[[], GraspCandidates],
    second_moves: int,
) -> ClearancePlan | None:
    """The plan with the fewest clearances among those looked at; None if none is found.

    Plans with one provisional put-down are looked for before those with two, and so on. A plan ends with its first one:
    the rest, whose existence was checked, is chosen anew once it is carried out.

    Args:
        problem: for which no monotone plan was found.
        order_by_task_plan, is_usable: as for `commitments_for`.
        new_candidates: makes grasp candidates for another arrangement of the objects.
        second_moves: provisional put-downs that the whole plan may have.
    """
    context = _Context(order_by_task_plan, is_usable, new_candidates)
    plans = (_best_plan(problem, context, count) for count in range(1, second_moves + 1))
    return next((plan for plan in plans if plan is not None), None)


def _best_plan(problem: ClearingProblem, context: _Context, second_moves: int) -> ClearancePlan | None:
    """The best plan with so many provisional put-downs."""
    best: ClearancePlan | None = None
    for first in _first_moves(problem, context):
        if context.tries <= 0 or problem.deadline.is_over:
            break
        context.tries -= 1
        rest = _plan_rest(problem, context, first.scene, second_moves - 1)
        if rest is not None:
            moves = first.plan.moves + rest.moves
            if best is None or moves < best.moves:
                best = replace(first.plan, moves=moves)
            if best.moves <= len(first.plan.commitments.order) + 1:
                break
    return best


def _plan_rest(problem: ClearingProblem, context: _Context, scene: Scene, second_moves: int) -> ClearancePlan | None:
    """A plan for the target from a scene on."""
    strategy, candidates = problem.strategy, context.new_candidates()
    less = replace(strategy, sets=min(strategy.sets, _SETS), variations=min(strategy.variations, _VARIATIONS))
    rest = replace(problem, scene=scene, candidates=candidates, strategy=less)
    for _ in range(_REJECTIONS):
        found = commitments_for(rest, context.order_by_task_plan, context.is_usable)
        if isinstance(found, ClearancePlan):
            return found
        if not isinstance(found, RejectedGrasps):
            break
        for grasp in found.grasps:
            candidates.ban(scene, grasp)
    return _best_plan(rest, context, second_moves) if second_moves else None


def _first_moves(problem: ClearingProblem, context: _Context) -> Iterator[_FirstMoves]:
    """What each usable alternative of commitments offers."""
    for commitments in alternatives(problem):
        if not isinstance(commitments, Commitments) or problem.deadline.is_over:
            return
        if all(context.is_usable(problem.scene, grasp) for grasp in commitments.grasps.values()):
            yield from _put_aside(problem, context.order_by_task_plan(commitments))


def _put_aside(problem: ClearingProblem, commitments: Commitments) -> Iterator[_FirstMoves]:
    """Clearances in order until an object finds no location; from there backwards, one put aside provisionally."""
    names = (*problem.scene.held_names, *commitments.order)
    turns, placements = simulate_until_stuck(problem, commitments, names)
    if len(placements) == len(names):
        return
    for count in reversed(range(len(placements) + 1)):
        name, before = names[count], turns[count]
        for keep in _next_grasps(commitments, names[count + 1 :]):
            done = simulate_clearance(problem, before.scene, before.remaining, name, keep)
            if done is not None:
                chosen = {**dict(itertools.islice(placements.items(), count)), name: done[0]}
                yield _FirstMoves(ClearancePlan(commitments, MappingProxyType(chosen), name, count + 1), done[1])


def _next_grasps(commitments: Commitments, later: tuple[str, ...]) -> Iterator[KeepClear]:
    """What a provisional put-down keeps clear: all obstacles that follow, half of them, or the next one alone."""
    for count in dict.fromkeys((len(later), (len(later) + 1) // 2, 1)):
        if 0 < count <= len(later):
            yield KeepClear(None, tuple(commitments.grasps[name] for name in later[:count]))
