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
from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass, fields
from graphlib import CycleError, TopologicalSorter
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from planners.regions import EDGE, RESTING, RIM, GoalError as GoalError, Region as Region, footprint, is_name, overlap

if TYPE_CHECKING:
    from planners.scene import Body, Scene

LIFTED = 0.10
"""[m] above where it stood from which on an object in the gripper counts as held up."""
TOLERANCE, YAW_TOLERANCE = 0.02, 0.1
"""[m] and [rad] about a pose, if no other tolerance is given."""


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
            is_there = region.contains(body) and scene.support_named(region.support).is_under(body.position[:2])
            return bool(is_there) and is_at_rest(scene, body, scene.support_named(region.support).top, start)
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


Fact: TypeAlias = Holding | On | Inside | At | Clear | Before


@dataclass(frozen=True)
class Goal:
    """Facts that must all hold; joined by `&`.

    Attributes:
        facts: in the order in which they were given, each once.

    Raises:
        GoalError: no fact, something that is none, or a name that is no text.
    """

    facts: tuple[Fact, ...]

    def __post_init__(self) -> None:
        facts = tuple(self.facts) if isinstance(self.facts, Iterable) else (self.facts,)
        for fact in facts:
            if not isinstance(fact, Fact):
                raise GoalError(f"{fact!r:.100} is no fact of a goal; valid are {_VALID}")
            if not all(is_name(name) for name in _names(fact)):
                raise GoalError(f"names are texts, not empty, without quotation marks; not so in {fact!r:.100}")
        if not facts:
            raise GoalError(f"a goal needs at least one fact; valid are {_VALID}")
        object.__setattr__(self, "facts", tuple(dict.fromkeys(facts)))

    def __and__(self, other: Goal) -> Goal:
        if not isinstance(other, Goal):
            return NotImplemented
        return Goal((*self.facts, *other.facts))

    def __str__(self) -> str:
        return self.to_pddl()

    @classmethod
    def of(cls, goal: str | Goal | Sequence[Sequence[str]]) -> Goal:
        """A goal as it is, of a PDDL text, of a list of facts, `[["on", "a", "tray"]]`, or of a name: it is held.

        Raises:
            GoalError: none of these.
        """
        if isinstance(goal, Goal):
            return goal
        if isinstance(goal, list | tuple):
            return cls(tuple(_fact(list(fact) if isinstance(fact, tuple) else fact, str(goal)) for fact in goal))
        if not isinstance(goal, str):
            raise GoalError(f"{goal!r} is no goal; valid are an object's name, PDDL text, and {_VALID}")
        if goal.lstrip().startswith("("):
            return cls.from_pddl(goal)
        kind, *names = goal.split() or [""]
        if names and kind.lower() in (*_ARGUMENTS, "at", "and"):
            raise GoalError(
                f"{goal!r:.200} is no object's name; a fact stands in parentheses: ({kind.lower()} {' '.join(names)})"
            )
        return holding(goal)

    @property
    def target(self) -> str:
        """Name of the object that is to be held, anywhere, if that is all, else ""."""
        match self.facts:
            case (Holding(name, None),):
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
        objects: dict[str, Collection[str]] = {"objects": scene.names}
        places: dict[str, Collection[str]] = {"regions": region_names(scene), "supports": scene.supports}
        for fact in self.facts:
            for entry, name in zip(fields(fact), _names(fact), strict=False):
                kinds = objects
                if entry.name in ("place", "region"):
                    kinds = places | objects if isinstance(fact, On) else places
                if not any(name in names for names in kinds.values()):
                    valid = "; ".join(f"{kind}: {', '.join(names) or 'none'}" for kind, names in kinds.items())
                    raise GoalError(f"the goal names {name!r}, which the scene does not have; {valid}")
                for region in (one for one in scene.regions if one.name == name):
                    face = scene.support_named(region.support)
                    if overlap(region.corners, face.outline) <= 0:
                        (x, y), (a, b) = face.outline.min(axis=0), face.outline.max(axis=0)
                        raise GoalError(
                            f"region {name!r} lies beside its support {region.support!r}, which reaches from "
                            f"({x:.2f}, {y:.2f}) to ({a:.2f}, {b:.2f}) m"
                        )
            point = np.array((fact.x, fact.y)) if isinstance(fact, At) else None
            if point is not None and not any(scene.support_named(name).is_under(point) for name in scene.supports):
                known = ", ".join(scene.supports) or "none"
                raise GoalError(
                    f"no support under ({point[0]:.2f}, {point[1]:.2f}) m for {_names(fact)[0]!r}; supports: {known}"
                )
        self._check_contradictions(scene)

    def _check_contradictions(self, scene: Scene) -> None:
        ends = [*self.held, *(fact.object for fact in self.placed)]
        if twice := sorted({name for name in ends if ends.count(name) > 1}):
            raise GoalError(f"an object can be held or placed once only; the goal says where twice: {', '.join(twice)}")
        if len(self.held) > 1:
            raise GoalError(
                f"{len(self.held)} objects to hold ({', '.join(self.held)}); at the end of a plan one can be"
            )
        places = {fact.object: "" if isinstance(fact, At) else _names(fact)[1] for fact in self.placed}
        for name, place in places.items():
            if {place, region_named(scene, place).support if place in region_names(scene) else place} & {*self.cleared}:
                raise GoalError(f"{name!r} is to be at {place!r}, which is to be clear")
            if place in self.held:
                raise GoalError(f"{name!r} is to stand on {place!r}, which is to be held")
        for fact, cleared in itertools.product(self.placed, self.cleared):
            if cleared not in region_names(scene):
                is_there = isinstance(fact, At) and _is_always_on(scene, fact, cleared)
            else:
                is_there = _is_always_in(scene, fact, region_named(scene, cleared))
            if is_there:
                raise GoalError(f"{fact.object!r} is to be where {cleared!r} is, which is to be clear")
        for edges in (places.items(), self.order):
            graph: TopologicalSorter[str] = TopologicalSorter()
            for one, other in edges:
                graph.add(other, one)
            try:
                graph.prepare()
            except CycleError as error:
                raise GoalError(f"the goal asks for a circle: {' -> '.join(error.args[1])}") from error

    def to_pddl(self) -> str:
        """The goal as PDDL; `from_pddl` reads it."""
        texts = [_format(fact) for fact in self.facts]
        return texts[0] if len(texts) == 1 else f"(and {' '.join(texts)})"

    @classmethod
    def from_pddl(cls, text: str) -> Goal:
        """The goal of a PDDL text: one fact, or `(and fact fact …)`, which may be nested; in `(:goal …)` or not.

        Facts are `(holding a)`, `(on a place)`, `(inside a region)`, `(clear region)`, `(before a b)`,
        `(at a (x 0.5) (y 0.2) (yaw 1.57) (z 0.83) (tolerance 0.02) (yaw-tolerance 0.1))`, of which x and y are needed,
        and `(holding a (x 0.5) (y 0.2) (z 1.1) (tolerance 0.02))`.
        A name with blanks or parentheses stands in quotation marks. Words of PDDL may be in capitals; names are as the
        scene has them.

        Raises:
            GoalError: it is none, or says what no goal can say here, such as `or`; the message says what is valid.
        """
        facts: list[Fact] = []
        left: list[_TREE] = [_parse(text)]
        while left:
            match left.pop():
                case [str(word), tree] if word.lower() == ":goal":
                    left.append(tree)
                case [str(word), *parts] if word.lower() == "and":
                    left += reversed(parts)
                case [str(word), *_] if word.lower() in _NOT_HERE:
                    raise GoalError(f"{word.lower()!r} in {text!r:.200}: {_NOT_HERE[word.lower()]}")
                case tree:
                    facts.append(_fact(tree, text))
        return cls(tuple(facts))


