"""A view of a whole scene: the table and the robot wherever it starts, as large as the picture allows."""

from __future__ import annotations

import math
from itertools import product

import mujoco
import numpy as np
from numpy.typing import NDArray

from clutter_env.scene.layout import TABLE_HEIGHT, Layout

__all__ = ["ABOVE", "ACROSS", "whole_scene"]

ACROSS = (72.0, -32.0)
"""[deg] azimuth and elevation: across the table from the robot's right; neither the arm nor the head hides the gripper
for long."""
ABOVE = (0.0, -90.0)
"""[deg] azimuth and elevation: straight down, the robot below the table."""
_ROBOT_RADIUS = 0.40
"""[m] around the base centre: the base, and the elbow when the arm is folded."""
_ROBOT_HEIGHT = 1.20
"""[m]"""
_OBJECT_HEIGHT = 0.30
"""[m] above the table: objects, and one that is lifted."""
_MARGIN = 1.04
"""Distance of the camera over that from which the scene fills the picture."""

Points = NDArray[np.float64]


def whole_scene(
    model: mujoco.MjModel, layout: Layout, direction: tuple[float, float], aspect: float
) -> mujoco.MjvCamera:
    """A free camera that has the table and the robot in view, from its start to the last grasp.

    Args:
        model: says how wide free cameras see.
        layout: table, and the region where the base starts.
        direction: azimuth and elevation [deg] in which the camera looks.
        aspect: width over height of the picture.
    """
    camera = mujoco.MjvCamera()
    camera.type = mujoco.mjtCamera.mjCAMERA_FREE
    camera.azimuth, camera.elevation = direction
    axes = _axes(*direction)
    along = _scene_points(layout) @ axes.T
    centre = (along.min(axis=0) + along.max(axis=0)) / 2
    camera.lookat[:] = centre @ axes
    up = math.tan(math.radians(model.vis.global_.fovy) / 2)
    forward, sideways, upwards = (along - centre).T
    needed = np.maximum(np.abs(sideways) / (up * aspect), np.abs(upwards) / up) - forward
    camera.distance = _MARGIN * float(needed.max())
    return camera


def _scene_points(layout: Layout) -> Points:
    """Corners (16, 3) [m] of the table with what stands on it, and of where the robot starts and works."""
    (low_x, low_y), (high_x, high_y) = layout.start_region
    half_x, half_y = layout.depth / 2, layout.width / 2
    top = TABLE_HEIGHT + max(layout.levels) + _OBJECT_HEIGHT
    table = product((-half_x, half_x), (-half_y, half_y), (TABLE_HEIGHT, top))
    around = low_y - _ROBOT_RADIUS, high_y + _ROBOT_RADIUS
    robot = product((low_x - _ROBOT_RADIUS, high_x + _ROBOT_RADIUS), around, (0.0, _ROBOT_HEIGHT))
    return np.array([*table, *robot])


def _axes(azimuth: float, elevation: float) -> Points:
    """Rows (3, 3): the directions forward, right and up of a camera."""
    turn, tilt = math.radians(azimuth), math.radians(elevation)
    forward = (math.cos(tilt) * math.cos(turn), math.cos(tilt) * math.sin(turn), math.sin(tilt))
    right = (math.sin(turn), -math.cos(turn), 0.0)
    return np.array((forward, right, np.cross(right, forward)))
