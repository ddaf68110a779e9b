"""Binding of references: to grasps for all of them at once, to motions action by action."""

from __future__ import annotations

from dataclasses import replace

from assets.robots import RobotSpec
from planners.cause import Cause
from planners.clearing.clearance_plan import ClearancePlan, as_plan
from planners.clearing.commitments import Commitments, NoCommitment, keep_clear
from planners.clearing.moves import MoveMaker
from planners.clock import cpu_seconds
from planners.goals import Goal, Holding
from planners.motion.approaches import is_handle
from planners.motion.path import BlockedBy, NoPath
from planners.placing.placements import Placement
from planners.scene import Scene
from planners.symbolic.engines import answer_of
from planners.symbolic.problem import (
    GRIPPER,
    ROBOT_INIT_LOC,
    GroundAction,
    NoPlan,
    SymbolicState,
    TaskPlan,
    TaskProblem,
)
from planners.symbolic.transitions import (
    GraspObstructed,
    Moved,
    reached_by,
    update_from_error,
    with_moves,
)
from planners.tamp.explain import explain
from planners.tamp.motion_layer import BoundMotion
from planners.tamp.solution import Infeasible
from planners.tamp.state import TASK_PLANNING_S, PlanState, Refutation, Search, as_seen

_GRASP_POSE, _PUT_DOWN_POSE = "robot_gp_", "robot_pdp_"


def bind_grasps(
    search: Search, symbols: SymbolicState, scene: Scene, before_it: ClearancePlan | None = None
) -> PlanState | Infeasible:
    """Choose grasps for the grasp references. A strategy that plans ahead chooses all moves.

    If all objects are where the plan `before_it` expects them, its later moves are kept.
    """
    before = cpu_seconds()
    if search.is_greedy:
        found = search.motion_layer.choose_grasps(search.strategy, scene, search.target, search.clearances)
    elif before_it is not None and before_it.begins_in(scene):
        found = as_plan(search.motion_layer.candidates, scene, before_it.later)
    else:
        found = search.motion_layer.plan_goal(_maker(search), scene)
    search.counts.motion_planning_s += cpu_seconds() - before
    if isinstance(found, NoCommitment):
        return explain(search, scene, found)
    if not search.is_greedy:
        return _with_moves(search, symbols, scene, found)
    for name in sorted(_obstructed(symbols) & {*scene.names}):
        # Forget earlier choices: the facts "obstructs" of this object belong to them.
        symbols = update_from_error(symbols, GraspObstructed(name, frozenset()))
    return PlanState(_with_arms(symbols, scene, found.commitments), scene, found)


def _obstructed(symbols: SymbolicState) -> set[str]:
    """Names of the objects that have a fact "obstructs"."""
    return {name for _, _, _, name in symbols.find("obstructs", None, None, None)}


def _maker(search: Search) -> MoveMaker:
    goal, start = search.goal, search.problem.start
    return search.motion_layer.maker(search.strategy, goal, start, search.not_placed, search.holds_aside)


def _with_moves(search: Search, symbols: SymbolicState, scene: Scene, found: ClearancePlan) -> PlanState | Infeasible:
    """s0 with the planned moves as facts, and with the facts to plan for."""
    lacking = () if found.until else search.goal.unmet(as_seen(scene), search.problem.start)
    if lacking:
        unmet = " ".join(Goal((fact,)).to_pddl() for fact in lacking)
        return search.infeasible(Cause.MOTION, f"the plan ends without {unmet}", ())
    symbols = _with_arms(symbols, scene, found.commitments)
    blockers = {name: set(names) & set(found.until) for name, names in found.commitments.blockers(scene).items()}
    moves: list[Moved] = []
    rest = [fact.object for fact in search.goal.placed if fact.object not in found.until]
    for index, name in enumerate(found.until):
        later = found.until[index + 1 :]
        blocked = (other for other in later if name in blockers.get(other, ()))
        obstructs = "" if name in found.general else next(blocked, (*later, *rest, "")[0])
        moves.append(Moved(name, tuple(sorted(blockers.get(name, ()))), name in found.placements, obstructs))
    symbols, wanted = with_moves(replace(symbols, holds_aside=found.holds_two), moves, found.steps)
    return PlanState(symbols, scene, found, wanted=wanted)


