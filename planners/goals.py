"""Goals of plans, as data that planner and environment share, and their geometric check.

    from planners import goals

    goal = goals.on("object_1", "tray") & goals.inside("object_2", "left") & goals.holding("object_3")
    goal = goals.Goal.from_pddl("(and (on object_1 tray) (inside object_2 left) (holding object_3))")
    goal.holds(scene)

Only data and plain geometry are here: no planning, no compiled code.
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
"""Number of alternatives that a refusal lists."""


@dataclass(frozen=True)
class Goal:
    """Facts that must all hold, joined by `&`.

    Attributes:
        facts: the facts in their given order, each once.
        placed: for each object, the most specific fact about its place. In a goal read with a scene, or made by
            `in_scene`, it agrees with the other facts.
        is_settled: whether `in_scene` has made the goal.

    Raises:
        GoalError: the goal has no fact, an invalid fact, or an invalid name.
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
        """Read a goal: a `Goal`, PDDL text, a list of facts, `[["on", "a", "tray"]]`, or the name of an object to hold.

        With a scene, names are resolved in it, as in `from_pddl` and `in_scene`.

        Raises:
            GoalError: the argument is none of these. With a scene, also the errors of `from_pddl` and `in_scene`.
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
        """Name of the object to hold anywhere, if that is the whole goal, else ""."""
        match self.facts:
            case (Holding(name, None),):
                return name
        return ""

    @property
    def held(self) -> tuple[str, ...]:
        """Names of the objects to hold."""
        return tuple(fact.object for fact in self.facts if isinstance(fact, Holding))

    @property
    def cleared(self) -> tuple[str, ...]:
        """Names of the regions and supports to clear."""
        return tuple(fact.region for fact in self.facts if isinstance(fact, Clear))

    @property
    def openings(self) -> tuple[Open | Closed | Turned, ...]:
        """Facts about doors, drawers, lids and knobs."""
        return tuple(fact for fact in self.facts if isinstance(fact, Open | Closed | Turned))

    @property
    def order(self) -> tuple[tuple[str, str], ...]:
        """Pairs of objects. The first one must move before the second."""
        return tuple((fact.first, fact.second) for fact in self.facts if isinstance(fact, Before))

    def holds(self, scene: Scene, start: Scene | None = None) -> bool:
        """Whether all facts hold in a scene, by its geometry alone.

        An object rests on a face if its lowest point is within `RESTING` of it. It must be upright, or must have lain
        at the start already.

        Args:
            scene: the scene, with held objects at their poses in the grippers.
            start: the scene before anything was moved. The height of held objects is measured from there. Without it,
                it is measured from the support under them.

        Raises:
            GoalError: the goal is invalid in that scene.
        """
        return not self.unmet(scene, start)

    def unmet(self, scene: Scene, start: Scene | None = None) -> tuple[Fact, ...]:
        """Facts that do not hold. Arguments and errors as for `holds`."""
        self.check(scene)
        return tuple(fact for fact in self.facts if not fact.holds(scene, start))

    def in_scene(self, scene: Scene) -> Goal:
        """Settle the goal for a scene in which nothing has been moved yet. A settled goal stays as it is.

        Names are spelled as in the scene. PDDL does not distinguish capitals: a name matches a name of the scene with
        other capitals. If two names of the scene differ only in capitals, the goal must use the exact spelling. Several
        facts about one object are joined in `placed`. For supports above each other, `planners.facts.support_at`
        chooses. Unknown names and contradictions are left to `check`.

        Raises:
            GoalError: a name matches several names of the scene.
        """
        if self.is_settled:
            return self
        goal = Goal(tuple(_spelled(fact, scene) for fact in self.facts))
        if any(goal._unknown_names(scene)) or contradiction_in(scene, goal.facts):
            return goal
        return replace(goal, placed=ends_in(scene, goal.facts), is_settled=True)

    def is_in_order(self, moved: Collection[str]) -> bool:
        """Whether picks in this order, with possible repetitions, obey every `before`."""
        moves = list(moved)
        last = {name: index for index, name in enumerate(moves)}
        return all(first not in last or second not in moves[: last[first]] for first, second in self.order)

    def check(self, scene: Scene) -> None:
        """Check that the goal is valid in a scene.

        Raises:
            GoalError: the goal names something unknown, or contradicts itself. The message lists the valid names.
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
        """Messages about the names that are not in the scene."""
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
        """The goal as PDDL, which `from_pddl` reads."""
        texts = [pddl_of(fact) for fact in self.facts]
        return texts[0] if len(texts) == 1 else f"(and {' '.join(texts)})"

    def sentence(self) -> str:
        """The goal in English, which `from_sentence` reads. See `planners.goal_sentence`."""
        return sentence_of(self.facts)

    @classmethod
    def from_pddl(cls, text: str, scene: Scene | None = None) -> Goal:
        """Read a goal from PDDL text: one fact, or `(and fact fact …)`, nested or not, with or without `(:goal …)`.

        Facts are `(holding a)`, `(on a place)`, `(inside a region)`, `(clear region)`, `(open drawer)`,
        `(closed drawer)` and `(before a b)`. Facts with numbers are `(turned knob (angle 1.2))`,
        `(at a (x 0.5) (y 0.2) (yaw 1.57) (z 0.83) (tolerance 0.02) (yaw-tolerance 0.1))`, which needs only x and y, and
        `(holding a (x 0.5) (y 0.2) (z 1.1) (tolerance 0.02))`. Names with blanks or parentheses need quotation marks.
        PDDL keywords may be in capitals.

        `forall` and `exists` range over the scene's objects, or with `?x - support`, `?x - region`, `?x - place` over
        these. Alternatives of `or`, `imply` and `exists` are dropped if they contradict the rest of the goal. Exactly
        one must be left, or one must hold in the scene. `not` must follow from the rest of the goal. Or it denies for
        all objects that they are on a support: the support is then clear.

        Args:
            text: the goal.
            scene: the scene of the goal. With it, names may have other capitals, see `in_scene`. Without it, names are
                kept as written, and `forall` and `exists` are refused.

        Raises:
            GoalError: the text is no goal, or asks for something that no goal can express. The message says what is
                valid.
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
        # Drop alternatives that ask for more than another one, or for as much as an earlier one.
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
    """A negated fact that no goal can express."""


def _read(literals: Sequence[Literal], text: str, scene: Scene | None) -> tuple[tuple[Fact, ...], tuple[Fact, ...]]:
    """Facts and negated facts of one alternative. Raises `GoalError`."""
    facts: tuple[list[Fact], list[Fact]] = [], []
    for tree, is_negated in literals:
        fact = fact_of(tree, text)
        facts[is_negated].append(fact if scene is None else _spelled(fact, scene))
    if scene is not None and facts[1]:  # names in negated facts must exist too
        for message in Goal((*facts[0], *facts[1]))._unknown_names(scene):
            raise GoalError(message)
    return tuple(facts[0]), tuple(facts[1])


def _said(condition: Condition, held: Sequence[Fact], denied: Sequence[Fact], scene: Scene | None) -> tuple[Fact, ...]:
    """Facts that express the facts and the negated facts. Raises `GoalError`."""
    facts = without_negations(held, denied, scene)
    if facts is None:
        say = "a goal says where objects are to be; say where, and that none is in a region says (clear region)"
        raise _NotSaidError(str(condition.refused("not", say)))
    if denied and not facts:
        raise condition.refused("not", "it says nothing that a plan is to bring about; name at least one fact")
    return facts


def _kinds(fact: Fact, entry: str, scene: Scene, name: str) -> dict[str, Collection[str]]:
    """Valid names for a field of a fact, by kind. Hollows are only listed if the other kinds lack the name."""
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
    """The fact with its names spelled as in the scene. Raises `GoalError` for a name with several matches."""
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
    """Goal to hold an object `LIFTED` above where it stood, or with its centre within a tolerance [m] of a point x, y,
    z.

    Raises:
        GoalError: the point is not three finite numbers, or the tolerance is not positive.
    """
    values = None if point is None else tuple(np.asarray(point, dtype=object).ravel().tolist())
    return Goal((Holding(name, values, tolerance),))


def on(name: str, place: str) -> Goal:
    """Goal to rest an object on a support, on another object (a stack), in a region, or in a hollow as for `inside`."""
    return Goal((On(name, place),))


def inside(name: str, region: str) -> Goal:
    """Goal to rest an object with its whole footprint in a region, on a support, or in a hollow.

    A hollow is an object or a static body: a basket, a bowl, a box, a tray. See `planners.hollows`.
    """
    return Goal((Inside(name, region),))


def at(name: str, pose: ArrayLike, tolerance: float = TOLERANCE, yaw_tolerance: float = YAW_TOLERANCE) -> Goal:
    """Goal to rest an object at a pose.

    Args:
        name: name of the object.
        pose: (2,) x, y [m], or (3,) x, y [m], yaw [rad], or T_world_object (4, 4). Position and yaw of the matrix are
            used.
        tolerance: tolerance of the position [m].
        yaw_tolerance: tolerance of the yaw [rad].

    Raises:
        GoalError: the pose has another shape, or a number is not finite.
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
    """Goal to clear a region or a support of all objects."""
    return Goal((Clear(region),))


