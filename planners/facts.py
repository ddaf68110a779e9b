"""Facts of a goal, and their meaning in a scene: data and plain geometry."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field, fields
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from planners.hollows import hollow_of, hollow_of_body
from planners.regions import EDGE, RESTING, Array, GoalError, Region, footprint, overlap, with_those_on

if TYPE_CHECKING:
    from planners.scene import Body, Scene, StaticObstacle

LIFTED = 0.10
"""Height [m] above its former place from which on an object in the gripper is held up."""
TOLERANCE, YAW_TOLERANCE = 0.02, 0.1
"""Default tolerances [m] and [rad] of a pose."""
OPEN_SHARE, AJAR = 0.8, 0.05
"""Default share of the range from which on something is open. Share up to which it is shut, and tolerance of a wanted
share."""
LACKS = 0.12
"""Share of its range that an opening may lack once it has been released. It is pulled farther than a goal asks."""


@dataclass(frozen=True)
class Holding:
    """Fact: the object is in a gripper, raised `LIFTED` above where it stood, or with its centre at a point.

    Attributes:
        object: name of the object.
        point: x, y, z [m] of its centre, None for any.
        tolerance: tolerance [m] of the point.

    Raises:
        GoalError: the point is not three finite numbers, or the tolerance is not positive.
    """

    object: str
    point: tuple[float, float, float] | None = None
    tolerance: float = TOLERANCE

    def __post_init__(self) -> None:
        try:
            if self.point is not None:
                x, y, z = self.point
                object.__setattr__(self, "point", (float(x), float(y), float(z)))
            object.__setattr__(self, "tolerance", TOLERANCE if self.point is None else float(self.tolerance))
            is_valid = np.isfinite((*(self.point or ()), self.tolerance)).all() and self.tolerance > 0
        except (TypeError, ValueError, OverflowError):
            is_valid = False
        if not is_valid:
            raise GoalError(f"a point is three finite numbers, its tolerance is positive, not {self!r:.200}")

    def holds(self, scene: Scene, start: Scene | None = None) -> bool:
        """Whether the object is held so. See `Goal.holds`."""
        if self.object not in scene.held_names:
            return False
        body = scene.body(self.object)
        if self.point is not None:
            return bool(np.linalg.norm(body.position - self.point) <= self.tolerance)
        if start is None:
            return body.bottom >= height_below(scene, body) + LIFTED - EDGE
        before = start.body(self.object)
        stood_at = height_below(start, before) if self.object in start.held_names else before.bottom
        return body.bottom >= stood_at + LIFTED - EDGE


@dataclass(frozen=True)
class Pulled(Holding):
    """Fact: the handle, which is among the scene's objects, has been pulled, and its drawer or door with it."""

    def holds(self, scene: Scene, start: Scene | None = None) -> bool:
        """Whether the handle is elsewhere than at the start. See `Goal.holds`."""
        return start is not None and scene.body(self.object) is not start.body(self.object)


@dataclass(frozen=True)
class On:
    """Fact: the object rests on a support, on another object, or in a region with its whole footprint.

    On a hollow object it is inside, or on the rim.

    Attributes:
        object: name of the object.
        place: name of the support, the other object, or the region.
        pose: its pose on another object, if other facts of the goal give one.
    """

    object: str
    place: str
    pose: At | None = field(default=None, repr=False)

    @property
    def where(self) -> str:
        """Name of the place."""
        return self.place

    def holds(self, scene: Scene, start: Scene | None = None) -> bool:
        """Whether the object rests there. See `Goal.holds`."""
        if self.place in region_names(scene):
            return Inside(self.object, self.place).holds(scene, start)
        body = scene.body(self.object)
        if self.place in scene.supports:
            face = scene.support_named(self.place)
            return is_at_rest(scene, body, face.top, start) and bool(face.is_under(body.position[:2]))
        if is_in_hollow(scene, body, self.place):
            return True
        if self.place not in scene.names:
            return False
        below = scene.body(self.place)
        is_over = overlap(footprint(below), body.position[None, :2]) >= 0
        return is_over and self.place not in scene.held_names and is_at_rest(scene, body, below.top, start)


