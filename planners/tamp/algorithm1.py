"""Algorithm 1 of Lee & Kim 2019: plan with references, bind action by action, replan where motion planning fails.

`task_and_motion_plan` is the algorithm. The functions below it are its steps, under the paper's names. They pass on the
state of `planners.tamp.state`. `planners.tamp.binding` binds the references to grasps and motions.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from types import MappingProxyType

import numpy as np

from planners.cause import Cause
from planners.clearing.commitments import NoCommitment
from planners.clock import cpu_seconds
from planners.goals import LIFTED, Holding, height_below
from planners.scene import Scene
from planners.symbolic.problem import ROBOT_INIT_LOC, GroundAction, TaskPlan, TaskProblem, format_atom
from planners.symbolic.transitions import (
    GraspObstructed,
    grasp_references,
    initial_state as symbolic_state,
    update_from_action,
    update_from_error,
)
from planners.tamp.binding import bind_action, bind_grasps, gripper_symbol, rebind_grasps, task_plan
from planners.tamp.explain import explain
from planners.tamp.motion_layer import BoundMotion
from planners.tamp.solution import BoundAction, Infeasible, ReplanRecord, Solution
from planners.tamp.state import MAX_ASIDE, MAX_CLEARANCES, MAX_REPLANS, PlanState, Refutation, Search, as_seen

_CAUSES = {
    "cyclic": Cause.NO_SELF_CLEARABLE_SET,
    "no grasp": Cause.UNREACHABLE,
    "no location": Cause.NO_CLEARANCE_LOCATION,
    "unsolvable": Cause.MOTION,
    "gave up": Cause.TIME_LIMIT,
}
"""Cause of the whole solve for each reason that a task planner gives."""


def task_and_motion_plan(search: Search) -> Solution | Infeasible:
    """Run Algorithm 1: plan with references, bind the actions to motions one by one, replan after a refuted action.

    Args:
        search: problem, strategy, task planner and motion layer. Its plan F is extended.
    """
    state = initial_state(search)
    if isinstance(state, PlanState):
        state = raise_target(search, state)
    while isinstance(state, PlanState) and not is_goal(search, state):
        plan = call_task_planning(search, state)
        if isinstance(plan, Infeasible):
            return plan
        for verified, action in enumerate(plan.actions):
            motion = call_motion_planning(search, state, action)
            if isinstance(motion, BoundMotion):
                bind_references(search, state.scene, action, motion)
                state = update_initial_state_from_action(state, action, motion)
            else:
                # The refutation changes facts or grasps, so the rest of the task plan is void.
                before = take_back_drive(search, state)
                state = update_initial_state_from_error(search, before, motion)
                record(search, plan, verified, motion, before, state)
                break
        else:
            if not is_goal(search, state):
                state = finish(search, state, plan)
    if isinstance(state, Infeasible):
        return state
    actions, end = shorten_plan(search, state.scene), as_seen(state.scene)
    clearances, bound = tuple(search.clearances), search.bound
    grasps = search.motion_layer.workspace.families
    found = Solution(
        actions, clearances, search.stats(), search.target, search.strategy, search.goal, bound, end, grasps
    )
    return found if bound is None else replace(found, bound=bound.met_by(found.picks))


def initial_state(search: Search) -> PlanState | Infeasible:
    """Initial state s0: the facts of the scene, with grasp references bound, or the reason for a refusal."""
    scene = search.problem.scene
    robot = scene.robot
    if not search.is_greedy:
        before = cpu_seconds()
        search.bound = search.motion_layer.lower_bound(search.problem)
        search.counts.motion_planning_s += cpu_seconds() - before
        if search.bound.picks is None and search.bound.proved:
            # A proof that no plan exists ends the search before any motion is planned.
            none = NoCommitment(Cause(search.bound.cause), search.bound.objects)
            return explain(search, scene, none)
        if kept_out := search.kept_out(scene):
            return explain(search, scene, NoCommitment(Cause.NO_CLEARANCE_LOCATION, kept_out, is_in_vain=True))
    held = {gripper_symbol(robot, one.arm): one.held.name for one in scene.aside}
    if scene.held is not None:
        held = {gripper_symbol(robot, robot.arm_name): scene.held.name, **held}
    grippers = [gripper_symbol(robot, arm) for arm in robot.acting_arms]
    return bind_grasps(
        search, symbolic_state(scene.names, held, grippers, held_obstructs=search.target * search.is_greedy), scene
    )


def is_goal(search: Search, state: PlanState) -> bool:
    """Whether s0 satisfies g: the target is held, or the goal's facts hold in the geometry of the scene."""
    if search.is_greedy:
        return TaskProblem(state.symbols, search.target).is_solved
    return search.goal.holds(as_seen(state.scene), search.problem.start)


