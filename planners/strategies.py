"""Four strategies to choose which objects to clear and where to put them, with the same grasps, bases and motions.

They differ in three choices: the grasps, the region to keep clear (eq. 1-3 of Lee & Kim 2019), and the order of
clearance locations. One of them also plans ahead. All have the same budget.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any, Literal, Self, TypeAlias, get_args, get_type_hints

Grasps: TypeAlias = Literal["greedy", "smallest"]
Region: TypeAlias = Literal["none", "ngr1", "ngr"]
Locations: TypeAlias = Literal["random", "priority"]


class UnknownStrategy(ValueError):
    """A choice that is neither the name of a strategy nor a `Strategy`. The message lists the known names."""


class StrategyError(ValueError):
    """A `Strategy` with an unknown field or an invalid value. The message lists the valid ones."""


@dataclass(frozen=True)
class Strategy:
    """A strategy for clearing: three choices, planning ahead or not, and a budget.

    The strategies of `STRATEGIES` have the same budget. `tries` belongs to planning ahead, the idea of "lookahead".

    Attributes:
        name: name of the strategy.
        grasps: "greedy" takes, object by object, the grasp with the fewest blockers. "smallest" takes the grasps of the
            smallest self-clearable set. A strategy that plans ahead finds its own.
        region: keep-out region of a cleared object: "none", "ngr1" (the target's grasp, eq. 1) or "ngr". "ngr" adds the
            grasps of the obstacles still to clear (eq. 3).
        locations: "random" order, or "priority" (section 3.3): farthest within R_work, then nearest outside it.
        plans_ahead: whether grasps, order and locations of the whole set are chosen before the first motion is planned.
            The task planner then gets the blockers of these grasps as facts.
        tries: tries of one look-ahead until a plan is found. Then a quarter as many for a plan with fewer picks.
        leaves_cleared: whether an object is cleared again only if nothing else helps.
        attempts: runs of Algorithm 1 with different random choices, before a solve ends without a plan or with a plan
            that clears an object twice.
        locations_per_level: locations to try at each refinement of the grid, once from the present base pose and once
            after a base motion. In "random" order, the same total is drawn from all levels.
        placements: placements to plan motions for before an object is regarded as without a location.

    Raises:
        StrategyError: a field is unknown, or its value is invalid.
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
        """Refuse unknown fields with an error that lists the valid ones, unlike Python's own."""
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
"""Strategies by name: ours, Lee & Kim 2019, Dogar & Srinivasa 2011 (NGR1), Srivastava et al. 2014 (no region)."""


def find_strategy(choice: str | Strategy) -> Strategy:
    """Find a strategy by name. A `Strategy` is returned as it is.

    Raises:
        UnknownStrategy: the choice is neither. The message lists the known names.
    """
    if isinstance(choice, Strategy):
        return choice
    if not isinstance(choice, str) or choice not in STRATEGIES:
        raise UnknownStrategy(
            f"no strategy {choice!r}; known strategies: {', '.join(STRATEGIES)}; or an object of planners.Strategy"
        )
    return STRATEGIES[choice]