@dataclass(frozen=True)
class Inside:
    """Fact: the object rests with its whole footprint within a region or the face of a support, or in a hollow."""

    object: str
    region: str

    @property
    def where(self) -> str:
        """Name of the place."""
        return self.region

    def holds(self, scene: Scene, start: Scene | None = None) -> bool:
        """Whether the object rests there. See `Goal.holds`."""
        body = scene.body(self.object)
        if self.region in region_names(scene):
            region = region_named(scene, self.region)
            is_there = region.contains(body) and scene.support_named(region.support).is_under(body.position[:2])
            return bool(is_there) and is_at_rest(scene, body, scene.support_named(region.support).top, start)
        if self.region not in scene.supports:
            return is_in_hollow(scene, body, self.region)
        face = scene.support_named(self.region)
        corners = footprint(body, -EDGE)
        return is_at_rest(scene, body, face.top, start) and bool(face.is_under(corners).all())


@dataclass(frozen=True)
class At:
    """Fact: the object rests at a pose.

    Attributes:
        object: name of the object.
        x, y: position [m] of its centre.
        yaw: yaw [rad], None for any. It is ignored for an upright cylinder.
        z: height [m] of its centre, None for any. It chooses between supports that lie above each other.
        tolerance: tolerance of the position [m].
        yaw_tolerance: tolerance of the yaw [rad].
        within: names of regions and supports that its whole footprint must lie in, if other facts of the goal say so.

    Raises:
        GoalError: a number is not finite, or a tolerance is not positive.
    """

    object: str
    x: float
    y: float
    yaw: float | None = None
    z: float | None = None
    tolerance: float = TOLERANCE
    yaw_tolerance: float = YAW_TOLERANCE
    within: tuple[str, ...] = field(default=(), repr=False)

    @property
    def where(self) -> str:
        """Empty: a pose names no place."""
        return ""

    def __post_init__(self) -> None:
        try:
            for name in ("x", "y", "yaw", "z", "tolerance", "yaw_tolerance"):
                if getattr(self, name) is not None:
                    object.__setattr__(self, name, float(getattr(self, name)))
            numbers = (self.x, self.y, self.yaw or 0.0, self.z or 0.0, self.tolerance, self.yaw_tolerance)
            is_valid = np.isfinite(numbers).all() and min(self.tolerance, self.yaw_tolerance) > 0
        except (TypeError, ValueError, OverflowError):
            is_valid = False
        if not is_valid:
            raise GoalError(f"a place needs finite numbers and positive tolerances, not {self!r:.200}")

    def holds(self, scene: Scene, start: Scene | None = None) -> bool:
        """Whether the object rests at the pose. See `Goal.holds`."""
        body = scene.body(self.object)
        if math.hypot(body.position[0] - self.x, body.position[1] - self.y) > self.tolerance:
            return False
        if self.z is not None and abs(float(body.position[2]) - self.z) > max(self.tolerance, RESTING):
            return False
        if self.yaw is not None and has_yaw(body):
            turn = math.remainder(body.yaw - self.yaw, 2 * math.pi)
            if abs(turn) > self.yaw_tolerance:
                return False
        return any(is_at_rest(scene, body, level, start) for level in levels_under(scene, body))


@dataclass(frozen=True)
class Clear:
    """Fact: no object stands in the region, or on the support."""

    region: str

    def holds(self, scene: Scene, start: Scene | None = None) -> bool:  # noqa: ARG002  as of the other facts
        """Whether no object stands there. See `Goal.holds`."""
        return not occupants(scene, self.region)


@dataclass(frozen=True)
class Before:
    """Fact: the last move of one object comes before the first move of another. A scene cannot show it."""

    first: str
    second: str

    def holds(self, scene: Scene, start: Scene | None = None) -> bool:  # noqa: ARG002  as of the other facts
        """True, since the fact is about the plan. See `Goal.is_in_order`."""
        return True


@dataclass(frozen=True)
class Open:
    """Fact: a drawer, door or lid is open.

    Attributes:
        opening: name of the drawer, door or lid.
        share: least share of its range, from 0 (shut) to 1.
        amount: least opening [m] or [rad], in place of the share.

    Raises:
        GoalError: the share is not between 0 and 1, or the amount is not positive.
    """

    opening: str
    share: float = OPEN_SHARE
    amount: float | None = None

    def __post_init__(self) -> None:
        try:
            object.__setattr__(self, "share", float(self.share))
            object.__setattr__(self, "amount", None if self.amount is None else float(self.amount))
            is_valid = 0 < self.share <= 1 and (self.amount is None or 0 < self.amount < math.inf)
        except (TypeError, ValueError, OverflowError):
            is_valid = False
        if not is_valid:
            raise GoalError(f"a share is above 0 and at most 1, an amount is positive, not {self!r:.200}")

    def position_in(self, scene: Scene) -> float:
        """Position [m] or [rad] from which on the fact holds."""
        one = scene.opening(self.opening)
        return one.at_share(self.share if self.amount is None else min(self.amount / abs(one.open - one.shut), 1.0))

    def holds(self, scene: Scene, start: Scene | None = None) -> bool:  # noqa: ARG002  as of the other facts
        """Whether it is open so far, with tolerance `AJAR`. See `Goal.holds`."""
        one = scene.opening(self.opening)
        lacks = (self.position_in(scene) - one.position) * math.copysign(1.0, one.open - one.shut)
        return lacks <= AJAR * abs(one.open - one.shut)


