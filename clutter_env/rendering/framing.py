"""Views of a scene, or of its table alone, as large as the picture allows."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import product

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from clutter_env.scene.layout import TABLE_HEIGHT, Layout, top_of

FRAMED_CAMERA = "scene"
"""Name of the view of the whole scene. All other cameras are in the model and stay in place."""
_ACROSS = (65.0, -29.0)
"""[deg] Azimuth and elevation: across the table from the robot's right, where arm and head hide the gripper only
briefly."""
_INTO_SHELF = (30.0, -50.0)
"""[deg] The same from farther in front and above, past the side of a shelf and through its transparent boards."""
_INTO_CUPBOARD = (38.0, -24.0)
"""[deg] The same from in front of a cupboard, past its open door, which has its hinges on the left."""
ABOVE = (0.0, -90.0)
"""[deg] Azimuth and elevation: straight down, with the robot below the table in the picture."""
_BASE_RADIUS, _BODY_RADIUS = 0.35, 0.2
"""[m] Radii around the base centre: on the ground, and above it."""
_START_HEIGHT, _WORK_HEIGHT = 1.25, 1.45
"""[m] Height of the robot with the lift at the start, and with the lift up."""
_KNEE, _WAIST = 0.35, 0.75
"""[m] Heights above the ground. Below the first a robot at work need not be in view, in a nearer view below the
second."""
_REACH = 0.55
"""[m] from the front of the table to the base centre of a robot at work."""
_INWARDS = 0.6
"""Share of the distance to the table's sides that the robot drives sideways. Its arm reaches farther."""
_OBJECT_HEIGHT = 0.30
"""[m] Height of the space above the table for objects, including a lifted object."""
_NEAR = 0.75
"""[m] Distance to a gripper in a near view."""
_MARGIN = 1.06
"""Distance of the camera relative to the distance at which the scene fills the picture."""

Points = NDArray[np.float64]


def across(layout: Layout) -> tuple[float, float]:
    """Azimuth and elevation [deg] that show most of a layout's objects with the robot beside them."""
    if layout.board_height is None:
        return _ACROSS
    if layout.opens is None:
        return _INTO_SHELF
    turn, tilt = _INTO_CUPBOARD
    return (turn if layout.opens == "door_left" else -turn), tilt


def whole_scene(
    model: mujoco.MjModel, layout: Layout, start: ArrayLike, direction: tuple[float, float], aspect: float
) -> mujoco.MjvCamera:
    """A free camera that has the table and the robot in view, from its start to the last grasp.

    Args:
        model: gives the field of view of free cameras.
        layout: table and the furniture beside it.
        start: x, y [m] of the base centre at the start. Further numbers are ignored.
        direction: azimuth and elevation [deg] in which the camera looks.
        aspect: width over height of the picture.
    """
    x, y = np.asarray(start, dtype=float)[:2]
    robot = [*_ring(x, y, _BASE_RADIUS, 0.0), *_ring(x, y, _BODY_RADIUS, _START_HEIGHT)]
    return view_of(model, np.array([*_at_work(layout, _KNEE), *robot]), direction, aspect)


def work_place(
    model: mujoco.MjModel, layout: Layout, direction: tuple[float, float], aspect: float
) -> mujoco.MjvCamera:
    """A nearer view: the table and the upper part of the robot at work there. Arguments as in `whole_scene`."""
    return view_of(model, np.array(_at_work(layout, _WAIST)), direction, aspect)


def _at_work(layout: Layout, lowest: float) -> list[Sequence[float]]:
    """Points [m] on the table, and of a robot in front of it and of its trays, above that height."""
    table = table_points(layout)
    points: list[Sequence[float]] = list(table)
    for side in (table[:, 1].min(), table[:, 1].max()):
        y = np.clip(side, -layout.width, layout.width) * _INWARDS
        for height in (lowest, _WORK_HEIGHT):
            points += _ring(-layout.depth / 2 - _REACH, y, _BODY_RADIUS, height)
    return points


