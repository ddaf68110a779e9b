"""What the network points at: an object from one of several directions, or a cell of the table."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from clutter_env.envs.observation import OBSERVATION_LAYOUT
from clutter_env.policies.parsed_observation import ParsedObservation, planar_pose, wrapped
from clutter_env.scene.layout import TABLE_HEIGHT, Layout

Array = NDArray[np.float64]
Rows = NDArray[np.float32]

_DIRECTIONS = 24
"""Yaws of the gripper, evenly about the vertical, as in a canonical plan."""
_TURNS = tuple(math.radians(degrees) for degrees in (0, -20, 20, -40, 40, -60, 60))
"""[rad] of the gripper's yaw against the base's."""
_WIDEST_YAW = math.radians(79.0)
"""[rad] of the base at most: the table has access from its front alone."""
_SPACING, _MARGIN = 0.05, 0.045
"""[m] between cells of the table, and from the outermost ones to its edge at least, as in a canonical plan."""
_UPRIGHT = 0.95
"""Cosine of an object's tilt from which on it stands."""
_OFF_TABLE = 0.02
"""[m] An object whose lowest point is this far below the table top does not stand on it."""
_ROW = OBSERVATION_LAYOUT["objects"]
OBJECT_COLUMNS = ("x", "y", "bottom", "radius", "height")
"""Network input of an object: position, height of its lowest point, radius and height, all [m], in the world."""


def _grasp_directions() -> Array:
    yaws = wrapped(np.arange(_DIRECTIONS) * (2 * math.pi / _DIRECTIONS))
    every = np.array([(yaw, yaw - turn) for yaw in yaws for turn in _TURNS])
    return every[np.abs(every[:, 1]) < _WIDEST_YAW]


DIRECTIONS = _grasp_directions()
"""(c, 2) yaw of the gripper and of the base [rad] in the world, for a grasp."""


def nearest_direction(yaw: float, base_yaw: float) -> tuple[int, float]:
    """Index of the direction nearest to yaws of gripper and base [rad], and how far [rad] it is off."""
    away = np.abs(wrapped(DIRECTIONS - (yaw, base_yaw))).max(axis=1)
    return int(away.argmin()), float(away.min())


def table_cells(layout: Layout) -> Array:
    """Centres (k, 2) [m] of the cells of the table, x before y, where objects are put down."""
    half = np.array((layout.depth, layout.width)) / 2 - _MARGIN
    x, y = (_SPACING * np.arange(-(one // _SPACING), one // _SPACING + 1) for one in half)
    return np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)


class ObservedObjects(NamedTuple):
    """The objects of an observation, in the order of its rows.

    Attributes:
        rows: (n, 5) `OBJECT_COLUMNS`; a fallen one is the upright cylinder around it.
        is_there: (n,) whether each is present, on the table, and not held.
        can_be_taken: (n,) whether it also stands upright.
        target: index of the target.
        held: index of the held object, -1 without one.
    """

    rows: Rows
    is_there: NDArray[np.bool_]
    can_be_taken: NDArray[np.bool_]
    target: int
    held: int


def observed_objects(seen: ParsedObservation) -> ObservedObjects:
    """The objects of one observation."""
    rows, T = seen.objects, planar_pose(seen.base)
    position = rows[:, _ROW["position"]] @ T[:3, :3].T + T[:3, 3]
    w, x, y, z = rows[:, _ROW["quaternion"]].T
    up = np.abs(w * w - x * x - y * y + z * z)
    radius, half_height = rows[:, _ROW["half_extents"]][:, :2].max(axis=1), rows[:, _ROW["half_extents"]][:, 2]
    stands = up > _UPRIGHT
    radius, half_height = np.where(stands, radius, half_height), np.where(stands, half_height, radius)
    bottom = position[:, 2] - half_height
    held = np.flatnonzero(rows[:, _ROW.index("held")] > 0)
    is_there = (rows[:, _ROW.index("present")] > 0) & (bottom > TABLE_HEIGHT - _OFF_TABLE)
    is_there[held] = False
    columns = np.column_stack((position[:, :2], bottom, radius, 2 * half_height))
    return ObservedObjects(
        rows=columns.astype(np.float32),
        is_there=is_there,
        can_be_taken=is_there & stands,
        target=int(rows[:, _ROW.index("is_target")].argmax()),
        held=int(held[0]) if len(held) else -1,
    )