@dataclass(frozen=True)
class Closed:
    """Fact: a drawer, door or lid is shut, to within `AJAR` of its range."""

    opening: str

    def position_in(self, scene: Scene) -> float:
        """Position [m] or [rad] of the shut state."""
        return scene.opening(self.opening).shut

    def holds(self, scene: Scene, start: Scene | None = None) -> bool:  # noqa: ARG002  as of the other facts
        """Whether it is shut. See `Goal.holds`."""
        return scene.opening(self.opening).share <= AJAR


@dataclass(frozen=True)
class Turned:
    """Fact: a knob, or anything else that opens, is at an angle.

    Attributes:
        opening: name of the knob.
        angle: angle [rad], or distance [m] of a slide, from shut towards open.
        tolerance: tolerance [rad] or [m].

    Raises:
        GoalError: a number is not finite, or the tolerance is not positive.
    """

    opening: str
    angle: float
    tolerance: float = YAW_TOLERANCE

    def __post_init__(self) -> None:
        try:
            object.__setattr__(self, "angle", float(self.angle))
            object.__setattr__(self, "tolerance", float(self.tolerance))
            is_valid = math.isfinite(self.angle) and 0 < self.tolerance < math.inf
        except (TypeError, ValueError, OverflowError):
            is_valid = False
        if not is_valid:
            raise GoalError(f"an angle is finite, its tolerance positive, not {self!r:.200}")

    def position_in(self, scene: Scene) -> float:
        """Position [m] or [rad] of that angle."""
        one = scene.opening(self.opening)
        return one.shut + math.copysign(self.angle, (one.open - one.shut) * self.angle)

    def holds(self, scene: Scene, start: Scene | None = None) -> bool:  # noqa: ARG002  as of the other facts
        """Whether it is at the angle. See `Goal.holds`."""
        return abs(scene.opening(self.opening).position - self.position_in(scene)) <= self.tolerance


def out_of_range(scene: Scene, fact: Open | Closed | Turned) -> str:
    """Message about an amount or an angle beyond the range of the opening, "" for none."""
    one = scene.opening(fact.opening)
    most, unit = abs(one.open - one.shut), "m" if one.kind == "slide" else "rad"
    if isinstance(fact, Open) and fact.amount is not None and fact.amount > (1 + AJAR) * most:
        return f"{one.name!r} opens by {most:.4g} {unit}, not by {fact.amount:.4g}"
    if isinstance(fact, Turned) and not -fact.tolerance <= fact.angle <= most + fact.tolerance:
        return f"{one.name!r} moves from 0 to {most:.4g} {unit}, not to {fact.angle:.4g}"
    return ""


Fact: TypeAlias = Holding | On | Inside | At | Clear | Before | Open | Closed | Turned
VALID = (
    "holding(a), holding(a, point), on(a, place), inside(a, region), at(a, pose), clear(region), before(a, b), "
    "open_(drawer), closed(drawer), turned(knob, angle), joined by &"
)
"""All kinds of facts, in words."""


# The geometry of scenes.


def region_names(scene: Scene) -> tuple[str, ...]:
    """Names of the scene's regions."""
    return tuple(region.name for region in scene.regions)


def region_named(scene: Scene, name: str) -> Region:
    """Region of that name. Raises `GoalError`, which lists the known regions."""
    for region in scene.regions:
        if region.name == name:
            return region
    raise GoalError(f"no region {name!r}; known regions: {', '.join(region_names(scene)) or 'none'}")


def occupants(scene: Scene, place: str) -> tuple[str, ...]:
    """Names of the objects in a region or on a support, also on top of other objects. Held objects are left out."""
    region = region_named(scene, place) if place in region_names(scene) else None
    face = scene.support_named(place if region is None else region.support)
    standing = [body for body in scene.objects if body.name not in scene.held_names]
    found = [b for b in standing if face.is_under(b.position[:2]) and stands_at(scene, b, face.top)]
    reached = with_those_on(found, standing)
    return tuple(body.name for body in reached if region is None or region.touches(body))


