"""Goals: what a plan is to bring about, as data that planner and environment share, and a geometric check of it.

    from planners import goals

    goal = goals.on("object_1", "tray") & goals.inside("object_2", "left") & goals.holding("object_3")
    goal = goals.Goal.from_pddl("(and (on object_1 tray) (inside object_2 left) (holding object_3))")
    goal.holds(scene)

Only data and plain geometry: nothing here plans or is compiled.
"""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from graphlib import CycleError, TopologicalSorter
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

if TYPE_CHECKING:
    from planners.scene import Body, Scene

Array: TypeAlias = NDArray[np.float64]

LIFTED = 0.10
"""[m] above where it stood from which on an object in the gripper counts as held up."""
RESTING = 0.005
"""[m] that the lowest point of an object may be above or below the face on which it stands: contacts are soft."""
EDGE = 0.002
"""[m] that an object may reach over the edge of its region."""
TOLERANCE, YAW_TOLERANCE = 0.02, 0.1
"""[m] and [rad] about a pose, if no other tolerance is given."""
_SIDES = 24
"""Points on the rim of a round footprint."""


class GoalError(ValueError):
    """A goal that means nothing in a scene, contradicts itself, or cannot be read; the message lists what is valid."""


@dataclass(frozen=True)
class Region:
    """A named rectangle on a support.

    Attributes:
        name: unlike that of any other region, support or object.
        support: name of the support on whose top face it lies.
        centre: x, y [m] in the world.
        half_extents: [m] along its own axes.
        yaw: [rad] of its x axis.

    Raises:
        GoalError: half extents that are not positive, or a number that is not finite.
    """

    name: str
    support: str
    centre: tuple[float, float]
    half_extents: tuple[float, float]
    yaw: float = 0.0

    def __post_init__(self) -> None:
        for name in ("centre", "half_extents"):
            x, y = getattr(self, name)
            object.__setattr__(self, name, (float(x), float(y)))
        object.__setattr__(self, "yaw", float(self.yaw))
        if not np.isfinite((*self.centre, *self.half_extents, self.yaw)).all() or min(self.half_extents) <= 0:
            raise GoalError(f"region {self.name!r} needs finite numbers and positive half extents, not {self}")

    @property
    def corners(self) -> Array:
        """(4, 2) [m] its corners in the world, counter-clockwise."""
        signs = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)], dtype=float)
        return np.asarray(self.centre + signs * self.half_extents @ self._axes.T)

    def local(self, points: ArrayLike) -> Array:
        """World points (..., 2) [m] in the frame of its centre."""
        return np.asarray((np.asarray(points, dtype=float) - self.centre) @ self._axes)

    def contains_points(self, points: ArrayLike) -> NDArray[np.bool_]:
        """Which world points (..., 2) [m] lie in it: (...)."""
        return np.asarray((np.abs(self.local(points)) <= self.half_extents).all(axis=-1))

    def touches_disc(self, points: ArrayLike, radius: float) -> NDArray[np.bool_]:
        """Whether discs of that radius [m] at world points (..., 2) overlap it: (...)."""
        away = np.maximum(np.abs(self.local(points)) - self.half_extents, 0.0)
        return np.asarray(np.hypot(away[..., 0], away[..., 1]) < radius)

    def contains(self, body: Body, margin: float = EDGE) -> bool:
        """Whether the footprint of an object lies within it, but for `margin` [m]."""
        half = np.array(self.half_extents) + margin
        return bool((np.abs(self.local(footprint(body))) <= half).all())

    def touches(self, body: Body) -> bool:
        """Whether the footprint of an object overlaps it by more than `EDGE`."""
        return overlap(self.corners, footprint(body)) > EDGE

    @property
    def _axes(self) -> Array:
        c, s = math.cos(self.yaw), math.sin(self.yaw)
        return np.array([[c, -s], [s, c]])


