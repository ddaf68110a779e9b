"""One base for several TCP positions, compiled: the waypoints of a path, or several targets.

The bases of one position, the reference, are searched in the order of `irm.inverse_table`. For each of these bases, the
μ of every other position is read from the voxel that contains it in the base frame. The score of a base is the smallest
μ. It cannot exceed μ of the reference, so the search ends as early as that of a single position.
"""

from __future__ import annotations

from math import cos, floor, pi, sin
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from irm.compilation import njit
from irm.free_space import Raster, floor_distance, point_is_free
from irm.inverse_table import Tiles
from irm.kinematics import wrap
from irm.query_kernels import is_apart
from irm.reachability_map import ReachabilityMap

Floats = NDArray[np.float64]
_ROUNDING = 1e-5
"""[m] of the single precision in which bases are stored; [rad] by which a yaw may leave its window."""


class GroupField(NamedTuple):
    """The map of one pitch and roll as dense arrays `mu` and `torso` (layer, yaw, x, y).

    `x0`, `y0`, `z0`: lowest corner of the grid in the base frame [m]; `voxel`: edge of its cells [m];
    `thickness` of its layers [m].
    """

    mu: NDArray[np.float32]
    torso: NDArray[np.float32]
    x0: float
    y0: float
    z0: float
    voxel: float
    thickness: float


class MultiTargetQuery(NamedTuple):
    """The positions that the base must reach.

    `points` (n, m, 3): the m TCP positions at each of the n yaws of the reference, the reference first. `yaws` (n,) of
    the reference [rad]. `windows` (m, 2): lower end and length of each position's range of yaws [rad]. `same_yaw`:
    whether all positions have the yaw of the reference instead.
    """

    points: Floats
    yaws: Floats
    windows: Floats
    same_yaw: bool


def group_field(rm: ReachabilityMap, group: int) -> GroupField:
    """The dense map of one orientation group."""
    grid, start = rm.grid, rm.grid.orientations.start
    layers, _, width, depth = grid.shape
    yaws = int(start[group + 1] - start[group])
    z, orientation, x, y = rm.indices()
    mine = (orientation >= start[group]) & (orientation < start[group + 1])
    mu, torso = np.zeros((layers, yaws, width, depth), np.float32), np.zeros((layers, yaws, width, depth), np.float32)
    place = z[mine], orientation[mine] - start[group], x[mine], y[mine]
    mu[place], torso[place] = rm.manipulability[mine], rm.torso[mine]
    edge = grid.half * grid.voxel
    return GroupField(mu, torso, grid.centre[0] - edge, grid.centre[1] - edge, grid.bottom, grid.voxel, grid.thickness)


@njit(cache=True, inline="always")
def _cell(field: GroupField, x: float, y: float, yaw: float, point: Floats, shift: float) -> tuple[int, int, int, bool]:
    """Layer, x and y index of the voxel that contains a point in a base frame, and whether it and the next one exist.

    `shift` 0.5 gives the lowest of the eight voxels whose centres surround the point.
    """
    c, s = cos(yaw), sin(yaw)
    dx, dy = point[0] - x, point[1] - y
    layer = floor((point[2] - field.z0) / field.thickness - shift)
    i = floor((c * dx + s * dy - field.x0) / field.voxel - shift)
    j = floor((c * dy - s * dx - field.y0) / field.voxel - shift)
    more = 1 if shift > 0.0 else 0
    layers, _, width, depth = field.mu.shape
    inside = 0 <= i < width - more and 0 <= j < depth - more and 0 <= layer < layers - more
    return layer, i, j, inside


@njit(cache=True)
def _best_yaw(
    field: GroupField, x: float, y: float, yaw: float, point: Floats, low: float, span: float
) -> tuple[float, int]:
    """Best μ of a TCP position in the frame of a base over the yaw samples within the window, and that sample."""
    mu_of, yaws = field.mu, field.mu.shape[1]
    layer, i, j, inside = _cell(field, x, y, yaw, point, 0.0)
    best, sample = 0.0, -1
    if not inside:
        return best, sample
    for g in range(yaws):
        mu = mu_of[layer, g, i, j]
        if mu > best:
            beyond = wrap(yaw + 2.0 * pi * g / yaws - low - pi) + pi
            if beyond <= span + _ROUNDING or beyond >= 2.0 * pi - _ROUNDING:
                best, sample = mu, g
    return best, sample


@njit(cache=True)
def _mu_at(field: GroupField, x: float, y: float, yaw: float, point: Floats, sample: int) -> float:
    """μ of a TCP position in the frame of a base at one yaw sample; 0 out of reach."""
    layer, i, j, inside = _cell(field, x, y, yaw, point, 0.0)
    return float(field.mu[layer, sample, i, j]) if inside else 0.0


@njit(cache=True)
def _is_enclosed(field: GroupField, x: float, y: float, yaw: float, point: Floats, sample: int) -> bool:
    """Whether the eight cell centres around a TCP position are all reachable at one yaw sample."""
    layer, i, j, inside = _cell(field, x, y, yaw, point, 0.5)
    if not inside:
        return False
    for a in range(2):
        for b in range(2):
            for d in range(2):
                if field.mu[layer + a, sample, i + b, j + d] <= 0.0:
                    return False
    return True


