"""Shorter paths without corners: shortcuts and parabolic blends, compiled.

Shortcuts: Geraerts & Overmars, "Creating high-quality paths for motion planning", IJRR 2007.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from irm.compilation import njit
from planners.collision.compilation import leaf_kernel
from planners.collision.configuration_kernel import CollisionQuery
from planners.collision.path_kernel import edge_hits
from planners.collision.references import by_reference
from planners.collision.rows import copy_row, copy_rows
from planners.motion.sampling.rrt import squared_distance

Array = NDArray[np.float64]

_NONE = np.uint64(0)
_ARC_PIECES = 8
"""Straight segments by which a blend is approximated."""


@njit(cache=True)
def _splice(path: Array, i: int, a: Array, j: int, b: Array) -> Array:
    """The path with all between point `a` on segment i and point `b` on segment j replaced by a straight line."""
    shorter = np.empty((i + 1 + 2 + path.shape[0] - j - 1, path.shape[1]))
    copy_rows(path[: i + 1], shorter[: i + 1])
    copy_row(a, shorter[i + 1])
    copy_row(b, shorter[i + 2])
    copy_rows(path[j + 1 :], shorter[i + 3 :])
    return shorter


@njit(cache=True)
def _without(path: Array, first: int, last: int) -> Array:
    """The path (k, d) without the waypoints from `first` up to `last`, which is kept."""
    shorter = np.empty((first + path.shape[0] - last, path.shape[1]))
    copy_rows(path[:first], shorter[:first])
    copy_rows(path[last:], shorter[first:])
    return shorter


@leaf_kernel
def _interpolate(path: Array, segment: int, share: float, point: Array) -> None:
    """Write the point (d,) at that share of a segment of the path."""
    for i in range(point.shape[0]):
        point[i] = path[segment, i] + (path[segment + 1, i] - path[segment, i]) * share


@njit(cache=True)
def _without_repeats(path: Array, weights: Array) -> Array:
    """The path without waypoints equal to the one before."""
    kept, count, last = np.empty(path.shape), 0, path.shape[0] - 1
    for i in range(path.shape[0]):
        if i in (0, last) or squared_distance(path[i - 1], path[i], weights) > 1e-12:
            copy_row(path[i], kept[count])
            count += 1
    return kept[:count].copy()


@njit(cache=True)
def shortcut(query: CollisionQuery, path: Array, step: float, attempts: int, rng: np.random.Generator) -> Array:
    """Cut detours of a free path: first between waypoints, then between random points on it.

    Args:
        query: what counts as a hit; `first_only` must be set.
        path: (k, d) whole-body configurations.
        step: [m] No point of the robot moves more between two checks.
        attempts: random shortcuts tried.
        rng: for these.

    Returns:
        a free path (j, d) with the same ends.
    """
    checks, first = by_reference(query), 0
    while first < path.shape[0] - 2:
        for last in range(path.shape[0] - 1, first + 1, -1):
            if edge_hits(checks, path[first], path[last], step) == _NONE:
                path = _without(path, first + 1, last)
                break
        first += 1
    a, b = np.empty(path.shape[1]), np.empty(path.shape[1])
    for _ in range(attempts):
        segments = path.shape[0] - 1
        if segments < 2:
            break
        u, v = rng.random() * segments, rng.random() * segments
        if u > v:
            u, v = v, u
        i, j = int(u), int(v)
        if i == j:
            continue
        _interpolate(path, i, u - i, a)
        _interpolate(path, j, v - j, b)
        if edge_hits(checks, a, b, step) == _NONE:
            path = _without_repeats(_splice(path, i, a, j, b), query.attached.reach)
    return path


@njit(cache=True)
def _arc(before: Array, corner: Array, after: Array, share: float) -> Array:
    """A parabola (pieces + 1, d) tangent to both segments at a corner, over that share of each."""
    arc = np.empty((_ARC_PIECES + 1, corner.shape[0]))
    for k in range(_ARC_PIECES + 1):
        t = k / _ARC_PIECES
        for joint in range(corner.shape[0]):
            into, out = (before[joint] - corner[joint]) * share, (after[joint] - corner[joint]) * share
            arc[k, joint] = corner[joint] + (1.0 - t) * (1.0 - t) * into + t * t * out
    return arc


@njit(cache=True)
def blend_corners(query: CollisionQuery, path: Array, step: float) -> Array:
    """Replace the corners of a free path by parabolas where these are free, so that the robot need not stop there.

    Args and result as for `shortcut`.
    """
    checks = by_reference(query)
    corners = path.shape[0] - 2
    if corners < 1:
        return path
    rounded = np.empty((2 + corners * (_ARC_PIECES + 1), path.shape[1]))
    copy_row(path[0], rounded[0])
    count = 1
    for i in range(1, corners + 1):
        share, found = 0.5, False
        while not found and share > 0.05:
            arc = _arc(path[i - 1], path[i], path[i + 1], share)
            found = True
            for k in range(_ARC_PIECES):
                if edge_hits(checks, arc[k], arc[k + 1], step) != _NONE:
                    found = False
                    break
            share *= 0.5
        if found:
            copy_rows(arc, rounded[count : count + _ARC_PIECES + 1])
            count += _ARC_PIECES + 1
        else:
            copy_row(path[i], rounded[count])
            count += 1
    copy_row(path[corners + 1], rounded[count])
    return _without_repeats(rounded[: count + 1], query.attached.reach)
