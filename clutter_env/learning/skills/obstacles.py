"""What is in the way of every grasp in a scene: from this, all labels of skills follow."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planners import DIRECTIONS, SIDE, Scene, SkillGeometry, generate_grasps

__all__ = ["YAWS", "YAWS_OF_DIRECTION", "GraspObstacles", "grasp_obstacles"]

YAWS = SIDE.directions
"""Yaws of grasps that are told apart, evenly about the vertical: the planner's side grasps of round objects."""
_STEP = YAWS // DIRECTIONS
YAWS_OF_DIRECTION = (np.arange(DIRECTIONS)[:, None] * _STEP + np.arange(-(_STEP // 2), _STEP // 2 + 1)) % YAWS
"""(directions, y) The yaws that belong to each direction of the skills; those on a border belong to both sides."""


@dataclass(frozen=True, eq=False)
class GraspObstacles:
    """The grasps of all n objects of a scene.

    Attributes:
        is_reachable: (n, YAWS) whether there is a grasp at that yaw, whatever stands in its way.
        masks: (n, YAWS) objects in the way of the grasp with the fewest, bit j for object j; 0 where there is no grasp.
    """

    is_reachable: NDArray[np.bool_]
    masks: NDArray[np.int64]


def grasp_obstacles(geometry: SkillGeometry, scene: Scene) -> GraspObstacles:
    """The grasps of a scene in which nothing is held; yaws of boxes count as the nearest ones of round objects."""
    is_reachable = np.zeros((len(scene.objects), YAWS), dtype=np.bool_)
    masks = np.zeros(is_reachable.shape, dtype=np.int64)
    for i, body in enumerate(scene.objects):
        for pose in generate_grasps(body, scene.robot):
            yaw = round(pose.yaw / (2 * math.pi / YAWS)) % YAWS
            found = [grasp.blockers for grasp in geometry.candidates(scene, body, [pose])]
            if is_reachable[i, yaw]:
                found.append(int(masks[i, yaw]))
            if found:
                is_reachable[i, yaw], masks[i, yaw] = True, min(found, key=int.bit_count)
    return GraspObstacles(is_reachable, masks)