def height_below(scene: Scene, body: Body) -> float:
    """Height [m] of the highest level face under the centre of an object, on which it stands or would fall.

    If no support is under a held object, it is the height of the scene's first support.
    """
    under = scene.support_under(body)
    is_beside = under.name not in scene.supports and body.name in scene.held_names
    return (scene.support if is_beside else under).top


def is_at_rest(scene: Scene, body: Body, level: float, start: Scene | None = None) -> bool:
    """Whether an object rests on a face at a height [m]: upright, or lying if it lay at the start."""
    is_standing = body.is_upright or (start is not None and not start.body(body.name).is_upright)
    return is_standing and body.name not in scene.held_names and stands_at(scene, body, level)


def stands_at(scene: Scene, body: Body, level: float) -> bool:
    """Whether an object's lowest point is at a face at a height [m], and no other face under its centre is nearer."""
    away = abs(body.bottom - level)
    return away <= RESTING and all(abs(body.bottom - other) >= away for other in levels_under(scene, body))


def is_in_hollow(scene: Scene, body: Body, name: str) -> bool:
    """Whether an object was released inside an object or a static body of that name."""
    hollow = None if {body.name, name} & {*scene.held_names} else hollow_of(scene, name)
    return hollow is not None and hollow.contains(body)


def levels_under(scene: Scene, body: Body) -> Iterator[float]:
    """Heights [m] of supports and objects under the centre of an object, within `RESTING` of its lowest point.

    For an object in a container, the container's floor is included.
    """
    for name in scene.supports:
        face = scene.support_named(name)
        if abs(face.top - body.bottom) <= RESTING and face.is_under(body.position[:2]):
            yield face.top
    for one in scene.objects:
        is_near = abs(one.top - body.bottom) <= RESTING and one.name not in (body.name, *scene.held_names)
        if is_near and overlap(footprint(one), body.position[None, :2]) >= 0:
            yield one.top
        hollow = (
            hollow_of_body(one) if one.shape == "pieces" and one.name not in (body.name, *scene.held_names) else None
        )
        if hollow is not None and abs(hollow.floor - body.bottom) <= RESTING and hollow.contains(body):
            yield hollow.floor


def has_yaw(body: Body) -> bool:
    """Whether a turn about the vertical changes the object: False for an upright cylinder."""
    return not (body.shape == "cylinder" and body.is_upright)


def names_in(fact: Fact) -> tuple[str, ...]:
    """Names in a fact, in the order of its fields."""
    return tuple(getattr(fact, entry.name) for entry in fields(fact) if entry.type == "str")


def support_at(scene: Scene, fact: At) -> StaticObstacle:
    """Support on which an object is to stand at a pose.

    If the pose gives a height, it is the support whose top is nearest to it. Otherwise only supports with enough
    clearance above them are considered: not a counter under a tray, but a table below a shelf that is high enough. Of
    these, the support on which the object already stands comes first, else the highest, which is reached from above.

    Args:
        scene: the scene with the object where it stands.
        fact: the pose, over some support.
    """
    body, point = scene.body(fact.object), np.array([fact.x, fact.y])
    under = supports_under(scene, fact)
    if fact.z is not None:
        bottom = fact.z - float(body.position[2]) + body.bottom
        return min(under, key=lambda face: (round(abs(face.top - bottom), 3), -face.top))
    free = [face for face in under if not is_filled(scene, np.append(point, face.top), body.top - body.bottom)] or under
    own = scene.support_under(body)
    is_standing = body.name not in scene.held_names and abs(own.top - body.bottom) <= RESTING
    return max(free, key=lambda face: (is_standing and face.name == own.name, face.top))


def supports_under(scene: Scene, fact: At) -> list[StaticObstacle]:
    """Supports under a pose. A valid goal has at least one."""
    point = np.array([fact.x, fact.y])
    return [face for face in map(scene.support_named, scene.supports) if face.is_under(point)]


def is_filled(scene: Scene, point: Array, height: float) -> bool:
    """Whether a static obstacle lies on the vertical line of a height [m] above a point (3,) of a face."""
    low, high = point[2] + RESTING / 2, point[2] + height
    over = (one for one in scene.static_obstacles if one.lower[2] < high and one.top > low)
    return any(bool(one.is_under(point[:2])) for one in over)


def whole_face(face: StaticObstacle) -> Region:
    """Top face of a support as a region. For a round support, the square around it."""
    x_axis = face.rotation[:2, 0] if face.shape == "box" else np.array([1.0, 0.0])
    yaw = float(np.arctan2(x_axis[1], x_axis[0]))
    return Region(face.name, face.name, tuple(face.position[:2]), tuple(face.half_extents[:2]), yaw)