@njit(cache=True)
def _own_sample(field: GroupField, relative_yaw: float) -> int:
    """The yaw sample of the map from which a base with this yaw relative to the approach was computed."""
    yaws = field.mu.shape[1]
    return floor(-relative_yaw / (2.0 * pi) * yaws + 0.5) % yaws


@njit(cache=True)
def _best_common_base(
    tiles: Tiles,
    key: int,
    query: MultiTargetQuery,
    field: GroupField,
    raster: Raster,
    taken: Floats,
    count: int,
    apart: float,
) -> tuple[float, int, int]:
    """Score, base and turn of the best base that is free and farther than `apart` from `count` rows of `taken`."""
    best, best_base, best_turn = 0.0, -1, -1
    bounded = raster.cells.size > 0
    x_of, y_of, yaw_of, mu_of = tiles.x, tiles.y, tiles.yaw, tiles.mu
    points, yaws, windows = query.points, query.yaws, query.windows
    for tile in range(tiles.key_first[key], tiles.key_first[key + 1]):
        if tiles.tile_mu[tile] <= best:
            break
        tx, ty, reach = tiles.tile_x[tile], tiles.tile_y[tile], tiles.tile_radius[tile] + _ROUNDING
        for turn in range(yaws.shape[0]):
            px, py = points[turn, 0, 0], points[turn, 0, 1]
            c, s = cos(yaws[turn]), sin(yaws[turn])
            if bounded and floor_distance(raster, px + c * tx - s * ty, py + s * tx + c * ty) > reach:
                continue
            for base in range(tiles.tile_first[tile], tiles.tile_last[tile]):
                if mu_of[base] <= best:
                    break
                x = px + c * x_of[base] - s * y_of[base]
                y = py + s * x_of[base] + c * y_of[base]
                yaw = yaws[turn] + yaw_of[base]
                score = float(mu_of[base])
                own = _own_sample(field, yaw_of[base])
                for m in range(1, points.shape[1]):
                    if query.same_yaw:
                        mu = _mu_at(field, x, y, yaw, points[turn, m], own)
                    else:
                        mu, _ = _best_yaw(field, x, y, yaw, points[turn, m], windows[m, 0], windows[m, 1])
                    score = min(score, mu)
                    if score <= best:
                        break
                if score > best and point_is_free(raster, x, y) and is_apart(taken, count, x, y, apart):
                    best, best_base, best_turn = score, base, turn
    return best, best_base, best_turn


@njit(cache=True)
def best_common_bases(
    tiles: Tiles,
    key: int,
    query: MultiTargetQuery,
    field: GroupField,
    exact: bool,
    raster: Raster,
    apart: float,
    rows: Floats,
    torsos: Floats,
    yaws: Floats,
    done: int,
    last: int,
) -> int:
    """The k best bases from which every position is reached.

    Args:
        tiles, key: bases of the reference.
        query: the positions.
        field: of the positions' pitch and roll.
        exact: whether pitch and roll are exactly those of the map.
        raster: of the free floor.
        apart: smallest distance between two bases [m].
        rows: (k, 5) filled with x, y, yaw, smallest μ, certain (0 or 1).
        torsos, yaws: (k, m) filled with torso height and approach yaw of each position.
        done, last: rows that are filled already, and rows to fill, at most k.

    Returns:
        How many rows are filled: fewer than `last` if there are no more bases.
    """
    samples = field.mu.shape[1]
    for k in range(done, last):
        score, base, turn = _best_common_base(tiles, key, query, field, raster, rows, k, apart)
        if base < 0:
            return k
        c, s = cos(query.yaws[turn]), sin(query.yaws[turn])
        x = query.points[turn, 0, 0] + c * tiles.x[base] - s * tiles.y[base]
        y = query.points[turn, 0, 1] + s * tiles.x[base] + c * tiles.y[base]
        yaw = query.yaws[turn] + tiles.yaw[base]
        own = _own_sample(field, tiles.yaw[base])
        certain = exact
        for m in range(query.points.shape[1]):
            point = query.points[turn, m]
            sample = own
            if not query.same_yaw and m > 0:
                _, sample = _best_yaw(field, x, y, yaw, point, query.windows[m, 0], query.windows[m, 1])
            layer, i, j, _ = _cell(field, x, y, yaw, point, 0.0)
            certain = certain and _is_enclosed(field, x, y, yaw, point, sample)
            height_offset = point[2] - field.z0 - (layer + 0.5) * field.thickness
            torso = field.torso[layer, sample, i, j] + height_offset
            torsos[k, m] = min(tiles.torso_upper, max(tiles.torso_lower, torso))
            yaws[k, m] = wrap(yaw + 2.0 * pi * sample / samples)
        rows[k, 0], rows[k, 1], rows[k, 2], rows[k, 3] = x, y, wrap(yaw), score
        rows[k, 4] = 1.0 if certain else 0.0
    return last