def _ring(x: float, y: float, radius: float, z: float) -> list[Sequence[float]]:
    turns = np.arange(8) * (math.pi / 4)
    return [(x + radius * math.cos(turn), y + radius * math.sin(turn), z) for turn in turns]


def near_view(direction: tuple[float, float]) -> mujoco.MjvCamera:
    """A free camera near the point that the caller sets as its `lookat`."""
    camera = mujoco.MjvCamera()
    camera.type, camera.distance = mujoco.mjtCamera.mjCAMERA_FREE, _NEAR
    camera.azimuth, camera.elevation = direction
    return camera


def pixels_of(
    model: mujoco.MjModel, camera: mujoco.MjvCamera, points: ArrayLike, size: tuple[int, int]
) -> NDArray[np.float64]:
    """Places (n, 2) of world points (n, 3) [m] in a picture of a free camera: column and row [pixels].

    Args:
        model: gives the field of view of free cameras.
        camera: that the picture was made with.
        points: before the camera.
        size: width and height [pixels] of the picture.
    """
    width, height = size
    forward, right, up = _axes((camera.azimuth, camera.elevation)) @ (np.asarray(points, dtype=float) - camera.lookat).T
    scale = height / 2 / math.tan(math.radians(model.vis.global_.fovy) / 2) / (forward + camera.distance)
    return np.column_stack((width / 2 + scale * right, height / 2 - scale * up))


def view_of(model: mujoco.MjModel, points: Points, direction: tuple[float, float], aspect: float) -> mujoco.MjvCamera:
    """The nearest free camera that has all points (n, 3) [m] in view."""
    camera = mujoco.MjvCamera()
    camera.type = mujoco.mjtCamera.mjCAMERA_FREE
    camera.azimuth, camera.elevation = direction
    axes = _axes(direction)
    forward, sideways, upwards = axes @ points.T
    middle = (forward.min() + forward.max()) / 2
    up = math.tan(math.radians(model.vis.global_.fovy) / 2)
    right, far = _centred(sideways, forward - middle, up * aspect)
    high, deep = _centred(upwards, forward - middle, up)
    camera.lookat[:] = np.array((middle, right, high)) @ axes
    camera.distance = _MARGIN * max(far, deep)
    return camera


def _axes(direction: tuple[float, float]) -> Points:
    """Unit vectors (3, 3) forward, right and up of a camera with this azimuth and elevation [deg]."""
    turn, tilt = map(math.radians, direction)
    ahead = (math.cos(tilt) * math.cos(turn), math.cos(tilt) * math.sin(turn), math.sin(tilt))
    right_hand = (math.sin(turn), -math.cos(turn), 0.0)
    return np.array((ahead, right_hand, np.cross(right_hand, ahead)))


def _centred(across: Points, forward: Points, slope: float) -> tuple[float, float]:
    """Least distance at which points fit between two lines of sight, and the middle of the picture at this distance.

    A point fits if |across - middle| <= slope (forward + distance).
    """
    highest, lowest = float((across - slope * forward).max()), float((across + slope * forward).min())
    return (highest + lowest) / 2, (highest - lowest) / (2 * slope)


def table_points(layout: Layout, around: float = 0.0) -> Points:
    """Corners (n, 3) [m] of the table and the layout's own supports, with the objects on them and a margin around
    them."""
    half_x, half_y = layout.depth / 2 + around, layout.width / 2 + around
    top = TABLE_HEIGHT + max(layout.levels) + _OBJECT_HEIGHT
    corners = list(product((-half_x, half_x), (-half_y, half_y), (TABLE_HEIGHT, top)))
    for box in layout.boxes:
        if box.name in (layout.supports or ()):
            (x, y, _), (box_x, box_y, _), level = box.position, box.half_extents, top_of(box)
            corners += product((x - box_x, x + box_x), (y - box_y, y + box_y), (level, level + _OBJECT_HEIGHT))
    return np.array(corners)