@dataclass(frozen=True)
class Holding:
    """The object is in a gripper, raised `LIFTED` above where it stood."""

    object: str

    def holds(self, scene: Scene, start: Scene | None = None) -> bool:
        """Whether it is; see `Goal.holds`."""
        if self.object not in scene.held_names:
            return False
        body = scene.body(self.object)
        if start is None:
            return body.bottom >= height_below(scene, body) + LIFTED - EDGE
        before = start.body(self.object)
        stood_at = height_below(start, before) if self.object in start.held_names else before.bottom
        return body.bottom >= stood_at + LIFTED - EDGE


@dataclass(frozen=True)
class On:
    """The object rests on a support, on another object, or in a region with its whole footprint."""

    object: str
    place: str

    def holds(self, scene: Scene, start: Scene | None = None) -> bool:
        """Whether it does; see `Goal.holds`."""
        if self.place in region_names(scene):
            return Inside(self.object, self.place).holds(scene, start)
        body = scene.body(self.object)
        if self.place in scene.supports:
            face = scene.support_named(self.place)
            return is_at_rest(scene, body, face.top, start) and bool(face.is_under(body.position[:2]))
        below = scene.body(self.place)
        is_over = overlap(footprint(below), body.position[None, :2]) >= 0
        return is_over and self.place not in scene.held_names and is_at_rest(scene, body, below.top, start)


