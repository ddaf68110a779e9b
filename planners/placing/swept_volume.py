"""Volume(robot, τ) of eq. 1 and 2: shapes that cover the robot in some of its configurations."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from planners.collision.geometry import Solids
from planners.collision.robot_model import BASE
from planners.collision.robot_pose_kernel import make_scratch, place_robot
from planners.collision.world import CollisionWorld
from planners.grasping.candidates import GraspCandidate
from planners.placing.negative_goal_region import SweptVolume, join_volumes

__all__ = ["configuration_volume", "grasp_volume"]

Array = NDArray[np.float64]

_SPACING = 0.02
"""[m] between spheres along a capsule; each is grown so that together they cover it."""


def grasp_volume(world: CollisionWorld, grasps: Iterable[GraspCandidate]) -> SweptVolume:
    """What the robot occupies at these grasps, the gripper open.

    The arm comes from above and leaves upwards, so that it is never lower at the same place.
    """
    return join_volumes(configuration_volume(world, grasp.base, grasp.q, grasp.opening) for grasp in grasps)


def configuration_volume(world: CollisionWorld, base: Array, q: Array, opening: float) -> SweptVolume:
    """Shapes that cover torso and arm at one configuration, grown by the padding of the collision world."""
    robot = world.robot
    nothing = world.attached(None)
    scratch = make_scratch(robot, nothing)
    place_robot(robot, nothing, scratch, np.array(base), np.array(q), opening)
    spheres: list[Array] = []
    boxes: list[int] = []
    for i in range(len(robot.core)):
        if robot.link[i] == BASE:
            continue
        if robot.radius[i] > 0:
            spheres.append(_along_capsule(scratch.solids, i, float(robot.radius[i]) + world.padding))
        else:
            boxes.append(i)
    rotation, position = np.array(scratch.solids.rotation), np.array(scratch.solids.position)
    return SweptVolume(
        spheres=np.concatenate(spheres) if spheres else np.zeros((0, 4)),
        box_centres=position[boxes],
        box_axes=rotation[boxes],
        box_half_extents=robot.half[boxes] + world.padding,
    )


def _along_capsule(solids: Solids, i: int, radius: float) -> Array:
    """Spheres (k, 4) that cover a capsule along its z axis."""
    half = float(solids.half[i, 2])
    count = 1 + int(np.ceil(2 * half / _SPACING))
    along = np.linspace(-half, half, count)
    centres = solids.position[i] + along[:, None] * solids.rotation[i][:, 2]
    grown = np.hypot(radius, half / max(count - 1, 1))
    return np.column_stack((centres, np.full(count, grown)))
