"""Four ways to decide what to clear and where to put it, from the same grasps, bases and motions.

They differ in three choices only: how grasps are committed to, which region is kept clear (eq. 1-3 of Lee & Kim
2019), and the order in which clearance locations are tried.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, TypeAlias, get_args

__all__ = ["STRATEGIES", "Strategy", "StrategyError", "UnknownStrategy", "find_strategy"]

Grasps: TypeAlias = Literal["greedy", "smallest"]
Region: TypeAlias = Literal["none", "ngr1", "ngr"]
Locations: TypeAlias = Literal["random", "priority"]


class UnknownStrategy(ValueError):
    """Neither the name of a strategy nor a `Strategy`; the message lists the known names."""


class StrategyError(ValueError):
    """A field of a `Strategy` has no valid value; the message lists the valid ones."""


@dataclass(frozen=True)
class Strategy:
    """A way to clear.

    Attributes:
        name: what it is called.
        grasps: "greedy" takes, object by object, the grasp with the fewest objects in its way; "smallest" takes the
            grasps of the smallest self-clearable set.
        region: what a cleared object must stay out of: "none", "ngr1" (the target's grasp, eq. 1), or "ngr" (also the
            grasps of the obstacles still to be cleared, eq. 3).
        locations: "random" order, or by "priority" (section 3.3): farthest within R_work, then nearest outside it.
        plans_ahead: whether grasps, order and locations of the whole set are chosen before the first motion is
            planned, and other sets are tried where locations are missing.
    """

    name: str
    grasps: Grasps
    region: Region
    locations: Locations
    plans_ahead: bool = False

    def __post_init__(self) -> None:
        for field, valid in (("grasps", Grasps), ("region", Region), ("locations", Locations)):
            if getattr(self, field) not in get_args(valid):
                raise StrategyError(
                    f"strategy {self.name!r}: {field}={getattr(self, field)!r} is not valid; valid values: "
                    f"{', '.join(map(repr, get_args(valid)))}"
                )


STRATEGIES = {
    entry.name: entry
    for entry in (
        Strategy("lookahead", grasps="smallest", region="ngr", locations="priority", plans_ahead=True),
        Strategy("ngr", grasps="greedy", region="ngr", locations="priority"),
        Strategy("dogar", grasps="greedy", region="ngr1", locations="priority"),
        Strategy("srivastava", grasps="greedy", region="none", locations="random"),
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
