"""Lines of sight, compiled: cells that an image shows to be empty, and solids between an eye and points."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from irm.compilation import njit
from planners.scene import Body, StaticObstacle

Array: TypeAlias = NDArray[np.float64]

FIXED = 1 << 62
"""Bit of a mask that represents all furniture."""


class Screens(NamedTuple):
    """Solids that hide what is behind them.

    Poses are `position` (k, 3) [m] and `rotation` (k, 3, 3), sizes are `half` (k, 3) [m]. `is_round` (k,) marks upright
    cylinders in their own frames, `bit` (k,) is the bit of a mask.
    """

    position: Array
    rotation: Array
    half: Array
    is_round: NDArray[np.bool_]
    bit: NDArray[np.int64]

    @classmethod
    def of(cls, bodies: Sequence[Body], furniture: Sequence[StaticObstacle]) -> Screens:
        """Screens with bit i for object i. Furniture that is no box or cylinder is replaced by the box around it."""
        solids: list[Any] = [*bodies, *furniture]
        bits = [1 << i for i in range(len(bodies))] + [FIXED] * len(furniture)
        return cls(
            np.array([one.position for one in solids]).reshape(-1, 3),
            np.array([one.rotation for one in solids]).reshape(-1, 3, 3),
            np.array([one.half_extents for one in solids]).reshape(-1, 3),
            np.array([one.shape == "cylinder" for one in solids], np.bool_),
            np.array(bits, np.int64),
        )


def between(eye: Array, points: Array, screens: Screens) -> NDArray[np.int64]:
    """Masks (n,) of the solids between an eye (3,) and points (n, 3) [m]. 0 means in sight."""
    found = np.zeros(len(points), np.int64)
    _between(np.asarray(eye, float), np.ascontiguousarray(points, float), *screens, found)
    return found


def load_kernels() -> None:
    """Load or compile the kernels of this module before any clock is started."""
    between(np.zeros(3), np.ones((1, 3)), Screens.of((), ()))
    carve(
        np.ones((1, 1, 1), np.bool_),
        np.zeros(3),
        np.ones(3),
        np.ones((1, 1), np.float32),
        np.eye(3),
        np.eye(4),
        0.0,
        1.0,
        1.0,
    )


@njit(cache=True)
def _between(  # noqa: C901  compiled: one loop over one state
    eye: Array,
    points: Array,
    position: Array,
    rotation: Array,
    half: Array,
    is_round: NDArray[np.bool_],
    bit: NDArray[np.int64],
    found: NDArray[np.int64],
) -> None:
    """Clip every segment from the eye to a point by the faces of each solid, in the solid's own frame.

    A cylinder is clipped by its two ends and by the round side, whose two crossings follow from a quadratic equation.
    If a part of the segment is left, it passes through the solid.
    """
    start, end = np.empty(3), np.empty(3)
    for k in range(position.shape[0]):
        R = rotation[k]
        for axis in range(3):
            start[axis] = 0.0
            for i in range(3):
                start[axis] += R[i, axis] * (eye[i] - position[k, i])
        for n in range(points.shape[0]):
            if found[n] & bit[k]:
                continue
            first, last = 0.0, 1.0
            for axis in range(3):
                end[axis] = 0.0
                for i in range(3):
                    end[axis] += R[i, axis] * (points[n, i] - position[k, i])
            for axis in range(2 if is_round[k] else 0, 3):
                way = end[axis] - start[axis]
                if abs(way) < 1e-12:
                    if abs(start[axis]) >= half[k, axis]:
                        first = 2.0
                    continue
                a, b = (-half[k, axis] - start[axis]) / way, (half[k, axis] - start[axis]) / way
                first, last = max(first, min(a, b)), min(last, max(a, b))
            if is_round[k] and first < last:
                dx, dy = end[0] - start[0], end[1] - start[1]
                a = dx * dx + dy * dy
                b = start[0] * dx + start[1] * dy
                c = start[0] * start[0] + start[1] * start[1] - half[k, 0] * half[k, 0]
                root = b * b - a * c
                if a < 1e-18:
                    if c >= 0.0:
                        first = 2.0
                elif root <= 0.0:
                    first = 2.0
                else:
                    first, last = max(first, (-b - math.sqrt(root)) / a), min(last, (-b + math.sqrt(root)) / a)
            if first < last:
                found[n] |= bit[k]


@njit(cache=True)
def carve(
    is_unseen: NDArray[np.bool_],
    origin: Array,
    cell: Array,
    depth: NDArray[np.float32],
    K: Array,
    T_camera_world: Array,
    margin: float,
    fine: float,
    coarse: float,
) -> int:
    """Clear the cells (nx, ny, nz) whose centres lie between the camera and the visible surface. Return their number.

    A cell is empty if its centre is nearer than the depth of its pixel by more than `margin` [m]. If a pixel is wider
    than `fine` [m], all four pixels around the centre must show this. If it is wider than `coarse`, the cell stays
    unseen.
    """
    nx, ny, nz = is_unseen.shape
    height, width = depth.shape
    R, t = T_camera_world[:3, :3], T_camera_world[:3, 3]
    cleared = 0
    for i in range(nx):
        for j in range(ny):
            for k in range(nz):
                if not is_unseen[i, j, k]:
                    continue
                x, y = origin[0] + (i + 0.5) * cell[0], origin[1] + (j + 0.5) * cell[1]
                z = origin[2] + (k + 0.5) * cell[2]
                ahead = R[2, 0] * x + R[2, 1] * y + R[2, 2] * z + t[2]
                wide = ahead / K[0, 0]
                if ahead < 0.05 or wide > coarse:
                    continue
                right = R[0, 0] * x + R[0, 1] * y + R[0, 2] * z + t[0]
                down = R[1, 0] * x + R[1, 1] * y + R[1, 2] * z + t[1]
                u, v = K[0, 0] * right / ahead + K[0, 2] + 0.5, K[1, 1] * down / ahead + K[1, 2] + 0.5
                away = 0.5 if wide > fine else 0.0
                left, up = math.floor(u - away), math.floor(v - away)
                last, low = math.floor(u + away), math.floor(v + away)
                if left < 0 or last >= width or up < 0 or low >= height:
                    continue
                nearest = min(min(depth[up, left], depth[up, last]), min(depth[low, left], depth[low, last]))
                if ahead < nearest - margin:
                    is_unseen[i, j, k] = False
                    cleared += 1
    return cleared
