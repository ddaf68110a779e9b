"""Locations on a support for an object (Lee & Kim 2019, Figs. 7 and 8), and the object's resting pose there."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from dataclasses import replace
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from planners.grasping.arm_configurations import gripper_rotation
from planners.scene import Body, HeldObject, Scene, StaticObstacle
from planners.scene.bodies import pose_matrix, release_pitch, up_axis, with_up

Array: TypeAlias = NDArray[np.float64]


_ROWS, _COLUMNS = 4, 4
"""c and r of the paper: cells of its grid along x (depth) and y (width)."""
_MARGIN = 0.045
"""l of the paper [m]: distance of the outermost locations from the edges."""
_FINEST = 0.015
"""Spacing of locations [m] below which the grid is not refined further."""
_SPACING = 0.05
"""Spacing [m] of the cells' centres in canonical plans."""


def stand_at(body: Body, location: Array, turn: float = 0.0) -> Body:
    """The object standing at `location` (3,) [m] on a support, turned about the vertical by `turn` [rad]."""
    cosine, sine = math.cos(turn), math.sin(turn)
    T = body.pose.copy()
    T[:3, :3] = np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]]) @ T[:3, :3]
    T[:3, 3] = (location[0], location[1], location[2] + float(body.position[2]) - body.bottom)
    return body.at_pose(T)


def placement_grid(support: StaticObstacle) -> Array:
    """The (c + 1)(r + 1) corners of the grid's cells on the support plane (Figs. 7 and 8), shape (n, 2) [m]."""
    return _grid(*_bounds(support), _ROWS, _COLUMNS)


def placement_cells(support: StaticObstacle) -> Array:
    """Centres (n, 3) [m] of the square cells of a support where a canonical plan puts objects, x before y."""
    half = support.extent[:2] - _MARGIN
    x, y = (_SPACING * np.arange(-(h // _SPACING), h // _SPACING + 1) for h in half)
    cells = support.position[:2] + np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)
    return np.column_stack((cells, np.full(len(cells), support.top)))


def placement_levels(support: StaticObstacle, rng: np.random.Generator) -> Iterator[Array]:
    """Yield the paper's grid, then grids twice as fine each time, with their points moved at random within their cells.

    Arrays (n, 2) [m]. The last grid has points no closer than 15 mm before the random shift.
    """
    yield placement_grid(support)
    low, high = _bounds(support)
    for level in itertools.count(1):
        cells = np.array((_ROWS, _COLUMNS)) * 2**level
        spacing = (high - low) / cells
        if spacing.min() < _FINEST:
            return
        grid = _grid(low, high, *cells)
        yield np.clip(grid + rng.uniform(-0.5, 0.5, grid.shape) * spacing, low, high)


def _grid(low: Array, high: Array, rows: int, columns: int) -> Array:
    x, y = np.linspace(low[0], high[0], rows + 1), np.linspace(low[1], high[1], columns + 1)
    return np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)


def _bounds(support: StaticObstacle) -> tuple[Array, Array]:
    half = np.maximum(support.extent[:2] - _MARGIN, 0.0)
    return support.position[:2] - half, support.position[:2] + half


def put_down(scene: Scene, gripper_pose: Array, level: float) -> Body:
    """The held object at rest on a support `level` [m] high, after its release at a gripper pose (5,)."""
    assert scene.held is not None
    body = scene.body(scene.held.name)
    T_world_tcp = rotated(gripper_pose[3], gripper_pose[4])
    T_world_tcp[:3, 3] = gripper_pose[:3]
    dropped = body.at_pose(T_world_tcp @ scene.held.T_tcp_object)
    if dropped.is_upright:
        body = replace(dropped, quaternion=np.array([np.cos(dropped.yaw / 2), 0.0, 0.0, np.sin(dropped.yaw / 2)]))
    else:
        body = dropped.at_pose(with_up(dropped, up_axis(dropped)))
    return stand_at(body, np.array([*dropped.position[:2], level]))


def in_hand(scene: Scene) -> tuple[HeldObject, Body]:
    """The held object, and its resting pose once it is put down where it was taken. An object must be held."""
    assert scene.held is not None
    body = scene.body(scene.held.name)
    if body.is_upright:
        return scene.held, body
    resting = put_down(scene, np.array([0.0, 0.0, 0.0, 0.0, release_pitch(body, scene.held)]), 0.0)
    return scene.held, stand_at(resting, body.foot)


def rotated(yaw: float, pitch: float) -> Array:
    """Transform (4, 4) of a gripper at the origin with this yaw and pitch [rad]: Rz(yaw) Ry(pitch)."""
    return pose_matrix(np.zeros(3), gripper_rotation(yaw, pitch))
