"""What the grasp references of Algorithm 1 stand for: commitments to grasps, and the facts that follow from them."""

from __future__ import annotations

from dataclasses import replace

from planners.cause import Cause
from planners.clearing.commitments import Commitments, NoCommitment
from planners.clock import cpu_seconds
from planners.scene import Scene
from planners.symbolic.checking import checked_answer
from planners.symbolic.problem import ROBOT_INIT_LOC, NoPlan, SymbolicState, TaskPlan, TaskProblem
from planners.symbolic.references import grasp_references
from planners.symbolic.transitions import GraspObstructed, update_from_error
from planners.tamp.arms import with_chosen_arms
from planners.tamp.solution import Infeasible
from planners.tamp.state import PlanState, Search, infeasible, out_of_time

__all__ = ["bind_grasps", "rebind_grasps", "task_plan"]


def bind_grasps(search: Search, symbols: SymbolicState, scene: Scene) -> PlanState | Infeasible:
    """Choose what the grasp references stand for; a strategy that plans ahead adds what obstructs these grasps."""
    before = cpu_seconds()

    def order_by_task_plan(commitments: Commitments) -> Commitments:
        """The commitments in the order in which the task planner clears."""
        return _in_planned_order(search, _with_obstructions(search, symbols, scene, commitments), commitments)

    symbols = replace(symbols, holds_aside=False)
    found = search.motion_layer.choose_grasps(
        search.strategy, scene, search.target, order_by_task_plan, search.clearances, search.hold_aside
    )
    search.motion_planning_s += cpu_seconds() - before
    if search.has_given_up:
        return out_of_time(search)
    if isinstance(found, NoCommitment):
        return infeasible(search, found.cause, _explain(found), found.objects)
    symbols = _with_obstructions(search, symbols, scene, found.commitments)
    return PlanState(replace(symbols, holds_aside=bool(found.aside)), scene, found)


def rebind_grasps(search: Search, symbols: SymbolicState, scene: Scene) -> PlanState | Infeasible:
    """Choose anew what the references stand for.

    The robot is said to be at `ROBOT_INIT_LOC`: the base-pose symbols are about to be rebound to other poses.
    """
    here = symbols.robot_at
    at_no_reference = symbols.changed(add={("robotAt", ROBOT_INIT_LOC)}, remove={("robotAt", here)})
    return bind_grasps(search, at_no_reference, scene)


def task_plan(search: Search, symbols: SymbolicState, aside: str = "") -> TaskPlan | NoPlan:
    """The task planner's answer for the target, checked; its time is counted. It does not put the object `aside` down.

    Raises:
        InvalidAnswerError: the task planner returned no valid answer.
    """
    before = cpu_seconds()
    offers = symbols.find("isClearanceLocation", None, aside, None) if aside else ()
    problem = TaskProblem(symbols.changed(remove=offers), search.target).pruned()
    time_limit = min(search.limits.task_planning_s, search.motion_layer.deadline.remaining)
    answer = search.task_planner.plan(problem, time_limit) if time_limit > 0 else NoPlan("gave up")
    search.task_planning_s += cpu_seconds() - before
    search.task_plans += 1
    checked = checked_answer(problem, answer, search.task_planner)
    search.has_given_up |= isinstance(checked, NoPlan) and checked.reason == "gave up"
    return checked


def _with_obstructions(search: Search, symbols: SymbolicState, scene: Scene, commitments: Commitments) -> SymbolicState:
    """Forget what obstructed earlier choices; a strategy that plans ahead says what obstructs these.

    Of a robot that acts with several arms the facts say which arm each choice is made for.
    """
    symbols = with_chosen_arms(symbols, scene, commitments)
    blockers = commitments.blockers(scene) if search.strategy.plans_ahead else {}
    obstructed = {trajectory for _, _, trajectory, _ in symbols.find("obstructs", None, None, None)}
    for name in scene.names:
        if blockers.get(name) or grasp_references(name).arm_trajectory in obstructed:
            symbols = update_from_error(symbols, GraspObstructed(name, frozenset(blockers.get(name, ()))))
    return symbols


def _in_planned_order(search: Search, symbols: SymbolicState, commitments: Commitments) -> Commitments:
    """The same commitments in the order of the task plan that follows from them."""
    skeleton = task_plan(search, symbols)
    if isinstance(skeleton, NoPlan):
        return commitments
    picked = [action.args[0] for action in skeleton.actions if action.name == "PickUp"]
    return replace(commitments, order=tuple(name for name in picked if name in commitments.order))


def _explain(found: NoCommitment) -> str:
    names = ", ".join(found.objects)
    return {
        Cause.UNREACHABLE: f"no free base pose and arm configuration reach {names}",
        Cause.NO_SELF_CLEARABLE_SET: f"whatever is removed first, something that must go before {names} is blocked",
        Cause.MOTION: f"without the grasps that motion planning refuted, there is no way to clear and take {names}",
        Cause.NO_CLEARANCE_LOCATION: f"no location for {names} that keeps clear of what remains to be done",
        Cause.TIME_LIMIT: f"the time was up before a way to take {names} was found",
    }[found.cause]
