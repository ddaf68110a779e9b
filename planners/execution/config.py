"""Limits and tolerances of the expert."""

from __future__ import annotations

from dataclasses import dataclass, field
from numbers import Integral

from planners.execution.errors import ExpertError, check_number
from planners.execution.monitor import MonitorConfig

__all__ = ["ExpertConfig"]


@dataclass(frozen=True)
class ExpertConfig:
    """Limits, tolerances and choices of the expert.

    Attributes:
        replans: maximum number of new plans after deviations in one episode.
        planning_s: [s] wall time for one solve; infinity for no limit.
        settle_s: [s] simulated time between a deviation and the next plan, one control step at least.
        hold_s: [s] simulated time for which the target is held up at the end, one control step at least.
        with_floor: whether the report contains the minimum number of clearances.
        monitor: tolerances of the monitor.
        hold_aside: whether one arm may hold an obstacle while another one takes the target, as for `solve`; None: as
            the planner does, which is not for a new one.

    Raises:
        ExpertError: a value of the wrong type or outside its range.
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
        check_number("planning_s", self.planning_s, allow_infinity=True)
        check_number("settle_s", self.settle_s)
        check_number("hold_s", self.hold_s)
        if not isinstance(self.with_floor, bool):
            raise ExpertError(f"with_floor={self.with_floor!r} is not valid; it must be True or False")
        if not isinstance(self.hold_aside, bool | None):
            raise ExpertError(f"hold_aside={self.hold_aside!r} is not valid; it must be True, False or None")
        if not isinstance(self.monitor, MonitorConfig):
            raise ExpertError(f"monitor={self.monitor!r} is not valid; it must be a MonitorConfig")
