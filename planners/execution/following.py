"""Actions followed to their end, or until the world deviates from the plan."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from assets.robots import RobotSpec
from planners.execution.executor import Command, Executor, Outcome
from planners.execution.monitor import MonitorConfig, Sensor
from planners.tamp.solution import BoundAction

__all__ = ["follow"]


def follow(
    actions: Sequence[BoundAction],
    robot: RobotSpec,
    sensor: Sensor,
    step: Callable[[Command], bool],
    config: MonitorConfig,
) -> str:
    """Follow motions; the kind of the deviation that stopped the execution, "" for none.

    Args:
        actions: what to do.
        robot: that does it.
        sensor: reads the world.
        step: carries out the command of one control step; true if that was the last one there may be.
        config: tolerances of the monitor.
    """
    plan = Executor(tuple(actions), robot, sensor.names, sensor.read(), config)
    outcome, is_over = Outcome.RUNNING, False
    while outcome is Outcome.RUNNING and not is_over:
        found = plan.advance(sensor.read())
        outcome = found.outcome
        is_over = step(found.command)
    return "" if plan.deviation is None else str(plan.deviation.kind)
