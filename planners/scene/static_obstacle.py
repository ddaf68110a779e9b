"""Static obstacles: convex solids that neither the robot nor anything else moves, in world coordinates."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from planners.scene.solid import LEVEL, Array, Solid

FLOOR = "floor"
"""Name of the floor as a support, which is no static obstacle: every scene has it."""


@dataclass(frozen=True, eq=False)
class StaticObstacle(Solid):
    """A convex solid that stays where it is: a table top, a wall, a pillar, a bottle that the robot must not touch.

    Its frame is the world, and its name unique among the static obstacles of a scene.
    """

    _KIND = "static obstacle"

    @property
    def top(self) -> float:
        """[m] height of the highest point."""
        return float(self.upper[2])

    @cached_property
    def has_level_top(self) -> bool:
        """Whether objects can stand on it: a box with a vertical axis, or an upright cylinder."""
        vertical = np.abs(self.rotation[2]) > 1 - LEVEL
        return bool(vertical.any() if self.shape == "box" else self.shape == "cylinder" and vertical[2])

    def is_under(self, points: Array) -> NDArray[np.bool_]:
        """Which points (..., 2) [m] lie above or below its outline; of an upright cylinder, its circle."""
        away = points - self.position[:2]
        if self.shape == "cylinder" and self.has_level_top:
            return np.asarray(np.hypot(away[..., 0], away[..., 1]) <= self.half_extents[0])
        corners = self.outline - self.position[:2]
        sides = np.roll(corners, -1, axis=0) - corners
        turns = sides[:, 0] * (away[..., 1, None] - corners[:, 1]) - sides[:, 1] * (away[..., 0, None] - corners[:, 0])
        return np.asarray((turns >= 0).all(axis=-1))
