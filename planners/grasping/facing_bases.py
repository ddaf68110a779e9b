"""Base poses that face the gripper from a fixed distance: one for each direction, smooth in the gripper's pose."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from irm.free_space import FreeSpace
from planners.grasping.base_placement import MapPlacer

Array = NDArray[np.float64]

STRAIGHT = (0.0,)
"""[rad] The gripper's yaw is the base's."""
TURNED = tuple(math.radians(degrees) for degrees in (20, -20, 40, -40, 60, -60))
"""[rad] Other yaws of the gripper relative to the base."""
_STANDOFF = 0.648
"""Share of the arm's reach, from the base's centre to the TCP, at which it moves well; 0.75 m for Fetch."""
_STEP, _FINER = 0.01, 64
"""[m] between distances tried, and into how many parts the last step is cut to find the edge of the free ground."""
_YAW_COST = 0.5
"""Cost of a radian of the base's yaw, if a radian of the gripper's yaw relative to the base costs 1."""


@dataclass(frozen=True)
class FacingPlacer:
    """For every gripper pose the base poses that face it at given relative yaws, those that turn least first.

    The distance is `standoff`, or where the free ground begins behind that.

    Attributes:
        placer: the free ground of the scene.
        reach: [m] from the base at most.
        turns: [rad] yaws of the gripper relative to the base.
    """

    placer: MapPlacer
    reach: float
    turns: tuple[float, ...] = STRAIGHT

    @property
    def standoff(self) -> float:
        """[m] from the base's centre to the TCP, in whole centimetres."""
        return round(_STANDOFF * self.reach, 2)

    def bases(self, gripper_poses: Array, most: int = 0) -> tuple[Array, NDArray[np.int64]]:  # noqa: ARG002  always all
        """As `MapPlacer.bases`; those of all gripper poses in one order, the least cost first."""
        turns = np.array(self.turns)
        yaw = _wrapped(gripper_poses[:, 3:4] - turns)
        distance = np.full(yaw.shape, np.inf)
        is_level = gripper_poses[:, 4] == 0.0
        for rows, ground in ((is_level, self.placer.ground), (~is_level, self.placer.open_ground)):
            if rows.any():
                distance[rows] = self._distance(ground, gripper_poses[rows], yaw[rows])
        x = gripper_poses[:, :1] - distance * np.cos(yaw)
        y = gripper_poses[:, 1:2] - distance * np.sin(yaw)
        cost = np.round(_YAW_COST * np.abs(yaw) + np.abs(turns), 9)
        index, turn = np.nonzero(np.isfinite(distance))
        order = np.argsort(cost[index, turn], kind="stable")
        found = np.stack((x, y, yaw), axis=-1)[index, turn][order]
        return np.ascontiguousarray(found), index[order].astype(np.int64)

    def _distance(self, ground: FreeSpace, gripper_poses: Array, yaw: Array) -> Array:
        """[m] behind gripper poses (k, 5) along yaws (k, t) where the base may stand: (k, t), infinite for none."""
        steps = np.tile(np.arange(self.standoff, self.reach, _STEP), (*yaw.shape, 1))
        x, y = gripper_poses[:, 0, None, None], gripper_poses[:, 1, None, None]
        cosine, sine = np.cos(yaw)[..., None], np.sin(yaw)[..., None]
        is_any = np.ones(yaw.shape, np.bool_)
        for _ in range(2):
            free = ground.are_free(x - steps * cosine, y - steps * sine)
            is_any &= free.any(axis=-1)
            first = np.take_along_axis(steps, free.argmax(axis=-1)[..., None], axis=-1)
            steps = np.maximum(first - _STEP * np.arange(_FINER)[::-1] / _FINER, self.standoff)
        return np.asarray(np.where(is_any, first[..., 0], np.inf))


def _wrapped(angles: Array) -> Array:
    """Angles [rad] in (-π, π]."""
    return math.pi - np.mod(math.pi - angles, 2 * math.pi)
