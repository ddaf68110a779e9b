"""Compiled search for the best free base of a key, over `Tiles` and `Raster`: in the order of μ, or tile by tile."""

from __future__ import annotations

from math import sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from irm.compilation import njit
from irm.floor.raster import FREE, MIXED, Raster, floor_distance, floor_gap, floor_kind, is_outside
from irm.queries.keys import Turns
from irm.queries.tiles import RADIUS_STEP, Ranking, Tiles

__all__ = ["ROUNDING", "SHORT", "TcpPlace", "best_in_tiles", "is_apart", "next_in_order"]

Floats = NDArray[np.float64]

ROUNDING = 1e-5
"""[m] added to distances that must not be underestimated: bases are stored in single precision."""

SHORT = 0.999
"""Share of a distance to free floor by which the kernels step over places that cannot be free."""


class TcpPlace(NamedTuple):
    """A TCP pose for kernels: number of its `key`, position `x`, `y` [m], `height_offset` above the middle of the key's
    layer [m], and whether its pitch and roll are `exact`ly those of the key."""

    key: int
    x: float
    y: float
    height_offset: float
    exact: bool


@njit(cache=True, inline="always")
def is_apart(taken: Floats, count: int, x: float, y: float, apart: float) -> bool:
    """Whether a point is farther than `apart` from the first `count` rows of `taken`."""
    near = 0
    limit = apart * apart
    for k in range(count):
        dx, dy = x - taken[k, 0], y - taken[k, 1]
        near += dx * dx + dy * dy <= limit
    return near == 0


@njit(cache=True, inline="always")
def next_in_order(
    tiles: Tiles,
    ranking: Ranking,
    start: int,
    tests: int,
    place: TcpPlace,
    turns: Turns,
    raster: Raster,
    taken: Floats,
    count: int,
    apart: float,
) -> tuple[int, int]:
    """The first base of a ranking, from `start` on, that is free and farther than `apart` from `count` rows of `taken`.

    At most about `tests` places are tested. Returns the rank of the base and its turn, (rank, -1) if the tests ended
    there, and (end of the key's ranking, -1) if there is no such base. Of the free turns of a base the one nearest to
    the middle is taken; if the turns cover all yaws, the first one.

    On the rings a turn by one yaw sample of the map is the same as the next yaw sample of the same voxel. So only the
    best sample of each voxel is needed, and all its positions around the TCP are equally good.
    """
    x_of, y_of, members, radius = tiles.x, tiles.y, ranking.base, ranking.radius
    vertices, starts, directions = raster.vertices, raster.starts, turns.directions
    last = directions.shape[0] - 1
    bounded = raster.cells.size > 0
    gap = floor_gap(raster, place.x, place.y) - ROUNDING if bounded else 0.0
    per_arc = last / (turns.yaws[last] - turns.yaws[0]) if last > 0 else 0.0
    end, steps = ranking.first[place.key + 1], ranking.skip.shape[1] - 1
    rank = max(start, ranking.skip[place.key, min(int(gap / RADIUS_STEP), steps)])
    while rank < end and tests > 0:
        base, best_turn = members[rank], -1
        turn = 0 if radius[rank] >= gap else last + 1
        while turn <= last:
            c, s = directions[turn, 0], directions[turn, 1]
            x, y = place.x + c * x_of[base] - s * y_of[base], place.y + s * x_of[base] + c * y_of[base]
            away = floor_distance(raster, x, y) if bounded else 0.0
            tests -= 1
            if away > 0.0:
                turn += 1 + int(SHORT * away / radius[rank] * per_arc)
                continue
            kind = floor_kind(raster, x, y) if bounded else FREE
            free = kind == FREE or (kind == MIXED and is_outside(vertices, starts, raster.radius, x, y))
            nearer = best_turn < 0 or abs(2 * turn - last) < abs(2 * best_turn - last)
            if free and nearer and is_apart(taken, count, x, y, apart):
                best_turn = turn
                if turns.all_around or 2 * turn >= last:
                    break
            turn += 1
        if best_turn >= 0:
            return rank, best_turn
        rank += 1
    return rank, -1


@njit(cache=True, inline="always")
def best_in_tiles(
    tiles: Tiles,
    key: int,
    px: float,
    py: float,
    turns: Floats,
    step: float,
    raster: Raster,
    taken: Floats,
    count: int,
    apart: float,
) -> tuple[int, int]:
    """The best base that is free and farther than `apart` from the first `count` rows of `taken`, and its turn.

    `turns` (n, 2) are cosines and sines of increasing approach yaws, `step` apart [rad]. Of equally good turns the one
    nearest to the middle is taken. Returns (-1, -1) if there is no such base.
    """
    best, best_base, best_turn = np.float32(-1.0), -1, -1
    x_of, y_of, mu = tiles.x, tiles.y, tiles.mu
    vertices, starts = raster.vertices, raster.starts
    bounded = raster.cells.size > 0
    gap = floor_gap(raster, px, py) if bounded else 0.0
    last = turns.shape[0] - 1
    per_arc = 1.0 / step if step > 0.0 else 0.0
    for tile in range(tiles.key_first[key], tiles.key_first[key + 1]):
        if tiles.tile_mu[tile] < best:
            break
        tx, ty, reach = tiles.tile_x[tile], tiles.tile_y[tile], tiles.tile_radius[tile] + ROUNDING
        distance = sqrt(tx * tx + ty * ty)
        if bounded and distance + reach < gap:
            continue
        turn = 0
        while turn <= last:
            c, s = turns[turn, 0], turns[turn, 1]
            away = floor_distance(raster, px + c * tx - s * ty, py + s * tx + c * ty) - reach if bounded else 0.0
            if away > 0.0:
                turn += 1 + int(SHORT * away / distance * per_arc)
                continue
            nearer = abs(2 * turn - last) < abs(2 * best_turn - last)
            for base in range(tiles.tile_first[tile], tiles.tile_last[tile]):
                if mu[base] < best or (mu[base] == best and not nearer):
                    break
                x, y = px + c * x_of[base] - s * y_of[base], py + s * x_of[base] + c * y_of[base]
                kind = floor_kind(raster, x, y) if bounded else FREE
                free = kind == FREE or (kind == MIXED and is_outside(vertices, starts, raster.radius, x, y))
                if free and is_apart(taken, count, x, y, apart):
                    best, best_base, best_turn = mu[base], base, turn
                    break
            turn += 1
    return best_base, best_turn
