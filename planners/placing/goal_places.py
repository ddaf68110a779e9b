"""Places that a goal names: locations for an object on a support, in a region or on another object, best first.

A region is filled row by row from the far side, so that later objects still fit. If the circles around boxes do not
fit, the boxes are aligned with the sides of the region.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from planners.facts import At, Inside, On, has_yaw, region_named, region_names, support_at, whole_face
from planners.goals import Goal
from planners.hollows import Hollow, hollow_of
from planners.placing.certain_overlap import Ends, overlaps_everywhere
from planners.placing.locations import stand_at
from planners.regions import EDGE, RESTING, RIM, Region, footprint, overlap
from planners.scene import Body, Scene, StaticObstacle
from planners.scene.bodies import resting_ways

Array: TypeAlias = NDArray[np.float64]
Yaws: TypeAlias = tuple[float | None, ...]

PITCH, NARROW = 0.01, 0.005
"""Spacing [m] of locations tried in a region: normal, and where space is scarce. Large regions have a wider spacing:
see `_MOST`."""
_MOST = 30
"""Most locations along a side."""
_GAPS = (0.03, 0.012, 0.004)
"""Clearances [m] between neighbours in a region, in the order of the tries. Wide ones let the fingers in."""
_SAME = 1e-9
"""Rounding tolerance [m] of the sides of a region."""
_TRIED = 12
"""Candidate locations for each gap that are checked for leaving room for the other objects, if the first one leaves
none."""
_WALL = 0.001
"""Thickness [m] of the thinnest wall that an object may stand on."""
_TURNS = np.arange(36) * (2 * np.pi / 36)
_AROUND = np.column_stack((np.cos(_TURNS), np.sin(_TURNS)))
"""Unit vectors (36, 2) all around."""
_TURN_MATRICES = np.stack((_AROUND, np.column_stack((-_AROUND[:, 1], _AROUND[:, 0]))), axis=1)
"""Matrices (36, 2, 2): points (n, 2) times one of them are turned by its angle."""
_NEAR = 1.5
"""Range [m] around the robot in which a larger face is searched, along each of its sides."""
_ABOUT, _REACH_ABOVE = 0.12, 0.5
"""Ranges [m] around a place, and above it, where static obstacles may be in the way of a gripper."""
_LEVEL = 0.9999
"""Cosine of the largest tilt at which the top of an object is level."""
_SHARES, _DIRECTIONS = (0.4, 0.8), 8
"""Offsets that are tried around a pose, as shares of its tolerance, and the number of their directions. The rest of the
tolerance is left for the accuracy of the put-down."""
_LEAST_SHIFT = 0.003
"""Smallest shift [m] of a pose. Put-downs are no more accurate than this."""
_TOUCHING = 0.01
"""Height [m] of an object that may lie below a face: contacts are soft, and objects lean."""


@dataclass(frozen=True, eq=False)
class Place:
    """A place where an object is to stand.

    Attributes:
        face: the support, or another object, that it stands on.
        area: region for its footprint. None at a pose, and on another object unless a flat top has space for more
            objects.
        location: (2,) x, y [m] of its centre. None with an area.
        slack: tolerance [m] of the location.
        yaw: yaw [rad] of the object, None for any.
        within: further regions for the footprint of an object at a location.
        below: name of the object that it stands on or in, "" for none.
        hollow: the hollow that it goes into, if any.
    """

    face: StaticObstacle
    area: Region | None = None
    location: Array | None = None
    slack: float = 0.0
    yaw: float | None = None
    within: tuple[Region, ...] = ()
    below: str = ""
    hollow: Hollow | None = None


def place_of(scene: Scene, fact: On | Inside | At) -> Place:
    """The place of a fact of a goal."""
    body = scene.body(fact.object)
    if isinstance(fact, At):
        yaw = fact.yaw if has_yaw(body) else None
        within, point = tuple(_region_or_face(scene, name) for name in fact.within), np.array([fact.x, fact.y])
        return Place(support_at(scene, fact), location=point, slack=fact.tolerance, yaw=yaw, within=within)
    name = fact.place if isinstance(fact, On) else fact.region
    if _is_area(scene, name):
        return _area_named(scene, name)
    hollow = _hollow_for(scene, fact)
    pose = fact.pose if isinstance(fact, On) else None
    if hollow is not None and pose is None:
        return Place(_floor_of(hollow), hollow.area, below=name if name in scene.names else "", hollow=hollow)
    other = scene.body(name)
    if pose is not None:
        face, yaw = _top_of(other) if hollow is None else _floor_of(hollow), pose.yaw if has_yaw(body) else None
        point = np.array([pose.x, pose.y])
        return Place(face, location=point, slack=pose.tolerance, yaw=yaw, below=name, hollow=hollow)
    if other.shape != "pieces":
        face = _top_of(other)
        if other.shape == "box" and abs(other.rotation[2, 2]) > _LEVEL:
            narrow, wide = sorted(other.half_extents[:2])
            if narrow > inner_radius(body) and wide > 2 * inner_radius(body):
                return Place(face, whole_face(face), below=name)
        return Place(face, location=other.position[:2], below=name)
    highest = other.corners[other.corners[:, 2] > other.top - _TOUCHING]
    return Place(_top_of(other), location=highest[:, :2].mean(axis=0), below=name)


def _hollow_for(scene: Scene, fact: On | Inside) -> Hollow | None:
    """Hollow that an object goes into. None for a flat place, or if the object stands on the rim.

    A fact `On` a hollow object means inside if the object fits into the mouth in any of its resting orientations.
    """
    hollow = hollow_of(scene, fact.where)
    if hollow is None or isinstance(fact, Inside) or fact.where not in scene.names:
        return hollow
    return hollow if _fits_into(scene.body(fact.object), hollow) else None


def _fits_into(body: Body, hollow: Hollow) -> bool:
    """Whether an object in the middle of a hollow lies within its mouth, in some yaw and resting orientation.

    Its footprint is turned, and not the object: a bowl has dozens of pieces.
    """
    for way in resting_ways(body):
        there = stand_at(way, np.append(hollow.area.centre, hollow.floor), 0.0)
        outline = footprint(there) - hollow.area.centre
        turned = outline @ _TURN_MATRICES + hollow.area.centre
        if any(bool((distances_to_polygon(one, hollow.mouth) == 0.0).all()) for one in turned):
            return True
    return False


@lru_cache(maxsize=64)
def _floor_of(hollow: Hollow) -> StaticObstacle:
    """The floor of a hollow as a support."""
    corners = [(*point, hollow.floor - down) for point in hollow.base for down in (0.0, _WALL)]
    return StaticObstacle.hull(hollow.name, corners)


def _is_area(scene: Scene, name: str) -> bool:
    return name in (*region_names(scene), *scene.supports)


def _area_named(scene: Scene, name: str) -> Place:
    """The place of a region or a support, the same for all objects."""
    area = _region_or_face(scene, name)
    is_face = area.name == area.support
    return Place(scene.support_named(area.support), _near(area, scene.state.base[:2]) if is_face else area)


def _places_of(scene: Scene, facts: Iterable[On | Inside | At]) -> Iterator[tuple[On | Inside | At, Place]]:
    """Places of facts. Each region or support is evaluated once, even if several facts name it."""
    areas: dict[str, Place] = {}
    for fact in facts:
        name = "" if isinstance(fact, At) else fact.place if isinstance(fact, On) else fact.region
        if name not in areas and _is_area(scene, name):
            areas[name] = _area_named(scene, name)
        yield fact, areas[name] if name in areas else place_of(scene, fact)


def _top_of(other: Body) -> StaticObstacle:
    """The top of an object as a support."""
    if other.shape == "pieces":
        return StaticObstacle.hull(other.name, other.corners)
    return StaticObstacle(other.name, other.position, other.half_extents, other.shape, other.rotation)


def _near(face: Region, base: Array) -> Region:
    """Part of a face around the robot, for a face as large as a ground. The rest is too far away to try."""
    if max(face.half_extents) <= _NEAR:
        return face
    half, middle, c, s = np.array(face.half_extents), face.local(base), math.cos(face.yaw), math.sin(face.yaw)
    low, high = np.maximum(-half, middle - _NEAR), np.minimum(half, middle + _NEAR)
    is_wide = (half > _NEAR) & (low < high)
    low, high = np.where(is_wide, (low, high), (-half, half))
    centre = face.centre + np.array([[c, -s], [s, c]]) @ (low + high) / 2
    return replace(face, centre=tuple(centre), half_extents=tuple((high - low) / 2))


def reserved_regions(scene: Scene, goal: Goal, besides: str = "") -> tuple[Region, ...]:
    """Regions reserved for objects of the goal, or to be kept clear. No other object is put there.

    The first support is reserved as a whole only if the goal wants it clear: objects are put aside on it.

    Args:
        scene: the scene as it is.
        goal: the goal.
        besides: name of an object. Its own place, and regions that contain this place, are not reserved.
    """
    own = placed_fact(goal, besides)
    if isinstance(own, At):
        return tuple(_rooms_beside(scene, goal, own))
    mine = None if own is None else place_of(scene, own).area
    if own is not None and mine is None:
        return ()
    found = {name: _region_or_face(scene, name) for name in goal.cleared}
    for fact, place in _places_of(scene, (one for one in goal.placed if one is not own)):
        if place.area is not None and place.area != mine:
            found[place.area.name] = place.area
        elif place.location is not None and not place.below:
            half = scene.body(fact.object).radius
            name = f"place of {fact.object}"
            found[name] = Region(name, place.face.name, tuple(place.location), (half, half))
    around = [] if mine is None else [one for one in found.values() if _contains(one, mine)]
    is_kept = {*found} - ({scene.support.name} - {*goal.cleared})
    swept = () if scene.pull is None else scene.pull.swept
    return (*(region for name, region in found.items() if name in is_kept and region not in around), *swept)


def _rooms_beside(scene: Scene, goal: Goal, own: At) -> Iterator[Region]:
    """Regions that an object at its pose keeps out of, so that overlapping poses of others remain possible.

    Each lies across the line between both objects. It is as wide as the other object covers anywhere within its
    tolerance.
    """
    body = scene.body(own.object)
    for fact in goal.placed:
        if not isinstance(fact, At) or fact is own or support_at(scene, fact).name != support_at(scene, own).name:
            continue
        radius, away = scene.body(fact.object).radius, np.array((own.x - fact.x, own.y - fact.y))
        most = _SHARES[-1] * fact.tolerance
        if np.hypot(*away) < radius + body.radius and radius > most:
            half, yaw = radius - most, math.atan2(away[1], away[0])
            yield Region(f"place of {fact.object}", support_at(scene, fact).name, (fact.x, fact.y), (half, half), yaw)


def _contains(region: Region, other: Region) -> bool:
    """Whether a region contains another one. Both may be the same region under two names."""
    return bool((np.abs(region.local(other.corners)) <= np.array(region.half_extents) + _SAME).all())


def _is_same(one: Region, other: Region) -> bool:
    return one.support == other.support and _contains(one, other) and _contains(other, one)


def _region_or_face(scene: Scene, name: str) -> Region:
    return region_named(scene, name) if name in region_names(scene) else whole_face(scene.support_named(name))


def locations_in(
    scene: Scene,
    body: Body,
    place: Place,
    leaving: Collection[str],
    others: Sequence[Body],
    allowed: Callable[[Array], NDArray[np.bool_]],
    pitch: float = PITCH,
    is_passed_over: Callable[[Array], bool] = lambda _: False,
) -> Iterator[tuple[Array, Yaws]]:
    """Find locations (2,) [m] of a place where an object fits, with its yaws there [rad], None for any. Best first.

    Locations that leave room for all others come first. Among them, any yaw comes before yaws along the sides, and wide
    gaps come before narrow ones.

    Args:
        scene: the scene with the objects where they stand.
        body: the object to put there.
        place: the place.
        leaving: names of objects that will have left when the others come.
        others: objects that come there later. Room is left for them if all fit.
        allowed: whether points (n, 2) are allowed: (n,).
        pitch: spacing of locations [m].
        is_passed_over: whether a location (2,) may be skipped at its turn.
    """
    if place.area is None:
        points = points_about(place)
        points = points[allowed(points)]
        for yaws in _yaws_at(place, body):
            is_within = np.ones(len(points), np.bool_)
            for area in place.within:
                is_within &= _fits(points, area, body, (), 0.0, yaws[0])
            yield from ((point, yaws) for point in points[is_within])
        return
    standing = [one for one in beside(scene, place.face, body) if one.name not in (body.name, place.below)]
    staying = [one for one in standing if one.name not in leaving]
    middle, has_middle = np.array([place.area.centre]), bool(place.below or place.hollow) and not others
    if has_middle and allowed(middle)[0] and _fits(middle, place.area, body, standing, 0.0, None)[0]:
        yield middle[0], (None,)
    points = _grid(place.area, scene.state.base[:2], pitch)
    may_stand = allowed(points)
    for yaws, gap in itertools.product(_ways(place.area, body), _GAPS):
        free = points[may_stand & _fits(points, place.area, body, standing, gap, yaws[0])]
        rest = RoomForOthers(points, place.area, staying, others, gap)
        if len(free) and not rest.is_left(body, free[0], yaws[0]):
            free = free[:: 1 + len(free) // _TRIED]
        wanted = (point for point in free if not is_passed_over(point))
        yield from ((point, yaws) for point in wanted if rest.is_left(body, point, yaws[0]))
    for yaws in _ways(place.area, body):
        fits = may_stand & _fits(points, place.area, body, standing, _GAPS[-1], yaws[0])
        yield from ((point, yaws) for point in points[fits])
    for yaws in _ways(place.area, body):
        narrow = _narrow_fits(place.area, body, standing, yaws[0])
        yield from ((point, yaws) for point in narrow[allowed(narrow)])


def points_about(place: Place) -> Array:
    """Locations (n, 2) [m] at a pose and within its tolerance, the nearest first."""
    assert place.location is not None
    turns = np.arange(_DIRECTIONS) * (2 * np.pi / _DIRECTIONS)
    around = np.column_stack((np.cos(turns), np.sin(turns)))
    rings = [share * place.slack * around for share in _SHARES if share * place.slack >= _LEAST_SHIFT]
    return np.asarray(np.concatenate((np.zeros((1, 2)), *rings)) + place.location)


def _yaws_at(place: Place, body: Body) -> Iterator[Yaws]:
    """Yaws of an object at a pose: the pose's own yaw, else any yaw, then yaws along the sides of its regions."""
    if place.yaw is not None and has_yaw(body):
        yield (place.yaw,)
        return
    yield (None,)
    for area in place.within:
        yield from _ways(area, body)[1:]


