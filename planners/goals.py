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
from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, fields, replace
from graphlib import CycleError, TopologicalSorter
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from planners.facts import (
    LIFTED as LIFTED,
    OPEN_SHARE,
    TOLERANCE,
    VALID,
    YAW_TOLERANCE,
    At as At,
    Before as Before,
    Clear as Clear,
    Closed as Closed,
    Fact as Fact,
    Holding as Holding,
    Inside as Inside,
    On as On,
    Open as Open,
    Turned as Turned,
    has_yaw as has_yaw,
    height_below as height_below,
    is_at_rest as is_at_rest,
    levels_under as levels_under,
    names_in as names_in,
    occupants as occupants,
    out_of_range,
    region_named as region_named,
    region_names as region_names,
    stands_at as stands_at,
)
from planners.goal_ends import contradiction_in, ends_in, narrowest
from planners.goal_sentence import facts_of, sentence_of
from planners.goal_text import ARGUMENTS, domain_of, fact_of, pddl_of, says_all, without_negations
from planners.hollows import hollow_names, static_hollows
from planners.pddl import Condition, Literal, parse
from planners.regions import EDGE, RIM, GoalError as GoalError, Region as Region, is_name, overlap

if TYPE_CHECKING:
    from planners.scene import Scene

_SHOWN = 3
"""Alternatives that a refusal lists."""


