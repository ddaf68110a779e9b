"""The motion behind one action of a task plan, or what refutes it."""

from __future__ import annotations

from dataclasses import replace

from planners.cause import Cause
from planners.clearing.lookahead import keep_clear
from planners.motion.arm import BlockedBy
from planners.symbolic.problem import GroundAction
from planners.tamp.motion_layer import BoundMotion
from planners.tamp.solution import Infeasible
from planners.tamp.state import PlanState, Refutation, Search, infeasible

__all__ = ["bind_action"]

_GRASP_POSE, _PUT_DOWN_POSE = "robot_gp_", "robot_pdp_"


def bind_action(search: Search, state: PlanState, action: GroundAction) -> BoundMotion | Refutation | Infeasible:
    """The motion that an action's references are bound to, or what refutes it; `state` knows what they mean."""
    match action:
        case GroundAction("MoveBase", (_, pose, _)) if pose.startswith(_GRASP_POSE):
            return _drive_to_grasp(search, state, action, pose.removeprefix(_GRASP_POSE))
        case GroundAction("MoveBase", (_, pose, _)):
            return _drive_to_put_down(search, state, pose.removeprefix(_PUT_DOWN_POSE))
        case GroundAction("PickUp", (name, *_)):
            return _pick_up(search, state, action, name)
        case _:
            return _put_down(search, state, action)


def _drive_to_grasp(search: Search, state: PlanState, action: GroundAction, name: str) -> BoundMotion | Refutation:
    grasp = state.clearance_plan.commitments.grasps.get(name)
    if grasp is None:
        return Refutation(action)
    driven = search.motion_layer.drive(state.scene, grasp.base)
    if isinstance(driven, BoundMotion):
        return driven
    search.motion_layer.ban(state.scene, grasp)
    return Refutation(action)


def _drive_to_put_down(search: Search, state: PlanState, location: str) -> BoundMotion | Infeasible:
    """Drive to where the first placement that can be reached and carried out is served from."""
    assert state.scene.held is not None
    name = state.scene.held.name
    clear_of = keep_clear(search.strategy, state.clearance_plan.commitments, name)
    planned = state.clearance_plan.places.get(name)
    for placement in search.motion_layer.placements(state.scene, clear_of, search.strategy, planned):
        driven = search.motion_layer.drive(state.scene, placement.base)
        if isinstance(driven, BoundMotion) and isinstance(
            search.motion_layer.put_down(driven.scene, placement), BoundMotion
        ):
            return replace(driven, placement=placement, location=location)
    detail = f"no place on the table for {name} that keeps clear of what remains to be done"
    return infeasible(search, Cause.NO_CLEARANCE_LOCATION, detail, (name,))


def _pick_up(search: Search, state: PlanState, action: GroundAction, name: str) -> BoundMotion | Refutation:
    grasp = state.clearance_plan.commitments.grasps[name]
    picked = search.motion_layer.pick_up(state.scene, grasp)
    if isinstance(picked, BoundMotion):
        return picked
    if isinstance(picked, BlockedBy) and picked.phase == "grasp":
        return Refutation(action, frozenset(picked.blockers))
    if isinstance(picked, BlockedBy):
        search.motion_layer.obstruct(state.scene, grasp, picked.blockers)
    else:
        search.motion_layer.ban(state.scene, grasp)
    return Refutation(action)


def _put_down(search: Search, state: PlanState, action: GroundAction) -> BoundMotion | Refutation:
    placed = search.motion_layer.put_down(state.scene, state.places[action.args[-1]])
    return placed if isinstance(placed, BoundMotion) else Refutation(action)
