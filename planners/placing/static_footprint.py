"""Cells of a support where nothing can be put: under static obstacles that stand on it, and beyond its edges."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planners.placing.negative_goal_region import SupportGrid, SweptVolume, swept_mask
from planners.scene import Scene, StaticObstacle

__all__ = ["static_mask"]

_INSET = 1e-6
"""[m] Obstacles are taken to be smaller by this, so that a wall flush with the edge of a table covers none of it."""
_FLUSH = 0.001
"""[m] An obstacle that rises less above the support is level with it."""


def static_mask(
    scene: Scene, support: StaticObstacle, grid: SupportGrid, height: float, clearance: float = 0.0
) -> NDArray[np.bool_]:
    """Cells of the grid over a support where an object would touch a static obstacle, or stand on nothing.

    Each obstacle counts as the box around it along its own axes, grown by `clearance`.

    Args:
        scene: its static obstacles count.
        support: what the grid lies over.
        grid: cells of the support plane.
        height: [m] of the object; obstacles that hang higher do not count.
        clearance: [m] to keep from the obstacles.
    """
    standing = [
        one
        for one in scene.static_obstacles
        if one.name != support.name and one.upper[2] > grid.height + _FLUSH and one.lower[2] < grid.height + height
    ]
    near = [one for one in standing if _overlaps(one.lower, one.upper, support.lower, support.upper)]
    volume = SweptVolume(
        box_centres=np.array([one.position for one in near]).reshape(-1, 3),
        box_axes=np.array([one.rotation for one in near]).reshape(-1, 3, 3),
        box_half_extents=np.array([one.half_extents + clearance - _INSET for one in near]).reshape(-1, 3),
    )
    covered = swept_mask(grid, volume, height) if near else grid.empty()
    return covered if support.shape == "box" and support.is_axis_aligned else covered | ~_on_top(support, grid)


def _overlaps(
    lower: NDArray[np.float64],
    upper: NDArray[np.float64],
    other_lower: NDArray[np.float64],
    other_upper: NDArray[np.float64],
) -> bool:
    """Whether two boxes overlap seen from above, by more than touching."""
    return bool(((lower + _INSET < other_upper) & (other_lower + _INSET < upper))[:2].all())


def _on_top(support: StaticObstacle, grid: SupportGrid) -> NDArray[np.bool_]:
    """Cells of which all four corners lie on the top face."""
    x = grid.x0 + np.arange(grid.shape[0] + 1) * grid.resolution
    y = grid.y0 + np.arange(grid.shape[1] + 1) * grid.resolution
    corners = support.is_under(np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1))
    inside: NDArray[np.bool_] = corners[:-1, :-1] & corners[1:, :-1] & corners[:-1, 1:] & corners[1:, 1:]
    return inside