_VALID = (
    "holding(a), holding(a, point), on(a, place), inside(a, region), at(a, pose), clear(region), before(a, b), "
    "joined by &"
)


def holding(name: str, point: ArrayLike | None = None, tolerance: float = TOLERANCE) -> Goal:
    """The object is held, `LIFTED` above where it stood; or with its centre at a point x, y, z, within a tolerance [m].

    Raises:
        GoalError: not three finite numbers, or a tolerance that is not positive.
    """
    values = None if point is None else tuple(np.asarray(point, dtype=object).ravel().tolist())
    return Goal((Holding(name, values, tolerance),))


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
    try:
        T = np.asarray(pose, dtype=float)
    except (TypeError, ValueError, OverflowError):
        T = np.zeros(0)
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


def and_(*goals: str | Goal) -> Goal:
    """All of these goals; raises `GoalError`, see `Goal.of`."""
    return Goal(tuple(fact for goal in goals for fact in Goal.of(goal).facts))


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


def _is_always_in(scene: Scene, fact: On | Inside | At, region: Region) -> bool:
    """Whether an object stands partly in a region wherever a fact holds; at a pose it counts as the circle within."""
    body = scene.body(fact.object)
    if isinstance(fact, At):
        radius = min(body.half_extents[:2] if body.is_upright else body.half_extents) - fact.tolerance - 2 * EDGE
        point = np.array((fact.x, fact.y))
        under = [name for name in scene.supports if scene.support_named(name).is_under(point)]
        is_known = body.shape != "pieces" and under == [region.support]
        return bool(is_known and region.touches_disc(point, radius))
    place = _names(fact)[1]
    areas = [one for one in scene.regions if one.name == place and one.support == region.support]
    return any(region.contains_points(area.corners).all() for area in areas)


