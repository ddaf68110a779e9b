"""Explanation of a search without a plan: the cause, the evidence, and the choices that the answer depends on."""

from __future__ import annotations

from planners.cause import Cause
from planners.clearing.commitments import NoCommitment
from planners.clearing.goal_bound import must_move, order_circle, waits_for
from planners.goals import Goal
from planners.placing.goal_places import fixed_about, place_of, without_room
from planners.scene import Scene
from planners.tamp.motion_layer import MotionLayer
from planners.tamp.solution import Infeasible
from planners.tamp.state import Search


def explain(search: Search, scene: Scene, found: NoCommitment) -> Infeasible:
    """Explain a search in which no grasps could be chosen.

    Args:
        search: the run of Algorithm 1, with what it learnt.
        scene: the scene in which it ended.
        found: the cause and the objects that the choice of moves reports.
    """
    cause, objects = _cause(search.motion_layer, scene, found), found.objects
    search.motion_layer.is_in_vain |= found.is_in_vain
    detail = _by_goal(search, scene, cause, objects)
    if detail:
        return search.infeasible(cause, detail, objects)
    workspace = search.motion_layer.workspace
    if cause is Cause.UNREACHABLE and all(too_wide := [workspace.too_wide(scene, name) for name in objects]):
        return search.infeasible(Cause.TOO_WIDE, f"{'; '.join(too_wide)}, {workspace.catalogue}", objects)
    if cause is Cause.NO_SELF_CLEARABLE_SET and (wide := _too_wide_to_leave(search, scene, objects)):
        reasons = "; ".join(workspace.too_wide(scene, name) for name in wide)
        detail = f"{', '.join(wide)} must go before {', '.join(objects)}, but: {reasons}, {workspace.catalogue}"
        return search.infeasible(Cause.TOO_WIDE, detail, wide)
    return search.infeasible(cause, _by_robot(search, scene, cause, objects), objects)


def _cause(motion_layer: MotionLayer, scene: Scene, found: NoCommitment) -> Cause:
    """Underlying cause of a lack of grasps: walls around the base, or refuted motions."""
    if not found.cause.lies_in_grasps:
        return found.cause
    if motion_layer.has_refuted:  # The grasps alone do not explain the failure.
        return Cause.MOTION
    if found.cause is Cause.UNREACHABLE and not _can_be_taken(motion_layer, scene, found.objects):
        anywhere = motion_layer.workspace.anywhere().grasps(motion_layer.compiled)
        if any(anywhere.for_object(scene, name) for name in found.objects):
            return Cause.NO_WAY_FOR_BASE
    return found.cause


def _can_be_taken(motion_layer: MotionLayer, scene: Scene, objects: tuple[str, ...]) -> bool:
    """Whether each of these objects has a grasp, blocked or not."""
    return all(motion_layer.candidates.for_object(scene, name) for name in objects)


def _too_wide_to_leave(search: Search, scene: Scene, objects: tuple[str, ...]) -> tuple[str, ...]:
    """Names of objects that must move before these objects reach their ends, but are too wide for every gripper."""
    waits = waits_for(scene, search.goal, must_move(scene, search.goal, search.problem.start))
    before = {one for name in objects for one in waits.get(name, ())}
    return tuple(name for name in scene.names if name in before and search.motion_layer.workspace.too_wide(scene, name))


def _by_goal(search: Search, scene: Scene, cause: Cause, objects: tuple[str, ...]) -> str:
    """Requirement of the goal that no robot can meet for these objects, "" if none is proved."""
    if cause is Cause.NO_CLEARANCE_LOCATION:
        crowd, why = without_room(scene, search.goal, objects)
        return f"{why}: proved, for all grasps" if crowd and set(crowd) == set(objects) else ""
    circle = order_circle(scene, search.goal, must_move(scene, search.goal, search.problem.start))
    if cause is Cause.NO_SELF_CLEARABLE_SET and set(objects) == {*circle}:
        return f"by the order of the goal, {', '.join(objects)} wait for each other"
    return ""


def _by_robot(search: Search, scene: Scene, cause: Cause, objects: tuple[str, ...]) -> str:
    """Requirement that this robot cannot meet for these objects, with the choices that the answer depends on."""
    workspace, names = search.motion_layer.workspace, ", ".join(objects)
    match cause:
        case Cause.UNREACHABLE if _can_be_taken(search.motion_layer, scene, objects):
            detail = _place_out_of_reach(search, scene, objects)
        case Cause.UNREACHABLE:
            detail = workspace.unreached(scene, objects)
        case Cause.NO_WAY_FOR_BASE:
            detail = f"from where the robot is, the base cannot drive to where it could take {names}"
        case Cause.NO_SELF_CLEARABLE_SET:
            detail = f"whatever is removed first, something that must go before {names} is blocked"
        case Cause.MOTION:
            detail = f"without the grasps that motion planning refuted, there is no way to clear and take {names}"
        case Cause.NO_CLEARANCE_LOCATION:
            detail = _without_location(search, scene, objects)
        case _:
            detail = f"the time was up before a way to take {names} was found"
    detail += f", {workspace.catalogue}"
    reasons = [reason for name in scene.names if (reason := workspace.too_wide(scene, name))]
    if cause is Cause.NO_SELF_CLEARABLE_SET and reasons:
        detail += f"; cannot be taken: {'; '.join(reasons)}"
    return detail


def _place_out_of_reach(search: Search, scene: Scene, objects: tuple[str, ...]) -> str:
    """Name the fixed bodies around a place that the robot cannot reach with an object in its hand."""
    facts = [fact for fact in search.goal.placed if fact.object in objects]
    about = dict.fromkeys(name for fact in facts for name in fixed_about(scene, place_of(scene, fact)))
    wanted = " ".join(str(Goal((fact,))) for fact in facts)
    detail = f"no free base pose and arm configuration put {', '.join(objects)} at the place of {wanted}"
    if why := search.why_not_placed(scene, facts):
        return f"{detail}{why}"
    return f"{detail}; fixed about it: {', '.join(about)}" if about else detail


def _without_location(search: Search, scene: Scene, objects: tuple[str, ...]) -> str:
    """Name the goal's place or the supports on which no location was found, and the supports that were not searched."""
    names, places = ", ".join(objects), [Goal((fact,)) for fact in search.goal.placed if fact.object in objects]
    if places:
        wanted = " ".join(map(str, places))
        detail = f"no base pose and arm configuration were found that put {names} where {wanted} wants it"
        facts = [fact for fact in search.goal.placed if fact.object in objects]
        return f"{detail}{search.why_not_placed(scene, facts)}"
    used = search.motion_layer.workspace.supports
    detail = f"no location on {', '.join(used)} for {names} that keeps clear of what remains to be done"
    others = [name for name in scene.supports if name not in used]
    return f"{detail}; not looked at, since not among the supports chosen: {', '.join(others)}" if others else detail