def raise_target(search: Search, state: PlanState) -> PlanState:
    """Append the arm motion that holds an object where the goal wants it, if nothing else of the goal is unmet.

    If the goal gives a point, the arm brings the object there. Otherwise the arm goes home if the object is not lifted
    yet, as after a plan that was ended early. Without need or without such a motion, F and s0 stay as they are.
    """
    to_hold = next((fact for fact in search.goal.facts if isinstance(fact, Holding)), None)
    scene = None if to_hold is None else state.scene.holding(to_hold.object)
    now = as_seen(state.scene)
    if to_hold is None or scene is None or set(search.goal.unmet(now, search.problem.start)) - {to_hold}:
        return state
    in_hand = now.body(to_hold.object)
    if to_hold.point is not None:
        found = None if to_hold.holds(now) else search.motion_layer.hold_at(scene, np.array(to_hold.point))
    else:
        is_up = in_hand.bottom >= height_below(scene, in_hand) + LIFTED
        found = None if is_up else search.motion_layer.bring_home(scene)
    if not isinstance(found, BoundMotion):
        return state
    symbols = (ROBOT_INIT_LOC, ROBOT_INIT_LOC, grasp_references(to_hold.object).base_trajectory)
    search.plan.append(BoundAction("MoveBase", symbols, found.trajectory, scene))
    return replace(state, scene=found.scene)


def finish(search: Search, state: PlanState, plan: TaskPlan) -> PlanState | Infeasible:
    """Raise the held object, or move it to its point, after the task plan. If the goal is still unmet, plan again."""
    state = raise_target(search, state)
    if is_goal(search, state):
        return state
    if not plan.actions:
        held = search.goal.held
        return search.infeasible(Cause.MOTION, f"no motion of the arm holds {', '.join(held)} where it is to be", held)
    return rebind_grasps(search, state.symbols, state.scene, state.clearance_plan)


def call_task_planning(search: Search, state: PlanState) -> TaskPlan | Infeasible:
    """T = callTaskPlanning(A, s0, g): the task plan, or the reason for its absence."""
    put_down = Counter(action.target for action in search.plan if action.name.startswith("PutDown"))
    is_too_often = put_down.total() - len(search.goal.placed) >= MAX_CLEARANCES
    is_too_often |= not search.is_greedy and max(put_down.values(), default=0) > MAX_ASIDE
    if search.is_late or len(search.history) >= MAX_REPLANS or is_too_often:
        return search.out_of_time(state.scene)
    found = task_plan(search, state)
    if isinstance(found, TaskPlan):
        return found
    if found.reason == "gave up" and search.is_late:
        return search.out_of_time()
    detail = f"{found.engine} found no task plan: {found.reason}"
    return search.infeasible(_CAUSES[found.reason], detail, found.evidence)


def call_motion_planning(
    search: Search, state: PlanState, action: GroundAction
) -> BoundMotion | Refutation | Infeasible:
    """t, e = callMotionPlanning(p0, P): a motion for the action's references, or a refutation of the action."""
    if search.is_late:
        return search.out_of_time()
    before = cpu_seconds()
    try:
        return bind_action(search, state, action)
    finally:
        search.counts.motion_planning_s += cpu_seconds() - before


