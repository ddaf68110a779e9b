"""What a row of the clearance table stands for: a strategy of the planner, or "lookahead" without one of its parts."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType

from assets.robots import RobotSpec
from planners.planner import Planner
from planners.scene import Scene
from planners.strategies import STRATEGIES, Strategy

__all__ = ["ABLATIONS", "ARMS", "VARIANTS", "Variant"]


@dataclass(frozen=True)
class Variant:
    """How a scene is planned in.

    Attributes:
        strategy: of the planner.
        grasps: name of a grasp set instead of the table's, "" for that.
        is_on_first: whether objects are put on the scene's first support alone: the table, without the counters.
        has_all_arms: whether all arms of the robot act.
        hold_aside: whether one arm may hold an obstacle while another one takes the target.
        saves_time: as for `Planner`.
    """

    strategy: Strategy
    grasps: str = ""
    is_on_first: bool = False
    has_all_arms: bool = False
    hold_aside: bool = False
    saves_time: bool | None = None

    def robot(self, robot: RobotSpec) -> RobotSpec:
        """The robot that a table's `robot` becomes."""
        return robot.with_all_arms() if self.has_all_arms else robot

    def planner(self, planner: Planner, scene: Scene) -> Planner:
        """The planner that a table's `planner` becomes in a scene: only what the variant is about differs."""
        supports = planner.support_choice if self.grasps else planner.supports
        if self.is_on_first:
            supports = scene.supports[:1]
        return replace(
            planner,
            robot=self.robot(planner.robot),
            grasps=self.grasps or planner.grasps,
            supports=supports,
            hold_aside=self.hold_aside,
            saves_time=self.saves_time,
        )


_LOOKAHEAD = STRATEGIES["lookahead"]
_ONE_STEP = replace(_LOOKAHEAD, plans_ahead=False, sets=1, slack=0, variations=0, non_monotone=0)

ABLATIONS: Mapping[str, Variant] = MappingProxyType(
    {
        "lookahead - look-ahead": Variant(_ONE_STEP),
        "lookahead - tilt": Variant(_LOOKAHEAD, grasps="side"),
        "lookahead - counters": Variant(_LOOKAHEAD, is_on_first=True),
        "lookahead - second moves": Variant(replace(_LOOKAHEAD, non_monotone=0)),
    }
)
"""By name: without simulating the clearances before the first motion (the smallest set is still chosen); with a level
gripper alone; with the table as the only support; with monotone plans alone."""

ARMS: Mapping[str, Variant] = MappingProxyType(
    {
        "lookahead, one arm, less time": Variant(_LOOKAHEAD, saves_time=True),
        "lookahead, two arms": Variant(_LOOKAHEAD, has_all_arms=True),
        "lookahead, two arms, hold aside": Variant(_LOOKAHEAD, has_all_arms=True, hold_aside=True),
    }
)
"""By name: with one arm, but with the choice of grasps that robots with several arms have; with two arms; where one of
them may hold an obstacle while the other one takes the target."""

VARIANTS: Mapping[str, Variant] = MappingProxyType(
    {**{name: Variant(strategy) for name, strategy in STRATEGIES.items()}, **ABLATIONS, **ARMS}
)
"""All rows that a table can have, by name."""