@dataclass(frozen=True)
class Goal:
    """Facts that must all hold; joined by `&`.

    Attributes:
        facts: in the order in which they were given, each once.
        placed: of each object the one fact that says most of where it is to stand; of a goal that was read with a
            scene, or by `in_scene`, one that keeps to the others.
        is_settled: whether `in_scene` has made it.

    Raises:
        GoalError: no fact, something that is none, or a name that is no text.
    """

    facts: tuple[Fact, ...]
    placed: tuple[On | Inside | At, ...] = field(default=(), repr=False, compare=False)
    is_settled: bool = field(default=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        facts = tuple(self.facts) if isinstance(self.facts, Iterable) else (self.facts,)
        for fact in facts:
            if not isinstance(fact, Fact):
                raise GoalError(f"{fact!r:.100} is no fact of a goal; valid are {VALID}")
            if not all(is_name(name) for name in names_in(fact)):
                raise GoalError(f"names are texts, not empty, without quotation marks; not so in {fact!r:.100}")
        if not facts:
            raise GoalError(f"a goal needs at least one fact; valid are {VALID}")
        object.__setattr__(self, "facts", tuple(dict.fromkeys(facts)))
        object.__setattr__(self, "placed", self.placed or narrowest(self.facts))

    def __and__(self, other: Goal) -> Goal:
        if not isinstance(other, Goal):
            return NotImplemented
        return Goal((*self.facts, *other.facts))

    def __str__(self) -> str:
        return self.to_pddl()

    @classmethod
    def of(cls, goal: str | Goal | Sequence[Sequence[str]], scene: Scene | None = None) -> Goal:
        """A goal as it is, of a PDDL text, of a list of facts, `[["on", "a", "tray"]]`, or of a name: it is held.

        With a scene it is the goal there, as of `from_pddl` and `in_scene`.

        Raises:
            GoalError: none of these; with a scene, also what `from_pddl` and `in_scene` raise.
        """
        if isinstance(goal, str) and goal.lstrip().startswith("("):
            return cls.from_pddl(goal, scene)
        if isinstance(goal, Goal):
            found = goal
        elif isinstance(goal, list | tuple):
            found = cls(tuple(fact_of(list(fact) if isinstance(fact, tuple) else fact, str(goal)) for fact in goal))
        elif not isinstance(goal, str):
            raise GoalError(f"{goal!r} is no goal; valid are an object's name, PDDL text, and {VALID}")
        else:
            kind, *names = goal.split() or [""]
            if names and kind.lower() in (*ARGUMENTS, "at", "and"):
                fact = f"({kind.lower()} {' '.join(names)})"
                raise GoalError(f"{goal!r:.200} is no object's name; a fact stands in parentheses: {fact}")
            found = holding(goal)
        return found if scene is None else found.in_scene(scene)

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
    def cleared(self) -> tuple[str, ...]:
        """Names of the regions and supports that are to be clear."""
        return tuple(fact.region for fact in self.facts if isinstance(fact, Clear))

    @property
    def openings(self) -> tuple[Open | Closed | Turned, ...]:
        """The facts about what opens."""
        return tuple(fact for fact in self.facts if isinstance(fact, Open | Closed | Turned))

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

    def in_scene(self, scene: Scene) -> Goal:
        """The same goal, settled for a scene, in which nothing has been moved yet; one that is settled stays as it is.

        Names are spelled as the scene has them. PDDL makes no difference between capitals and small letters: a name
        that fits one of the scene's so is that one; of two that differ in nothing else, the one that is meant must be
        spelled exactly. What several facts say of one object is put together in `placed`, and which support is meant
        where several lie one above the other: see `planners.facts.support_at`. Unknown names and contradictions stay
        for `check`.

        Raises:
            GoalError: a name fits several of the scene's.
        """
        if self.is_settled:
            return self
        goal = Goal(tuple(_spelled(fact, scene) for fact in self.facts))
        if any(goal._unknown_names(scene)) or contradiction_in(scene, goal.facts):
            return goal
        return replace(goal, placed=ends_in(scene, goal.facts), is_settled=True)

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
        for message in self._unknown_names(scene):
            raise GoalError(message)
        for fact in self.facts:
            for name in names_in(fact):
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
                    f"no support under ({point[0]:.2f}, {point[1]:.2f}) m for {names_in(fact)[0]!r}; supports: {known}"
                )
        for message in filter(None, (out_of_range(scene, fact) for fact in self.openings)):
            raise GoalError(message)
        self._check_contradictions(scene)

    def _unknown_names(self, scene: Scene) -> Iterator[str]:
        """What is wrong with each name that the scene does not have."""
        for fact in self.facts:
            for entry, name in zip(fields(fact), names_in(fact), strict=False):
                kinds = _kinds(fact, entry.name, scene, name)
                if not any(name in names for names in kinds.values()):
                    if name in scene.names and "hollow" in kinds:
                        why = "which is not hollow, seen from above"
                    else:
                        why = "which the scene does not have"
                    valid = "; ".join(f"{kind}: {', '.join(names) or 'none'}" for kind, names in kinds.items())
                    yield f"the goal names {name!r}, {why}; {valid}"

    def _check_contradictions(self, scene: Scene) -> None:
        if pair := contradiction_in(scene, self.facts):
            name, (one, other) = names_in(pair[0])[0], map(pddl_of, pair)
            raise GoalError(
                "an object can be held or placed once only, where several facts say it in places one within the other; "
                f"the goal says where twice: {name}: {one} and {other}"
            )
        said: dict[str, Fact] = {}
        for how in self.openings:
            if (first := said.setdefault(how.opening, how)) is not how:
                raise GoalError(f"the goal says twice how {how.opening!r} is: {pddl_of(first)} and {pddl_of(how)}")
        hands = len(scene.robot.acting_arms)
        if len(self.held) > hands:
            raise GoalError(
                f"{len(self.held)} objects to hold ({', '.join(self.held)}); at the end of a plan {hands} can be, one "
                "in each hand that acts"
            )
        ends = [fact for fact in self.facts if isinstance(fact, On | Inside)]
        places = [(fact.object, names_in(fact)[1]) for fact in ends]
        for name, place in places:
            if {place, region_named(scene, place).support if place in region_names(scene) else place} & {*self.cleared}:
                raise GoalError(f"{name!r} is to be at {place!r}, which is to be clear")
            if place in self.held:
                raise GoalError(f"{name!r} is to stand on {place!r}, which is to be held")
        stated = [fact for fact in self.facts if isinstance(fact, On | Inside | At)]
        for fact, cleared in itertools.product(stated, self.cleared):
            if cleared not in region_names(scene):
                is_there = isinstance(fact, At) and _is_always_on(scene, fact, cleared)
            else:
                is_there = _is_always_in(scene, fact, region_named(scene, cleared))
            if is_there:
                raise GoalError(f"{fact.object!r} is to be where {cleared!r} is, which is to be clear")
        for edges in (places, self.order):
            graph: TopologicalSorter[str] = TopologicalSorter()
            for one, other in edges:
                graph.add(other, one)
            try:
                graph.prepare()
            except CycleError as error:
                raise GoalError(f"the goal asks for a circle: {' -> '.join(error.args[1])}") from error

    def to_pddl(self) -> str:
        """The goal as PDDL; `from_pddl` reads it."""
        texts = [pddl_of(fact) for fact in self.facts]
        return texts[0] if len(texts) == 1 else f"(and {' '.join(texts)})"

    def sentence(self) -> str:
        """The goal in English; `from_sentence` reads it again. See `planners.goal_sentence`."""
        return sentence_of(self.facts)

    @classmethod
    def from_pddl(cls, text: str, scene: Scene | None = None) -> Goal:
        """The goal of a PDDL text: one fact, or `(and fact fact …)`, which may be nested; in `(:goal …)` or not.

        Facts are `(holding a)`, `(on a place)`, `(inside a region)`, `(clear region)`, `(before a b)`,
        `(at a (x 0.5) (y 0.2) (yaw 1.57) (z 0.83) (tolerance 0.02) (yaw-tolerance 0.1))`, of which x and y are needed,
        and `(holding a (x 0.5) (y 0.2) (z 1.1) (tolerance 0.02))`.
        A name with blanks or parentheses stands in quotation marks. Words of PDDL may be in capitals.

        `forall` and `exists` range over the scene's objects, or with `?x - support`, `?x - region`, `?x - place` over
        these. Of the alternatives of `or`, `imply` and `exists` those are left out that contradict the rest of the
        goal; one must be left, or hold in the scene. `not` needs to follow from the rest, or to say of all objects
        that none is on a support, which is that it is clear.

        Args:
            text: the goal.
            scene: where it is to be; its names may then be in other capitals, see `in_scene`. Without it names are as
                they are written, and nothing is known of the objects that `forall` and `exists` mean.

        Raises:
            GoalError: it is none, or says what no goal can say here; the message says what is valid.
        """
        condition = Condition(text, parse(text), None if scene is None else domain_of(scene))
        found = [_read(literals, text, scene) for literals in condition.alternatives()]
        if len(found) == 1 and not condition.choices:
            goal = cls(_said(condition, *found[0], scene))
            return goal if scene is None else goal.in_scene(scene)
        word = condition.choices[0] if condition.choices else "="
        left: dict[Goal | str, None] = {}
        reasons: list[GoalError] = []
        for held, denied in found:
            try:
                goal = cls(_said(condition, held, denied, scene))
                if scene is not None:
                    goal = goal.in_scene(scene)
                    goal.check(scene)
                left[goal] = None
            except _NotSaidError:
                left[f"(not {pddl_of(denied[0])})"] = None
            except GoalError as reason:
                reasons.append(reason)
        goals = [one for one in left if isinstance(one, Goal)]
        # What asks for more than another alternative, or for as much as an earlier one, is left out.
        asks_more = [
            one
            for k, one in enumerate(goals)
            for m, other in enumerate(goals)
            if m != k and says_all(one.facts, other.facts, scene)
            if m < k or not says_all(other.facts, one.facts, scene)
        ]
        possible = [one for one in left if one not in asks_more]
        done = [one for one in goals if scene is not None and one.holds(scene)]
        match done[:1] or possible:
            case [Goal() as goal]:
                return goal
            case []:
                why = str(reasons[0]) if reasons else "there is nothing that it could be true of"
                raise condition.refused(word, f"no alternative can be: {why}")
        listed = f"{', or '.join(map(str, possible[:_SHOWN]))}{', …' * (len(possible) > _SHOWN)}"
        advice = "name the object that it is to be" if word == "exists" else "plan for each alternative"
        raise condition.refused(
            word, f"it may mean {listed}: a goal says one thing, all of its facts hold at the end of a plan; {advice}"
        )