def before(first: str, second: str) -> Goal:
    """Goal to move the first object before the second, if both move."""
    return Goal((Before(first, second),))


def open_(name: str, share: float = OPEN_SHARE, amount: float | None = None) -> Goal:
    """Goal to open a drawer, door or lid by at least a share of its range, or an amount [m] or [rad].

    Raises:
        GoalError: the share is not between 0 and 1, or the amount is not positive.
    """
    return Goal((Open(name, share, amount),))


def closed(name: str) -> Goal:
    """Goal to shut a drawer, door or lid."""
    return Goal((Closed(name),))


def turned(name: str, angle: float, tolerance: float = YAW_TOLERANCE) -> Goal:
    """Goal to turn a knob to an angle [rad] from its shut position, within a tolerance [rad].

    Raises:
        GoalError: a number is not finite, or the tolerance is not positive.
    """
    return Goal((Turned(name, angle, tolerance),))


def from_sentence(text: str, scene: Scene | None = None) -> Goal:
    """Read a goal from an English sentence, by a grammar: "put the red can into the basket and close the drawer".

    Args:
        text: clauses joined by commas, "and" or "then". See `planners.goal_sentence`.
        scene: the scene with the names. Without it, a name is its words joined by underscores.

    Raises:
        GoalError: a clause cannot be read, a phrase matches no name of the scene or several, or the goal is invalid
            there. See `Goal.check`.
    """
    if scene is None:
        return Goal(facts_of(text))
    openings = [one.name for one in scene.openings]
    names = (*scene.names, *scene.supports, *region_names(scene), *openings, *hollow_names(scene))
    goal = Goal(facts_of(text, names)).in_scene(scene)
    goal.check(scene)
    return goal


def and_(*goals: str | Goal) -> Goal:
    """Join goals into one. Raises `GoalError` as `Goal.of`."""
    return Goal(tuple(fact for goal in goals for fact in Goal.of(goal).facts))


def _is_always_in(scene: Scene, fact: On | Inside | At, region: Region) -> bool:
    """Whether a fact puts an object into a region, at least in part. At a pose, only its inner circle is tested."""
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
    """Whether a support is the only one under an object at a pose, directly or below other objects."""
    around = np.concatenate(([(fact.x, fact.y)], (fact.x, fact.y) + fact.tolerance * RIM))
    under = {name for name in scene.supports if scene.support_named(name).is_under(around).any()}
    return under == {support} and bool(scene.support_named(support).is_under(around).all())
