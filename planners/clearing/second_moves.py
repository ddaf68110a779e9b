"""Plans that move an object twice, for scenes in which no monotone plan is found.

A plan is monotone if it moves each object once. Where some object finds no location that keeps clear of all that
remains to be done, an object is put aside provisionally: in the way of a later step, but not of the next ones. When it
comes to be in the way, it is moved again; by then there may be room that was needed before.
"""

from __future__ import annotations

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
    keep_clear,
    simulate_clearance,
)
from planners.grasping.candidates import GraspCandidates
from planners.placing.placements import Placement
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
    candidates_afresh: Callable[[], GraspCandidates]
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
    candidates_afresh: Callable[[], GraspCandidates],
    second_moves: int,
) -> ClearancePlan | None:
    """The plan with the fewest clearances among those looked at; None if none is found.

    Plans with one provisional put-down are looked for before those with two, and so on. A plan ends with its first one:
    the rest, whose existence was checked, is chosen anew once it is carried out.

    Args:
        problem: for which no monotone plan was found.
        order_by_task_plan, is_usable: as for `commitments_for`.
        candidates_afresh: makes grasp candidates for another arrangement of the objects.
        second_moves: provisional put-downs that the whole plan may have.
    """
    context = _Context(order_by_task_plan, is_usable, candidates_afresh)
    plans = (_plan(problem, context, count) for count in range(1, second_moves + 1))
    return next((plan for plan in plans if plan is not None), None)


def _plan(problem: ClearingProblem, context: _Context, second_moves: int) -> ClearancePlan | None:
    """The best plan with so many provisional put-downs."""
    best: ClearancePlan | None = None
    for first in _first_moves(problem, context):
        if context.tries <= 0 or problem.deadline.is_over:
            break
        context.tries -= 1
        rest = _rest(problem, context, first.scene, second_moves - 1)
        if rest is not None:
            moves = first.plan.moves + rest.moves
            if best is None or moves < best.moves:
                best = replace(first.plan, moves=moves)
            if best.moves <= len(first.plan.commitments.order) + 1:
                break
    return best


def _rest(problem: ClearingProblem, context: _Context, scene: Scene, second_moves: int) -> ClearancePlan | None:
    """A plan for the target from a scene on."""
    strategy, candidates = problem.strategy, context.candidates_afresh()
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
    return _plan(rest, context, second_moves) if second_moves else None


def _first_moves(problem: ClearingProblem, context: _Context) -> Iterator[_FirstMoves]:
    for commitments in alternatives(problem):
        if not isinstance(commitments, Commitments) or problem.deadline.is_over:
            return
        if all(context.is_usable(problem.scene, grasp) for grasp in commitments.grasps.values()):
            yield from _provisional(problem, context.order_by_task_plan(commitments))


def _provisional(problem: ClearingProblem, commitments: Commitments) -> Iterator[_FirstMoves]:
    """Clearances in order until an object finds no location; from there backwards, one put aside provisionally."""
    scenes, remaining = [problem.scene], [commitments]
    placements: list[tuple[str, Placement]] = []
    names = _names(problem.scene, commitments)
    for name in names:
        keep = keep_clear(problem.strategy, remaining[-1], name)
        done = simulate_clearance(problem, scenes[-1], remaining[-1], name, keep)
        if done is None:
            break
        placements.append((name, done[0]))
        scenes.append(done[1])
        remaining.append(remaining[-1].without(name))
    for turn in reversed(range(len(placements) + 1 if len(placements) < len(names) else 0)):
        for keep in _next_ones(commitments, names[turn + 1 :]):
            done = simulate_clearance(problem, scenes[turn], remaining[turn], names[turn], keep)
            if done is not None:
                chosen = MappingProxyType(dict([*placements[:turn], (names[turn], done[0])]))
                yield _FirstMoves(ClearancePlan(commitments, chosen, names[turn], turn + 1), done[1])


def _names(scene: Scene, commitments: Commitments) -> tuple[str, ...]:
    """The objects to put aside in order, first the one in the gripper."""
    held = () if scene.held is None else (scene.held.name,)
    return (*held, *commitments.order)


def _next_ones(commitments: Commitments, later: tuple[str, ...]) -> Iterator[KeepClear]:
    """What a provisional put-down keeps clear: all obstacles that follow, half of them, or the next one alone."""
    for count in dict.fromkeys((len(later), (len(later) + 1) // 2, 1)):
        if 0 < count <= len(later):
            yield KeepClear(None, tuple(commitments.grasps[name] for name in later[:count]))
