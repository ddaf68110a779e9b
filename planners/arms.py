"""Robots that act with several arms: what they can be combined with, and one search where there is one arm."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TypeVar

from assets.robots import RobotSpec

__all__ = ["ArmsError", "check_arms", "one_or_all"]

T = TypeVar("T")


class ArmsError(ValueError):
    """A choice that does not fit the number of arms that a robot acts with; the message says what does."""


def check_arms(robot: RobotSpec, hold_aside: bool, is_told_tcp_poses: bool, canonical: bool) -> None:
    """Check a planner's choices.

    Raises:
        ArmsError: they do not fit the arms that the robot acts with.
    """
    if not isinstance(hold_aside, bool):
        raise ArmsError(f"hold_aside={hold_aside!r} is not valid; valid values: False, True")
    if hold_aside and not robot.acts_with_all_arms:
        several = bool(robot.idle_arms)
        advice = "robot.with_all_arms() does" if several else "it has one arm; valid value: hold_aside=False"
        raise ArmsError(f"hold_aside needs a robot that acts with several arms, {robot.name!r} does not; {advice}")
    if robot.acts_with_all_arms and (is_told_tcp_poses or canonical):
        what = "control mode 'ee'" if is_told_tcp_poses else "canonical plans"
        raise ArmsError(f"{what} are for one arm; robot.using(arm) of {robot.name!r} has one of: {_arms(robot)}")


def one_or_all(by_arm: Mapping[str, T], together: Callable[[Mapping[str, T]], T]) -> T:
    """The entry of the only arm, or those of all arms together."""
    return next(iter(by_arm.values())) if len(by_arm) == 1 else together(by_arm)


def _arms(robot: RobotSpec) -> str:
    return ", ".join(repr(arm) for arm in robot.acting_arms)