def _narrow_fits(area: Region, body: Body, standing: Sequence[Body], yaw: float | None) -> Array:
    """Points (n, 2) [m] where an object just fits into an area hardly larger: in the middle and at the sides.

    A grid over the area may miss all of them.
    """
    room = np.array(area.half_extents) - _half_at(area, body, yaw)
    if room.min() < -EDGE / 2 or room.min() > PITCH:
        return np.zeros((0, 2))
    along = [np.linspace(-one, one, max(3, 2 * round(one / PITCH) + 1)) for one in np.maximum(room, 0.0)]
    local = np.stack(np.meshgrid(*along, indexing="ij"), axis=-1).reshape(-1, 2)
    local = local[np.argsort(np.linalg.norm(local, axis=1), kind="stable")]
    c, s = np.cos(area.yaw), np.sin(area.yaw)
    points = area.centre + local @ np.array([[c, s], [-s, c]])
    x, y = area.half_extents
    wider = replace(area, half_extents=(x + EDGE / 2, y + EDGE / 2))
    return np.asarray(points[_fits(points, wider, body, standing, _GAPS[-1], yaw)])


def _ways(area: Region, body: Body) -> tuple[Yaws, ...]:
    """Yaws of an object in an area: any yaw, then, for objects with corners, along the sides of the area."""
    if body.shape == "cylinder" or not body.is_upright:
        return ((None,),)
    quarters = [area.yaw + quarter * np.pi / 2 for quarter in range(4)]
    return (None,), (quarters[0], quarters[2]), (quarters[1], quarters[3])


