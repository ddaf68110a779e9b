"""Base poses for hand poses, from the inverse reachability map and the free floor of a scene."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from irm.floor.free_space import FreeSpace
from irm.queries.inverse import InverseReachabilityMap
from planners.scene import Scene

__all__ = ["MapPlacer", "free_floor"]

Array = NDArray[np.float64]

FLOOR_MARGIN = 0.02
"""[m] that the base keeps from furniture."""
FLOOR_SIZE = 2.5
"""[m] from the table's centre to the edges of the floor that is used."""


def free_floor(scene: Scene) -> FreeSpace:
    """The floor around the furniture, grown by the base's footprint."""
    boxes = [(*box.position[:2], *(2 * box.half_extents[:2])) for box in scene.furniture]
    bounds = (-FLOOR_SIZE, -FLOOR_SIZE, FLOOR_SIZE, FLOOR_SIZE)
    return FreeSpace.from_boxes(boxes, scene.robot.base_radius + FLOOR_MARGIN, bounds)


@dataclass(frozen=True)
class MapPlacer:
    """Base poses from an inverse reachability map.

    Attributes:
        map: of the robot.
        floor: where the base may stand.
        per_gripper_pose: base poses offered for each hand pose.
        yaw_tolerance: [rad] by which the map's approach may differ from the hand's: half a step of its yaws.
    """

    map: InverseReachabilityMap
    floor: FreeSpace
    per_gripper_pose: int = 3
    yaw_tolerance: float = 1e-6

    def bases(self, gripper_poses: Array) -> tuple[Array, NDArray[np.int64]]:
        """Base poses (m, 3) that reach level hands (k, 4), x, y, z [m], yaw [rad]; index of the hand of each (m,)."""
        yaws = gripper_poses[:, 3]
        ranges = np.column_stack((yaws - self.yaw_tolerance, yaws + self.yaw_tolerance))
        found = self.map.query_batch(
            gripper_poses[:, :3], yaw_ranges=ranges, free_space=self.floor, k=self.per_gripper_pose
        )
        index = np.repeat(np.arange(len(gripper_poses)), found.count)
        rank = np.concatenate([np.arange(count) for count in found.count]) if len(gripper_poses) else index
        return np.ascontiguousarray(found.poses[index, rank.astype(np.int64)]), index
