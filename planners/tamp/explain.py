"""Why there is no plan, worked out once a search has ended: the cause, the evidence, and what would have to change."""

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
    """The end of a search in which nothing could be committed to.

    Args:
        search: what was to be planned, and what has been found out.
        scene: in which it ended.
        found: what the choice of moves says.
    """
    cause, objects = _cause(search.motion_layer, scene, found), found.objects
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
    """The cause that lies behind a lack of grasps: walls around the base, or motions that were refuted."""
    if not found.cause.lies_in_grasps:
        return found.cause
    if motion_layer.has_refuted:  # it is not the grasps alone that leave no commitments
        return Cause.MOTION
    if found.cause is Cause.UNREACHABLE and not _can_be_taken(motion_layer, scene, found.objects):
        anywhere = motion_layer.workspace.anywhere().grasps(motion_layer.compiled)
        if any(anywhere.for_object(scene, name) for name in found.objects):
            return Cause.NO_WAY_FOR_BASE
    return found.cause


def _can_be_taken(motion_layer: MotionLayer, scene: Scene, objects: tuple[str, ...]) -> bool:
    """Whether each of these objects has a grasp, whatever is in its way."""
    return all(motion_layer.candidates.for_object(scene, name) for name in objects)


def _too_wide_to_leave(search: Search, scene: Scene, objects: tuple[str, ...]) -> tuple[str, ...]:
    """Names of what must leave before these objects come to their ends, and fits in no gripper."""
    waits = waits_for(scene, search.goal, must_move(scene, search.goal, search.problem.start))
    before = {one for name in objects for one in waits.get(name, ())}
    return tuple(name for name in scene.names if name in before and search.motion_layer.workspace.too_wide(scene, name))


def _by_goal(search: Search, scene: Scene, cause: Cause, objects: tuple[str, ...]) -> str:
    """What the goal asks of these objects that cannot be, whatever the robot; "" if that is not proved."""
    if cause is Cause.NO_CLEARANCE_LOCATION:
        crowd, why = without_room(scene, search.goal, objects)
        return f"{why}: proved, for all grasps" if crowd and set(crowd) == set(objects) else ""
    circle = order_circle(scene, search.goal, must_move(scene, search.goal, search.problem.start))
    if cause is Cause.NO_SELF_CLEARABLE_SET and set(objects) == {*circle}:
        return f"by the order of the goal, {', '.join(objects)} wait for each other"
    return ""


def _by_robot(search: Search, scene: Scene, cause: Cause, objects: tuple[str, ...]) -> str:
    """What the robot cannot do with these objects, with the choices that the answer holds for."""
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
    """What is fixed about the places of objects that can be taken, but not put there."""
    facts = [fact for fact in search.goal.placed if fact.object in objects]
    about = dict.fromkeys(name for fact in facts for name in fixed_about(scene, place_of(scene, fact)))
    wanted = " ".join(str(Goal((fact,))) for fact in facts)
    detail = f"no free base pose and arm configuration put {', '.join(objects)} at the place of {wanted}"
    if why := search.why_not_placed(scene, facts):
        return f"{detail}{why}"
    return f"{detail}; fixed about it: {', '.join(about)}" if about else detail


def _without_location(search: Search, scene: Scene, objects: tuple[str, ...]) -> str:
    """Where no place was found for objects: those of the goal, or the supports; and the supports that were left out."""
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
