"""Several runs of Algorithm 1 in one solve: when another one could do no better, and which result counts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from planners.cause import Cause
from planners.clock import Deadline
from planners.tamp.motion_layer import MotionLayer
from planners.tamp.solution import Infeasible, Solution

__all__ = ["best_outcome", "is_final"]


def is_final(outcome: Solution | Infeasible, motion_layer: MotionLayer) -> bool:
    """Whether another attempt could do no better.

    A plan that clears an object twice can be improved on. A refusal cannot if it follows from all grasps, as it does
    with two of the causes; configurations near home only are not all. At a limit there is no time for another attempt.
    """
    if isinstance(outcome, Solution):
        return not outcome.duplicated
    is_proved = outcome.cause.lies_in_grasps and not motion_layer.candidates.config.near_home
    return is_proved or outcome.cause is Cause.TIME_LIMIT


def best_outcome(
    outcomes: Sequence[Solution | Infeasible], is_proved: bool, deadline: Deadline
) -> Solution | Infeasible:
    """The plan with the fewest objects cleared twice, of these one with the fewest clearances; or why there is none.

    Args:
        outcomes: of the attempts, at least one, in order.
        is_proved: whether the last one is final.
        deadline: once it is over, a refusal that is not proved has the cause "time limit".
    """
    plans = [outcome for outcome in outcomes if isinstance(outcome, Solution)]
    if plans:
        return min(plans, key=lambda plan: (len(plan.duplicated), len(plan.clearances)))
    refusals = [outcome for outcome in outcomes if isinstance(outcome, Infeasible)]
    last = refusals[-1]
    is_cut_short = last.cause is Cause.TIME_LIMIT or (deadline.is_over and not is_proved)
    if not is_cut_short:
        return last
    reasons = dict.fromkeys(f"{one.cause}: {one.detail}" for one in refusals if one.cause is not Cause.TIME_LIMIT)
    end = last.detail if last.cause is Cause.TIME_LIMIT else f"the time was up in attempt {len(outcomes)}"
    return replace(last, cause=Cause.TIME_LIMIT, detail="; before that, ".join([end, *reasons]))
