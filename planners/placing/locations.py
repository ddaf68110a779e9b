"""Locations on a support where an object can be put: Lee & Kim 2019, section 3.3, Figs. 7 and 8."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from planners.scene import Body, StaticObstacle

__all__ = ["PlacementConfig", "placement_grid", "placement_levels", "stand_at"]

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
