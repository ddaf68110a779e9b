"""Views of a scene, or of its table alone, as large as the picture allows."""

from __future__ import annotations

import math
from itertools import product

import mujoco
import numpy as np
from numpy.typing import NDArray

from clutter_env.scene.layout import TABLE_HEIGHT, Layout

__all__ = ["ABOVE", "ACROSS", "FRAMED_CAMERA", "whole_scene", "whole_table"]

FRAMED_CAMERA = "scene"
"""Name of the view of the whole scene; all other cameras are in the model and stay where they are."""
ACROSS = (55.0, -34.0)
"""[deg] azimuth and elevation: across the table from the robot's right and in front of boards; neither the arm nor the
head hides the gripper for long."""
ABOVE = (0.0, -90.0)
"""[deg] azimuth and elevation: straight down, the robot below the table."""
_ROBOT_RADIUS = 0.40
"""[m] around the base centre: the base, and the elbow when the arm is folded."""
_ROBOT_HEIGHT = 1.20
"""[m]"""
_OBJECT_HEIGHT = 0.30
"""[m] above the table: objects, and one that is lifted."""
_AROUND_TABLE = 0.12
"""[m] around the table, so that a picture of it shows what it stands beside."""
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
    return _view(model, _scene_points(layout), direction, aspect)


def whole_table(
    model: mujoco.MjModel, layout: Layout, direction: tuple[float, float], aspect: float
) -> mujoco.MjvCamera:
    """A free camera that has the table and what stands on it in view; arguments as of `whole_scene`."""
    return _view(model, _table_points(layout, _AROUND_TABLE), direction, aspect)


def _view(model: mujoco.MjModel, points: Points, direction: tuple[float, float], aspect: float) -> mujoco.MjvCamera:
    """The nearest free camera that has all points (n, 3) [m] in view."""
    camera = mujoco.MjvCamera()
    camera.type = mujoco.mjtCamera.mjCAMERA_FREE
    camera.azimuth, camera.elevation = direction
    axes = _axes(*direction)
    along = points @ axes.T
    centre = (along.min(axis=0) + along.max(axis=0)) / 2
    camera.lookat[:] = centre @ axes
    up = math.tan(math.radians(model.vis.global_.fovy) / 2)
    forward, sideways, upwards = (along - centre).T
    needed = np.maximum(np.abs(sideways) / (up * aspect), np.abs(upwards) / up) - forward
    camera.distance = _MARGIN * float(needed.max())
    return camera


def _table_points(layout: Layout, around: float) -> Points:
    """Corners (8, 3) [m] of the table with what stands on it, and so far around it."""
    half_x, half_y = layout.depth / 2 + around, layout.width / 2 + around
    top = TABLE_HEIGHT + max(layout.levels) + _OBJECT_HEIGHT
    return np.array(list(product((-half_x, half_x), (-half_y, half_y), (TABLE_HEIGHT, top))))


def _scene_points(layout: Layout) -> Points:
    """Corners (16, 3) [m] of the table with what stands on it, and of where the robot starts and works."""
    (low_x, low_y), (high_x, high_y) = layout.start_region
    around = low_y - _ROBOT_RADIUS, high_y + _ROBOT_RADIUS
    robot = product((low_x - _ROBOT_RADIUS, high_x + _ROBOT_RADIUS), around, (0.0, _ROBOT_HEIGHT))
    return np.vstack((_table_points(layout, 0.0), list(robot)))


def _axes(azimuth: float, elevation: float) -> Points:
    """Rows (3, 3): the directions forward, right and up of a camera."""
    turn, tilt = math.radians(azimuth), math.radians(elevation)
    forward = (math.cos(tilt) * math.cos(turn), math.cos(tilt) * math.sin(turn), math.sin(tilt))
    right = (math.sin(turn), -math.cos(turn), 0.0)
    return np.array((forward, right, np.cross(right, forward)))
