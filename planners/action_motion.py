"""The motion behind one action of a task plan, or what refutes it."""

from __future__ import annotations

from dataclasses import replace

from planners.arm_motion import Obstruction
from planners.binding import Bound
from planners.lookahead import keep_clear
from planners.solution import Cause, Infeasible
from planners.symbolic import GroundAction
from planners.tamp_state import PlanState, Refutation, Search, infeasible

__all__ = ["motion_behind"]

_GRASP_POSE, _PUT_DOWN_POSE = "robot_gp_", "robot_pdp_"


def motion_behind(search: Search, state: PlanState, action: GroundAction) -> Bound | Refutation | Infeasible:
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


def _drive_to_grasp(search: Search, state: PlanState, action: GroundAction, name: str) -> Bound | Refutation:
    grasp = state.foresight.commitments.grasps.get(name)
    if grasp is None:
        return Refutation(action)
    driven = search.binder.drive(state.scene, grasp.base)
    if isinstance(driven, Bound):
        return driven
    search.binder.ban(state.scene, grasp)
    return Refutation(action)


def _drive_to_put_down(search: Search, state: PlanState, location: str) -> Bound | Infeasible:
    """Drive to where the first placement that can be reached and carried out is served from."""
    assert state.scene.held is not None
    name = state.scene.held.name
    clear_of = keep_clear(search.strategy, state.foresight.commitments, name)
    planned = state.foresight.places.get(name)
    for placement in search.binder.placements(state.scene, clear_of, search.strategy, planned):
        driven = search.binder.drive(state.scene, placement.base)
        if isinstance(driven, Bound) and isinstance(search.binder.put_down(driven.scene, placement), Bound):
            return replace(driven, placement=placement, location=location)
    detail = f"no place on the table for {name} that keeps clear of what remains to be done"
    return infeasible(search, Cause.NO_CLEARANCE_LOCATION, detail, (name,))


def _pick_up(search: Search, state: PlanState, action: GroundAction, name: str) -> Bound | Refutation:
    grasp = state.foresight.commitments.grasps[name]
    picked = search.binder.pick_up(state.scene, grasp)
    if isinstance(picked, Bound):
        return picked
    if isinstance(picked, Obstruction) and picked.phase == "grasp":
        return Refutation(action, frozenset(picked.blockers))
    if isinstance(picked, Obstruction):
        search.binder.obstruct(state.scene, grasp, picked.blockers)
    else:
        search.binder.ban(state.scene, grasp)
    return Refutation(action)


def _put_down(search: Search, state: PlanState, action: GroundAction) -> Bound | Refutation:
    placed = search.binder.put_down(state.scene, state.places[action.args[-1]])
    return placed if isinstance(placed, Bound) else Refutation(action)