def _is_always_on(scene: Scene, fact: At, support: str) -> bool:
    """Whether an object stands on a support, or on others that do, at a pose: no other support is under it."""
    around = np.concatenate(([(fact.x, fact.y)], (fact.x, fact.y) + fact.tolerance * RIM))
    under = {name for name in scene.supports if scene.support_named(name).is_under(around).any()}
    return under == {support} and bool(scene.support_named(support).is_under(around).all())


def occupants(scene: Scene, place: str) -> tuple[str, ...]:
    """Names of the objects that stand in a region, or on a support, directly or on others; held ones stand nowhere."""
    region = region_named(scene, place) if place in region_names(scene) else None
    face = scene.support_named(place if region is None else region.support)
    standing = [body for body in scene.objects if body.name not in scene.held_names]
    found = [b for b in standing if face.is_under(b.position[:2]) and stands_at(scene, b, face.top)]
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
    return is_standing and body.name not in scene.held_names and stands_at(scene, body, level)


def stands_at(scene: Scene, body: Body, level: float) -> bool:
    """Whether an object's lowest point is at a face at a height [m], and at no other face under its centre rather."""
    away = abs(body.bottom - level)
    return away <= RESTING and all(abs(body.bottom - other) >= away for other in levels_under(scene, body))


def levels_under(scene: Scene, body: Body) -> Iterator[float]:
    """[m] heights of the supports and objects under the centre of an object, within `RESTING` of its lowest point."""
    for name in scene.supports:
        face = scene.support_named(name)
        if abs(face.top - body.bottom) <= RESTING and face.is_under(body.position[:2]):
            yield face.top
    for one in scene.objects:
        is_near = abs(one.top - body.bottom) <= RESTING and one.name not in (body.name, *scene.held_names)
        if is_near and overlap(footprint(one), body.position[None, :2]) >= 0:
            yield one.top


def has_yaw(body: Body) -> bool:
    """Whether turning the object about the vertical changes anything: not of an upright cylinder."""
    return not (body.shape == "cylinder" and body.is_upright)


# PDDL.


def _names(fact: Fact) -> tuple[str, ...]:
    return tuple(getattr(fact, entry.name) for entry in fields(fact) if entry.type == "str")


def _format(fact: Fact) -> str:
    numbers: dict[str, float | None] = {}
    match fact:
        case At():
            numbers = {entry.name: getattr(fact, entry.name) for entry in fields(fact) if entry.name != "object"}
        case Holding(_, (x, y, z), tolerance):
            numbers = {"x": x, "y": y, "z": z, "tolerance": tolerance}
    given = (f"({name.replace('_', '-')} {number!r})" for name, number in numbers.items() if number is not None)
    names = (name if re.fullmatch(rf"(?!\?){_WORD}", name) else f'"{name}"' for name in _names(fact))
    return f"({' '.join((type(fact).__name__.lower(), *names, *given))})"


