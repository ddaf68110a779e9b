"""Proof that the joints do not reach a pose, for any structure of the arm, by two outer maps of points.

Two coordinates of the last joint's origin do not depend on the angle of the first joint: its distance from the first
axis, and its position along this axis. The possible coordinates about one axis form a solid of revolution, which
determines those about the next axis. Only the surface of the solid is followed. Every cell that the image of the
surface may touch is marked, and the interior is filled. So the solid grows by a cell or two at every joint, and
contains every possible point. The same is done for the first joint's origin in the frame of the hand. For the joint at
either end, the angles within its limits are tried, and the second table of each side is tested as well.
"""

from __future__ import annotations

from functools import lru_cache
from math import ceil, cos, floor, hypot, pi, sin
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from irm.chain import ArmChain, ChainKey, pose_of
from irm.compilation import njit
from irm.rotations import rotations

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]
_CELLS = 300
"""Cells of a table from the axis to the reach of the arm."""
_SPARE = 24
"""Additional cells around these, for the growth of the solids."""
_ANGLES = 144
"""Tried angles of the joint at either end."""
_LIFT_STEP = 0.01
"""[m] Step between the tried heights of the lift."""
_ROUNDING = 1e-7
"""[m] Error of a length in a file, in a pose, or in the tables, whose numbers have seven digits."""


class _Side(NamedTuple):
    """Possible places of a point relative to one end of the arm. `axes` (2,): axis of the joint there and the next
    axis. `tables` (2, r, z): distance of each cell from a possible cell, in coordinates about these axes [m]. `size`:
    edge of the cells [m]. `turns` (m, 3, 3), `shift` (3,): from the frame of the first axis to that of the second, at
    angles at most `half_step` from any angle within the limits [rad]."""

    tables: NDArray[np.float32]
    size: float
    axes: NDArray[np.int64]
    turns: Floats
    shift: Floats
    half_step: float


def are_out_of_reach(chain: ArmChain, torso_range: tuple[float, float], T_base_tcp: Floats) -> Bools:
    """(n,) whether the joints certainly do not reach poses (n, 4, 4), with the lift in a range [m]."""
    (low, high), hand = torso_range, pose_of(chain.tip)
    last = T_base_tcp @ np.linalg.inv(hand)  # frames of the last link, with the same origin at every angle of the joint
    away = last[:, :3, 3] - chain.shoulder
    away[:, 2] -= np.clip(away[:, 2], low, high)
    beyond = ~(np.linalg.norm(away, axis=1) <= chain.reach - np.linalg.norm(hand[:3, 3]) + _ROUNDING)
    lift, near, far = pose_of(chain.offsets[0]), *_sides(ChainKey(chain))
    first, up = lift @ pose_of(chain.offsets[1]), lift[:3, chain.axes[0] % 3]
    heights = np.linspace(low, high, ceil((high - low) / _LIFT_STEP) + 1)
    slack = 0.5 * (high - low) / max(1, len(heights) - 1) + _ROUNDING
    open_ = np.flatnonzero(~beyond)
    apart = last[open_, None, :3, 3] - heights[:, None] * up - first[:3, 3]
    seen = np.einsum("nhj,nji->nhi", -apart, last[open_, :3, :3])
    beyond[open_] = _are_impossible(near, far, apart @ first[:3, :3], seen, slack)
    return np.asarray(beyond)


@lru_cache(maxsize=16)
def _sides(key: ChainKey) -> tuple[_Side, _Side]:
    """The last joint's origin relative to the base, and the first joint's origin relative to the hand."""
    chain, n = key.chain, key.chain.size - 1
    steps = [pose_of(place) for place in chain.offsets[1:]]  # step k leads from link k to joint k + 1
    back: list[Floats] = [np.asarray(np.linalg.inv(step)) for step in steps]
    near = _side(chain, steps[n - 1][:3, 3], steps[n - 2 : 0 : -1], list(range(n, 0, -1))[1:], back[1], -1.0)
    far = _side(chain, back[1][:3, 3], back[2:], list(range(2, n + 1)), steps[n - 1], 1.0)
    return near, far


