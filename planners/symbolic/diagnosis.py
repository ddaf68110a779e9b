"""Why a task problem has no plan: objects that wait for each other, one without a grasp, or one without a location."""

from __future__ import annotations

from collections.abc import Collection

from planners.symbolic.problem import Reason, SymbolicState, TaskProblem


def why_unsolvable(problem: TaskProblem) -> tuple[Reason, tuple[str, ...]] | None:
    """Why no plan can exist, with the names of the objects concerned; None if none of the usual causes holds.

    Removes, one by one, the objects that can be grasped, first as if there were always a location to put them. If the
    target is not removed, it waits for objects that wait for each other, or for one that cannot be grasped at all.
    """
    state = problem.state
    held = state.all_held
    stuck = () if state.holds_aside else [name for name in held if name != problem.target]
    for name in stuck:
        if not _has_free_location(state, name):
            return "no location", (name,)
    relevant = problem.relevant_objects()
    gone = _removable(state, relevant)
    if problem.target not in gone:
        ungraspable = {name for name in relevant if name not in held and not _grasp_trajectories(state, name)}
        if problem.target in _removable(state, relevant, free=ungraspable):
            return "no grasp", tuple(sorted(ungraspable))
        return "cyclic", _circle(state, relevant - gone)
    homeless = {name for name in relevant if name != problem.target and not _locations(state, name)}
    if state.holds_aside:
        homeless = set()
    if problem.target not in _removable(state, relevant - homeless):
        return "no location", tuple(sorted(homeless))
    return None


def _removable(state: SymbolicState, objects: Collection[str], free: Collection[str] = ()) -> set[str]:
    """`free`, the held object, and what of `objects` can be taken one by one after them."""
    blockers = state.blockers()
    gone = {*free, *state.all_held}
    while True:
        takeable = {
            name
            for name in set(objects) - gone
            if any(blockers.get(name, {}).get(path, set()) <= gone for path in _grasp_trajectories(state, name))
        }
        if not takeable:
            return gone
        gone |= takeable


def _circle(state: SymbolicState, stuck: Collection[str]) -> tuple[str, ...]:
    """The stuck objects that some other stuck object waits for, directly or not, and that wait themselves."""
    circle = set(stuck)
    while True:
        waited_for = {fact[1] for fact in state.find("obstructs", None, None, None) if fact[3] in circle}
        if circle <= waited_for:
            return tuple(sorted(circle))
        circle &= waited_for


def _grasp_trajectories(state: SymbolicState, name: str) -> set[str]:
    """Arm trajectories that end at a grasp of the object where it stands."""
    grasps = [g for at in state.find("objectAt", name, None) for g in state.find("isGrasp", None, name, at[2])]
    return {motion[1] for grasp in grasps for motion in state.find("isMotion", None, None, grasp[1])}


def _locations(state: SymbolicState, name: str) -> set[str]:
    """Locations offered for the object."""
    clearance = {fact[1] for fact in state.find("isClearanceLocation", None, name, None)}
    return clearance | {fact[1] for fact in state.find("isPlacementLocation", None, name)}


def _has_free_location(state: SymbolicState, held: str) -> bool:
    """Whether a held object can be put down now: nothing can be moved out of the way first."""
    blockers = state.blockers().get(held, {})
    grasps = [g for g in state.find("isGrasp", None, held, None) if g[3] in _locations(state, held)]
    return any(not blockers.get(motion[1]) for g in grasps for motion in state.find("isMotion", None, None, g[1]))
