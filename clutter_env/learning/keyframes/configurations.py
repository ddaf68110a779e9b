"""Arm configurations that are the same for the gripper, and which of them a network learns."""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray

from assets import RobotSpec
from clutter_env.learning.contacts.reading import wrapped

__all__ = ["is_wrist_turned", "nearest_home", "shortest_way", "with_wrist_turned"]

Array = NDArray[np.float64]


def nearest_home(robot: RobotSpec, q: Array) -> Array:
    """Configurations (..., 8) with the same gripper pose, each in the one form that is nearest to home.

    Joints that turn without end are brought within half a turn of home. Where three joints in a row roll, bend and roll
    about one line, as Fetch's elbow and wrist do, both rolls by half a turn and the opposite bend are the same for all
    that follows: the bend gets the sign that it has at home.
    """
    home, turned = np.array(robot.home), np.array(q)
    for first in _rolls_and_bends(robot):
        bend = turned[..., first + 1]
        is_flipped = bend * np.sign(home[first + 1]) < 0
        turned[..., first + 1] = np.where(is_flipped, -bend, bend)
        for roll in (first, first + 2):
            turned[..., roll] += np.where(is_flipped, np.pi, 0.0)
    endless = list(_endless(robot))
    turned[..., endless] = home[endless] + wrapped(turned[..., endless] - home[endless])
    return turned


def with_wrist_turned(robot: RobotSpec, q: Array) -> Array:
    """Configurations (..., 8) with the same gripper pose, the wrist bent the other way and the forearm half a turn on.

    A robot whose arm does not end in a roll, a bend and a roll about one line keeps its configurations.
    """
    turned = np.array(q)
    for first in _rolls_and_bends(robot)[-1:]:
        turned[..., first + 1] *= -1.0
        turned[..., (first, first + 2)] += np.pi
    return turned


def is_wrist_turned(robot: RobotSpec, q: Array) -> bool:
    """Whether the wrist is bent the other way than at home, in a configuration (8,)."""
    return any(q[first + 1] * robot.home[first + 1] < 0 for first in _rolls_and_bends(robot)[-1:])


def shortest_way(robot: RobotSpec, q: Array, goals: Array) -> Array:
    """Goals (..., 8) with joints that turn by more than one turn on the shorter way from a configuration (8,).

    Where that way leads beyond a limit of the joint it is the longer one.
    """
    endless, turned = list(_endless(robot)), np.array(goals)
    lower, upper = np.array([(robot.chain[i].lower, robot.chain[i].upper) for i in endless]).reshape(-1, 2).T
    near = q[endless] + wrapped(turned[..., endless] - q[endless])
    turned[..., endless] = near - 2 * np.pi * (near > upper) + 2 * np.pi * (near < lower)
    return turned


@cache
def _rolls_and_bends(robot: RobotSpec) -> tuple[int, ...]:
    """Numbers of the first of three joints that roll, bend and roll about one line."""
    chain = robot.chain

    def is_one(first: int) -> bool:
        """Whether the three joints from this one on are such."""
        roll, bend, second = chain[first : first + 3]
        in_line = not any(bend.offset[1:]) and not any(second.offset[1:])
        is_symmetric = bend.lower == -bend.upper
        return (roll.axis, bend.axis, second.axis) == ("x", "y", "x") and in_line and is_symmetric

    return tuple(first for first in range(1, len(chain) - 2) if is_one(first))


@cache
def _endless(robot: RobotSpec) -> tuple[int, ...]:
    """Numbers of the joints that turn by more than one turn."""
    return tuple(i for i, link in enumerate(robot.chain) if link.upper - link.lower > 2 * np.pi)
