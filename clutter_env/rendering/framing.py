"""Views of a scene, or of its table alone, as large as the picture allows."""

from __future__ import annotations

import math
from itertools import product

import mujoco
import numpy as np
from numpy.typing import NDArray

from clutter_env.scene.layout import TABLE_HEIGHT, Layout, top_of

FRAMED_CAMERA = "scene"
"""Name of the view of the whole scene; all other cameras are in the model and stay where they are."""
_ACROSS = (72.0, -32.0)
"""[deg] azimuth and elevation: across the table from the robot's right; neither the arm nor the head hides the gripper
for long."""
_INTO_SHELF = (30.0, -50.0)
"""[deg] The same from farther in front and above, past the side of a shelf and through its transparent boards."""
ABOVE = (0.0, -90.0)
"""[deg] azimuth and elevation: straight down, the robot below the table."""
_ROBOT_RADIUS = 0.40
"""[m] around the base centre: the base, and the elbow when the arm is folded."""
_ROBOT_HEIGHT = 1.45
"""[m] with the lift up."""
_KNEE = 0.35
"""[m] above the floor: what is lower of a robot at work need not be seen."""
_OBJECT_HEIGHT = 0.30
"""[m] above the table: objects, and one that is lifted."""
_MARGIN = 1.06
"""Distance of the camera over that from which the scene fills the picture."""

Points = NDArray[np.float64]


def across(layout: Layout) -> tuple[float, float]:
    """Azimuth and elevation [deg] from which most of a layout's objects are seen, and the robot beside them."""
    return _ACROSS if layout.board_height is None else _INTO_SHELF


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
    (low_x, low_y), (high_x, high_y) = layout.start_region
    around = low_y - _ROBOT_RADIUS, high_y + _ROBOT_RADIUS
    robot = product((low_x - _ROBOT_RADIUS, high_x + _ROBOT_RADIUS), around, (0.0, _ROBOT_HEIGHT))
    return view_of(model, np.vstack((table_points(layout), list(robot))), direction, aspect)


def work_place(
    model: mujoco.MjModel, layout: Layout, direction: tuple[float, float], aspect: float
) -> mujoco.MjvCamera:
    """A nearer view: the table and the upper part of the robot while it works there; arguments as of `whole_scene`."""
    (_, (start_x, _)), half_y = layout.start_region, layout.width / 2
    before = product((start_x - _ROBOT_RADIUS, -layout.depth / 2), (-half_y, half_y), (_KNEE, _ROBOT_HEIGHT))
    return view_of(model, np.vstack((table_points(layout), list(before))), direction, aspect)


def view_of(model: mujoco.MjModel, points: Points, direction: tuple[float, float], aspect: float) -> mujoco.MjvCamera:
    """The nearest free camera that has all points (n, 3) [m] in view."""
    camera = mujoco.MjvCamera()
    camera.type = mujoco.mjtCamera.mjCAMERA_FREE
    camera.azimuth, camera.elevation = direction
    turn, tilt = map(math.radians, direction)
    ahead = (math.cos(tilt) * math.cos(turn), math.cos(tilt) * math.sin(turn), math.sin(tilt))
    right_hand = (math.sin(turn), -math.cos(turn), 0.0)
    axes = np.array((ahead, right_hand, np.cross(right_hand, ahead)))  # forward, right and up of the camera
    forward, sideways, upwards = axes @ points.T
    middle = (forward.min() + forward.max()) / 2
    up = math.tan(math.radians(model.vis.global_.fovy) / 2)
    right, far = _centred(sideways, forward - middle, up * aspect)
    high, deep = _centred(upwards, forward - middle, up)
    camera.lookat[:] = np.array((middle, right, high)) @ axes
    camera.distance = _MARGIN * max(far, deep)
    return camera


def _centred(across: Points, forward: Points, slope: float) -> tuple[float, float]:
    """The least distance at which points fit between two lines of sight, and where the middle of the picture is then.

    A point fits if |across - middle| <= slope (forward + distance).
    """
    highest, lowest = float((across - slope * forward).max()), float((across + slope * forward).min())
    return (highest + lowest) / 2, (highest - lowest) / (2 * slope)


def table_points(layout: Layout, around: float = 0.0) -> Points:
    """Corners (n, 3) [m] of the table and the layout's own supports with what stands on them, and so far around it."""
    half_x, half_y = layout.depth / 2 + around, layout.width / 2 + around
    top = TABLE_HEIGHT + max(layout.levels) + _OBJECT_HEIGHT
    corners = list(product((-half_x, half_x), (-half_y, half_y), (TABLE_HEIGHT, top)))
    for box in layout.boxes:
        if box.name in (layout.supports or ()):
            (x, y, _), (box_x, box_y, _), level = box.position, box.half_extents, top_of(box)
            corners += product((x - box_x, x + box_x), (y - box_y, y + box_y), (level, level + _OBJECT_HEIGHT))
    return np.array(corners)
