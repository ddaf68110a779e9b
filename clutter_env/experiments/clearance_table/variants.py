"""What a row of the clearance table stands for: a strategy of the planner, or "lookahead" without one of its parts."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType

from planners.planner import Planner
from planners.scene import Scene
from planners.strategies import STRATEGIES, Strategy

__all__ = ["ABLATIONS", "VARIANTS", "Variant"]


@dataclass(frozen=True)
class Variant:
    """How a scene is planned in.

    Attributes:
        strategy: of the planner.
        grasps: name of a grasp set instead of the table's, "" for that.
        is_on_first: whether objects are put on the scene's first support alone: the table, without the counters.
    """

    strategy: Strategy
    grasps: str = ""
    is_on_first: bool = False

    def planner(self, planner: Planner, scene: Scene) -> Planner:
        """The planner that a table's `planner` becomes in a scene: only what the variant is about differs."""
        supports = planner.support_choice if self.grasps else planner.supports
        if self.is_on_first:
            supports = scene.supports[:1]
        return replace(planner, grasps=self.grasps or planner.grasps, supports=supports)


_LOOKAHEAD = STRATEGIES["lookahead"]
_ONE_STEP = replace(_LOOKAHEAD, plans_ahead=False, sets=1, slack=0, variations=0, second_moves=0)

ABLATIONS: Mapping[str, Variant] = MappingProxyType(
    {
        "lookahead - look-ahead": Variant(_ONE_STEP),
        "lookahead - tilt": Variant(_LOOKAHEAD, grasps="side"),
        "lookahead - counters": Variant(_LOOKAHEAD, is_on_first=True),
        "lookahead - second moves": Variant(replace(_LOOKAHEAD, second_moves=0)),
    }
)
"""By name: without simulating the clearances before the first motion (the smallest set is still chosen); with a level
gripper alone; with the table as the only support; with monotone plans alone."""

VARIANTS: Mapping[str, Variant] = MappingProxyType(
    {**{name: Variant(strategy) for name, strategy in STRATEGIES.items()}, **ABLATIONS}
)
"""All rows that a table can have, by name."""
