"""Facts of a goal, and what each of them means in a scene: data and plain geometry."""

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
"""[m] above where it stood from which on an object in the gripper counts as held up."""
TOLERANCE, YAW_TOLERANCE = 0.02, 0.1
"""[m] and [rad] about a pose, if no other tolerance is given."""
OPEN_SHARE, AJAR = 0.8, 0.05
"""Share of its range from which on something counts as open if no other is given; and up to which it counts as shut,
or may lack of what is wanted."""


@dataclass(frozen=True)
class Holding:
    """The object is in a gripper, raised `LIFTED` above where it stood, or with its centre at a point.

    Attributes:
        object: its name.
        point: x, y, z [m] of its centre; None for any.
        tolerance: [m] about the point.

    Raises:
        GoalError: not three finite numbers, or a tolerance that is not positive.
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
        """Whether it is; see `Goal.holds`."""
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
    """The handle has been pulled, and what it opens with it: of the scene in which it stands among the objects."""

    def holds(self, scene: Scene, start: Scene | None = None) -> bool:
        """Whether it is elsewhere than at the start; see `Goal.holds`."""
        return start is not None and scene.body(self.object) is not start.body(self.object)


@dataclass(frozen=True)
class On:
    """The object rests on a support, on another object, or in a region with its whole footprint.

    On something hollow it is inside, or on the rim.

    Attributes:
        object: its name.
        place: name of the support, the other object, or the region.
        pose: where on another object it is to stand: of a goal that says so by other facts.
    """

    object: str
    place: str
    pose: At | None = field(default=None, repr=False)

    @property
    def where(self) -> str:
        """Name of the place."""
        return self.place

    def holds(self, scene: Scene, start: Scene | None = None) -> bool:
        """Whether it does; see `Goal.holds`."""
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
    """The object rests within a region or the face of a support, with its whole footprint; or in something hollow."""

    object: str
    region: str

    @property
    def where(self) -> str:
        """Name of the place."""
        return self.region

    def holds(self, scene: Scene, start: Scene | None = None) -> bool:
        """Whether it does; see `Goal.holds`."""
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
    """The object rests at a place.

    Attributes:
        object: its name.
        x, y: [m] of its centre.
        yaw: [rad], None for any; of an upright cylinder it never matters.
        z: [m] of its centre, None for any: where one support lies above another it says on which of them.
        tolerance: [m].
        yaw_tolerance: [rad].
        within: names of regions and supports in which its whole footprint is to be, too: of a goal that says so by
            other facts.

    Raises:
        GoalError: a number that is not finite, or a tolerance that is not positive.
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
        """None: "", which names no place."""
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
        """Whether it does; see `Goal.holds`."""
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
    """No object stands in the region, or on the support."""

    region: str

    def holds(self, scene: Scene, start: Scene | None = None) -> bool:  # noqa: ARG002  as of the other facts
        """Whether none does; see `Goal.holds`."""
        return not occupants(scene, self.region)


@dataclass(frozen=True)
class Before:
    """The last move of one object comes before the first one of another; a scene cannot show whether it did."""

    first: str
    second: str

    def holds(self, scene: Scene, start: Scene | None = None) -> bool:  # noqa: ARG002  as of the other facts
        """True: it is about the plan; see `Goal.is_in_order`."""
        return True


@dataclass(frozen=True)
class Open:
    """A drawer, door or lid is open.

    Attributes:
        opening: its name.
        share: of its range, from 0 (shut) to 1.
        amount: [m] or [rad] that it is open at least, in place of the share.

    Raises:
        GoalError: a share that is not between 0 and 1, or an amount that is not positive.
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
        """[m] or [rad] from which on it holds."""
        one = scene.opening(self.opening)
        return one.at_share(self.share if self.amount is None else min(self.amount / abs(one.open - one.shut), 1.0))

    def holds(self, scene: Scene, start: Scene | None = None) -> bool:  # noqa: ARG002  as of the other facts
        """Whether it is; see `Goal.holds`."""
        one = scene.opening(self.opening)
        lacks = (self.position_in(scene) - one.position) * math.copysign(1.0, one.open - one.shut)
        return lacks <= AJAR * abs(one.open - one.shut)


@dataclass(frozen=True)
class Closed:
    """A drawer, door or lid is shut, but for `AJAR` of its range."""

    opening: str

    def position_in(self, scene: Scene) -> float:
        """[m] or [rad] where it is then."""
        return scene.opening(self.opening).shut

    def holds(self, scene: Scene, start: Scene | None = None) -> bool:  # noqa: ARG002  as of the other facts
        """Whether it is; see `Goal.holds`."""
        return scene.opening(self.opening).share <= AJAR


@dataclass(frozen=True)
class Turned:
    """A knob, or anything else that opens, is at an angle.

    Attributes:
        opening: its name.
        angle: [rad], of a slide [m], from where it is shut towards where it is open.
        tolerance: [rad], [m].

    Raises:
        GoalError: a number that is not finite, or a tolerance that is not positive.
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
        """[m] or [rad] where it is then."""
        one = scene.opening(self.opening)
        return one.shut + math.copysign(self.angle, (one.open - one.shut) * self.angle)

    def holds(self, scene: Scene, start: Scene | None = None) -> bool:  # noqa: ARG002  as of the other facts
        """Whether it is; see `Goal.holds`."""
        return abs(scene.opening(self.opening).position - self.position_in(scene)) <= self.tolerance