class _NotSaidError(GoalError):
    """That a fact does not hold, which no goal can say."""


def _read(literals: Sequence[Literal], text: str, scene: Scene | None) -> tuple[tuple[Fact, ...], tuple[Fact, ...]]:
    """The facts of one alternative that hold, and those that do not; raises `GoalError`."""
    facts: tuple[list[Fact], list[Fact]] = [], []
    for tree, is_negated in literals:
        fact = fact_of(tree, text)
        facts[is_negated].append(fact if scene is None else _spelled(fact, scene))
    if scene is not None and facts[1]:  # what is denied must mean something, too
        for message in Goal((*facts[0], *facts[1]))._unknown_names(scene):
            raise GoalError(message)
    return tuple(facts[0]), tuple(facts[1])


def _said(condition: Condition, held: Sequence[Fact], denied: Sequence[Fact], scene: Scene | None) -> tuple[Fact, ...]:
    """Facts that say that some hold and others do not; raises `GoalError`."""
    facts = without_negations(held, denied, scene)
    if facts is None:
        say = "a goal says where objects are to be; say where, and that none is in a region says (clear region)"
        raise _NotSaidError(str(condition.refused("not", say)))
    if denied and not facts:
        raise condition.refused("not", "it says nothing that a plan is to bring about; name at least one fact")
    return facts


def _kinds(fact: Fact, entry: str, scene: Scene, name: str) -> dict[str, Collection[str]]:
    """The names that may stand in a field of a fact, by what they are of; what is hollow only if others lack a name."""
    if entry == "opening":
        return {"what opens": tuple(one.name for one in scene.openings)}
    objects: dict[str, Collection[str]] = {"objects": scene.names}
    places: dict[str, Collection[str]] = {"regions": region_names(scene), "supports": scene.supports}
    if entry not in ("place", "region"):
        return objects
    kinds = places | objects if isinstance(fact, On) else places
    if any(name in names for names in kinds.values()):
        return kinds
    return kinds | {"hollow": static_hollows(scene) if isinstance(fact, On) else hollow_names(scene)}


