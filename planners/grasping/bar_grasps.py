"""Grasps of a bar that lies level before what it opens: the fingers close on it from above and below.

Gripper poses have a yaw and a pitch, and close along a level line. For a bar like the handles of most drawers the hand
is turned by 90° about its approach direction. Where the arm's last joint turns about that direction, these are the
configurations for the pose that is not turned, with the last joint turned.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cache, lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from assets.robots import RobotSpec
from irm.chain import ArmChain
from irm.kernel_arguments import packed
from irm.kinematics import link_frames
from planners.collision.scene_arrays import RobotArrays
from planners.collision.world import CollisionWorld
from planners.grasping.arm_configurations import ArmConfigurations, GripperPoses, gripper_rotation
from planners.grasping.grasp_poses import GraspPose
from planners.scene import Body, Scene
from planners.scene.bodies import pose_matrix
from planners.scene.masks import FIXED_BITS

Array = NDArray[np.float64]

_PITCHES = tuple(math.radians(degrees) for degrees in (0, 10, 20, 40))
"""[rad] of the approach below the level."""
_TURNS = tuple(math.radians(degrees) for degrees in (0, -25, 25, -50, 50))
"""[rad] of the approach, seen from above, away from straight against the pull."""
_ALONG = (0.0, -0.5, 0.5)
"""Where the fingers take the bar, in half its length from its middle."""
_SAME_AXIS = 1e-3
"""Of the cross product of the last joint's axis and the approach direction, and [m] of their distance: rounding."""


@dataclass(frozen=True)
class BarFamily:
    """Grasps of a handle with the hand turned by 90° about its approach: the fingers close along an upright plane."""

    name: str = "across a level bar"


def bar_grasps(scene: Scene, body: Body, robot: RobotSpec) -> tuple[GraspPose, ...]:
    """The poses of the hand, not turned yet, from which the fingers, turned, close on a bar from above and below."""
    assert scene.pull is not None
    direction = scene.opening(scene.pull.opening).direction(body.position)
    if not turns_last(robot) or math.hypot(direction[0], direction[1]) < 0.5:
        return ()
    longest = int(np.argmax(body.half_extents))
    along = body.rotation[:, longest] * body.half_extents[longest]
    found = []
    for pitch in _PITCHES:
        for turn in _TURNS:
            yaw = math.atan2(-direction[1], -direction[0]) + turn
            R = gripper_rotation(yaw, pitch)
            for share in _ALONG:
                T = pose_matrix(body.position + share * along, R)
                across = pose_matrix(T[:3, 3], R @ _QUARTER)
                width = body.width_in_gripper(np.linalg.inv(across) @ body.pose)
                opening = min(width + 2 * robot.finger_gap, robot.max_opening)
                if width + robot.finger_gap <= robot.max_opening:
                    found.append(GraspPose(math.remainder(yaw, 2 * math.pi), pitch, T, opening))
    return tuple(found)


_QUARTER = np.array([(1.0, 0.0, 0.0), (0.0, 0.0, -1.0), (0.0, 1.0, 0.0)])
"""A quarter turn about the approach direction."""


@cache
def turns_last(robot: RobotSpec) -> bool:
    """Whether the last joint turns the hand about its approach direction."""
    chain = ArmChain.from_robot(robot)
    R, p = link_frames(chain, np.array(robot.home))
    axis, approach, away = R[-2][:, chain.axes[-1] % 3], R[-1][:, 0], p[-1] - p[-2]
    is_hinge = chain.axes[-1] < 3
    is_along = np.linalg.norm(np.cross(axis, approach)) < _SAME_AXIS
    return bool(is_hinge and is_along and np.linalg.norm(np.cross(axis, away)) < _SAME_AXIS)


def with_hand_turned(world: CollisionWorld) -> CollisionWorld:
    """The world of a robot whose hand sits turned by 90° on its last joint: what is free for it is free for `turned`.

    Of a robot of which `turns_last` holds.
    """
    return replace(world, robot=_with_hand_turned(world.robot))


@lru_cache(maxsize=16)
def _with_hand_turned(arrays: RobotArrays) -> RobotArrays:
    """The robot with the solids of its last link turned about the axis of the last joint; packed."""
    last = len(arrays.axes) - 1
    rows = arrays.link == last
    R = Rotation.from_rotvec(math.pi / 2 * np.eye(3)[arrays.axes[last]]).as_matrix()
    position, rotation, slide = arrays.position.copy(), arrays.rotation.copy(), arrays.slide.copy()
    position[rows], rotation[rows], slide[rows] = position[rows] @ R.T, R @ rotation[rows], slide[rows] @ R.T
    return packed(arrays._replace(position=position, rotation=rotation, slide=slide))


def turned(
    world: CollisionWorld, poses: GripperPoses, found: ArmConfigurations, opening: float, ignore: int
) -> ArmConfigurations:
    """Configurations with the last joint turned by 90°, to the side where it may, and what they hit then."""
    lower, upper = world.robot.lower[-1], world.robot.upper[-1]
    rows, Q, hits = [], [], []
    for row, (q, pair) in enumerate(zip(found.q, found.pair, strict=True)):
        for turn in (math.pi / 2, -math.pi / 2):
            last = q[-1] + turn
            if not lower <= last <= upper:
                last = math.remainder(last, 2 * math.pi)
            if lower <= last <= upper:
                other = np.append(q[:-1], last)
                mask = world.hits(poses.bases[pair], other, opening, ignore=ignore)
                if not mask & FIXED_BITS:
                    rows.append(row)
                    Q.append(other)
                    hits.append(mask)
                    break
    index = np.array(rows, dtype=np.int64)
    q = np.array(Q).reshape(-1, found.q.shape[1])
    return ArmConfigurations(q, found.pair[index], np.array(hits, dtype=np.uint64), found.quality[index])