def beside(scene: Scene, face: StaticObstacle, body: Body) -> list[Body]:
    """Objects that an object on a face could touch. Held objects are left out."""
    height = body.top - body.bottom
    return [
        one
        for one in scene.objects
        if one.bottom < face.top + height and one.top > face.top + _TOUCHING and one.name not in scene.held_names
    ]


def must_go_first(scene: Scene, body: Body, fact: On | Inside | At) -> tuple[str, ...]:
    """Names of the objects that each alone keep an object from its place: proved.

    Of two objects of one piece, the moving one is reduced to the circle inside it. The point of an area farthest from
    an obstacle is a corner, so only corners are tested. For objects of several pieces, see `overlaps_everywhere`.
    """
    place = place_of(scene, fact)
    lowest = min(resting_ways(body), key=lambda way: way.top - way.bottom)
    if place.below and place.area is None:
        return _on_top(scene, lowest, place)
    standing = [one for one in beside(scene, place.face, lowest) if one.name not in (body.name, place.below)]
    if place.area is None:
        assert place.location is not None
        x, y = place.location
        ends = Ends(place.face.top, point=(float(x), float(y)), tolerance=place.slack)
    else:
        ends = Ends(place.face.top, place.area, by_centre=_is_by_centre(scene, fact))
    return tuple(one.name for one in standing if _keeps_out(one, body, ends))


