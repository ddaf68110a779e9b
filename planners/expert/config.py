"""Limits and tolerances of the expert."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, fields
from numbers import Integral, Real


class ExpertError(ValueError):
    """Wrong use of the expert: an unsuitable environment or value, or a call before `reset`."""


@dataclass(frozen=True)
class MonitorConfig:
    """Tolerances: larger differences between world and plan are deviations.

    Attributes:
        displacement: motion [m] of an object that no action moves.
        tilt: tilt [rad] of an object that should stand.
        slip: motion [m] of a held object in the TCP frame.
        base: tracking error [m] and [rad] of a base joint.
        arm: tracking error [m] and [rad] of a torso or arm joint.
        aim: difference [m] between the planned and the perceived position of an object, or of a neighbour, just before
            the gripper approaches it.
        turn: turn [rad] about the vertical of an object to grasp. After a larger turn, the open fingers would hit it.

    Raises:
        ExpertError: a value is no number of at least 0.
    """

    displacement: float = 0.015
    tilt: float = 0.25
    slip: float = 0.02
    base: float = 0.08
    arm: float = 0.12
    aim: float = math.inf
    turn: float = 0.3

    def __post_init__(self) -> None:
        for entry in fields(self):
            _check_number(entry.name, getattr(self, entry.name), allow_infinity=True)


@dataclass(frozen=True)
class ExpertConfig:
    """Limits, tolerances and choices of the expert.

    Attributes:
        replans: maximum number of new plans after deviations in one episode.
        planning_s: wall time [s] of one solve, infinity for no limit.
        settle_s: simulated time [s] between a deviation and the next plan, at least one control step.
        hold_s: simulated time [s] of holding the target up at the end, at least one control step.
        with_floor: whether the report contains the minimum number of clearances.
        monitor: tolerances of the monitor.
        hold_aside: whether one arm may hold an obstacle while another one takes the target, as for `solve`. None leaves
            it to the planner, whose default is False.

    Raises:
        ExpertError: a value has the wrong type or is outside its range.
    """

    replans: int = 6
    planning_s: float = 30.0
    settle_s: float = 0.5
    hold_s: float = 0.8
    with_floor: bool = True
    monitor: MonitorConfig = field(default_factory=MonitorConfig)
    hold_aside: bool | None = None

    def __post_init__(self) -> None:
        if not isinstance(self.replans, Integral) or isinstance(self.replans, bool) or self.replans < 0:
            raise ExpertError(f"replans={self.replans!r} is not valid; it must be an integer of at least 0")
        _check_number("planning_s", self.planning_s, allow_infinity=True)
        _check_number("settle_s", self.settle_s)
        _check_number("hold_s", self.hold_s)
        if not isinstance(self.with_floor, bool):
            raise ExpertError(f"with_floor={self.with_floor!r} is not valid; it must be True or False")
        if not isinstance(self.hold_aside, bool | None):
            raise ExpertError(f"hold_aside={self.hold_aside!r} is not valid; it must be True, False or None")
        if not isinstance(self.monitor, MonitorConfig):
            raise ExpertError(f"monitor={self.monitor!r} is not valid; it must be a MonitorConfig")


def _check_number(name: str, value: object, allow_infinity: bool = False) -> None:
    if isinstance(value, Real) and not isinstance(value, bool):
        number = float(value)
        if number >= 0 and (allow_infinity or not math.isinf(number)):
            return
    kind = "number" if allow_infinity else "finite number"
    raise ExpertError(f"{name}={value!r} is not valid; it must be a {kind} of at least 0")
