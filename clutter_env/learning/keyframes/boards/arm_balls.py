"""The links of the arm as balls, for distances: their collision solids, read from the robot's model."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray

from assets import RobotSpec
from clutter_env.learning.keyframes.kinematics import ArmKinematics
from planners import RobotArrays, robot_arrays

__all__ = ["ArmBalls"]

Array = NDArray[np.float64]


class ArmBalls:
    """b balls about the links from the first joint of the arm to the wrist, without the gripper.

    Attributes:
        radius: (b,) [m].
    """

    def __init__(self, robot: RobotSpec) -> None:
        arrays = robot_arrays(robot)
        found = [_balls(arrays, solid) for solid in range(arrays.held_from, len(arrays.core)) if arrays.link[solid] > 0]
        self.radius = np.concatenate([np.full(len(centres), radius) for centres, radius, _ in found])
        self._centres = np.concatenate([centres for centres, _, _ in found])
        self._links = np.concatenate([np.full(len(centres), link) for centres, _, link in found])
        self._kinematics = ArmKinematics(robot)

    def centres(self, q: Array) -> Array:
        """(k, b, 3) [m] in the base's frame, at configurations (k, 8)."""
        origins, rotations = self._kinematics.links(torch.from_numpy(q.astype(np.float32)))
        R, p = rotations.numpy().astype(float)[:, self._links], origins.numpy().astype(float)[:, self._links]
        return np.asarray(p + (R @ self._centres[:, :, None])[..., 0])


def _balls(arrays: RobotArrays, solid: int) -> tuple[Array, float, int]:
    """Centres (n, 3) in its link's frame, radius and link of balls along the longest axis of a solid."""
    half = arrays.half[solid]
    longest = int(np.argmax(half))
    radius = float(arrays.radius[solid] + np.linalg.norm(np.delete(half, longest)))
    count = 2 + int(half[longest] / radius)
    along = np.linspace(-half[longest], half[longest], count)[:, None] * arrays.rotation[solid][:, longest]
    return arrays.position[solid] + along, radius, int(arrays.link[solid])