@dataclass(frozen=True)
class Inside:
    """The object rests within a region, or within the face of a support, with its whole footprint."""

    object: str
    region: str

    def holds(self, scene: Scene, start: Scene | None = None) -> bool:
        """Whether it does; see `Goal.holds`."""
        body = scene.body(self.object)
        if self.region in region_names(scene):
            region = region_named(scene, self.region)
            return is_at_rest(scene, body, scene.support_named(region.support).top, start) and region.contains(body)
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
    """

    object: str
    x: float
    y: float
    yaw: float | None = None
    z: float | None = None
    tolerance: float = TOLERANCE
    yaw_tolerance: float = YAW_TOLERANCE

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


Fact: TypeAlias = Holding | On | Inside | At | Clear | Before


@dataclass(frozen=True)
class Goal:
    """Facts that must all hold; joined by `&`.

    Attributes:
        facts: in the order in which they were given, each once.
    """

    facts: tuple[Fact, ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "facts", tuple(dict.fromkeys(self.facts)))
        for fact in self.facts:
            if not isinstance(fact, Fact):
                raise GoalError(f"{fact!r} is no fact of a goal; valid are {_VALID}")
        if not self.facts:
            raise GoalError(f"a goal needs at least one fact; valid are {_VALID}")

    def __and__(self, other: Goal) -> Goal:
        if not isinstance(other, Goal):
            return NotImplemented
        return Goal((*self.facts, *other.facts))

    def __str__(self) -> str:
        return self.to_pddl()

    @classmethod
    def of(cls, goal: str | Goal) -> Goal:
        """A goal as it is, that of a PDDL text, or of a name: that object is held.

        Raises:
            GoalError: none of these.
        """
        if isinstance(goal, Goal):
            return goal
        if not isinstance(goal, str):
            raise GoalError(f"{goal!r} is no goal; valid are an object's name, PDDL text, and {_VALID}")
        return cls.from_pddl(goal) if goal.lstrip().startswith("(") else holding(goal)

    @property
    def target(self) -> str:
        """Name of the object that is to be held if that is all, else ""."""
        match self.facts:
            case (Holding(name),):
                return name
        return ""

    @property
    def held(self) -> tuple[str, ...]:
        """Names of the objects that are to be held."""
        return tuple(fact.object for fact in self.facts if isinstance(fact, Holding))

    @property
    def placed(self) -> tuple[On | Inside | At, ...]:
        """The facts that say where objects are to stand."""
        return tuple(fact for fact in self.facts if isinstance(fact, On | Inside | At))

    @property
    def cleared(self) -> tuple[str, ...]:
        """Names of the regions and supports that are to be clear."""
        return tuple(fact.region for fact in self.facts if isinstance(fact, Clear))

    @property
    def order(self) -> tuple[tuple[str, str], ...]:
        """Pairs of objects of which the first one is to be moved before the second."""
        return tuple((fact.first, fact.second) for fact in self.facts if isinstance(fact, Before))

    def holds(self, scene: Scene, start: Scene | None = None) -> bool:
        """Whether all facts hold in a scene, by its geometry alone.

        An object rests where its lowest point is within `RESTING` of the face, and it is upright, or lay already at
        the start.

        Args:
            scene: in which held objects have the pose at which they are held.
            start: the scene before anything was moved, from which the height of held objects counts; without it they
                must be that high above the support under them.

        Raises:
            GoalError: the goal means nothing in that scene.
        """
        return not self.unmet(scene, start)

    def unmet(self, scene: Scene, start: Scene | None = None) -> tuple[Fact, ...]:
        """The facts that do not hold; arguments and errors as of `holds`."""
        self.check(scene)
        return tuple(fact for fact in self.facts if not fact.holds(scene, start))

    def is_in_order(self, moved: Collection[str]) -> bool:
        """Whether objects that were taken in this order, some perhaps twice, keep to every `before`."""
        moves = list(moved)
        last = {name: index for index, name in enumerate(moves)}
        return all(first not in last or second not in moves[: last[first]] for first, second in self.order)

    def check(self, scene: Scene) -> None:
        """Check that the goal means something in a scene.

        Raises:
            GoalError: it names something that is not there, or contradicts itself; the message says what is valid.
        """
        regions, objects = region_names(scene), scene.names

        def known(name: str, *kinds: tuple[str, Collection[str]]) -> None:
            if not any(name in names for _, names in kinds):
                valid = "; ".join(f"{kind}: {', '.join(names) or 'none'}" for kind, names in kinds)
                raise GoalError(f"the goal names {name!r}, which the scene does not have; {valid}")

        places = ("regions", regions), ("supports", scene.supports)
        for fact in self.facts:
            match fact:
                case On(name, place):
                    known(name, ("objects", objects))
                    known(place, *places, ("objects", objects))
                case Inside(name, place):
                    known(name, ("objects", objects))
                    known(place, *places)
                case Holding(name) | At(name):
                    known(name, ("objects", objects))
                case Clear(place):
                    known(place, *places)
                case Before(first, second):
                    known(first, ("objects", objects))
                    known(second, ("objects", objects))
        self._check_contradictions(scene)

    def _check_contradictions(self, scene: Scene) -> None:
        ends = [*self.held, *(fact.object for fact in self.placed)]
        if twice := sorted({name for name in ends if ends.count(name) > 1}):
            raise GoalError(f"an object can be held or placed once only; the goal says where twice: {', '.join(twice)}")
        if len(self.held) > 1:
            raise GoalError(
                f"{len(self.held)} objects to hold ({', '.join(self.held)}); at the end of a plan one can be"
            )
        places = {fact.object: _place_of(fact) for fact in self.placed}
        for name, place in places.items():
            if place in self.cleared or (place in region_names(scene) and _lies_on(scene, place, self.cleared)):
                raise GoalError(f"{name!r} is to be at {place!r}, which is to be clear")
            if place in self.held:
                raise GoalError(f"{name!r} is to stand on {place!r}, which is to be held")
        for edges in (places.items(), self.order):
            graph: dict[str, set[str]] = {}
            for one, other in edges:
                graph.setdefault(other, set()).add(one)
            try:
                TopologicalSorter(graph).prepare()
            except CycleError as error:
                circle = " -> ".join(error.args[1])
                raise GoalError(f"the goal asks for a circle: {circle}") from error

    def to_pddl(self) -> str:
        """The goal as PDDL; `from_pddl` reads it."""
        texts = [_format(fact) for fact in self.facts]
        return texts[0] if len(texts) == 1 else f"(and {' '.join(texts)})"

    @classmethod
    def from_pddl(cls, text: str) -> Goal:
        """The goal of a PDDL text: one fact, or `(and fact fact …)`.

        Facts are `(holding a)`, `(on a place)`, `(inside a region)`, `(clear region)`, `(before a b)` and
        `(at a (x 0.5) (y 0.2) (yaw 1.57) (z 0.83) (tolerance 0.02) (yaw-tolerance 0.1))`, of which x and y are needed.

        Raises:
            GoalError: it is none; the message says what is valid.
        """
        tree, rest = _parse(re.findall(r"[()]|[^\s()]+", re.sub(r";.*", "", text)), text)
        if rest or not isinstance(tree, list) or not tree:
            raise GoalError(f"{text!r} is no goal; valid are {_VALID}")
        return cls(tuple(_fact(part, text) for part in (tree[1:] if tree[0] == "and" else [tree])))


_VALID = "holding(a), on(a, place), inside(a, region), at(a, pose), clear(region), before(a, b), joined by &"


def holding(name: str) -> Goal:
    """The object is held, `LIFTED` above where it stood."""
    return Goal((Holding(name),))


def on(name: str, place: str) -> Goal:
    """The object rests on a support, on another object (a stack), or in a region."""
    return Goal((On(name, place),))


def inside(name: str, region: str) -> Goal:
    """The object rests with its whole footprint in a region, or on a support."""
    return Goal((Inside(name, region),))


def at(name: str, pose: ArrayLike, tolerance: float = TOLERANCE, yaw_tolerance: float = YAW_TOLERANCE) -> Goal:
    """The object rests at a pose.

    Args:
        name: of the object.
        pose: (2,) x, y [m]; (3,) x, y [m], yaw [rad]; or T_world_object (4, 4), of which the yaw counts.
        tolerance: [m].
        yaw_tolerance: [rad].

    Raises:
        GoalError: another shape, or a number that is not finite.
    """
    T = np.asarray(pose, dtype=float)
    if T.shape not in ((2,), (3,), (4, 4)) or not np.isfinite(T).all():
        raise GoalError(f"a pose is finite, of shape (2,), (3,) or (4, 4), not {pose!r:.100}")
    if T.shape == (4, 4):
        yaw = math.atan2(T[1, 0], T[0, 0])
        return Goal((At(name, float(T[0, 3]), float(T[1, 3]), yaw, float(T[2, 3]), tolerance, yaw_tolerance),))
    yaw_only = float(T[2]) if len(T) == 3 else None
    return Goal((At(name, float(T[0]), float(T[1]), yaw_only, None, tolerance, yaw_tolerance),))


def clear(region: str) -> Goal:
    """No object stands in the region, or on the support."""
    return Goal((Clear(region),))


def before(first: str, second: str) -> Goal:
    """The first object is moved before the second, if both are."""
    return Goal((Before(first, second),))


def and_(*goals: Goal) -> Goal:
    """All of these."""
    return Goal(tuple(fact for goal in goals for fact in goal.facts))


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


def footprint(body: Body, margin: float = 0.0) -> Array:
    """Points (k, 2) [m] whose convex hull is the object seen from above, grown by `margin` [m]."""
    if body.shape == "cylinder" and body.is_upright:
        angles = np.arange(_SIDES) * (2 * np.pi / _SIDES)
        radius = float(body.half_extents[0]) + margin
        return np.asarray(body.position[:2] + radius * np.column_stack((np.cos(angles), np.sin(angles))))
    half = np.maximum(np.array(body.half_extents) + margin, 0.0)
    corners = np.array(list(itertools.product((-1.0, 1.0), repeat=3))) * half
    return np.asarray(body.position[:2] + corners @ body.rotation[:2].T)


def overlap(one: Array, other: Array) -> float:
    """[m] by which the convex hulls of two sets of points (k, 2) overlap at least; negative: how far apart they are.

    Measured along the directions across the lines between neighbouring points of each set: exact for rectangles.
    """
    normals = []
    for points in (one, other):
        sides = np.concatenate([points - points[0], np.roll(points, -1, axis=0) - points])
        length = np.linalg.norm(sides, axis=1)
        sides = sides[length > 1e-9] / length[length > 1e-9, None]
        normals.append(np.column_stack((-sides[:, 1], sides[:, 0])))
    across = np.concatenate(normals)
    a, b = across @ one.T, across @ other.T
    depth = np.minimum(a.max(axis=1) - b.min(axis=1), b.max(axis=1) - a.min(axis=1))
    return float(depth.min())


def occupants(scene: Scene, place: str) -> tuple[str, ...]:
    """Names of the objects that stand in a region, or on a support, directly or on others; held ones stand nowhere."""
    region = region_named(scene, place) if place in region_names(scene) else None
    face = scene.support_named(place if region is None else region.support)
    standing = [body for body in scene.objects if body.name not in scene.held_names]
    found = [b for b in standing if abs(b.bottom - face.top) <= RESTING and face.is_under(b.position[:2])]
    for below in found:
        found += [
            body
            for body in standing
            if body not in found
            and abs(body.bottom - below.top) <= RESTING
            and overlap(footprint(body), footprint(below)) > 0
        ]
    return tuple(body.name for body in found if region is None or region.touches(body))


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
    return is_standing and body.name not in scene.held_names and abs(body.bottom - level) <= RESTING


def levels_under(scene: Scene, body: Body) -> Iterator[float]:
    """[m] heights of the supports and objects under the centre of an object."""
    for name in scene.supports:
        if scene.support_named(name).is_under(body.position[:2]):
            yield scene.support_named(name).top
    others = (one for one in scene.objects if one.name not in (body.name, *scene.held_names))
    yield from (one.top for one in others if overlap(footprint(one), body.position[None, :2]) >= 0)


def has_yaw(body: Body) -> bool:
    """Whether turning the object about the vertical changes anything: not of an upright cylinder."""
    return not (body.shape == "cylinder" and body.is_upright)


def _lies_on(scene: Scene, region: str, supports: Collection[str]) -> bool:
    return region_named(scene, region).support in supports


def _place_of(fact: On | Inside | At) -> str:
    match fact:
        case On(_, place) | Inside(_, place):
            return place
    return ""


# PDDL.


def _format(fact: Fact) -> str:
    match fact:
        case At():
            numbers = {
                "x": fact.x,
                "y": fact.y,
                "yaw": fact.yaw,
                "z": fact.z,
                "tolerance": fact.tolerance,
                "yaw-tolerance": fact.yaw_tolerance,
            }
            given = " ".join(f"({name} {number!r})" for name, number in numbers.items() if number is not None)
            return f"(at {fact.object} {given})"
        case Before(one, other) | On(one, other) | Inside(one, other):
            return f"({type(fact).__name__.lower()} {one} {other})"
        case Clear(name) | Holding(name):
            return f"({type(fact).__name__.lower()} {name})"


_TREE: TypeAlias = "str | list[_TREE]"
_ARGUMENTS = {"holding": (Holding, 1), "on": (On, 2), "inside": (Inside, 2), "clear": (Clear, 1), "before": (Before, 2)}


def _parse(words: list[str], text: str) -> tuple[_TREE, list[str]]:
    """The first expression of a text, and the words after it."""
    if not words or words[0] == ")":
        raise GoalError(f"{text!r} is no goal: parentheses do not match")
    first, *rest = words
    if first != "(":
        return first, rest
    parts: list[_TREE] = []
    while rest and rest[0] != ")":
        part, rest = _parse(rest, text)
        parts.append(part)
    if not rest:
        raise GoalError(f"{text!r} is no goal: parentheses do not match")
    return parts, rest[1:]


def _fact(tree: _TREE, text: str) -> Fact:
    """A fact; raises `GoalError`."""
    match tree:
        case ["at", str(name), *given]:
            numbers: dict[str, float] = {}
            for part in given:
                match part:
                    case [str(key), str(value)] if re.fullmatch(r"x|y|z|yaw|tolerance|yaw-tolerance", key):
                        try:
                            numbers[key.replace("-", "_")] = float(value)
                        except ValueError:
                            raise GoalError(f"{value!r} in {text!r} is no number") from None
                    case _:
                        raise GoalError(f"{part!r} in {text!r}: valid are (x 0.5), and so y, yaw, z, tolerance")
            if {"x", "y"} <= numbers.keys():
                return At(name, **numbers)
            raise GoalError(f"(at {name} …) in {text!r} needs (x …) and (y …)")
        case [str(kind), *names] if kind in _ARGUMENTS and len(names) == _ARGUMENTS[kind][1]:
            if all(isinstance(name, str) for name in names):
                return _ARGUMENTS[kind][0](*names)
    raise GoalError(f"{tree!r} in {text!r} is no fact; valid are {_VALID}")
