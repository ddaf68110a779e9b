"""Four ways to decide what to clear and where to put it, from the same grasps, bases and motions.

They differ in three choices: how grasps are committed to, which region is kept clear (eq. 1-3 of Lee & Kim 2019), and
the order in which clearance locations are tried. One of them also plans ahead. Their budget is the same.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any, Literal, Self, TypeAlias, get_args, get_type_hints

Grasps: TypeAlias = Literal["greedy", "smallest"]
Region: TypeAlias = Literal["none", "ngr1", "ngr"]
Locations: TypeAlias = Literal["random", "priority"]


class UnknownStrategy(ValueError):
    """Neither the name of a strategy nor a `Strategy`; the message lists the known names."""


class StrategyError(ValueError):
    """A `Strategy` has no such field, or a field has no valid value; the message lists the valid ones."""


@dataclass(frozen=True)
class Strategy:
    """A way to clear: three choices, planning ahead or not, and a budget.

    The strategies of `STRATEGIES` have the same budget; `tries` is part of planning ahead, the idea of "lookahead".

    Attributes:
        name: what it is called.
        grasps: "greedy" takes, object by object, the grasp with the fewest objects in its way; "smallest" takes the
            grasps of the smallest self-clearable set; a strategy that plans ahead looks for its own.
        region: what a cleared object must stay out of: "none", "ngr1" (the target's grasp, eq. 1), or "ngr" (also the
            grasps of the obstacles still to be cleared, eq. 3).
        locations: "random" order, or by "priority" (section 3.3): farthest within R_work, then nearest outside it.
        plans_ahead: whether grasps, order and locations of the whole set are chosen before the first motion is
            planned, and the task planner is told what obstructs these grasps.
        tries: moves tried in one look-ahead until a plan is found; then a quarter as many for one with fewer picks.
        leaves_cleared: whether an object that was cleared before is cleared again only if nothing else helps.
        attempts: runs of Algorithm 1, with other random choices, before a solve ends without a plan or with a plan that
            clears an object twice.
        locations_per_level: locations tried at each refinement of the grid, once from where the base stands and once
            after a base motion. In "random" order the same number in all are drawn from the locations of all levels.
        placements: placements for which motions are planned before an object counts as having no location.

    Raises:
        StrategyError: there is no such field, or a field has no valid value.
    """

    name: str
    grasps: Grasps
    region: Region
    locations: Locations
    plans_ahead: bool = False
    tries: int = 100
    leaves_cleared: bool = True
    attempts: int = 3
    locations_per_level: int = 120
    placements: int = 12

    def __new__(cls, *_values: Any, **given: Any) -> Self:
        """Refuse unknown fields by an error of this package; Python's own names no valid ones."""
        known = [field.name for field in fields(cls)]
        for name in given:
            if name not in known:
                raise StrategyError(f"a strategy has no field {name!r}; fields: {', '.join(known)}")
        return super().__new__(cls)

    def __post_init__(self) -> None:
        for name, kind in get_type_hints(type(self)).items():
            value = getattr(self, name)
            if choices := get_args(kind):
                is_valid = isinstance(value, str) and value in choices
                rule = f"valid values: {', '.join(map(repr, choices))}"
            elif kind is int:
                is_valid, rule = isinstance(value, int) and value >= 1, "it must be an integer of at least 1"
            else:
                is_valid, rule = isinstance(value, kind), f"it must be {'a string' if kind is str else 'True or False'}"
            if not is_valid:
                raise StrategyError(f"strategy {self.name!r}: {name}={value!r} is not valid; {rule}")


STRATEGIES = {
    entry.name: entry
    for entry in (
        Strategy("lookahead", "smallest", "ngr", "priority", plans_ahead=True),
        Strategy("ngr", "greedy", "ngr", "priority"),
        Strategy("dogar", "greedy", "ngr1", "priority"),
        Strategy("srivastava", "greedy", "none", "random"),
    )
}
"""By name: ours; Lee & Kim 2019; Dogar & Srinivasa 2011 (NGR1); Srivastava et al. 2014 (no region)."""


def find_strategy(choice: str | Strategy) -> Strategy:
    """The strategy of that name; a `Strategy` is returned as it is.

    Raises:
        UnknownStrategy: neither; the message lists the known names.
    """
    if isinstance(choice, Strategy):
        return choice
    if not isinstance(choice, str) or choice not in STRATEGIES:
        raise UnknownStrategy(
            f"no strategy {choice!r}; known strategies: {', '.join(STRATEGIES)}; or an object of planners.Strategy"
        )
    return STRATEGIES[choice]
