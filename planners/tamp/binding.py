"""Binding of references: grasps are chosen for all of them at once, motions action by action."""

from __future__ import annotations

from dataclasses import replace

from assets.robots import RobotSpec
from planners.cause import Cause
from planners.clearing.commitments import Commitments, NoCommitment
from planners.clearing.lookahead import keep_clear
from planners.clock import cpu_seconds
from planners.motion.path import NoPath
from planners.scene import Scene
from planners.symbolic.engines import checked_answer
from planners.symbolic.problem import (
    GRIPPER,
    ROBOT_INIT_LOC,
    GroundAction,
    NoPlan,
    SymbolicState,
    TaskPlan,
    TaskProblem,
)
from planners.symbolic.transitions import GraspObstructed, grasp_references, reached_by, update_from_error
from planners.tamp.motion_layer import BoundMotion
from planners.tamp.solution import Infeasible
from planners.tamp.state import TASK_PLANNING_S, PlanState, Refutation, Search

_GRASP_POSE, _PUT_DOWN_POSE = "robot_gp_", "robot_pdp_"


def bind_grasps(search: Search, symbols: SymbolicState, scene: Scene) -> PlanState | Infeasible:
    """Choose what the grasp references stand for; a strategy that plans ahead adds what obstructs these grasps."""
    before, task_planning_before = cpu_seconds(), search.task_planning_s

    def order_by_task_plan(commitments: Commitments) -> Commitments:
        """The commitments in the order in which the task planner clears."""
        skeleton = task_plan(search, _with_obstructions(search, symbols, scene, commitments))
        if isinstance(skeleton, NoPlan):
            return commitments
        picked = [action.args[0] for action in skeleton.actions if action.name == "PickUp"]
        return replace(commitments, order=tuple(name for name in picked if name in commitments.order))

    symbols = replace(symbols, holds_aside=False)
    found = search.motion_layer.choose_grasps(
        search.strategy, scene, search.target, order_by_task_plan, search.clearances, search.hold_aside
    )
    # The order comes from the task planner, whose time is counted where it is called.
    ordering = search.task_planning_s - task_planning_before
    search.motion_planning_s += cpu_seconds() - before - ordering
    if search.has_given_up:
        return search.out_of_time()
    if isinstance(found, NoCommitment):
        names = ", ".join(found.objects)
        detail = {
            Cause.UNREACHABLE: f"no free base pose and arm configuration reach {names}",
            Cause.NO_WAY_FOR_BASE: f"from where the robot is, the base cannot drive to where it could take {names}",
            Cause.NO_SELF_CLEARABLE_SET: f"whatever is removed first, something that must go before {names} is blocked",
            Cause.MOTION: f"without the grasps that motion planning refuted, there is no way to clear and take {names}",
            Cause.NO_CLEARANCE_LOCATION: f"no location for {names} that keeps clear of what remains to be done",
            Cause.TIME_LIMIT: f"the time was up before a way to take {names} was found",
        }[found.cause]
        return search.infeasible(found.cause, detail, found.objects)
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
    time_limit = min(TASK_PLANNING_S, search.motion_layer.deadline.remaining)
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
    if scene.robot.acts_with_all_arms:
        for name, grasp in commitments.grasps.items():
            symbols = reached_by(symbols, name, gripper_symbol(scene.robot, grasp.arm))
    blockers = commitments.blockers(scene) if search.strategy.plans_ahead else {}
    obstructed = {trajectory for _, _, trajectory, _ in symbols.find("obstructs", None, None, None)}
    for name in scene.names:
        if blockers.get(name) or grasp_references(name).arm_trajectory in obstructed:
            symbols = update_from_error(symbols, GraspObstructed(name, frozenset(blockers.get(name, ()))))
    return symbols


def gripper_symbol(robot: RobotSpec, arm: str) -> str:
    """The symbol of an arm's gripper: `GRIPPER` of a robot that acts with one arm."""
    return f"{arm}_gripper" if robot.acts_with_all_arms else GRIPPER


def bind_action(search: Search, state: PlanState, action: GroundAction) -> BoundMotion | Refutation | Infeasible:
    """The motion that an action's references are bound to, or what refutes it.

    A put-down is bound together with the base motion that leads to it: of the placements that a location symbol may
    stand for, the first one is taken for which both motions exist.
    """
    match action:
        case GroundAction("MoveBase", (_, pose, _)) if pose.startswith(_GRASP_POSE):
            return _drive_to_grasp(search, state, action, pose.removeprefix(_GRASP_POSE))
        case GroundAction("MoveBase", (_, pose, _)):
            return _drive_to_put_down(search, state, pose.removeprefix(_PUT_DOWN_POSE))
        case GroundAction("PickUp", (name, *_)):
            return _pick_up(search, state, action, name)
        case _:
            return state.put_downs[action.args[-1]]


def _drive_to_grasp(search: Search, state: PlanState, action: GroundAction, name: str) -> BoundMotion | Refutation:
    """Drive to the base pose of the grasp committed to; a grasp without a free path is not offered again."""
    grasp = state.clearance_plan.commitments.grasps.get(name)
    if grasp is None:
        return Refutation(action)
    driven = search.motion_layer.drive_to_grasp(state.scene, grasp)
    if isinstance(driven, BoundMotion):
        return driven
    search.motion_layer.ban(state.scene, grasp)
    return Refutation(action, reason=driven.reason)


def _drive_to_put_down(search: Search, state: PlanState, location: str) -> BoundMotion | Infeasible:
    """Drive to the base pose of the first placement that can be driven to and carried out."""
    name = next(name for _, _, name, _ in state.symbols.find("isGrasp", None, None, location))
    motion_layer, scene = search.motion_layer, state.scene.holding(name)
    assert scene is not None
    clear_of = keep_clear(search.strategy, state.clearance_plan.commitments, name)
    planned = state.clearance_plan.placements.get(name)
    for placement in motion_layer.placements(scene, clear_of, search.strategy, planned):
        if search.is_late:
            break
        driven = motion_layer.drive_to_placement(scene, placement)
        if isinstance(driven, BoundMotion):
            put_down = motion_layer.put_down(driven.scene, placement)
            if isinstance(put_down, BoundMotion):
                return replace(driven, location=location, put_down=put_down)
    if search.is_late:
        return search.out_of_time()
    detail = f"no location for {name} that keeps clear of what remains to be done"
    return search.infeasible(Cause.NO_CLEARANCE_LOCATION, detail, (name,))


def _pick_up(search: Search, state: PlanState, action: GroundAction, name: str) -> BoundMotion | Refutation:
    """Take an object through the grasp committed to.

    What is hit at the grasp itself becomes a fact. What is only in the way of the motion to or from it is remembered
    with the grasp, and other grasps are compared with it; a grasp without any motion is not offered again.
    """
    grasp = state.clearance_plan.commitments.grasps[name]
    picked = search.motion_layer.pick_up(state.scene, grasp)
    if isinstance(picked, BoundMotion):
        return picked
    if isinstance(picked, NoPath):
        search.motion_layer.ban(state.scene, grasp)
        return Refutation(action, reason=picked.reason)
    reason = f"{picked.phase}: {', '.join(sorted(picked.blockers))} in the way"
    if picked.phase == "grasp":
        return Refutation(action, frozenset(picked.blockers), reason)
    search.motion_layer.obstruct(state.scene, grasp, picked.blockers)
    return Refutation(action, reason=reason)
