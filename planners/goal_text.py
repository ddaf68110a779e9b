"""Facts of a goal as PDDL text, and negated facts: some follow from the others, some cannot be expressed."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import MISSING, fields
from typing import TYPE_CHECKING, Any, get_args

from planners.facts import VALID, At, Clear, Fact, Holding, Inside, On, Open, Turned, names_in, occupants, region_names
from planners.goal_ends import excludes
from planners.pddl import WORD, Quoted, Tree, shown
from planners.regions import GoalError

if TYPE_CHECKING:
    from planners.scene import Scene

_NUMBERS = ("x", "y", "z", "yaw", "tolerance", "yaw-tolerance")
ARGUMENTS: dict[str, tuple[Callable[..., Fact], int]] = {
    kind.__name__.lower(): (kind, sum(entry.type == "str" for entry in fields(kind)))
    for kind in get_args(Fact)
    if all(entry.type == "str" for entry in fields(kind) if entry.default is MISSING)
}
"""Facts whose arguments are names only, with the number of names."""
_AMOUNTS = {"open": (Open, ("share", "amount"), ()), "turned": (Turned, ("angle", "tolerance"), ("angle",))}
"""Facts about openings that take numbers: valid numbers, required numbers."""


def fact_of(tree: Tree, text: str) -> Fact:
    """Fact of a list of words. Raises `GoalError`."""
    if isinstance(tree, list) and tree and isinstance(tree[0], str):
        tree = [tree[0].lower(), *tree[1:]]
        if any(isinstance(part, str) and not isinstance(part, Quoted) and part.startswith("?") for part in tree):
            raise GoalError(f"{shown(tree):.100} in {text!r:.200}: no variables here; write one fact for each object")
        tree = [str(part) if isinstance(part, str) else part for part in tree]
    match tree:
        case ["at" | "holding" as kind, str(name), *given] if kind == "at" or given:
            numbers: dict[str, Any] = {}
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
                            f"{shown(part):.100} in {text!r:.200}: valid are {_NUMBERS}, each once, as in (x 0.5)"
                        )
            needed = {"x", "y"} if kind == "at" else {"x", "y", "z"}
            if kind == "at" and needed <= numbers.keys():
                return At(name, **numbers)
            if kind == "holding" and needed <= numbers.keys() <= needed | {"tolerance"}:
                x, y, z = (numbers.pop(axis) for axis in "xyz")
                return Holding(name, (x, y, z), **numbers)
            valid = "(x …), (y …), (z …), and takes (tolerance …)" if kind == "holding" else "(x …) and (y …)"
            raise GoalError(f"({kind} {name} …) in {text!r:.200} needs {valid}")
        case [str(kind), str(name), *given] if kind in _AMOUNTS and (given or kind not in ARGUMENTS):
            made, valid_numbers, required = _AMOUNTS[kind]
            amounts = {str(part[0]): part[1] for part in given if isinstance(part, list) and len(part) == 2}
            if len(amounts) == len(given) and {*required} <= amounts.keys() <= {*valid_numbers}:
                return made(name, **amounts)
            listed = " ".join(f"({one} …)" for one in valid_numbers)
            raise GoalError(f"({kind} {name} …) in {text!r:.200} takes {listed}")
        case [str(kind), *names] if kind in ARGUMENTS and len(names) == ARGUMENTS[kind][1]:
            if all(isinstance(name, str) for name in names):
                return ARGUMENTS[kind][0](*names)
    raise GoalError(f"{shown(tree):.100} in {text!r:.200} is no fact; valid are {VALID}")


def domain_of(scene: Scene) -> dict[str, tuple[str, ...]]:
    """Names that variables range over, by type: `?x`, as `?x - object`, ranges over the objects."""
    regions, supports = region_names(scene), tuple(scene.supports)
    return {"object": scene.names, "support": supports, "region": regions, "place": (*supports, *regions)}


def without_negations(facts: Sequence[Fact], denied: Sequence[Fact], scene: Scene | None) -> tuple[Fact, ...] | None:
    """Turn facts and negated facts into facts. None if that is impossible.

    A negated fact may be left out if the other facts exclude it. If every object is said not to be on a support, the
    support is clear. The same holds for a region, unless an object overlaps it in part.

    Raises:
        GoalError: a fact must hold and must not hold.
    """
    ends = {name: fact for fact in facts if (name := getattr(fact, "object", ""))}
    left: list[Fact] = []
    for fact in denied:
        if fact in facts:
            raise GoalError(f"the goal says that {pddl_of(fact)} holds, and that it does not")
        end = ends.get(getattr(fact, "object", ""))
        is_said = end is not None and scene is not None and excludes(scene, end, fact)
        # At the end of a plan, only the objects of the goal are held.
        is_said |= isinstance(fact, Holding) and (
            end is not None or (scene is not None and fact.object not in scene.held_names)
        )
        left += [] if is_said else [fact]
    found = list(facts)
    while left:
        fact = left[0]
        if scene is None or not isinstance(fact, On | Inside) or not _is_area(scene, names_in(fact)[1]):
            return None
        place = names_in(fact)[1]
        same = [one for one in left if isinstance(one, On | Inside) and names_in(one)[1] == place]
        others = set(scene.names) - {one.object for one in same}
        is_of_all = all(name in ends and excludes(scene, ends[name], On(name, place)) for name in others)
        if not is_of_all or not _is_clear_if_empty(scene, fact):
            return None
        found.append(Clear(place))
        left = [one for one in left if one not in same]
    return tuple(found)


def says_all(facts: Sequence[Fact], others: Sequence[Fact], scene: Scene | None) -> bool:
    """Whether facts imply all others. A support is clear, for example, if all objects are elsewhere."""
    ends = {name: fact for fact in facts if (name := getattr(fact, "object", ""))}

    def is_empty(place: str) -> bool:
        assert scene is not None
        return all(name in ends and excludes(scene, ends[name], On(name, place)) for name in scene.names)

    return all(
        fact in facts
        or (scene is not None and isinstance(fact, Clear) and fact.region in scene.supports and is_empty(fact.region))
        for fact in others
    )


def _is_area(scene: Scene, name: str) -> bool:
    return name in scene.supports or any(region.name == name for region in scene.regions)


def _is_clear_if_empty(scene: Scene, fact: On | Inside) -> bool:
    """Whether a place is clear once the fact holds for no object: no object overlaps the place in part."""
    place = names_in(fact)[1]
    if place in scene.supports:
        return isinstance(fact, On)
    return all(Inside(name, place).holds(scene, scene) for name in occupants(scene, place))


def pddl_of(fact: Fact) -> str:
    """The fact as PDDL."""
    numbers: dict[str, float | None] = {}
    match fact:
        case At():
            numbers = {
                entry.name: getattr(fact, entry.name)
                for entry in fields(fact)
                if entry.name not in ("object", "within")
            }
        case Holding(_, (x, y, z), tolerance):
            numbers = {"x": x, "y": y, "z": z, "tolerance": tolerance}
        case Open(_, share, amount):
            numbers = {"amount": amount} if amount is not None else {"share": share}
        case Turned(_, angle, tolerance):
            numbers = {"angle": angle, "tolerance": tolerance}
    given = (f"({name.replace('_', '-')} {number!r})" for name, number in numbers.items() if number is not None)
    names = (name if re.fullmatch(rf"(?!\?){WORD}", name) else f'"{name}"' for name in names_in(fact))
    return f"({' '.join((type(fact).__name__.lower(), *names, *given))})"
