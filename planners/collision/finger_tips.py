"""Tips of the closed fingers, which push drawers and doors, and the direction in which a pushed point moves."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from assets.robots import RobotSpec
from irm.chain import pose_of
from planners.collision.scene_arrays import robot_arrays
from planners.scene import Opening

Array = NDArray[np.float64]

_TIP = 0.012
"""[m] Half of the touching length of the fingers, from their tips."""


@dataclass(frozen=True)
class FingerTips:
    """Ends of the closed fingers as a box.

    Attributes:
        ahead: its middle, from the TCP along the approach [m].
        half: (3,) half extents along the approach, along the motion of the fingers, and across both [m].
    """

    ahead: float
    half: tuple[float, float, float]

    def middle(self, T_world_tcp: Array) -> Array:
        """Middle of the box in the world (3,) [m]."""
        return np.asarray(T_world_tcp[:3, 3] + self.ahead * T_world_tcp[:3, 0])

    def reach(self, rotation: Array, direction: Array) -> float:
        """Extent of the box from its middle in a direction (3,) [m], with the hand turned by a rotation (3, 3)."""
        return float(np.abs(direction @ rotation) @ self.half)


@cache
def finger_tips(robot: RobotSpec) -> FingerTips:
    """Find the ends of a robot's closed fingers."""
    arrays = robot_arrays(robot)
    T_tcp_link = np.linalg.inv(pose_of(arrays.tip))
    fingers = arrays.slides & (arrays.link == len(robot.chain) - 1)
    centre = arrays.position[fingers] @ T_tcp_link[:3, :3].T + T_tcp_link[:3, 3]
    rotation = T_tcp_link[:3, :3] @ arrays.rotation[fingers]
    extent = np.einsum("kij,kj->ki", np.abs(rotation), arrays.half[fingers]) + arrays.radius[fingers, None]
    sides, front = np.abs(centre) + extent, float((centre + extent)[:, 0].max())
    return FingerTips(front - _TIP, (_TIP, float(sides[:, 1].max()), float(sides[:, 2].max())))


def way_of(opening: Opening, point: Array, position: float) -> Array:
    """Unit vector (3,) of the initial motion of a point (3,) [m] on a drawer or door, on the way to a position."""
    sign = 1.0 if opening.opens_to(position) else -1.0
    return sign * opening.direction(point)