def _keeps_out(standing: Body, body: Body, ends: Ends) -> bool:
    """Whether an object where it stands overlaps another one at each of its ends: proved."""
    if "pieces" in (body.shape, standing.shape):
        return overlaps_everywhere(body, ends, standing)
    radius = inner_radius(body)
    if ends.area is None:
        centres, slack = np.array([ends.point]), ends.tolerance + EDGE
    else:
        inset, slack = 0.0 if ends.by_centre else radius, EDGE
        x, y = np.maximum(np.array(ends.area.half_extents) - inset + EDGE, EDGE)
        centres = replace(ends.area, half_extents=(float(x), float(y))).corners
    return bool((distances(centres, standing) < radius - slack).all())


def without_room(scene: Scene, goal: Goal, to_move: Collection[str]) -> tuple[tuple[str, ...], str]:
    """Find objects that cannot all be at their goal places, with the reason: proved. Result (), "" if none are found.

    For two poses, at least one of the objects must move. Nothing is claimed about objects of several pieces.
    """
    facts = [fact for fact in goal.placed if fact.object in to_move]
    for find_reason in (_why_too_large, _why_beside, _why_falling, _why_in_the_air, _why_in_obstacles):
        reasons = {fact.object: why for fact in facts if (why := find_reason(scene, fact))}
        if reasons:
            return tuple(reasons), "; ".join(f"{name}, however it is put down, {why}" for name, why in reasons.items())
    if poses := _overlapping(scene, goal, to_move):
        return poses, f"{' and '.join(poses)} overlap at their poses, by more than the tolerances allow"
    crowd = _crowd(scene, [fact for fact in goal.placed if scene.body(fact.object).shape != "pieces"])
    return crowd, f"however they are put down, {', '.join(crowd)} do not all fit where they are to stand" * bool(crowd)


def _crowd(scene: Scene, facts: Sequence[On | Inside | At]) -> tuple[str, ...]:
    """Names of objects that do not all fit into their areas, () if none are found.

    Each object covers at least the largest circle inside it. The centres of two objects are at least the sum of their
    radii apart. For more objects, Oler's inequality (Acta Mathematica 105, 1961) bounds the number of centres at
    distances of d in a convex area.
    """
    # Last entry: smallest distance [m] of its centre from the area's sides.
    found: list[tuple[str, float, Region, float]] = []
    for fact, place in _places_of(scene, facts):
        area, radius = place.area, inner_radius(scene.body(fact.object))
        inset = 0.0 if _is_by_centre(scene, fact) else radius - EDGE
        if area is not None and min(area.half_extents) > inset:
            found.append((fact.object, radius, area, inset))
    corners = [_shrunk(area, inset).corners for _, _, area, inset in found]
    for k, m in itertools.combinations(range(len(found)), 2):
        one, other = found[k], found[m]
        away = np.linalg.norm(corners[k][:, None] - corners[m], axis=2).max()
        if one[2].support == other[2].support and away < one[1] + other[1]:
            return one[0], other[0]
    for area in dict.fromkeys(area for _, _, area, _ in found):
        # An area may have several names, or lie inside another one.
        within = [one for one in found if one[2].support == area.support and _contains(area, one[2])]
        within.sort(key=lambda one: -one[1])
        for count, (_, radius, _, _) in enumerate(within, start=1):
            x, y = np.array(area.half_extents) - min(inset for *_, inset in within[:count])
            most = 8 / math.sqrt(3) * x * y / (2 * radius) ** 2 + (x + y) / radius + 1
            if count > most + 1e-9:
                return tuple(name for name, *_ in within[:count])
    return ()


