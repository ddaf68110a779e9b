"""Base poses that face the gripper from a fixed distance: one for each direction, smooth in the gripper's pose."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from irm.floor.free_space import FreeSpace
from planners.grasping.base_placement import MapPlacer

__all__ = ["STRAIGHT", "TURNED", "FacingPlacer"]

Array = NDArray[np.float64]

STRAIGHT = (0.0,)
"""[rad] The gripper's yaw is the base's."""
TURNED = tuple(math.radians(degrees) for degrees in (20, -20, 40, -40, 60, -60))
"""[rad] Other yaws of the gripper relative to the base."""
_STANDOFF = 0.75
"""[m] from the base's centre to the TCP, where the arm reaches well."""
_STEP, _HALVINGS = 0.01, 8
"""[m] between distances tried, and how often the last step is halved to find the edge of the free floor."""
_YAW_COST = 0.5
"""Cost of a radian of the base's yaw, if a radian of the gripper's yaw relative to the base costs 1."""


@dataclass(frozen=True)
class FacingPlacer:
    """For every gripper pose the base poses that face it at given relative yaws, those that turn least first.

    The distance is `_STANDOFF`, or where the free floor begins behind that.

    Attributes:
        placer: the free floors of the scene.
        reach: [m] from the base at most.
        turns: [rad] yaws of the gripper relative to the base.
    """

    placer: MapPlacer
    reach: float
    turns: tuple[float, ...] = STRAIGHT

    def bases(self, gripper_poses: Array, most: int = 0) -> tuple[Array, NDArray[np.int64]]:  # noqa: ARG002  always all
        """As `BasePlacer.bases`; those of all gripper poses in one order, the least cost first."""
        turns = np.array(self.turns)
        yaw = _wrapped(gripper_poses[:, 3:4] - turns)
        distance = np.where(
            gripper_poses[:, 4:5] == 0.0,
            self._distance(self.placer.floor, gripper_poses, yaw),
            self._distance(self.placer.open_floor, gripper_poses, yaw),
        )
        x = gripper_poses[:, :1] - distance * np.cos(yaw)
        y = gripper_poses[:, 1:2] - distance * np.sin(yaw)
        cost = np.round(_YAW_COST * np.abs(yaw) + np.abs(turns), 9)
        index, turn = np.nonzero(np.isfinite(distance))
        order = np.argsort(cost[index, turn], kind="stable")
        found = np.stack((x, y, yaw), axis=-1)[index, turn][order]
        return np.ascontiguousarray(found), index[order].astype(np.int64)

    def _distance(self, floor: FreeSpace, gripper_poses: Array, yaw: Array) -> Array:
        """[m] behind gripper poses (k, 5) along yaws (k, t) where the base may stand: (k, t), infinite for none."""
        steps = np.arange(_STANDOFF, self.reach, _STEP)

        def is_free(distance: Array) -> NDArray[np.bool_]:
            """Whether the base may stand at distances (k, t, s)."""
            x = gripper_poses[:, 0, None, None] - distance * np.cos(yaw)[..., None]
            y = gripper_poses[:, 1, None, None] - distance * np.sin(yaw)[..., None]
            return floor.are_free(x, y)

        free = is_free(np.broadcast_to(steps, (*yaw.shape, len(steps))))
        first = free.argmax(axis=-1)
        near, far = steps[np.maximum(first - 1, 0)][..., None], steps[first][..., None]
        for _ in range(_HALVINGS):
            middle = (near + far) / 2
            ahead = is_free(middle)
            near, far = np.where(ahead, near, middle), np.where(ahead, middle, far)
        return np.asarray(np.where(free.any(axis=-1), far[..., 0], np.inf))


def _wrapped(angles: Array) -> Array:
    """Angles [rad] in (-π, π]."""
    return math.pi - np.mod(math.pi - angles, 2 * math.pi)
