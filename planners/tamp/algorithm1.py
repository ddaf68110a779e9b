"""Algorithm 1 of Lee & Kim 2019: a task plan with references, bound or refuted action by action, then replanned.

`task_and_motion_plan` is the algorithm; the names of its steps are the paper's. What they pass on is in `tamp_state`.
"""

from __future__ import annotations

import time
from dataclasses import replace
from types import MappingProxyType

from planners.cause import Cause
from planners.clearing.commitments import Commitments, NoCommitment
from planners.scene import Scene
from planners.symbolic.checking import checked_answer
from planners.symbolic.problem import (
    ROBOT_INIT_LOC,
    GroundAction,
    NoPlan,
    SymbolicState,
    TaskPlan,
    TaskProblem,
    format_atom,
)
from planners.symbolic.references import grasp_references
from planners.symbolic.transitions import (
    GraspObstructed,
    LocationRefuted,
    obstruction_problem,
    update_from_action,
    update_from_error,
)
from planners.tamp.binding import bind_action
from planners.tamp.motion_layer import BoundMotion
from planners.tamp.solution import BoundAction, Infeasible, ReplanRecord, Solution
from planners.tamp.state import PlanState, Refutation, Search, infeasible, stats

__all__ = ["task_and_motion_plan"]


def task_and_motion_plan(search: Search, scene: Scene) -> Solution | Infeasible:
    """Algorithm 1: plan symbolically, bind each action to a motion, replan with what a refuted one taught.

    Args:
        search: target, strategy, task planner and motion layer; its plan is extended.
        scene: where to start; the robot in its home configuration.
    """
    state = initial_state(search, scene)
    while isinstance(state, PlanState) and not is_goal(search, state):
        skeleton = call_task_planning(search, state)
        if isinstance(skeleton, Infeasible):
            return skeleton
        for index, action in enumerate(skeleton.actions):
            motion = call_motion_planning(search, state, action)
            if isinstance(motion, BoundMotion):
                bind_references(search, state.scene, action, motion)
                state = update_initial_state_from_action(state, action, motion)
            else:
                before, state = state, update_initial_state_from_error(search, state, motion)
                record(search, skeleton, index, motion, before, state)
                break
    return (
        state
        if isinstance(state, Infeasible)
        else Solution(tuple(search.plan), tuple(search.clearances), stats(search), search.target, search.strategy)
    )


def initial_state(search: Search, scene: Scene) -> PlanState | Infeasible:
    """The facts that the scene gives; a strategy that plans ahead adds what obstructs the grasps it committed to."""
    held = scene.held.name if scene.held else None
    problem = obstruction_problem(search.target, {}, objects=scene.names, held=held, held_obstructs=search.target)
    return _commit(search, problem.state, scene)


def is_goal(search: Search, state: PlanState) -> bool:
    """Whether the target is held."""
    return TaskProblem(state.symbols, search.target).is_solved


def call_task_planning(search: Search, state: PlanState) -> TaskPlan | Infeasible:
    """The skeleton T, or why there is none."""
    if (
        search.motion_layer.is_timed_out()
        or len(search.history) >= search.limits.task_plans
        or len(search.clearances) >= search.limits.clearances
    ):
        counts = f"{len(search.history)} replans and {len(search.clearances)} clearances"
        return infeasible(search, Cause.TIME_LIMIT, f"given up after {counts}", ())
    found = _task_plan(search, state.symbols)
    if isinstance(found, NoPlan):
        cause = {
            "cyclic": Cause.NO_SELF_CLEARABLE_SET,
            "no location": Cause.NO_CLEARANCE_LOCATION,
            "gave up": Cause.TIME_LIMIT,
        }.get(found.reason, Cause.UNREACHABLE)
        return infeasible(search, cause, f"{found.engine} found no task plan: {found.reason}", found.evidence)
    return found


def call_motion_planning(
    search: Search, state: PlanState, action: GroundAction
) -> BoundMotion | Refutation | Infeasible:
    """A motion behind the action's references, or what refutes it."""
    before = time.process_time()
    try:
        return bind_action(search, state, action)
    finally:
        search.motion_planning_s += time.process_time() - before


def bind_references(search: Search, scene: Scene, action: GroundAction, motion: BoundMotion) -> None:
    """F ← F + action, its references bound in the scene before it."""
    search.plan.append(BoundAction(action.name, action.args, motion.trajectory, scene, action.object or ""))
    if action.name.startswith("PutDown"):
        search.clearances.append(action.args[0])


def update_initial_state_from_action(state: PlanState, action: GroundAction, motion: BoundMotion) -> PlanState:
    """s0 after the action: its effects on the facts, and the scene it leaves."""
    clearance_plan, places = state.clearance_plan, state.places
    if action.name.startswith("PutDown"):
        clearance_plan = clearance_plan.without(action.args[0])
    if motion.placement is not None:
        places = MappingProxyType({**places, motion.location: motion.placement})
    return PlanState(update_from_action(state.symbols, action), motion.scene, clearance_plan, places)


