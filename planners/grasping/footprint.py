"""Does the base fit where a map places it? For bases that are not round: their outline, turned by the yaw."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from assets.robots import RobotSpec

Array = NDArray[np.float64]


def inner_radius(robot: RobotSpec) -> float:
    """[m] of a circle inside the base's outline: no base pose is free where this circle is not."""
    if not robot.base_outline:
        return robot.base_radius
    corners = np.array(robot.base_outline)
    edges = np.roll(corners, -1, axis=0) - corners
    across = edges[:, 0] * corners[:, 1] - edges[:, 1] * corners[:, 0]
    return float(np.abs(across / np.linalg.norm(edges, axis=1)).min())


def fits(robot: RobotSpec, bases: Array, obstacles: Sequence[Array], margin: float) -> NDArray[np.bool_]:
    """Whether the base's outline at base poses (n, 3) keeps `margin` [m] from convex obstacles, each (v, 2) corners.

    Two convex polygons are apart if an edge of one of them separates them; at corners the margin is measured across
    the edges, and may be a little more than asked for.
    """
    if not robot.base_outline or not len(bases):
        return np.ones(len(bases), dtype=np.bool_)
    corners = np.array(robot.base_outline)
    c, s = np.cos(bases[:, 2]), np.sin(bases[:, 2])
    turn = np.stack((np.stack((c, -s), axis=-1), np.stack((s, c), axis=-1)), axis=-2)
    placed = np.einsum("nij,vj->nvi", turn, corners) + bases[:, None, :2]
    own = np.einsum("nij,vj->nvi", turn, _normals(corners))
    free = np.ones(len(bases), dtype=np.bool_)
    for obstacle in obstacles:
        along = np.einsum("nvi,nki->nvk", placed, own)
        other = np.einsum("wi,nki->nwk", obstacle, own)
        gap = np.maximum(other.min(axis=1) - along.max(axis=1), along.min(axis=1) - other.max(axis=1)).max(axis=1)
        normals = _normals(obstacle)
        along, other = placed @ normals.T, obstacle @ normals.T
        sides = np.maximum(other.min(axis=0) - along.max(axis=1), along.min(axis=1) - other.max(axis=0))
        free &= np.maximum(gap, sides.max(axis=1)) >= margin
    return free


def _normals(corners: Array) -> Array:
    """Unit normals (v, 2) of the edges of a polygon."""
    edges = np.roll(corners, -1, axis=0) - corners
    normals = np.column_stack((edges[:, 1], -edges[:, 0]))
    return np.asarray(normals / np.linalg.norm(normals, axis=1, keepdims=True))
