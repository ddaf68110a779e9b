"""Where an object is to be when several facts of a goal say so: the narrowest of them, or a contradiction."""

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
"""A fact that says where an object is to stand."""
_NARROWER = (At, Inside, On)
"""Kinds of facts, the one that says most first."""


def narrowest(facts: Sequence[Fact]) -> tuple[Placed, ...]:
    """The fact of each object that says most of where it is to stand, as far as their kinds tell."""
    found: dict[str, Placed] = {}
    for kind in _NARROWER:
        for fact in facts:
            if isinstance(fact, kind):
                found.setdefault(fact.object, fact)
    order = dict.fromkeys(fact.object for fact in facts if isinstance(fact, On | Inside | At))
    return tuple(found[name] for name in order)


def ends_in(scene: Scene, facts: Sequence[Fact]) -> tuple[Placed, ...]:
    """The one fact of each object that says where it is to stand, and keeps to the others; see `contradiction_in`."""
    found: dict[str, Placed] = {}
    for fact in facts:
        if isinstance(fact, On | Inside | At):
            end = found.setdefault(fact.object, fact)
            found[fact.object] = end if end is fact else _joined(scene, end, fact, facts) or end
    return tuple(_at_height(scene, fact) if isinstance(fact, At) else fact for fact in found.values())


def _at_height(scene: Scene, pose: At) -> At:
    """A pose with its height where several supports lie one above the other: in a hand, an object stands on none."""
    if pose.z is not None or len(supports_under(scene, pose)) < 2:
        return pose
    body = scene.body(pose.object)
    return replace(pose, z=support_at(scene, pose).top + float(body.position[2]) - body.bottom)


def contradiction_in(scene: Scene, facts: Sequence[Fact]) -> tuple[Fact, Fact] | None:
    """Two facts that say of the same object that it is held, or where it stands, and cannot both hold; None: none."""
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
    """Whether an object that is where one fact says cannot be where another one does."""
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
    """Names of the supports and objects one of which it is to stand on, for sure."""
    if isinstance(fact, At):
        around = np.concatenate(([(fact.x, fact.y)], (fact.x, fact.y) + fact.tolerance * RIM))
        found = {name for name in scene.supports if scene.support_named(name).is_under(around).any()}
        return found | set(scene.names)
    place = _place(fact)
    return {region_named(scene, place).support if place in region_names(scene) else place}


def _outline(scene: Scene, fact: Placed) -> Array | None:
    """(k, 2) [m] corners of what its centre is to be in; None for a support or an object."""
    if isinstance(fact, At):
        return np.array((fact.x, fact.y)) + fact.tolerance * RIM
    place = _place(fact)
    return region_named(scene, place).corners if place in region_names(scene) else None


def _place(fact: On | Inside) -> str:
    return fact.place if isinstance(fact, On) else fact.region


def _joined(scene: Scene, one: Placed, other: Placed, facts: Sequence[Fact]) -> Placed | None:
    """One fact about an object that says what two of them say; None if they contradict each other."""
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
    """The first pose, if all that it allows is allowed by the second one; None if not."""
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
    """Whether an object that is where one fact says is where the other one does."""
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
    """A pose that keeps to a place; None if what it allows is not there."""
    place = _place(fact)
    if place in scene.names:
        given = fact.pose if isinstance(fact, On) else None
        nearer = pose if given is None else _nearer(pose, given) or _nearer(given, pose)
        return On(pose.object, place, nearer) if nearer is not None and _is_over(scene, pose, place, facts) else None
    if place not in (*region_names(scene), *scene.supports):
        return None  # a pose is on a support or an object
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
    # Its corners may be turned out of the way: so much of it sticks out at least.
    inner = float(min(body.half_extents[:2] if body.is_upright else body.half_extents))
    half = np.array(area.half_extents) - inner + EDGE
    if half.min() < 0:
        return None
    outside = np.maximum(np.abs(area.local((pose.x, pose.y))) - half, 0.0)
    if np.hypot(*outside) > pose.tolerance:
        return None
    return replace(pose, within=tuple(dict.fromkeys((*pose.within, place))))


def _is_over(scene: Scene, pose: At, below: str, facts: Sequence[Fact]) -> bool:
    """Whether a pose is over an object, however it is turned, where that one stands or is to stand."""
    ends = [fact for fact in narrowest(facts) if fact.object == below]
    if ends and not isinstance(ends[0], At):
        return False
    body = scene.body(below)
    point = (ends[0].x, ends[0].y) if ends and isinstance(ends[0], At) else body.position[:2]
    return math.dist(point, (pose.x, pose.y)) <= float(min(body.half_extents[:2]))
