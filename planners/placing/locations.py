"""Locations on a support where an object can be put (Lee & Kim 2019, Figs. 7 and 8), and how it rests there."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from planners.scene import Body, Scene, StaticObstacle
from planners.scene.bodies import up_axis

Array: TypeAlias = NDArray[np.float64]


@dataclass(frozen=True)
class PlacementConfig:
    """The grid of placement locations.

    Attributes:
        rows: c of the paper: cells along x (depth).
        columns: r of the paper: cells along y (width).
        margin: l of the paper [m]: distance of the outermost locations from the edges.
        finest: [m] between locations, below which the grid is not refined further.
    """

    rows: int = 4
    columns: int = 4
    margin: float = 0.045
    finest: float = 0.015


def stand_at(body: Body, location: Array, turn: float = 0.0) -> Body:
    """The object standing at `location` (3,) [m] on a support, turned about the vertical by `turn` [rad]."""
    cosine, sine = math.cos(turn), math.sin(turn)
    T = body.pose.copy()
    T[:3, :3] = np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]]) @ T[:3, :3]
    T[:3, 3] = (location[0], location[1], location[2] + float(body.position[2]) - body.bottom)
    return body.at_pose(T)


def placement_grid(support: StaticObstacle, config: PlacementConfig | None = None) -> Array:
    """The (c + 1)(r + 1) corners of the cells of a grid on the support plane (Figs. 7 and 8), shape (n, 2) [m]."""
    config = config or PlacementConfig()
    return _grid(support, config, config.rows, config.columns)


def placement_levels(
    support: StaticObstacle, rng: np.random.Generator, config: PlacementConfig | None = None
) -> Iterator[Array]:
    """The paper's grid, then grids twice as fine each time, their points moved at random within their cells.

    Yields arrays (n, 2) [m]; ends when the points would be closer than `config.finest`.
    """
    config = config or PlacementConfig()
    yield placement_grid(support, config)
    low, high = _bounds(support, config)
    for level in range(1, 32):
        cells = np.array((config.rows, config.columns)) * 2**level
        spacing = (high - low) / cells
        if spacing.min() < config.finest:
            return
        grid = _grid(support, config, int(cells[0]), int(cells[1]))
        yield np.clip(grid + rng.uniform(-0.5, 0.5, grid.shape) * spacing, low, high)


def _grid(support: StaticObstacle, config: PlacementConfig, rows: int, columns: int) -> Array:
    low, high = _bounds(support, config)
    x = np.linspace(low[0], high[0], rows + 1)
    y = np.linspace(low[1], high[1], columns + 1)
    return np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)


def _bounds(support: StaticObstacle, config: PlacementConfig) -> tuple[Array, Array]:
    half = np.maximum(support.extent[:2] - config.margin, 0.0)
    return support.position[:2] - half, support.position[:2] + half


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
