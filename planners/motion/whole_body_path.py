"""Motions in which the base may drive while the arm is rigid, or stand while the arm moves."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from planners.motion.arm import ArmPath
from planners.motion.base import BasePath
from planners.scene import HeldObject

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class WholeBodyPath:
    """A motion of base, torso and arm, straight between configurations. Arrays are read-only.

    Attributes:
        configurations: (n, 11) base x [m], y [m], yaw [rad] (continuous), torso [m] and arm [rad].
        opening: of the gripper [m].
        held: the held object.
        ignore: mask of objects that did not count as obstacles.
    """

    configurations: Array
    opening: float
    held: HeldObject | None = None
    ignore: int = 0

    def __post_init__(self) -> None:
        array = np.array(self.configurations, dtype=float)
        array.setflags(write=False)
        object.__setattr__(self, "configurations", array)

    @classmethod
    def joined(cls, drive: BasePath | None, arm: ArmPath) -> WholeBodyPath:
        """The base drives, if it has to, then the arm moves; opening and held object are those of the arm's path."""
        before = np.empty((0, arm.configurations.shape[1])) if drive is None else drive.configurations
        rows = np.vstack([before, arm.configurations])
        return cls(rows, arm.opening, arm.held, arm.ignore)

    @property
    def base(self) -> Array:
        """(3,) base pose at the start: x [m], y [m], yaw [rad]."""
        return np.asarray(self.configurations[0, :3])

    @property
    def start(self) -> Array:
        """(8,) torso and arm at the start."""
        return np.asarray(self.configurations[0, 3:])

    @property
    def end_base(self) -> Array:
        """(3,) base pose at the end."""
        return np.asarray(self.configurations[-1, :3])

    @property
    def end(self) -> Array:
        """(8,) torso and arm at the end."""
        return np.asarray(self.configurations[-1, 3:])

    def reversed(self) -> WholeBodyPath:
        """The same motion backwards."""
        return replace(self, configurations=self.configurations[::-1])
