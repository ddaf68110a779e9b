"""Poses and projections of the robot's cameras: from pixels to points in the base frame and back.

A camera's frame is that of OpenCV and ROS: x to the right of the image, y down, z ahead. The centre of the first pixel,
at the upper left, is (0, 0).
"""

from __future__ import annotations

import math

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from clutter_env.simulation.world import World

_FROM_MUJOCO = np.diag((1.0, -1.0, -1.0))
"""MuJoCo's cameras look along -z, with y up."""


def camera_matrix(model: mujoco.MjModel, camera: str, width: int, height: int) -> NDArray[np.float64]:
    """Camera matrix K (3, 3). A point (x, y, z) [m] in the camera's frame has the pixel (u, v) with z (u, v, 1) = K (x,
    y, z)."""
    focal_length = height / 2 / math.tan(math.radians(model.cam_fovy[model.camera(camera).id]) / 2)
    middle = (width - 1) / 2, (height - 1) / 2
    return np.array(((focal_length, 0.0, middle[0]), (0.0, focal_length, middle[1]), (0.0, 0.0, 1.0)))


def camera_pose(world: World, camera: str) -> NDArray[np.float64]:
    """Camera pose T_base_camera (4, 4) in the present state. The base frame is on the ground, x ahead, z up."""
    model, data = world.model, world.data
    number, base = model.camera(camera).id, world.index.base_body
    body, turn = model.cam_bodyid[number], np.empty(9)
    mujoco.mju_quat2Mat(turn, model.cam_quat[number])
    R_world_body, R_world_base = data.xmat[body].reshape(3, 3), data.xmat[base].reshape(3, 3)
    pose = np.eye(4)
    pose[:3, :3] = R_world_base.T @ R_world_body @ turn.reshape(3, 3) @ _FROM_MUJOCO
    eye = data.xpos[body] + R_world_body @ model.cam_pos[number]
    pose[:3, 3] = R_world_base.T @ (eye - data.xpos[base] * (1.0, 1.0, 0.0))
    return pose


def back_project(
    pixels: ArrayLike, depth: ArrayLike, K: NDArray[np.float64], T_base_camera: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Points (n, 3) [m] in the base frame at pixels (n, 2), column u and row v, with depths (n,) [m]."""
    u, v = np.asarray(pixels, float).T
    rays = np.column_stack(((u - K[0, 2]) / K[0, 0], (v - K[1, 2]) / K[1, 1], np.ones(len(u))))
    return np.asarray(rays * np.asarray(depth)[:, None] @ T_base_camera[:3, :3].T + T_base_camera[:3, 3])


def heights(
    depth: NDArray[np.float32], K: NDArray[np.float64], T_base_camera: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Heights [m] above the ground of the points at the pixels of a depth image (height, width)."""
    rows, columns = (np.arange(size) for size in depth.shape)
    slope = (columns - K[0, 2]) / K[0, 0] * T_base_camera[2, 0] + T_base_camera[2, 2]
    slope = slope + ((rows - K[1, 2]) / K[1, 1] * T_base_camera[2, 1])[:, None]
    return np.asarray(slope * depth + T_base_camera[2, 3])
