"""The motion behind one action of a task plan, or what refutes it."""

from __future__ import annotations

from dataclasses import replace

from planners.cause import Cause
from planners.clearing.lookahead import keep_clear
from planners.motion.arm import NoPath
from planners.symbolic.problem import GroundAction
from planners.tamp.motion_layer import BoundMotion
from planners.tamp.solution import Infeasible
from planners.tamp.state import PlanState, Refutation, Search, infeasible, out_of_time

__all__ = ["bind_action"]

_GRASP_POSE, _PUT_DOWN_POSE = "robot_gp_", "robot_pdp_"


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
    """Drive to the base pose of the grasp committed to; a grasp without a free way is not offered again."""
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
        if motion_layer.deadline.is_over:
            break
        driven = motion_layer.drive_to_placement(scene, placement)
        if isinstance(driven, BoundMotion):
            put_down = motion_layer.put_down(driven.scene, placement)
            if isinstance(put_down, BoundMotion):
                return replace(driven, location=location, put_down=put_down)
    if motion_layer.deadline.is_over:
        return out_of_time(search)
    detail = f"no location for {name} that keeps clear of what remains to be done"
    return infeasible(search, Cause.NO_CLEARANCE_LOCATION, detail, (name,))


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