def _spelled(fact: Fact, scene: Scene) -> Fact:
    """The fact with its names spelled as in the scene; raises `GoalError` if one fits several."""
    changed: dict[str, Any] = {}
    for entry, name in zip(fields(fact), names_in(fact), strict=False):
        valid = [one for names in _kinds(fact, entry.name, scene, name).values() for one in names]
        alike = [] if name in valid else [one for one in valid if one.casefold() == name.casefold()]
        if len(alike) > 1:
            raise GoalError(f"{name!r} may be {' or '.join(map(repr, alike))}; spell it as the scene does")
        if alike:
            changed[entry.name] = alike[0]
    return replace(fact, **changed) if changed else fact


def holding(name: str, point: ArrayLike | None = None, tolerance: float = TOLERANCE) -> Goal:
    """The object is held, `LIFTED` above where it stood; or with its centre at a point x, y, z, within a tolerance [m].

    Raises:
        GoalError: not three finite numbers, or a tolerance that is not positive.
    """
    values = None if point is None else tuple(np.asarray(point, dtype=object).ravel().tolist())
    return Goal((Holding(name, values, tolerance),))


def on(name: str, place: str) -> Goal:
    """The object rests on a support, on another object (a stack), in a region, or in something hollow, as `inside`."""
    return Goal((On(name, place),))


def inside(name: str, region: str) -> Goal:
    """The object rests with its whole footprint in a region, or on a support; or in something hollow.

    That is an object, or a body that does not move: a basket, a bowl, a box, a tray; see `planners.hollows`.
    """
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


def open_(name: str, share: float = OPEN_SHARE, amount: float | None = None) -> Goal:
    """A drawer, door or lid is open by a share of its range at least, or by an amount [m], [rad].

    Raises:
        GoalError: a share that is not between 0 and 1, or an amount that is not positive.
    """
    return Goal((Open(name, share, amount),))


def closed(name: str) -> Goal:
    """A drawer, door or lid is shut."""
    return Goal((Closed(name),))


def turned(name: str, angle: float, tolerance: float = YAW_TOLERANCE) -> Goal:
    """A knob is at an angle [rad] from where it is shut, within a tolerance [rad].

    Raises:
        GoalError: a number that is not finite, or a tolerance that is not positive.
    """
    return Goal((Turned(name, angle, tolerance),))


def from_sentence(text: str, scene: Scene | None = None) -> Goal:
    """The goal that an English sentence says, by a grammar: "put the red can into the basket and close the drawer".

    Args:
        text: clauses joined by commas, "and" or "then"; see `planners.goal_sentence`.
        scene: whose names are meant; without one a name is its words joined by underscores.

    Raises:
        GoalError: a clause that is none, a phrase that fits no name of the scene, or several, or a goal that means
            nothing there; see `Goal.check`.
    """
    if scene is None:
        return Goal(facts_of(text))
    openings = [one.name for one in scene.openings]
    names = (*scene.names, *scene.supports, *region_names(scene), *openings, *hollow_names(scene))
    goal = Goal(facts_of(text, names)).in_scene(scene)
    goal.check(scene)
    return goal


def and_(*goals: str | Goal) -> Goal:
    """All of these goals; raises `GoalError`, see `Goal.of`."""
    return Goal(tuple(fact for goal in goals for fact in Goal.of(goal).facts))


def _is_always_in(scene: Scene, fact: On | Inside | At, region: Region) -> bool:
    """Whether an object stands partly in a region wherever a fact holds; at a pose it counts as the circle within."""
    body = scene.body(fact.object)
    if isinstance(fact, At):
        radius = min(body.half_extents[:2] if body.is_upright else body.half_extents) - fact.tolerance - 2 * EDGE
        point = np.array((fact.x, fact.y))
        under = [name for name in scene.supports if scene.support_named(name).is_under(point)]
        is_known = body.shape != "pieces" and under == [region.support]
        return bool(is_known and region.touches_disc(point, radius))
    place = names_in(fact)[1]
    areas = [one for one in scene.regions if one.name == place and one.support == region.support]
    return any(region.contains_points(area.corners).all() for area in areas)


def _is_always_on(scene: Scene, fact: At, support: str) -> bool:
    """Whether an object stands on a support, or on others that do, at a pose: no other support is under it."""
    around = np.concatenate(([(fact.x, fact.y)], (fact.x, fact.y) + fact.tolerance * RIM))
    under = {name for name in scene.supports if scene.support_named(name).is_under(around).any()}
    return under == {support} and bool(scene.support_named(support).is_under(around).all())
