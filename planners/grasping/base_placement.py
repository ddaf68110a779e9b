"""Base poses for gripper poses, from the inverse reachability map and the free floor of a scene."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from assets.robots import RobotSpec
from irm.floor.free_space import FreeSpace
from irm.queries.inverse import InverseReachabilityMap
from planners.collision.robot_model import BASE, robot_arrays
from planners.scene import Scene

__all__ = ["MapPlacer", "free_floor"]

Array = NDArray[np.float64]

FLOOR_MARGIN = 0.02
"""[m] that the base keeps from static obstacles."""
FLOOR_SIZE = 2.5
"""[m] from the centre of the support to the edges of the floor that is used."""


def free_floor(scene: Scene) -> FreeSpace:
    """The floor around the support where the base may stand: clear of the outlines of static obstacles.

    Obstacles that are lower than the base, such as a slab that is the floor, and those above the robot do not count.

    Raises:
        SceneError: the scene has no support.
    """
    low, high = _trunk_heights(scene.robot)
    outlines = [one.outline for one in scene.static_obstacles if one.upper[2] > low and one.lower[2] < high]
    x, y = scene.support.position[:2]
    bounds = (x - FLOOR_SIZE, y - FLOOR_SIZE, x + FLOOR_SIZE, y + FLOOR_SIZE)
    return FreeSpace.from_polygons(outlines, scene.robot.base_radius + FLOOR_MARGIN, bounds)


@cache
def _trunk_heights(robot: RobotSpec) -> tuple[float, float]:
    """[m] below and above which neither the base nor the torso with the head reaches, at any height of the torso."""
    arrays = robot_arrays(robot)
    is_base, is_torso = arrays.link == BASE, arrays.link == 0
    raised = np.where(is_torso, arrays.offsets[0, 2] + arrays.upper[0], 0.0)
    top = (arrays.position[:, 2] + raised + arrays.bound)[is_base | is_torso].max()
    corners = np.abs(arrays.rotation[:, 2]) * arrays.half
    bottom = (arrays.position[:, 2] - corners.sum(axis=1) - arrays.radius)[is_base].min()
    return float(bottom), float(top)


@dataclass(frozen=True)
class MapPlacer:
    """Base poses from an inverse reachability map.

    Attributes:
        map: of the robot.
        floor: where the base may stand.
        per_gripper_pose: base poses returned for each gripper pose at most.
        yaw_tolerance: [rad] by which the yaw of the map's approach may differ from the gripper's.
    """

    map: InverseReachabilityMap
    floor: FreeSpace
    per_gripper_pose: int = 3
    yaw_tolerance: float = 1e-6

    def bases(self, gripper_poses: Array) -> tuple[Array, NDArray[np.int64]]:
        """As `BasePlacer.bases`."""
        bases, index = [np.empty((0, 3))], [np.empty(0, dtype=np.int64)]
        for pitch in np.unique(gripper_poses[:, 4]):
            rows = np.flatnonzero(gripper_poses[:, 4] == pitch)
            found = self._bases_at_pitch(gripper_poses[rows], float(pitch))
            bases.append(found[0])
            index.append(rows[found[1]])
        order = np.argsort(np.concatenate(index), kind="stable")
        return np.ascontiguousarray(np.concatenate(bases)[order]), np.concatenate(index)[order]

    def _bases_at_pitch(self, gripper_poses: Array, pitch: float) -> tuple[Array, NDArray[np.int64]]:
        """As `bases`, for gripper poses of one pitch [rad]: the map's ring nearest to it answers."""
        yaws = gripper_poses[:, 3]
        ranges = np.column_stack((yaws - self.yaw_tolerance, yaws + self.yaw_tolerance))
        found = self.map.query_batch(
            gripper_poses[:, :3], yaw_ranges=ranges, pitch=pitch, free_space=self.floor, k=self.per_gripper_pose
        )
        rank = np.concatenate([np.arange(count) for count in found.count])
        index = np.repeat(np.arange(len(gripper_poses)), found.count)
        return found.poses[index, rank], index