def _side(chain: ArmChain, point: Floats, steps: list[Floats], joints: list[int], step: Floats, sign: float) -> _Side:
    """Follow a point, fixed before the first of `joints`, to the axes of the last two. `steps` (4, 4): transforms
    between the joints. `step`: transform from the last joint to the one before, after a turn by `sign` times the last
    joint's angle."""
    from scipy.ndimage import binary_erosion, binary_fill_holes, distance_transform_edt  # a tenth of a second to import

    size, axes, middle = chain.reach / _CELLS, chain.axes[joints], _CELLS + _SPARE
    solid = np.zeros((middle, 2 * middle), dtype=bool)
    solid[int(hypot(*np.delete(point, axes[0])) / size), floor(point[axes[0]] / size) + middle] = True
    solids = [solid]
    for T, axis, next_axis in zip(steps, axes[:-1], axes[1:], strict=True):
        inner = binary_erosion(np.concatenate([solid[::-1], solid]))[middle:]  # the axis is a mirror
        marks, R, at = np.zeros_like(solid), np.ascontiguousarray(T[:3, :3]), np.ascontiguousarray(T[:3, 3])
        _revolve(np.argwhere(solid & ~inner), size, axis, R, at, next_axis, marks)
        solid = binary_fill_holes(np.concatenate([marks[::-1], marks]))[middle:]
        solids.append(solid)
    # Distances between middles of cells, reduced by the distance of two points from these middles.
    gaps = np.array([distance_transform_edt(~solid) - np.sqrt(2.0) for solid in solids[:-3:-1]])
    tables = np.asarray(gaps * size - _ROUNDING, dtype=np.float32)
    end, angles = joints[-1], np.zeros((3, _ANGLES))
    width = min(2 * pi, float(chain.upper[end] - chain.lower[end]))
    angles[2 - axes[-1]] = sign * (chain.lower[end] + width * (np.arange(_ANGLES) + 0.5) / _ANGLES)
    turns = np.ascontiguousarray(step[:3, :3] @ rotations(*angles))
    return _Side(tables, size, axes[:-3:-1].copy(), turns, step[:3, 3].copy(), 0.5 * width / _ANGLES)


@njit(cache=True)
def _revolve(
    cells: NDArray[np.int64], size: float, axis: int, R: Floats, p: Floats, next_axis: int, marks: Bools
) -> None:
    """Mark the circles of cells (m, 2) about an axis in coordinates about the next axis, and all adjacent cells.

    A point of a cell is at most 0.71 sizes from its middle. In a turn it is at most half a size from the nearest angle,
    at right angles to that distance. Together this is less than one size, so the point is in a marked cell.
    """
    middle = marks.shape[1] // 2
    x, y = np.empty(3), np.empty(3)
    for k in range(cells.shape[0]):
        radius = (cells[k, 0] + 0.5) * size
        x[axis] = (cells[k, 1] - middle + 0.5) * size
        count = ceil(2.0 * pi * (cells[k, 0] + 1.0))
        for t in range(count):
            angle = 2.0 * pi * t / count
            x[(axis + 1) % 3], x[(axis + 2) % 3] = radius * cos(angle), radius * sin(angle)
            for i in range(3):
                y[i] = p[i] + R[i, 0] * x[0] + R[i, 1] * x[1] + R[i, 2] * x[2]
            away = int(hypot(y[(next_axis + 1) % 3], y[(next_axis + 2) % 3]) / size)
            along = floor(y[next_axis] / size) + middle
            marks[max(0, away - 1) : away + 2, along - 1 : along + 2] = True


@njit(cache=True)
def _are_impossible(near: _Side, far: _Side, from_near: Floats, from_far: Floats, slack: float) -> Bools:
    """(n,) whether every one of h heights excludes at least one of two points (n, h, 3), each with a tolerance `slack`
    [m]."""
    impossible = np.ones(from_near.shape[0], np.bool_)
    for n in range(from_near.shape[0]):
        for k in range(from_near.shape[1]):
            if _may_be(near, from_near[n, k], slack) and _may_be(far, from_far[n, k], slack):
                impossible[n] = False
                break
    return impossible


@njit(cache=True)
def _may_be(side: _Side, x: Floats, slack: float) -> bool:
    """Whether a point within `slack` [m] of `x` (3,) in the frame of the first axis is possible."""
    if _gap(side, 0, x[0], x[1], x[2]) > slack:
        return False
    axis, p = side.axes[0], side.shift
    slack += hypot(x[(axis + 1) % 3], x[(axis + 2) % 3]) * side.half_step
    for R in side.turns:
        y0 = p[0] + R[0, 0] * x[0] + R[0, 1] * x[1] + R[0, 2] * x[2]
        y1 = p[1] + R[1, 0] * x[0] + R[1, 1] * x[1] + R[1, 2] * x[2]
        y2 = p[2] + R[2, 0] * x[0] + R[2, 1] * x[1] + R[2, 2] * x[2]
        if _gap(side, 1, y0, y1, y2) <= slack:
            return True
    return False


@njit(cache=True)
def _gap(side: _Side, which: int, *x: float) -> float:
    """Lower bound of a point's distance from its possible places [m]."""
    axis, (_, across, length) = side.axes[which], side.tables.shape
    away = int(hypot(x[(axis + 1) % 3], x[(axis + 2) % 3]) / side.size)
    along = floor(x[axis] / side.size) + length // 2
    return side.tables[which, away, along] if away < across and 0 <= along < length else np.inf