def update_initial_state_from_error(
    search: Search, state: PlanState, error: Refutation | Infeasible
) -> PlanState | Infeasible:
    """s0 with what the refuted motion taught: what obstructs it, or that its references must mean something else."""
    if isinstance(error, Infeasible):
        return error
    match error:
        case Refutation(GroundAction("PickUp", (name, *_)), blockers) if blockers:
            obstructed = update_from_error(state.symbols, GraspObstructed(name, blockers))
            if blockers <= set(state.clearance_plan.commitments.grasps):
                return replace(state, symbols=obstructed)
            return _commit(search, _standing_anywhere(obstructed), state.scene)
        case Refutation(GroundAction("PutDownForClearance" | "PutDownGeneral", (name, *_, location))):
            return replace(state, symbols=update_from_error(state.symbols, LocationRefuted(name, location)))
        case _:
            return _commit(search, _standing_anywhere(state.symbols), state.scene)


def record(
    search: Search,
    skeleton: TaskPlan,
    verified: int,
    error: Refutation | Infeasible,
    before: PlanState,
    after: PlanState | Infeasible,
) -> None:
    """Keep what this turn of the loop tried and learnt, as in Fig. 11."""
    new = after.symbols.facts - before.symbols.facts if isinstance(after, PlanState) else frozenset()
    refuted = str(error.action) if isinstance(error, Refutation) else error.detail
    plan = tuple(str(action) for action in skeleton.actions)
    search.history.append(ReplanRecord(plan, verified, refuted, tuple(sorted(format_atom(fact) for fact in new))))


def _commit(search: Search, symbols: SymbolicState, scene: Scene) -> PlanState | Infeasible:
    """Decide what the grasp references stand for; who plans ahead tells the task planner what that means."""
    before = time.process_time()

    def arrange(commitments: Commitments) -> Commitments:
        return _in_planned_order(search, _with_obstructions(search, symbols, scene, commitments), commitments)

    found = search.motion_layer.choose_grasps(search.strategy, scene, search.target, arrange, search.clearances)
    search.motion_planning_s += time.process_time() - before
    if isinstance(found, NoCommitment):
        return infeasible(search, found.cause, _explain(found), found.objects)
    return PlanState(_with_obstructions(search, symbols, scene, found.commitments), scene, found)


def _with_obstructions(search: Search, symbols: SymbolicState, scene: Scene, commitments: Commitments) -> SymbolicState:
    """Forget what obstructed earlier choices; a strategy that plans ahead says what obstructs these."""
    blockers = commitments.blockers(scene) if search.strategy.plans_ahead else {}
    obstructed = {trajectory for _, _, trajectory, _ in symbols.find("obstructs", None, None, None)}
    for name in scene.names:
        if blockers.get(name) or grasp_references(name).arm_trajectory in obstructed:
            symbols = update_from_error(symbols, GraspObstructed(name, frozenset(blockers.get(name, ()))))
    return symbols


def _in_planned_order(search: Search, symbols: SymbolicState, commitments: Commitments) -> Commitments:
    """The same commitments in the order of the task plan that follows from them."""
    skeleton = _task_plan(search, symbols)
    if isinstance(skeleton, NoPlan):
        return commitments
    picked = [action.args[0] for action in skeleton.actions if action.name == "PickUp"]
    return replace(commitments, order=tuple(name for name in picked if name in commitments.order))


def _task_plan(search: Search, symbols: SymbolicState) -> TaskPlan | NoPlan:
    before = time.process_time()
    problem = TaskProblem(symbols, search.target).pruned()
    answer = search.task_planner.plan(problem, search.limits.task_planning_s)
    search.task_planning_s += time.process_time() - before
    search.task_plans += 1
    return checked_answer(problem, answer, search.task_planner)


def _explain(found: NoCommitment) -> str:
    names = ", ".join(found.objects)
    return {
        Cause.UNREACHABLE: f"no free base pose and arm configuration reach {names}",
        Cause.NO_SELF_CLEARABLE_SET: f"whatever is removed first, something that must go before {names} is blocked",
        Cause.NO_CLEARANCE_LOCATION: f"no place on the table for {names} that keeps clear of what remains to be done",
    }.get(found.cause, found.cause)


def _standing_anywhere(symbols: SymbolicState) -> SymbolicState:
    """The robot where it is, but under no base pose's name: those are about to mean other poses."""
    here = symbols.robot_at
    return symbols.changed(add={("robotAt", ROBOT_INIT_LOC)}, remove={("robotAt", here)})
