"""The gripper as points on its surface, for what it would run into: solids of the robot's model."""

from __future__ import annotations

import itertools

import numpy as np
from numpy.typing import NDArray

from assets import RobotSpec
from irm import pose_of
from planners import RobotArrays, robot_arrays

__all__ = ["GripperPoints"]

Array = NDArray[np.float64]

_SPACING = 0.02
"""[m] between points, at most."""


class GripperPoints:
    """Points on the boxes about palm, fingers and last wrist joint, in the TCP's frame."""

    def __init__(self, robot: RobotSpec) -> None:
        arrays = robot_arrays(robot)
        solids = [(_surface(arrays, solid), arrays.slide[solid]) for solid in range(arrays.held_from)]
        T = np.linalg.inv(pose_of(arrays.tip))
        self._closed = np.concatenate([points for points, _ in solids]) @ T[:3, :3].T + T[:3, 3]
        self._slide = np.concatenate([np.tile(slide, (len(points), 1)) for points, slide in solids]) @ T[:3, :3].T

    def at(self, finger: float) -> Array:
        """(n, 3) [m] with each finger at this position [m]."""
        return np.asarray(self._closed + finger * self._slide)


def _surface(arrays: RobotArrays, solid: int) -> Array:
    """(n, 3) Points on the box around a solid, in its link's frame."""
    half = arrays.half[solid] + arrays.radius[solid]
    steps = [np.linspace(-size, size, 1 + max(int(np.ceil(2 * size / _SPACING)), 1)) for size in half]
    grid = np.array(list(itertools.product(*steps)))
    on_surface = np.isclose(np.abs(grid), half).any(axis=1)
    return np.asarray(arrays.position[solid] + grid[on_surface] @ arrays.rotation[solid].T)
