"""The place of an object if several facts of a goal give one: the narrowest place, or a contradiction."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from planners.facts import (
    At,
    Fact,
    Holding,
    Inside,
    On,
    is_filled,
    region_named,
    region_names,
    support_at,
    supports_under,
    whole_face,
)
from planners.regions import EDGE, RESTING, RIM, Array, overlap

if TYPE_CHECKING:
    from planners.scene import Scene

Placed: TypeAlias = On | Inside | At
"""A fact that gives the place of an object."""
_NARROWER = (At, Inside, On)
"""Kinds of facts, the most specific first."""


def narrowest(facts: Sequence[Fact]) -> tuple[Placed, ...]:
    """The most specific fact about the place of each object, by kind."""
    found: dict[str, Placed] = {}
    for kind in _NARROWER:
        for fact in facts:
            if isinstance(fact, kind):
                found.setdefault(fact.object, fact)
    order = dict.fromkeys(fact.object for fact in facts if isinstance(fact, On | Inside | At))
    return tuple(found[name] for name in order)


def ends_in(scene: Scene, facts: Sequence[Fact]) -> tuple[Placed, ...]:
    """The fact that gives the place of each object and agrees with the other facts. See `contradiction_in`."""
    found: dict[str, Placed] = {}
    for fact in facts:
        if isinstance(fact, On | Inside | At):
            end = found.setdefault(fact.object, fact)
            found[fact.object] = end if end is fact else _joined(scene, end, fact, facts) or end
    return tuple(_at_height(scene, fact) if isinstance(fact, At) else fact for fact in found.values())


def _at_height(scene: Scene, pose: At) -> At:
    """Add the height to a pose over several supports, since an object in a hand later stands on none."""
    if pose.z is not None or len(supports_under(scene, pose)) < 2:
        return pose
    body = scene.body(pose.object)
    return replace(pose, z=support_at(scene, pose).top + float(body.position[2]) - body.bottom)


def contradiction_in(scene: Scene, facts: Sequence[Fact]) -> tuple[Fact, Fact] | None:
    """Find two facts about the same object, held or placed, that cannot both hold. None if all agree."""
    found: dict[str, tuple[Fact, Fact]] = {}
    for fact in facts:
        if not isinstance(fact, Holding | On | Inside | At):
            continue
        first, end = found.setdefault(fact.object, (fact, fact))
        if end is fact:
            continue
        if isinstance(end, Holding) or isinstance(fact, Holding):
            return first, fact
        joined = _joined(scene, end, fact, facts)  # type: ignore[arg-type]  # ends alone are joined
        if joined is None:
            return first, fact
        found[fact.object] = (fact if joined is fact else first), joined
    return None


def excludes(scene: Scene, end: Fact, fact: Fact) -> bool:
    """Whether two facts about an object exclude each other."""
    if isinstance(end, Holding) or isinstance(fact, Holding):
        return isinstance(end, Holding) != isinstance(fact, Holding)
    if not isinstance(end, On | Inside | At) or not isinstance(fact, On | Inside | At):
        return False
    one, other = _faces(scene, end), _faces(scene, fact)
    if not one & other:
        return True
    here, there = _outline(scene, end), _outline(scene, fact)
    return here is not None and there is not None and overlap(here, there) < 0


def _faces(scene: Scene, fact: Placed) -> set[str]:
    """Names of the supports and objects that can carry the object if the fact holds."""
    if isinstance(fact, At):
        around = np.concatenate(([(fact.x, fact.y)], (fact.x, fact.y) + fact.tolerance * RIM))
        found = {name for name in scene.supports if scene.support_named(name).is_under(around).any()}
        return found | set(scene.names)
    place = _place(fact)
    return {region_named(scene, place).support if place in region_names(scene) else place}


def _outline(scene: Scene, fact: Placed) -> Array | None:
    """Corners (k, 2) [m] of the area of its centre. None for a support or an object."""
    if isinstance(fact, At):
        return np.array((fact.x, fact.y)) + fact.tolerance * RIM
    place = _place(fact)
    return region_named(scene, place).corners if place in region_names(scene) else None


def _place(fact: On | Inside) -> str:
    return fact.place if isinstance(fact, On) else fact.region


def _joined(scene: Scene, one: Placed, other: Placed, facts: Sequence[Fact]) -> Placed | None:
    """Join two facts about an object into one. None if they contradict each other."""
    if isinstance(one, At) and isinstance(other, At):
        return _nearer(one, other) or _nearer(other, one)
    if isinstance(other, At):
        one, other = other, one
    assert not isinstance(other, At)
    if isinstance(one, At):
        return _pose_in(scene, one, other, facts)
    narrow, wide = (one, other) if _is_in(scene, one, other) else (other, one)
    return narrow if _is_in(scene, narrow, wide) else None


def _nearer(one: At, other: At) -> At | None:
    """The first pose, if the second pose allows everything that the first one allows. None otherwise."""
    away = math.hypot(one.x - other.x, one.y - other.y) + one.tolerance
    turn = 0.0
    if other.yaw is not None:
        turn = (
            math.inf if one.yaw is None else abs(math.remainder(one.yaw - other.yaw, 2 * math.pi)) + one.yaw_tolerance
        )
    if other.z is None:
        rise, slack = 0.0, 0.0
    else:
        slack = max(other.tolerance, RESTING)
        rise = math.inf if one.z is None else abs(one.z - other.z) + max(one.tolerance, RESTING)
    is_nearer = away <= other.tolerance and turn <= other.yaw_tolerance and rise <= slack
    return replace(one, within=tuple(dict.fromkeys((*one.within, *other.within)))) if is_nearer else None


def _is_in(scene: Scene, one: On | Inside, other: On | Inside) -> bool:
    """Whether the first fact implies the second."""
    inner, outer = _place(one), _place(other)
    if inner in region_names(scene):
        region = region_named(scene, inner)
        if outer not in region_names(scene):
            face = scene.support_named(outer) if outer in scene.supports else None
            is_whole = face is not None and (isinstance(other, On) or bool(face.is_under(region.corners).all()))
            return region.support == outer and is_whole
        around = region_named(scene, outer)
        return region.support == around.support and bool(around.contains_points(region.corners).all())
    return inner == outer and not (isinstance(one, On) and isinstance(other, Inside))


def _pose_in(scene: Scene, pose: At, fact: On | Inside, facts: Sequence[Fact]) -> Placed | None:
    """Restrict a pose to a place. None if the pose lies elsewhere."""
    place = _place(fact)
    if place in scene.names:
        given = fact.pose if isinstance(fact, On) else None
        nearer = pose if given is None else _nearer(pose, given) or _nearer(given, pose)
        return On(pose.object, place, nearer) if nearer is not None and _is_over(scene, pose, place, facts) else None
    if place not in (*region_names(scene), *scene.supports):
        return None  # poses are on supports or objects only
    region = region_named(scene, place) if place in region_names(scene) else None
    face, body = scene.support_named(place if region is None else region.support), scene.body(pose.object)
    if support_at(scene, pose).name != face.name:
        height = body.top - body.bottom
        is_free = not is_filled(scene, np.array([pose.x, pose.y, face.top]), height)
        if pose.z is not None or not (is_free and face.is_under(np.array((pose.x, pose.y)))):
            return None
        pose = replace(pose, z=face.top + float(body.position[2]) - body.bottom)
    if region is None and isinstance(fact, On):
        return pose
    area = region or whole_face(face)
    # Its corners may be turned away from the edge: at least the inner circle sticks out.
    inner = float(min(body.half_extents[:2] if body.is_upright else body.half_extents))
    half = np.array(area.half_extents) - inner + EDGE
    if half.min() < 0:
        return None
    outside = np.maximum(np.abs(area.local((pose.x, pose.y))) - half, 0.0)
    if np.hypot(*outside) > pose.tolerance:
        return None
    return replace(pose, within=tuple(dict.fromkeys((*pose.within, place))))


def _is_over(scene: Scene, pose: At, below: str, facts: Sequence[Fact]) -> bool:
    """Whether a pose is over an object, at any yaw, where that object stands or is to stand."""
    ends = [fact for fact in narrowest(facts) if fact.object == below]
    if ends and not isinstance(ends[0], At):
        return False
    body = scene.body(below)
    point = (ends[0].x, ends[0].y) if ends and isinstance(ends[0], At) else body.position[:2]
    return math.dist(point, (pose.x, pose.y)) <= float(min(body.half_extents[:2]))
