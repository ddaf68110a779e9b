"""Where a mover sends the robot next: what the two kinds of motions, in the open and under a board, have in common."""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from clutter_env.learning.contacts.reading import Reading
from clutter_env.learning.keyframes.aim import Aim, GripperError
from planners import Contact

__all__ = ["AHEAD", "Guide", "Keyframe", "drive_goal", "gripper_error"]

Array = NDArray[np.float64]

AHEAD = 0.06
"""[m] On a straight line the robot goes to the configuration this far ahead, which keeps the gripper on the line."""
_TUCKED = 0.4
"""[m], [rad] of the arm from its configuration for driving within which the base drives."""


class Keyframe(NamedTuple):
    """Where the robot goes now.

    Attributes:
        goal: (11,) whole-body configuration.
        finger: position of one finger [m].
        expected: (4, 4) where the TCP should be now, in the world.
        stops: how many base poses are left on the way of a drive, the present one too where the arm is tucked in first.
        length: [m] of the straight line that the gripper is on.
        slack: share of the greatest small error that the gripper may have at the end of a transit.
    """

    goal: Array
    finger: float
    expected: Array
    stops: int = 1
    length: float = 0.0
    slack: float = 1.0


class Guide(Protocol):
    """Knows the way to contacts and away from them."""

    def begin(self, contact: Contact, index: int, reading: Reading) -> list[str]:
        """Choose how to bring a contact of object `index` about; the phases to go through."""
        ...

    def keyframe(self, phase: str, contact: Contact, aim: Aim, reading: Reading) -> Keyframe:
        """Where the robot goes in a phase; the contact may have moved since."""
        ...


def gripper_error(phase: str, reading: Reading, expected: Array, contact: Contact) -> GripperError:
    """Of the gripper; on a straight line without the part along it, since the distance is measured."""
    error = GripperError.between(reading.tcp, expected)
    if phase in ("transit", "reach"):
        return error
    return error.across(expected[:3, 3] - contact.tcp[:3, 3])


def drive_goal(reading: Reading, way: list[Array], q: Array) -> tuple[Array, int]:
    """Where the base (3,) goes on a way of base poses while the arm goes to q (8,), and how many stops are left.

    The base drives once the arm is tucked in.
    """
    if np.abs(q - reading.q).max() <= _TUCKED:
        return way[0], len(way)
    return reading.base, 1 + len(way)
