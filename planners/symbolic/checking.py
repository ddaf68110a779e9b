"""Is what a task planner returned an answer to the problem? Built-in and user-written planners pass the same check."""

from __future__ import annotations

from collections.abc import Iterable
from typing import get_args

from planners.symbolic.diagnosis import why_unsolvable
from planners.symbolic.problem import GroundAction, NoPlan, Reason, TaskPlan, TaskPlanner, TaskProblem
from planners.symbolic.transitions import InapplicableActionError, update_from_action

__all__ = ["InvalidAnswerError", "checked_answer", "planner_name", "without_detours"]


class InvalidAnswerError(RuntimeError):
    """A task planner returned something that is no answer to its problem; the message says what and why."""


def checked_answer(problem: TaskProblem, answer: TaskPlan | NoPlan, planner: TaskPlanner) -> TaskPlan | NoPlan:
    """The same answer, without detours.

    Raises:
        InvalidAnswerError: neither a `TaskPlan` nor a `NoPlan`, or a plan with an action that is not applicable, or
            one that does not end with the target held; or a `NoPlan` with an unknown reason.
    """
    name = planner_name(planner)
    if isinstance(answer, NoPlan):
        return _checked_refusal(problem, answer, name)
    if not isinstance(answer, TaskPlan):
        raise InvalidAnswerError(
            f"plan() of the task planner {name} must return a TaskPlan or a NoPlan, not {answer!r}"
        )
    actions = without_detours(answer.actions)
    state = problem.state
    for number, action in enumerate(actions, start=1):
        try:
            state = update_from_action(state, action)
        except InapplicableActionError as error:
            raise InvalidAnswerError(f"step {number} of the plan of {name}: {error}") from error
    if problem.goal not in state.facts:
        raise InvalidAnswerError(f"the plan of {name} ends before {problem.target} is held")
    return TaskPlan(actions, answer.engine or name)


def _checked_refusal(problem: TaskProblem, answer: NoPlan, name: str) -> NoPlan:
    """The same refusal, with its cause where the planner named none but one of the usual causes can be shown."""
    if answer.reason not in get_args(Reason):
        raise InvalidAnswerError(f"{name}: no reason {answer.reason!r}; valid reasons: {', '.join(get_args(Reason))}")
    cause = why_unsolvable(problem) if answer.reason == "unsolvable" else None
    reason, evidence = cause or (answer.reason, answer.evidence)
    return NoPlan(reason, evidence, answer.engine or name)


def without_detours(actions: Iterable[GroundAction]) -> tuple[GroundAction, ...]:
    """The same plan with one base motion in place of several in a row: any base pose can be reached from any other."""
    kept: list[GroundAction] = []
    for action in actions:
        if action.name == "MoveBase" and kept and kept[-1].name == "MoveBase":
            start = kept.pop().args[0]
            action = GroundAction("MoveBase", (start, *action.args[1:]))
            if action.args[0] == action.args[1]:
                continue
        kept.append(action)
    return tuple(kept)


def planner_name(planner: TaskPlanner) -> str:
    """Its `name` if it has one, else the name of its class."""
    return str(getattr(planner, "name", type(planner).__name__))