def out_of_range(scene: Scene, fact: Open | Closed | Turned) -> str:
    """What is wrong with an amount or an angle that is beyond the range of what opens; "" if it is not."""
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
"""The facts that there are, in words."""


# The geometry of scenes.


def region_names(scene: Scene) -> tuple[str, ...]:
    """The scene's regions."""
    return tuple(region.name for region in scene.regions)


def region_named(scene: Scene, name: str) -> Region:
    """The region of that name; raises `GoalError`, which lists the known ones."""
    for region in scene.regions:
        if region.name == name:
            return region
    raise GoalError(f"no region {name!r}; known regions: {', '.join(region_names(scene)) or 'none'}")


def occupants(scene: Scene, place: str) -> tuple[str, ...]:
    """Names of the objects that stand in a region, or on a support, directly or on others; held ones stand nowhere."""
    region = region_named(scene, place) if place in region_names(scene) else None
    face = scene.support_named(place if region is None else region.support)
    standing = [body for body in scene.objects if body.name not in scene.held_names]
    found = [b for b in standing if face.is_under(b.position[:2]) and stands_at(scene, b, face.top)]
    reached = with_those_on(found, standing)
    return tuple(body.name for body in reached if region is None or region.touches(body))


def height_below(scene: Scene, body: Body) -> float:
    """[m] of the highest level face under the centre of an object, on which it stands or would fall.

    What is held beside the supports is compared with the first one.
    """
    under = scene.support_under(body)
    is_beside = under.name not in scene.supports and body.name in scene.held_names
    return (scene.support if is_beside else under).top


def is_at_rest(scene: Scene, body: Body, level: float, start: Scene | None = None) -> bool:
    """Whether an object stands on a face at a height [m], upright, or lying as it did at the start."""
    is_standing = body.is_upright or (start is not None and not start.body(body.name).is_upright)
    return is_standing and body.name not in scene.held_names and stands_at(scene, body, level)


def stands_at(scene: Scene, body: Body, level: float) -> bool:
    """Whether an object's lowest point is at a face at a height [m], and at no other face under its centre rather."""
    away = abs(body.bottom - level)
    return away <= RESTING and all(abs(body.bottom - other) >= away for other in levels_under(scene, body))


def is_in_hollow(scene: Scene, body: Body, name: str) -> bool:
    """Whether an object has been let go inside an object, or a body that does not move, of that name."""
    hollow = None if {body.name, name} & {*scene.held_names} else hollow_of(scene, name)
    return hollow is not None and hollow.contains(body)


def levels_under(scene: Scene, body: Body) -> Iterator[float]:
    """[m] heights of the supports and objects under the centre of an object, within `RESTING` of its lowest point.

    Of an object that it is in, the floor.
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
    """Whether turning the object about the vertical changes anything: not of an upright cylinder."""
    return not (body.shape == "cylinder" and body.is_upright)


def names_in(fact: Fact) -> tuple[str, ...]:
    """The names in a fact, in the order of its fields."""
    return tuple(getattr(fact, entry.name) for entry in fields(fact) if entry.type == "str")


def support_at(scene: Scene, fact: At) -> StaticObstacle:
    """The support on which an object is to stand at a pose.

    With a height that the pose gives, the one whose top is nearest to it. Else only those count on which the object has
    room below what lies or hangs above them: a counter has none where a tray lies on it, a table has below a board that
    is high enough. Of these it is the one on which the object stands at that pose already, else the one on which it
    stands elsewhere, as under the same board, else the highest: it is reached from above.

    Args:
        scene: with the object where it stands.
        fact: the pose, which is over some support.
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
    """The supports under a pose, one at least where a goal means something."""
    point = np.array([fact.x, fact.y])
    return [face for face in map(scene.support_named, scene.supports) if face.is_under(point)]


def is_filled(scene: Scene, point: Array, height: float) -> bool:
    """Whether a static obstacle is in the upright line of a height [m] from a point (3,) of a face up."""
    low, high = point[2] + RESTING / 2, point[2] + height
    over = (one for one in scene.static_obstacles if one.lower[2] < high and one.top > low)
    return any(bool(one.is_under(point[:2])) for one in over)


def whole_face(face: StaticObstacle) -> Region:
    """The top face of a support as a region; of a round one, the square around it."""
    x_axis = face.rotation[:2, 0] if face.shape == "box" else np.array([1.0, 0.0])
    yaw = float(np.arctan2(x_axis[1], x_axis[0]))
    return Region(face.name, face.name, tuple(face.position[:2]), tuple(face.half_extents[:2]), yaw)