_TREE: TypeAlias = "str | list[_TREE]"
_NUMBERS = ("x", "y", "z", "yaw", "tolerance", "yaw-tolerance")
_ARGUMENTS = {"holding": (Holding, 1), "on": (On, 2), "inside": (Inside, 2), "clear": (Clear, 1), "before": (Before, 2)}


_NOT_HERE = {
    "or": "all of its facts hold at the end of a plan; plan for each alternative",
    "imply": "all of its facts hold at the end of a plan",
    "not": "a goal says where objects are to be; that none is in a region says (clear region)",
    "forall": "write one fact for each object",
    "exists": "name the object that it is to be",
}
"""Words of PDDL that a goal does not have, and what to do."""
_WORD = r'[^\s()";]+'


class _Quoted(str):
    """A word that stood in quotation marks: a name, also where it begins as a variable does."""

    __slots__ = ()


def _parse(text: str) -> list[_TREE]:
    """The expression of a text: words, and lists of them."""
    if not isinstance(text, str):
        raise GoalError(f"{text!r:.100} is no text")
    outer: list[_TREE] = []
    open_lists = [outer]
    for word in re.findall(rf'"[^"]*"|[()"]|{_WORD}', re.sub(r'("[^"]*")|;.*', r"\1", text)):
        if word == "(":
            inner: list[_TREE] = []
            open_lists[-1].append(inner)
            open_lists.append(inner)
        elif word == ")" and len(open_lists) > 1:
            open_lists.pop()
        elif word in '()"':
            raise GoalError(f"{text!r:.200} is no goal: parentheses do not match")
        else:
            open_lists[-1].append(_Quoted(word[1:-1]) if word[0] == '"' else word)
    match outer:
        case [[_, *_] as tree] if len(open_lists) == 1:
            return tree
    raise GoalError(f"{text!r:.200} is no goal: parentheses do not match, or it is empty; valid are {_VALID}")


def _shown(tree: _TREE) -> str:
    """The expression as text, what is deeper in it left out."""
    if not isinstance(tree, list):
        return str(tree)
    return f"({' '.join('(…)' if isinstance(part, list) else str(part) for part in tree)})"


def _fact(tree: _TREE, text: str) -> Fact:
    """A fact; raises `GoalError`."""
    if isinstance(tree, list) and tree and isinstance(tree[0], str):
        tree = [tree[0].lower(), *tree[1:]]
        if any(isinstance(part, str) and not isinstance(part, _Quoted) and part.startswith("?") for part in tree):
            raise GoalError(f"{_shown(tree):.100} in {text!r:.200}: no variables here; write one fact for each object")
        tree = [str(part) if isinstance(part, str) else part for part in tree]
    match tree:
        case ["at" | "holding" as kind, str(name), *given] if kind == "at" or given:
            numbers: dict[str, float] = {}
            for part in given:
                match part:
                    case [str(key), str() | int() | float() as value] if (
                        key in _NUMBERS and key.replace("-", "_") not in numbers
                    ):
                        try:
                            numbers[key.replace("-", "_")] = float(value)
                        except ValueError:
                            raise GoalError(f"{value!r} in {text!r:.200} is no number") from None
                    case _:
                        raise GoalError(
                            f"{_shown(part):.100} in {text!r:.200}: valid are {_NUMBERS}, each once, as in (x 0.5)"
                        )
            needed = {"x", "y"} if kind == "at" else {"x", "y", "z"}
            if kind == "at" and needed <= numbers.keys():
                return At(name, **numbers)
            if kind == "holding" and needed <= numbers.keys() <= needed | {"tolerance"}:
                x, y, z = (numbers.pop(axis) for axis in "xyz")
                return Holding(name, (x, y, z), **numbers)
            valid = "(x …), (y …), (z …), and takes (tolerance …)" if kind == "holding" else "(x …) and (y …)"
            raise GoalError(f"({kind} {name} …) in {text!r:.200} needs {valid}")
        case [str(kind), *names] if kind in _ARGUMENTS and len(names) == _ARGUMENTS[kind][1]:
            if all(isinstance(name, str) for name in names):
                return _ARGUMENTS[kind][0](*names)
    raise GoalError(f"{_shown(tree):.100} in {text!r:.200} is no fact; valid are {_VALID}")