def bind_references(search: Search, scene: Scene, action: GroundAction, motion: BoundMotion) -> None:
    """F ← F + action, with its references bound in the scene before the action."""
    moved, scene = action.object or "", motion.before or scene
    search.plan.append(BoundAction(action.name, action.args, motion.trajectory, scene, moved, motion.surfaces))
    if action.name == "PutDownForClearance" or (action.name == "PutDownGeneral" and search.target):
        search.clearances.append(action.args[0])
    if action.name.startswith("PutDown"):
        search.not_placed = search.not_placed.without_blocker(moved)


def take_back_drive(search: Search, state: PlanState) -> PlanState:
    """Take a drive out of F and s0 if the action after it was refuted.

    Strategies that do not plan ahead keep the drive, as the paper does.
    """
    if not search.strategy.plans_ahead or not search.plan or search.plan[-1].name != "MoveBase":
        return state
    drive = search.plan.pop()
    symbols = state.symbols.changed(add={("robotAt", drive.args[0])}, remove={("robotAt", drive.args[1])})
    return replace(state, symbols=symbols, scene=drive.scene)


def update_initial_state_from_action(state: PlanState, action: GroundAction, motion: BoundMotion) -> PlanState:
    """s0 = updateInitialStateFromAction(s0, a): apply the action's effects to facts and scene."""
    clearance_plan, put_downs = state.clearance_plan, state.put_downs
    if action.name.startswith("PutDown"):
        clearance_plan = clearance_plan.without(action.args[0])
    if motion.put_down is not None:
        put_downs = MappingProxyType({**put_downs, motion.location: motion.put_down})
    return replace(
        state,
        symbols=update_from_action(state.symbols, action),
        scene=motion.scene,
        clearance_plan=clearance_plan,
        put_downs=put_downs,
    )


def update_initial_state_from_error(
    search: Search, state: PlanState, error: Refutation | Infeasible
) -> PlanState | Infeasible:
    """s0 = updateInitialStateFromError(s0, e): add blocking objects as facts, or bind the grasp references again."""
    if isinstance(error, Infeasible):
        return error
    is_aside_in_hand = state.clearance_plan.aside in state.scene.held_names
    if is_aside_in_hand:
        search.holds_aside = False
    # A strategy that plans ahead has kept the blockers with the grasp already: it only has to choose again.
    if is_aside_in_hand or not error.blockers or not search.is_greedy:
        return rebind_grasps(search, state.symbols, state.scene)
    obstructed = update_from_error(state.symbols, GraspObstructed(error.action.args[0], error.blockers))
    # The chosen grasps already include one for each blocker: the new facts suffice.
    if error.blockers <= set(state.clearance_plan.commitments.grasps):
        return replace(state, symbols=obstructed)
    return rebind_grasps(search, obstructed, state.scene)


def shorten_plan(search: Search, end: Scene) -> tuple[BoundAction, ...]:
    """Shorten F in simulated time.

    F stays as it is under end-effector control and in canonical plans: their robot rests between actions.
    """
    if not search.motion_layer.workspace.shortens:
        return tuple(search.plan)
    before = cpu_seconds()
    actions = search.motion_layer.shortened(search.plan, end)
    search.counts.motion_planning_s += cpu_seconds() - before
    return actions


def record(
    search: Search,
    skeleton: TaskPlan,
    verified: int,
    error: Refutation | Infeasible,
    before: PlanState,
    after: PlanState | Infeasible,
) -> None:
    """Record what this turn of the loop tried and learnt, as in Fig. 11."""
    new = after.symbols.facts - before.symbols.facts if isinstance(after, PlanState) else frozenset()
    refuted, reason = (str(error.action), error.reason) if isinstance(error, Refutation) else (error.detail, "")
    plan = tuple(str(action) for action in skeleton.actions)
    facts = tuple(sorted(format_atom(fact) for fact in new))
    search.history.append(ReplanRecord(plan, verified, refuted, facts, reason))