def _is_by_centre(scene: Scene, fact: On | Inside | At) -> bool:
    """Whether an object may reach over the edges of its place: on a support, or on another object."""
    if not isinstance(fact, On) or fact.place not in (*scene.supports, *scene.names):
        return False
    return fact.place in scene.supports or _hollow_for(scene, fact) is None


def _shrunk(area: Region, inset: float) -> Region:
    x, y = area.half_extents
    return replace(area, half_extents=(x - inset, y - inset))


def _why_too_large(scene: Scene, fact: On | Inside | At) -> str:
    """Reason if an object is larger than its area in every yaw and resting orientation, else "".

    It is a proof: between the tested angles, extents change by less than the margin that is added.
    """
    body, area = scene.body(fact.object), place_of(scene, fact).area
    if area is None or body.name in scene.held_names or _is_by_centre(scene, fact) or not _is_larger(body, area):
        return ""
    if not isinstance(fact, At) and hollow_of(scene, fact.where) is not None and not _is_area(scene, fact.where):
        (x, y), least = 2e3 * np.array(area.half_extents), 2e3 * inner_radius(body)
        return f"is larger than the inside of {area.name}, {x:.0f} by {y:.0f} mm: it measures {least:.0f} mm or more"
    return f"is larger than its place, {area.name}"