def rebind_grasps(
    search: Search, symbols: SymbolicState, scene: Scene, before_it: ClearancePlan | None = None
) -> PlanState | Infeasible:
    """Choose grasps again for the grasp references. Arguments as for `bind_grasps`."""
    # Reset robotAt: the base-pose symbols are about to be rebound to other poses.
    here = {("robotAt", symbols.robot_at)}
    return bind_grasps(search, symbols.changed(add={("robotAt", ROBOT_INIT_LOC)}, remove=here), scene, before_it)


def task_plan(search: Search, state: PlanState) -> TaskPlan | NoPlan:
    """Call the task planner, check its answer and count its time."""
    before = cpu_seconds()
    target = search.target if search.is_greedy else state.clearance_plan.commitments.target
    problem = TaskProblem(state.symbols, target, state.wanted).pruned()
    checked = search.answers.get(problem)
    if checked is None:
        time_limit = min(TASK_PLANNING_S, search.motion_layer.deadline.remaining)
        checked = search.answers[problem] = answer_of(search.task_planner, problem, time_limit)
    search.counts.task_planning_s += cpu_seconds() - before
    search.counts.task_plans += 1
    search.has_given_up |= isinstance(checked, NoPlan) and checked.reason == "gave up"
    return checked


def _with_arms(symbols: SymbolicState, scene: Scene, commitments: Commitments) -> SymbolicState:
    """Facts that say which arm makes each chosen grasp. They are only needed if the robot acts with several arms."""
    for name, grasp in commitments.grasps.items() if scene.robot.acts_with_all_arms else ():
        symbols = reached_by(symbols, name, gripper_symbol(scene.robot, grasp.arm))
    return symbols


def gripper_symbol(robot: RobotSpec, arm: str) -> str:
    """Symbol of an arm's gripper. It is `GRIPPER` if the robot acts with one arm."""
    return f"{arm}_gripper" if robot.acts_with_all_arms else GRIPPER


def bind_action(search: Search, state: PlanState, action: GroundAction) -> BoundMotion | Refutation | Infeasible:
    """Bind an action's references to a motion, or refute the action.

    A put-down is bound together with the drive to it. A location symbol may stand for several placements. The first
    placement with both motions is taken.
    """
    match action:
        case GroundAction("MoveBase", (_, pose, _)) if pose.startswith(_GRASP_POSE):
            return _drive_to_grasp(search, state, action, pose.removeprefix(_GRASP_POSE))
        case GroundAction("MoveBase", (_, pose, _)):
            return _drive_to_put_down(search, state, action, pose.removeprefix(_PUT_DOWN_POSE))
        case GroundAction("PickUp", (name, *_)):
            return _pick_up(search, state, action, name)
    return state.put_downs[action.args[-1]]


def _drive_to_grasp(search: Search, state: PlanState, action: GroundAction, name: str) -> BoundMotion | Refutation:
    """Drive to the base pose of the chosen grasp. A grasp without a collision-free path is not offered again."""
    grasp = state.clearance_plan.commitments.grasps.get(name)
    if grasp is None:
        return Refutation(action)
    driven = search.motion_layer.drive_to_grasp(state.scene, grasp)
    if isinstance(driven, BoundMotion):
        return driven
    search.motion_layer.ban(state.scene, grasp)
    return Refutation(action, reason=driven.reason)


