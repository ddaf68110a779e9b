"""Attempts: several runs of Algorithm 1 with different random choices, until another run could not improve the
result."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from planners.cause import Cause
from planners.clock import Deadline, cpu_seconds
from planners.problem import Problem
from planners.scene.bodies import leans
from planners.strategies import Strategy
from planners.symbolic.problem import TaskPlanner
from planners.tamp.algorithm1 import task_and_motion_plan
from planners.tamp.motion_layer import MotionLayer
from planners.tamp.solution import Infeasible, Solution
from planners.tamp.state import Search

_LIMITS = (Cause.TIME_LIMIT, Cause.GIVEN_UP)
"""Limits of time or effort. No other attempt follows them, and they prove nothing about the scene."""


def best_of_attempts(
    problem: Problem, strategy: Strategy, task_planner: TaskPlanner, rng: np.random.Generator, deadline: Deadline
) -> Solution | Infeasible:
    """Find the best plan among a strategy's attempts, or the reason why none was found.

    An end-effector-controlled robot first tries arm configurations near home: its controller keeps the joints there.
    """
    started, workspace = cpu_seconds(), problem.workspace
    first = [problem.near_home()] if workspace.follower is not None else []
    outcomes: list[Solution | Infeasible] = []
    is_proved = is_in_vain = False
    known = None
    for number, asked in enumerate([*first, *[problem] * strategy.attempts]):
        # A canonical plan depends on the scene alone, not on the state of the caller's generator.
        draws = np.random.default_rng(number) if workspace.canonical else rng
        # Grasps near home are not all grasps: another workspace has a cache of its own.
        known = known if known is not None and known.workspace is asked.workspace else None
        outcome, known = _attempt(asked, strategy, task_planner, draws, deadline, known)
        outcomes.append(outcome)
        is_in_vain = known.is_in_vain and not asked.workspace.near_home
        is_proved = is_in_vain or is_final(outcome, asked.workspace.near_home)
        if deadline.is_over or is_proved:
            break
    best = best_outcome(outcomes, is_proved, deadline)
    best = best if is_in_vain else _or_with_fewer_picks(best, problem, strategy, task_planner, rng, deadline)
    scene = problem.scene
    leaning = [one.name for one in scene.objects if one.name not in scene.held_names and leans(one)]
    if isinstance(best, Infeasible) and leaning:
        best = replace(best, detail=f"{best.detail}; neither upright nor lying: {', '.join(leaning)}")
    return replace(best, stats=replace(best.stats, total_s=cpu_seconds() - started))


def _attempt(
    problem: Problem,
    strategy: Strategy,
    task_planner: TaskPlanner,
    rng: np.random.Generator,
    deadline: Deadline,
    known: MotionLayer | None,
) -> tuple[Solution | Infeasible, MotionLayer]:
    """Run Algorithm 1 once, with the motion layer `known` from the run before it.

    With a target, a strategy that does not plan ahead starts each run afresh, as in the paper. Where motions are
    shortened, MuJoCo checks them once, at the end, as it rarely refutes one. If it does, the run is repeated with a
    check of each motion.
    """
    before, workspace, compiled = rng.bit_generator.state, problem.workspace, problem.compiled
    remembers = strategy.plans_ahead or not problem.target
    layer = MotionLayer(
        workspace, rng, compiled, deadline, problem.motions, problem.checkers, checks_at_end=workspace.shortens
    )
    layer = layer.with_known(known if remembers else None)
    outcome = task_and_motion_plan(Search(problem, strategy, task_planner, layer))
    if layer.is_refuted:
        # The repeated run makes the same random choices.
        rng.bit_generator.state = before
        layer = MotionLayer(workspace, rng, compiled, deadline, checkers=problem.checkers).with_known(
            layer if remembers else None
        )
        outcome = task_and_motion_plan(Search(problem, strategy, task_planner, layer))
    return outcome, layer


def _or_with_fewer_picks(
    found: Solution | Infeasible,
    problem: Problem,
    strategy: Strategy,
    task_planner: TaskPlanner,
    rng: np.random.Generator,
    deadline: Deadline,
) -> Solution | Infeasible:
    """The outcome, or a plan from many more base poses that has fewer picks, if the lower bound allows one.

    A plan from them alone is not always better: they include grasps to which no motion leads. Canonical plans stay as
    they are, so that they can be learned.
    """
    is_unplaced = _lacks_placements(found, problem, strategy)
    has_bound = found.bound is not None if isinstance(found, Solution) else found.cause.lies_in_grasps or is_unplaced
    if not has_bound:
        return found
    if deadline.is_over:
        return _without_closer_look(found, problem, deadline)
    bound = problem.lower_bound(deadline=deadline, is_exact=False)
    if isinstance(found, Solution):
        found = replace(found, bound=bound.met_by(found.picks))
    elif deadline.is_over:
        return _without_closer_look(found, problem, deadline)
    can_be_better = bound.picks is not None and (isinstance(found, Infeasible) or bound.least < found.picks)
    if not can_be_better or problem.workspace.canonical:
        return found
    outcome, _ = _attempt(problem.closer, strategy, task_planner, rng, deadline, None)
    # A refusal for want of grasps is refuted by the bound.
    best = best_outcome([found, outcome], False, deadline)
    if isinstance(best, Solution) and best.bound is not None:
        return replace(best, bound=bound.met_by(best.picks))
    return best


def _lacks_placements(found: Solution | Infeasible, problem: Problem, strategy: Strategy) -> bool:
    """Whether a refusal of a strategy that plans ahead is for want of put-downs, and more base poses may have some."""
    is_refused = isinstance(found, Infeasible) and found.cause is Cause.NO_CLEARANCE_LOCATION
    is_canonical = problem.workspace.canonical
    return is_refused and strategy.plans_ahead and not is_canonical and problem.candidates.can_look_closely


def _without_closer_look(found: Solution | Infeasible, problem: Problem, deadline: Deadline) -> Solution | Infeasible:
    """The outcome after the deadline: what it says of the base poses that plans begin with is not said of all."""
    if isinstance(found, Infeasible):
        is_proved = problem.workspace.canonical or not problem.candidates.can_look_closely
        return found if is_proved or found.cause is Cause.TOO_WIDE else best_outcome([found], False, deadline)
    bound = found.bound and problem.without_closer_look(found.bound)
    return replace(found, bound=bound and bound.met_by(found.picks))


def is_final(outcome: Solution | Infeasible, near_home: bool) -> bool:
    """Whether another attempt cannot improve the result.

    Another attempt can improve a plan that clears an object twice, or a plan with a refuted motion and more picks than
    the lower bound. A refusal for lack of grasps is final, unless only grasps near home were considered. A refusal for
    lack of a base path is final, too. After a limit, no attempt follows.
    """
    if isinstance(outcome, Solution):
        if outcome.bound is not None:
            return outcome.picks <= outcome.bound.least or not outcome.stats.replans
        return not outcome.duplicated
    is_over = outcome.cause in (*_LIMITS, Cause.NO_WAY_FOR_BASE)
    return (outcome.cause.lies_in_grasps and not near_home) or is_over


def best_outcome(
    outcomes: Sequence[Solution | Infeasible], is_proved: bool, deadline: Deadline
) -> Solution | Infeasible:
    """Choose the plan with the fewest objects cleared twice, then clearances, then picks. Without a plan, the last
    refusal.

    After the deadline, a refusal without a proof has the cause "time limit".
    """
    plans = [outcome for outcome in outcomes if isinstance(outcome, Solution)]
    if plans:
        return min(plans, key=lambda plan: (len(plan.duplicated), len(plan.clearances), plan.picks))
    refusals = [outcome for outcome in outcomes if isinstance(outcome, Infeasible)]
    last = refusals[-1]
    if last.cause in _LIMITS:
        cause, end = last.cause, last.detail
    elif deadline.is_over and not is_proved:
        cause, end = Cause.TIME_LIMIT, f"the time was up in attempt {len(outcomes)}"
    else:
        return last
    reasons = dict.fromkeys(f"{one.cause}: {one.detail}" for one in refusals if one.cause not in _LIMITS)
    return replace(last, cause=cause, detail="; before that, ".join([end, *reasons]))