def _is_larger(body: Body, area: Region) -> bool:
    """Whether an object is larger than an area in every yaw and resting orientation. See `_why_too_large`."""
    angles = np.linspace(0.0, np.pi, 180, endpoint=False)
    for way in resting_ways(body):
        along = np.ptp(footprint(way) @ np.stack((np.cos(angles), np.sin(angles))), axis=0)
        most = 2 * (np.array(area.half_extents) + EDGE) + along.max() * (angles[1] - angles[0])
        if ((along <= most[0]) & (np.roll(along, len(angles) // 2) <= most[1])).any():
            return False
    return True


def _why_beside(scene: Scene, fact: On | Inside | At) -> str:
    """Reason if an object within its region would have its centre beside the support: proved. "" otherwise."""
    body, place = scene.body(fact.object), place_of(scene, fact)
    if place.area is None or place.area.name == place.face.name or body.shape == "pieces":
        return ""
    inset = inner_radius(body) - EDGE
    is_narrow = min(place.area.half_extents) <= inset
    if is_narrow or overlap(_shrunk(place.area, inset).corners, place.face.outline) >= 0:
        return ""
    return f"has its middle beside the support of its region, {place.face.name}"


def _why_falling(scene: Scene, fact: On | Inside | At) -> str:
    """Reason if an object on another, standing object of pieces would fall: proved. "" otherwise.

    It needs support no lower than the top, on all sides of its centre, within the circle that it covers in any yaw. The
    tested points are so dense that the wall of a cup cannot lie between them.
    """
    body, place = scene.body(fact.object), place_of(scene, fact)
    if not place.below or place.hollow is not None:
        return ""
    if scene.body(place.below).shape != "pieces" or not scene.body(place.below).is_upright:
        return ""
    reach = max(way.radius for way in resting_ways(body))
    away = np.linspace(0.0, reach, math.ceil(reach / _WALL) + 1)[:, None, None] * _AROUND
    points = np.append(away, np.zeros((*away.shape[:2], 1)), axis=2).reshape(-1, 3)
    points[:, :2] += place.location
    is_held = np.zeros(len(points), np.bool_)
    for piece in scene.body(place.below).placed:
        enter, leave, *_ = piece.cut(points, np.tile((0.0, 0.0, 1.0), (len(points), 1)))
        is_held |= (enter < leave) & (leave > place.face.top - RESTING)
    on_sides = away.reshape(-1, 2)[is_held] @ _AROUND.T
    if (on_sides.max(axis=0, initial=-np.inf) >= -np.linalg.norm(body.centre_of_mass)).all():
        return ""
    return f"would fall: what it is to stand on is hollow there, {place.below}"


def _why_in_the_air(scene: Scene, fact: On | Inside | At) -> str:
    """Reason if nothing can support an object at the height of its pose: proved. "" if something may.

    Tested are the supports, within the tolerances, and all other objects stacked on the highest support.
    """
    if not isinstance(fact, At) or fact.z is None:
        return ""
    body, slack = scene.body(fact.object), max(fact.tolerance, RESTING) + RESTING
    bottoms = [fact.z - float(way.position[2]) + way.bottom for way in resting_ways(body)]
    tops = [face.top for face in _supports_about(scene, fact)]
    tallest = sum(2 * float(np.linalg.norm(one.half_extents)) for one in scene.objects if one.name != body.name)
    is_near = any(abs(top - bottom) <= slack for top in tops for bottom in bottoms)
    is_stacked = any(top - slack <= bottom <= top + tallest + slack for top in tops for bottom in bottoms)
    if is_near or is_stacked:
        return ""
    heights = ", ".join(f"{face.name} ({face.top:.2f} m)" for face in _supports_about(scene, fact))
    return f"has no support at the height of its pose, {bottoms[0]:.2f} m: those there are {heights}"


def _why_in_obstacles(scene: Scene, fact: On | Inside | At) -> str:
    """Reason if an object at a pose overlaps static obstacles on every possible support: proved. "" otherwise.

    Only boxes with a vertical axis and objects of one piece are tested.
    """
    body = scene.body(fact.object)
    if not isinstance(fact, At) or body.shape == "pieces":
        return ""
    there, slack = _least_footprint(scene, fact), _play(scene, fact)
    lowest = min(way.top - way.bottom for way in resting_ways(body))
    boxes = [one for one in scene.static_obstacles if one.shape == "box" and one.has_level_top]
    boxes = [one for one in boxes if overlap(there, one.outline) > slack]
    found: dict[str, None] = {}
    for face in _supports_about(scene, fact):
        over = [one.name for one in boxes if one.top > face.top + _TOUCHING and one.lower[2] < face.top + lowest]
        if not over:
            return ""
        found |= dict.fromkeys(over)
    return f"overlaps {', '.join(found)} at its pose"


def _supports_about(scene: Scene, fact: At) -> list[StaticObstacle]:
    """Supports under a pose, or within its tolerance."""
    around = np.concatenate(([(fact.x, fact.y)], (fact.x, fact.y) + fact.tolerance * RIM))
    return [face for face in map(scene.support_named, scene.supports) if face.is_under(around).any()]


def fixed_about(scene: Scene, place: Place) -> tuple[str, ...]:
    """Names of the static obstacles around or above a place that may keep a gripper out, for the text of a refusal."""
    middle = np.array(place.area.centre) if place.area is not None else place.location
    assert middle is not None
    half = 0.0 if place.area is None else math.hypot(*place.area.half_extents)
    near = (
        one
        for one in scene.static_obstacles
        if place.face.top + _TOUCHING < one.top and one.lower[2] < place.face.top + _REACH_ABOVE
    )
    return tuple(one.name for one in near if overlap(one.outline, middle + (half + _ABOUT) * RIM) > 0)


def _overlapping(scene: Scene, goal: Goal, to_move: Collection[str]) -> tuple[str, ...]:
    """Names of two objects that would overlap at the poses of a goal: proved. () if none would.

    At least one of them must move. The other one overlaps it at its pose and, if it may stay, where it stands, by more
    than the tolerances allow. Boxes with a free yaw, and lying objects, are reduced to the circle inside. Nothing is
    claimed about objects of several pieces.
    """
    facts = [fact for fact in goal.placed if isinstance(fact, At) and scene.body(fact.object).shape != "pieces"]
    for one, other in itertools.permutations(facts, 2):
        if one.object not in to_move or place_of(scene, one).face.name != place_of(scene, other).face.name:
            continue
        there, slack = _least_footprint(scene, one), _play(scene, one)
        is_apart = overlap(there, _least_footprint(scene, other)) <= slack + _play(scene, other)
        may_stay = other.object not in to_move and overlap(there, footprint(scene.body(other.object))) <= slack
        if not (is_apart or may_stay):
            return one.object, other.object
    return ()


def _play(scene: Scene, fact: At) -> float:
    """Largest shift [m] of an object's outline at a pose, in any direction, within the tolerances."""
    body = scene.body(fact.object)
    turns = body.is_upright and fact.yaw is not None and has_yaw(body)
    return fact.tolerance + (body.radius * min(fact.yaw_tolerance, np.pi) if turns else 0.0)


def _least_footprint(scene: Scene, fact: At) -> Array:
    """Points (k, 2) [m] whose convex hull an object at a pose covers in every possible orientation."""
    body, location = scene.body(fact.object), np.array([fact.x, fact.y])
    if body.is_upright and fact.yaw is not None:
        return footprint(_standing(body, location, fact.yaw))
    radius = inner_radius(body)
    angles = np.linspace(0.0, 2 * np.pi, 24, endpoint=False)
    return np.asarray(location + radius * np.column_stack((np.cos(angles), np.sin(angles))))


def inner_radius(body: Body) -> float:
    """Radius [m] of a circle inside the object seen from above, in every yaw and resting orientation."""
    return float(min(body.half_extents[:2] if body.is_upright else body.half_extents))


def in_the_way(scene: Scene, body: Body, place: Place, waiting: Collection[str]) -> tuple[str, ...]:
    """Names of objects to remove so that an object fits at its place. Empty if it fits without removals.

    Args:
        scene: the scene with the objects where they stand.
        body: the object to put there, in the resting orientation with the smallest radius.
        place: the place.
        waiting: names of objects that will leave anyway.
    """
    body = least_room(body)
    if place.below and place.area is None:
        return tuple(name for name in _on_top(scene, body, place) if name not in waiting)
    standing = [one for one in beside(scene, place.face, body) if one.name not in (body.name, place.below)]
    staying = [one for one in standing if one.name not in waiting]
    if place.area is None:
        assert place.location is not None
        near = [one for one in staying if distances(place.location[None], one)[0] < body.radius + _GAPS[-1]]
        return tuple(one.name for one in near)
    points = _grid(place.area, scene.state.base[:2])

    def fits(others: Sequence[Body]) -> bool:
        """Whether the object fits beside these objects."""
        assert place.area is not None
        area, yaws = place.area, [yaw for yaw, *_ in _ways(place.area, body)]
        is_on_grid = any(_fits(points, area, body, others, _GAPS[-1], yaw).any() for yaw in yaws)
        return is_on_grid or any(len(_narrow_fits(area, body, others, yaw)) for yaw in yaws)

    if fits(staying):
        return ()
    inside = [one for one in staying if place.area.touches(one)]
    alone = [one for one in inside if fits([other for other in staying if other is not one])]
    return tuple(one.name for one in alone[:1] or inside)


def least_room(body: Body) -> Body:
    """The object in its resting orientation with the smallest radius: a lying object may come to stand."""
    return min(resting_ways(body), key=lambda way: way.radius)


def _on_top(scene: Scene, body: Body, place: Place) -> tuple[str, ...]:
    """Names of the objects that stand on the object below the place."""
    over = (one for one in scene.objects if abs(one.bottom - place.face.top) <= _TOUCHING and one.name != place.below)
    over = (one for one in over if one.name not in (body.name, *scene.held_names))
    return tuple(one.name for one in over if place.face.is_under(one.position[:2]))


def _steps(area: Region, pitch: float = PITCH) -> NDArray[np.intp]:
    """Number of locations along each side of an area."""
    size = 2 * np.array(area.half_extents)
    return np.clip(np.ceil(size / pitch).astype(int) + 1, 2, _MOST)


def _grid(area: Region, base: Array, pitch: float = PITCH) -> Array:
    """Points (n, 2) [m] of an area, row by row, the row farthest from the base first."""
    counts = _steps(area, pitch)
    along = [np.linspace(-half, half, count) for half, count in zip(area.half_extents, counts, strict=True)]
    towards = area.local(base)
    depth = int(np.abs(towards).argmax())  # axis along which the robot looks at the area
    rows, columns = -np.sign(towards[depth] or 1.0) * along[depth][::-1], along[1 - depth]
    grid = np.stack(np.meshgrid(rows, columns, indexing="ij"), axis=-1).reshape(-1, 2)
    local = grid if depth == 0 else grid[:, ::-1]
    c, s = np.cos(area.yaw), np.sin(area.yaw)
    return np.asarray(area.centre + local @ np.array([[c, s], [-s, c]]))


def _fits(
    points: Array, area: Region, body: Body, standing: Sequence[Body], gap: float, yaw: float | None
) -> NDArray[np.bool_]:
    """Whether the box around an object at a yaw, or its circle, lies in an area with a gap [m] to others: (n,)."""
    most = np.array(area.half_extents) - _half_at(area, body, yaw)
    inside = np.asarray((np.abs(area.local(points)) <= most).all(axis=1), np.bool_)
    within = math.hypot(*area.half_extents) + body.radius + gap
    for one in standing:
        if math.dist(one.position[:2], area.centre) > within + one.radius:
            continue
        _clear_beside(inside, points, body, yaw, one, gap)
    return inside


def _clear_beside(
    free: NDArray[np.bool_], points: Array, body: Body, yaw: float | None, one: Body, gap: float
) -> NDArray[np.bool_]:
    """Clear entries (n,) of points where an object is closer than a gap [m] to another one, in place."""
    away = np.linalg.norm(points - one.position[:2], axis=1)
    near = np.flatnonzero(free & (away < body.radius + one.radius + gap))
    if len(near):
        free[near] = _room_beside(points[near], body, yaw, one) >= gap
    return free


def _half_at(area: Region, body: Body, yaw: float | None) -> Array:
    """Half extents (2,) [m], along the sides of an area, of the box around an object at a yaw, or of its circle."""
    return np.full(2, body.radius) if yaw is None else np.abs(_corners(body, yaw - area.yaw)).max(axis=0)


def _corners(body: Body, yaw: float) -> Array:
    """Corners (4, 2) [m] of the upright box around an object at the origin."""
    c, s = np.cos(yaw), np.sin(yaw)
    signs = np.array([(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)])
    return np.asarray(signs * body.half_extents[:2] @ np.array([[c, s], [-s, c]]))


def _room_beside(points: Array, body: Body, yaw: float | None, one: Body) -> Array:
    """Clearance [m] from the box or circle around an object, at points (n, 2), to another one. At most 0: overlap."""
    if yaw is None:
        return distances(points, one) - body.radius
    corners = _corners(body, yaw)
    if one.shape == "cylinder" and one.is_upright:
        return distances_to_polygon(one.position[:2] - points, corners) - one.half_extents[0]
    sums = (footprint(one)[:, None] - corners).reshape(-1, 2)
    return distances_to_polygon(points, sums[ConvexHull(sums).vertices])


def distances(points: Array, body: Body) -> Array:
    """Distances [m] from points (n, 2) to an object seen from above, 0 inside."""
    if body.shape == "cylinder" and body.is_upright:
        return np.maximum(np.linalg.norm(points - body.position[:2], axis=1) - body.half_extents[0], 0.0)
    if body.shape == "pieces":
        away = points - body.position[:2]
        return np.min([distances_to_polygon(away, one) for one in body.piece_outlines], axis=0)
    outline = footprint(body)
    if abs(body.rotation[2, 2]) < _LEVEL:
        return distances_to_polygon(points, outline[ConvexHull(outline).vertices])
    axes = body.rotation[:2, :2]
    local, corners = (points - body.position[:2]) @ axes, (outline - body.position[:2]) @ axes
    outside = np.maximum(np.abs(local) - np.abs(corners).max(axis=0), 0.0)
    return np.asarray(np.linalg.norm(outside, axis=1))


def distances_to_polygon(points: Array, corners: Array) -> Array:
    """Distances [m] from points (n, 2) to a convex polygon (k, 2), counter-clockwise. 0 inside."""
    sides, away = np.roll(corners, -1, axis=0) - corners, points[:, None] - corners
    length = np.maximum((sides**2).sum(axis=1), 1e-18)
    shares = np.clip((away * sides).sum(axis=2) / length, 0.0, 1.0)
    nearest = np.linalg.norm(away - shares[..., None] * sides, axis=2).min(axis=1)
    inside = (sides[:, 0] * away[..., 1] - sides[:, 1] * away[..., 0] >= 0).all(axis=1)
    return np.where(inside, 0.0, nearest)


class RoomForOthers:
    """Test of whether other objects still fit in an area once an object stands at a point, for many points.

    Each of the others goes to the first free point, the largest first. Free points next to the objects that stay, and
    next to others already placed at the same point, are computed once.
    """

    def __init__(
        self, points: Array, area: Region, staying: Sequence[Body], others: Sequence[Body], gap: float
    ) -> None:
        """Prepare points (n, 2) of an area, the objects that stay and come, and the gap [m] between neighbours."""
        self.points, self.area, self.staying, self.gap = points, area, staying, gap
        self.others = sorted(others, key=lambda one: -one.radius)
        self._free: dict[tuple[int, float | None], NDArray[np.bool_]] = {}
        self._stood: dict[tuple[int, float | None, int], Body] = {}
        self._beside: dict[tuple[int, float | None, Body], NDArray[np.bool_]] = {}

    def is_left(self, body: Body, point: Array, yaw: float | None) -> bool:
        """Whether the others fit too once an object stands at a point. With a yaw, they may have one as well.

        Args:
            body: the object.
            point: (2,) [m].
            yaw: yaw [rad] of the object, None for any.
        """
        if not self.others:
            return True
        first, placed = _standing(body, point, yaw), list[Body]()
        for k, other in enumerate(self.others):
            for way, *_ in _ways(self.area, other)[slice(1) if yaw is None else slice(None, None, -1)]:
                free = self._free_among(k, way, placed)
                _clear_beside(free, self.points, other, way, first, self.gap)
                if free.any():
                    break
            else:
                return False
            placed.append(self._standing(k, way, int(free.argmax())))
        return True

    def _free_among(self, k: int, yaw: float | None, placed: Sequence[Body]) -> NDArray[np.bool_]:
        """Free points of one of the others at a yaw, next to objects that stay or are placed: (n,), a copy."""
        other, points, gap = self.others[k], self.points, self.gap
        if (k, yaw) not in self._free:
            self._free[k, yaw] = _fits(points, self.area, other, self.staying, gap, yaw)
        free = self._free[k, yaw].copy()
        for one in placed:
            if (k, yaw, one) not in self._beside:
                self._beside[k, yaw, one] = _clear_beside(np.ones(len(points), np.bool_), points, other, yaw, one, gap)
            free &= self._beside[k, yaw, one]
        return free

    def _standing(self, k: int, yaw: float | None, at: int) -> Body:
        """One of the others at a point, cached: the same object for the same arguments."""
        if (k, yaw, at) not in self._stood:
            self._stood[k, yaw, at] = _standing(self.others[k], self.points[at], yaw)
        return self._stood[k, yaw, at]


def _standing(body: Body, point: Array, yaw: float | None) -> Body:
    return stand_at(body, np.append(point, body.bottom), 0.0 if yaw is None else yaw - body.yaw)


def placed_fact(goal: Goal, name: str) -> On | Inside | At | None:
    """The fact that places an object, if any."""
    return next((fact for fact in goal.placed if fact.object == name), None)


def stacked_on(scene: Scene, goal: Goal, name: str) -> list[Body]:
    """Objects that a goal wants on an object, or on these, from below."""
    found: list[Body] = []
    while above := next((fact.object for fact in goal.placed if fact.where == name), ""):
        found.append(scene.body(above))
        name = above
    return found


def of_same_area(scene: Scene, goal: Goal, name: str, waiting: Collection[str]) -> list[Body]:
    """Objects still to move into the same area as an object of the goal, under any of the area's names."""
    own = placed_fact(goal, name)
    area = None if own is None else place_of(scene, own).area
    if area is None:
        return []
    others = [fact for fact in goal.placed if fact.object in waiting and fact.object != name]
    areas = ((fact.object, place.area) for fact, place in _places_of(scene, others) if not isinstance(fact, At))
    return [least_room(scene.body(one)) for one, theirs in areas if theirs is not None and _is_same(theirs, area)]
