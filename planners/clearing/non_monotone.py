"""Non-monotone plans, which move an object twice, for scenes in which no monotone plan is found.

A plan is monotone if it moves each object once. Where some object finds no location that keeps clear of all that
remains to be done, an object is put aside provisionally: in the way of a later step, but not of the next ones. When it
comes to be in the way, it is moved again; by then there may be space that was needed before.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import replace
from types import MappingProxyType

from planners.clearing.commitments import ClearingProblem, Commitments
from planners.clearing.lookahead import (
    ClearancePlan,
    alternatives,
    commitments_for,
    simulate_clearance,
    simulate_until_stuck,
)
from planners.placing.surfaces import KeepClear
from planners.scene import Scene

_TRIES = 12
"""Scenes after a provisional put-down from which a plan for the rest is looked for, in one search."""
_REJECTIONS = 8
"""Times that grasps which cannot be used are taken out before a scene counts as without a plan."""
_SETS, _VARIATIONS = 3, 2
"""Sets and variations looked at for the rest, at most."""


def non_monotone_plan(problem: ClearingProblem, provisional: int) -> ClearancePlan | None:
    """The plan with the fewest clearances among those looked at; None if none is found.

    Plans with one provisional put-down are looked for before those with two, and so on. A plan ends with its first one:
    the rest, whose existence was checked, is chosen anew once it is carried out.

    Args:
        problem: for which no monotone plan was found.
        provisional: put-downs of that kind that the whole plan may have.
    """
    tries = iter(range(_TRIES))
    plans = (_best_plan(problem, tries, count) for count in range(1, provisional + 1))
    return next((plan for plan in plans if plan is not None), None)


def _best_plan(problem: ClearingProblem, tries: Iterator[int], provisional: int) -> ClearancePlan | None:
    """The best plan with so many provisional put-downs, as long as there are `tries` left."""
    best: ClearancePlan | None = None
    for first, scene in _first_moves(problem):
        if problem.deadline.is_over or next(tries, None) is None:
            break
        rest = _plan_rest(problem, tries, scene, provisional - 1)
        if rest is not None:
            moves = first.moves + rest.moves
            if best is None or moves < best.moves:
                best = replace(first, moves=moves)
            if best.moves <= len(first.commitments.order) + 1:
                break
    return best


def _plan_rest(problem: ClearingProblem, tries: Iterator[int], scene: Scene, provisional: int) -> ClearancePlan | None:
    """A plan for the target from a scene on, its grasps looked for anew."""
    strategy, candidates = problem.strategy, problem.candidates.blank_copy()
    less = replace(strategy, sets=min(strategy.sets, _SETS), variations=min(strategy.variations, _VARIATIONS))
    rest = replace(
        problem, scene=scene, candidates=candidates, reject=candidates.ban, strategy=less, left_alone=frozenset()
    )
    found = commitments_for(rest, _REJECTIONS)
    if isinstance(found, ClearancePlan):
        return found
    return _best_plan(rest, tries, provisional) if provisional else None


def _first_moves(problem: ClearingProblem) -> Iterator[tuple[ClearancePlan, Scene]]:
    """Clearances up to one that puts an object aside provisionally, and the scene after it.

    Of each usable alternative the objects are cleared in order until one finds no location; from there backwards, one
    of them is put aside provisionally.
    """
    for commitments in alternatives(problem):
        if not isinstance(commitments, Commitments) or problem.deadline.is_over:
            return
        if not all(problem.is_usable(problem.scene, grasp) for grasp in commitments.grasps.values()):
            continue
        commitments = problem.order_by_task_plan(commitments)
        names = (*problem.scene.held_names, *commitments.order)
        turns, placements = simulate_until_stuck(problem, commitments, names)
        if len(placements) == len(names):
            continue
        for count in reversed(range(len(placements) + 1)):
            name, before, later = names[count], turns[count], names[count + 1 :]
            # It keeps clear of all obstacles that follow, of half of them, or of the next one alone.
            for number in dict.fromkeys((len(later), (len(later) + 1) // 2, 1)):
                if not 0 < number <= len(later):
                    continue
                keep = KeepClear(None, tuple(commitments.grasps[other] for other in later[:number]))
                done = simulate_clearance(problem, before.scene, before.remaining, name, keep)
                if done is not None:
                    chosen = {**dict(itertools.islice(placements.items(), count)), name: done[0]}
                    yield ClearancePlan(commitments, MappingProxyType(chosen), name, count + 1), done[1]
