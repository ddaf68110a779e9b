"""How the held object comes to stand: the pitch of the gripper when it lets go, and the object afterwards."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from planners.placing.locations import stand_at
from planners.scene import Body, HeldObject, Scene
from planners.scene.bodies import UPRIGHT_TILT

__all__ = ["put_down", "release_pitch", "rotated"]

Array = NDArray[np.float64]

_DIGITS = 3
"""Pitches are rounded to so many decimals [rad]: what remains is closed by the gap under the object."""


def release_pitch(body: Body, held: HeldObject) -> float:
    """Pitch [rad] of the gripper at which a held object rests on a level plane: standing if it can be, else lying.

    It is the pitch of the grasp if the object stood when it was taken and has not slipped. Level where no pitch between
    level and straight down lets the object rest.
    """
    pitches = (round(math.atan2(-up[0], up[2]), _DIGITS) + 0.0 for up in _resting_axes(body, held.T_tcp_object[:3, :3]))
    return next((pitch for pitch in pitches if -UPRIGHT_TILT <= pitch <= math.pi / 2 + UPRIGHT_TILT), 0.0)


def put_down(scene: Scene, gripper_pose: Array, level: float) -> Body:
    """The held object as it rests, on a support `level` [m] high, after it is released at a gripper pose (5,)."""
    assert scene.held is not None
    body = scene.body(scene.held.name)
    T_world_tcp = rotated(gripper_pose[3], gripper_pose[4])
    T_world_tcp[:3, 3] = gripper_pose[:3]
    dropped = body.at_pose(T_world_tcp @ scene.held.T_tcp_object)
    return stand_at(_settled(dropped), np.array([*dropped.position[:2], level]))


def _resting_axes(body: Body, rotation: Array) -> Iterator[Array]:
    """Directions (3,) in the TCP frame that may point up when the object rests, its own z axis before the others.

    Args:
        body: the object.
        rotation: R_tcp_object (3, 3).
    """
    axes = [rotation[:, 2], -rotation[:, 2]]
    if body.shape == "cylinder":
        lying = np.array((-rotation[2, 2], 0.0, rotation[0, 2]))
        axes += [lying, -lying]
    else:
        axes += [rotation[:, 0], -rotation[:, 0], rotation[:, 1], -rotation[:, 1]]
    for axis in axes:
        if abs(axis[1]) < math.sin(UPRIGHT_TILT) and math.hypot(axis[0], axis[2]) > math.sin(UPRIGHT_TILT):
            yield axis


def _settled(body: Body) -> Body:
    """The object turned by the smallest angle such that it rests."""
    if body.is_upright:
        return replace(body, quaternion=np.array([np.cos(body.yaw / 2), 0.0, 0.0, np.sin(body.yaw / 2)]))
    up = _up_axis(body)
    T = body.pose
    T[:3, :3] = _turn_between(up, np.array((0.0, 0.0, 1.0))) @ T[:3, :3]
    return body.at_pose(T)


def _up_axis(body: Body) -> Array:
    """The direction (3,) in the world, fixed to the object, that points up once it rests."""
    z_axis, up = body.rotation[:, 2], np.array((0.0, 0.0, 1.0))
    if body.shape == "cylinder" and abs(z_axis[2]) < math.sqrt(0.5):
        level = up - z_axis[2] * z_axis
        return np.asarray(level / np.linalg.norm(level))
    axis = 2 if body.shape == "cylinder" else int(np.abs(body.rotation[2]).argmax())
    return np.asarray(body.rotation[:, axis] * np.sign(body.rotation[2, axis]))


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
