"""Feedback from the measured gripper pose: the contact that a network is told is shifted until the gripper is right."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

__all__ = ["MOST_SHIFT", "MOST_TURN", "Aim", "GripperError"]

Array = NDArray[np.float64]

_GAIN = 0.15
"""Share of the measured error by which the aim moves in a control step; the arm follows in 0.1 s."""
MOST_SHIFT, MOST_TURN = 0.06, 0.3
"""[m], [rad] by which the aim may differ from the contact: the network was fitted to such."""
_CLOSE, _ALIGNED = 0.008, 0.08
"""[m], [rad] that a gripper may be off a straight line while it goes on along the line; it leaves 12 mm a side."""
_SHORT = 0.02
"""[m] from the contact up to which the error along the line counts too."""


@dataclass(frozen=True, eq=False)
class GripperError:
    """From the measured to the expected gripper pose.

    Attributes:
        shift: (3,) [m] in the world.
        turn: (3,) rotation vector [rad] in the world.
    """

    shift: Array
    turn: Array

    @classmethod
    def between(cls, measured: Array, expected: Array) -> GripperError:
        """Of two TCP poses (4, 4) in the world."""
        turn = Rotation.from_matrix(expected[:3, :3] @ measured[:3, :3].T).as_rotvec()
        return cls(expected[:3, 3] - measured[:3, 3], turn)

    def across(self, line: Array) -> GripperError:
        """The error without its part along a line (3,) [m] from the contact; all of it where that is short."""
        length = float(np.linalg.norm(line))
        if length < _SHORT:
            return self
        along = line / length
        return GripperError(self.shift - (self.shift @ along) * along, self.turn)

    @property
    def is_small(self) -> bool:
        """Whether the gripper may go on along its line."""
        return self.is_within(1.0)

    def is_within(self, share: float) -> bool:
        """Whether it is at most a share of the greatest small error."""
        return bool(np.linalg.norm(self.shift) < share * _CLOSE and np.linalg.norm(self.turn) < share * _ALIGNED)


class Aim:
    """The integral of the gripper's errors: where a network has to be told that the contact is."""

    def __init__(self) -> None:
        self._shift, self._turn = np.zeros(3), np.zeros(3)

    def correct(self, error: GripperError) -> None:
        """Move the aim by a share of an error."""
        self._shift = _limited(self._shift + _GAIN * error.shift, MOST_SHIFT)
        turn = Rotation.from_rotvec(_GAIN * error.turn) * Rotation.from_rotvec(self._turn)
        self._turn = _limited(turn.as_rotvec(), MOST_TURN)

    def of(self, contact: Array) -> Array:
        """The aim (4, 4) for a contact (4, 4), both in the world."""
        aim = np.array(contact)
        aim[:3, :3] = Rotation.from_rotvec(self._turn).as_matrix() @ contact[:3, :3]
        aim[:3, 3] += self._shift
        return aim


def _limited(vector: Array, most: float) -> Array:
    """A vector (3,) shortened to this length, if it is longer."""
    return vector * min(1.0, most / max(float(np.linalg.norm(vector)), 1e-12))