def _drive_to_put_down(
    search: Search, state: PlanState, action: GroundAction, location: str
) -> BoundMotion | Refutation | Infeasible:
    """Drive to the base pose of the first placement with a drive and a put-down motion."""
    name = next(name for _, _, name, _ in state.symbols.find("isGrasp", None, None, location))
    motion_layer, scene = search.motion_layer, state.scene.holding(name)
    assert scene is not None
    plan = state.clearance_plan
    clear_of = keep_clear(search.strategy, plan.commitments, name)
    if search.is_greedy:
        placements = motion_layer.placements(scene, clear_of, search.strategy, plan.placements.get(name))
    else:
        placements = motion_layer.goal_placements(_maker(search), scene, clear_of, plan)
    refuted: list[tuple[Scene, Placement]] = []
    no_drive = ""
    for placement in placements:
        if search.is_late:
            break
        driven = motion_layer.drive_to_placement(state.scene, name, placement)
        if isinstance(driven, BoundMotion):
            there = driven.scene.holding(name)
            assert there is not None
            put_down = motion_layer.put_down(there, placement)
            if isinstance(put_down, BoundMotion):
                if motion_layer.can_leave(put_down.scene, scene.state.base):
                    return replace(driven, location=location, put_down=put_down)
                no_drive = "; from where it is put down the base cannot drive back"
            refuted.append((there, placement))
        else:
            no_drive = f"; {driven.reason}"
    if search.is_late:
        return search.out_of_time()
    # The place is the goal's, so other locations do not help. Plan again, without this put-down.
    if name in plan.general and name not in search.not_placed.blockers:
        found = motion_layer.put_down(*refuted[0], find_blockers=True) if refuted else None
        blockers = found.blockers - {name} if isinstance(found, BlockedBy) else frozenset()
        grasp = plan.commitments.grasps.get(name)
        refused = name, blockers, None if grasp is None else grasp.pitch
        search.not_placed = search.not_placed.having(*refused)
        motion_layer.not_placed = motion_layer.not_placed.having(*refused)
        by = f": {', '.join(sorted(blockers))} in the way" if blockers else ""
        return Refutation(action, reason=f"no motion puts {name} at its place{by}")
    detail = f"no location for {name} that keeps clear of what remains to be done"
    return search.infeasible(Cause.NO_CLEARANCE_LOCATION, detail + no_drive, (name,))


def _pick_up(search: Search, state: PlanState, action: GroundAction, name: str) -> BoundMotion | Refutation:
    """Take an object with the chosen grasp.

    Objects in collision at the grasp itself become facts if the strategy is greedy. Objects in the way of the approach
    or the retreat are remembered with the grasp, and other grasps are compared with it. A grasp without any motion is
    not offered again.
    """
    grasp = state.clearance_plan.commitments.grasps[name]
    if is_handle(state.scene, name):
        picked = search.motion_layer.pull(state.scene, grasp)
    else:
        picked = search.motion_layer.pick_up(state.scene, grasp)
    is_low = isinstance(picked, BoundMotion) and not _is_up(search, picked, name)
    # The torso alone may be unable to raise the object high enough, as from a high shelf: let the arm help.
    if is_low:
        picked = search.motion_layer.pick_up(state.scene, grasp, rises=True)
    if isinstance(picked, BoundMotion):
        if not is_low or _is_up(search, picked, name):
            return picked
        picked = NoPath(f"the arm cannot hold {name} up where it takes it")
    if isinstance(picked, NoPath):
        search.motion_layer.ban(state.scene, grasp)
        return Refutation(action, reason=picked.reason)
    reason = f"{picked.phase}: {', '.join(sorted(picked.blockers))} in the way"
    if picked.phase == "grasp" and search.is_greedy:
        return Refutation(action, frozenset(picked.blockers), reason)
    search.motion_layer.obstruct(state.scene, grasp, picked.blockers)
    return Refutation(action, reason=reason)


def _is_up(search: Search, picked: BoundMotion, name: str) -> bool:
    """Whether a pick lifts an object high enough, if the goal wants it held. True for any other object."""
    is_held_up = Holding(name) in search.goal.facts
    return not is_held_up or Holding(name).holds(as_seen(picked.scene), search.problem.start)
