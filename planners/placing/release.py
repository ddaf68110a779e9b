"""How the held object comes to stand: the gripper when it lets go, and the object afterwards."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from planners.placing.locations import stand_at
from planners.scene import Body, Scene
from planners.scene.bodies import up_axis

__all__ = ["put_down", "rotated"]

Array = NDArray[np.float64]


def put_down(scene: Scene, gripper_pose: Array, level: float) -> Body:
    """The held object as it rests, on a support `level` [m] high, after it is released at a gripper pose (5,)."""
    assert scene.held is not None
    body = scene.body(scene.held.name)
    T_world_tcp = rotated(gripper_pose[3], gripper_pose[4])
    T_world_tcp[:3, 3] = gripper_pose[:3]
    dropped = body.at_pose(T_world_tcp @ scene.held.T_tcp_object)
    return stand_at(_settled(dropped), np.array([*dropped.position[:2], level]))


def _settled(body: Body) -> Body:
    """The object turned by the smallest angle such that it rests."""
    if body.is_upright:
        return replace(body, quaternion=np.array([np.cos(body.yaw / 2), 0.0, 0.0, np.sin(body.yaw / 2)]))
    up = up_axis(body)
    T = body.pose
    T[:3, :3] = _turn_between(up, np.array((0.0, 0.0, 1.0))) @ T[:3, :3]
    return body.at_pose(T)


def _turn_between(one: Array, other: Array) -> Array:
    """The smallest rotation (3, 3) that takes a unit vector to another one, not its opposite."""
    cross = np.cross(one, other)
    K = np.array([[0.0, -cross[2], cross[1]], [cross[2], 0.0, -cross[0]], [-cross[1], cross[0], 0.0]])
    return np.asarray(np.eye(3) + K + K @ K / (1.0 + one @ other))


def rotated(yaw: float, pitch: float) -> Array:
    """The transform (4, 4) of a gripper at the origin with this yaw and pitch [rad]: Rz(yaw) Ry(pitch)."""
    cy, sy, cp, sp = np.cos(yaw), np.sin(yaw), np.cos(pitch), np.sin(pitch)
    T = np.eye(4)
    T[:3, :3] = [[cy * cp, -sy, cy * sp], [sy * cp, cy, sy * sp], [-sp, 0.0, cp]]
    return T
