"""Compiled placement queries over `Tiles` and `Raster`."""

from __future__ import annotations

from math import cos, hypot, pi, sin, sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from irm.arm.closed_form import wrap
from irm.compilation import njit
from irm.floor.raster import FREE, MIXED, Raster, floor_distance, floor_gap, floor_kind, is_outside
from irm.maps.reachability import CERTAIN_IN_HEIGHT, CERTAIN_IN_PITCH
from irm.queries.keys import Turns
from irm.queries.tiles import RING_WIDTH, Tiles

__all__ = [
    "SAME_PLACE",
    "WindowTurns",
    "any_base_near",
    "best_bases",
    "best_bases_batch",
    "is_apart",
    "turns_of",
]

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

SAME_PLACE = 1e-6
"""[m] Two bases closer than this are the same base."""

_ROUNDING = 1e-5
"""[m] added to distances that must not be underestimated: bases are stored in single precision."""

_SHORT = 0.999
"""Share of a distance to free floor by which the kernels step over places that cannot be free."""


class WindowTurns(NamedTuple):
    """The `Turns` of several ranges of yaws one after another, for kernels.

    Range w owns `yaws` (n,) and `directions` (n, 2) from `first[w]` to `first[w + 1]`; `all_around` has one entry for
    each range, and `yaw_shift` is the same for all.
    """

    yaws: Floats
    directions: Floats
    all_around: NDArray[np.bool_]
    first: Integers
    yaw_shift: float


@njit(cache=True)
def turns_of(yaws: Floats) -> Floats:
    """(n, 2) cosines and sines."""
    turns = np.empty((yaws.shape[0], 2))
    for k in range(yaws.shape[0]):
        turns[k, 0], turns[k, 1] = cos(yaws[k]), sin(yaws[k])
    return turns


@njit(cache=True, inline="always")
def is_apart(taken: Floats, count: int, x: float, y: float, apart: float) -> bool:
    """Whether a point is farther than `apart` from the first `count` rows of `taken`."""
    near = 0
    for k in range(count):
        near += hypot(x - taken[k, 0], y - taken[k, 1]) <= apart
    return near == 0


@njit(cache=True, inline="always")
def _best_on_rings(
    tiles: Tiles, key: int, px: float, py: float, turns: Floats, raster: Raster, taken: Floats, count: int, apart: float
) -> tuple[int, int]:
    """`_best_in_tiles` for turns that cover all yaws in the steps of the map's own yaw samples.

    To turn the approach by such a step is the same as to take the next yaw sample of the same voxel. So only the best
    sample of each voxel is needed, and all its positions around the TCP are equally good.
    """
    x_of, y_of, radius, members = tiles.x, tiles.y, tiles.ring_radius, tiles.ring_base
    vertices, starts = raster.vertices, raster.starts
    bounded = raster.cells.size > 0
    gap = floor_gap(raster, px, py) - _ROUNDING if bounded else 0.0
    per_arc = turns.shape[0] / (2.0 * pi)
    skip = tiles.ring_skip[key, min(int(gap / RING_WIDTH), tiles.ring_skip.shape[1] - 1)]
    for ring in range(skip, tiles.ring_first[key + 1]):
        if radius[ring] < gap:
            continue
        base = members[ring]
        turn = 0
        while turn < turns.shape[0]:
            c, s = turns[turn, 0], turns[turn, 1]
            x, y = px + c * x_of[base] - s * y_of[base], py + s * x_of[base] + c * y_of[base]
            away = floor_distance(raster, x, y) if bounded else 0.0
            if away <= 0.0:
                kind = floor_kind(raster, x, y) if bounded else FREE
                free = kind == FREE or (kind == MIXED and is_outside(vertices, starts, raster.radius, x, y))
                if free and is_apart(taken, count, x, y, apart):
                    return base, turn
            turn += 1 + int(_SHORT * away / radius[ring] * per_arc)
    return -1, -1


@njit(cache=True, inline="always")
def _best_in_tiles(
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
        tx, ty, reach = tiles.tile_x[tile], tiles.tile_y[tile], tiles.tile_radius[tile] + _ROUNDING
        distance = sqrt(tx * tx + ty * ty)
        if bounded and distance + reach < gap:
            continue
        turn = 0
        while turn <= last:
            c, s = turns[turn, 0], turns[turn, 1]
            away = floor_distance(raster, px + c * tx - s * ty, py + s * tx + c * ty) - reach if bounded else 0.0
            if away > 0.0:
                turn += 1 + int(_SHORT * away / distance * per_arc)
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


@njit(cache=True, inline="always")
def best_bases(
    tiles: Tiles,
    key: int,
    px: float,
    py: float,
    height_offset: float,
    exact: bool,
    turns: Turns,
    raster: Raster,
    apart: float,
    rows: Floats,
) -> int:
    """The k best bases for one TCP pose, each farther than `apart` from the better ones.

    Args:
        tiles: of the inverse map.
        key: number of the key of the TCP's height, pitch and roll.
        px, py: TCP position [m].
        height_offset: of the TCP above the middle of the key's layer [m].
        exact: whether pitch and roll of the TCP are exactly those of the key.
        turns: yaws to try.
        raster: of the free floor.
        apart: [m].
        rows: (k, 7) filled with x, y, yaw, approach yaw, μ, torso, certain (0 or 1).

    Returns:
        How many rows were filled.
    """
    yaws, directions = turns.yaws, turns.directions
    step = yaws[1] - yaws[0] if yaws.shape[0] > 1 else 0.0
    lower, upper = tiles.torso_lower, tiles.torso_upper
    torso_follows = upper > lower
    for k in range(rows.shape[0]):
        if turns.all_around:
            base, turn = _best_on_rings(tiles, key, px, py, directions, raster, rows, k, apart)
        else:
            base, turn = _best_in_tiles(tiles, key, px, py, directions, step, raster, rows, k, apart)
        if base < 0:
            return k
        c, s = directions[turn, 0], directions[turn, 1]
        rows[k, 0] = px + c * tiles.x[base] - s * tiles.y[base]
        rows[k, 1] = py + s * tiles.x[base] + c * tiles.y[base]
        rows[k, 2] = wrap(yaws[turn] + tiles.yaw[base])
        rows[k, 3] = wrap(yaws[turn] + turns.yaw_shift)
        rows[k, 4] = tiles.mu[base]
        torso = tiles.torso[base] + height_offset
        rows[k, 5] = min(upper, max(lower, torso)) if torso_follows else tiles.torso[base]
        in_range = torso_follows and lower <= torso <= upper
        inside = abs(height_offset) < 1e-9 or in_range or tiles.flags[base] & CERTAIN_IN_HEIGHT != 0
        rows[k, 6] = 1.0 if (exact and inside) or tiles.flags[base] & CERTAIN_IN_PITCH != 0 else 0.0
    return rows.shape[0]


@njit(cache=True)
def best_bases_batch(
    tiles: Tiles,
    keys: Integers,
    positions: Floats,
    height_offsets: Floats,
    windows: WindowTurns,
    window: Integers,
    exact: bool,
    raster: Raster,
    apart: float,
    rows: Floats,
    counts: Integers,
) -> None:
    """`best_bases` of n queries.

    Args:
        tiles: of the inverse map.
        keys: (n,) numbers of the keys, -1 where the TCP is out of reach.
        positions: (n, 3) of the TCP [m].
        height_offsets: (n,) [m].
        windows: yaws to try, of every range of yaws.
        window: (n,) the range of each query.
        exact, raster, apart: as in `best_bases`, for all.
        rows: (n, k, 7) filled as in `best_bases`, with NaN where no base was found.
        counts: (n,) filled with the number of bases found.
    """
    for i in range(keys.shape[0]):
        counts[i] = 0
        if keys[i] >= 0:
            w = window[i]
            first, last = windows.first[w], windows.first[w + 1]
            yaws, directions = windows.yaws[first:last], windows.directions[first:last]
            turns = Turns(yaws, directions, windows.all_around[w], windows.yaw_shift)
            x, y = positions[i, 0], positions[i, 1]
            counts[i] = best_bases(tiles, keys[i], x, y, height_offsets[i], exact, turns, raster, apart, rows[i])
        for k in range(counts[i], rows.shape[1]):
            rows[i, k, :6] = np.nan
            rows[i, k, 6] = 0.0


@njit(cache=True)
def any_base_near(
    tiles: Tiles, keys: Integers, px: float, py: float, turns: Floats, half_turn: float, raster: Raster, slack: float
) -> bool:
    """Whether any base of any of the `keys` lies within `slack` of free floor at one of the `turns` (n, 2).

    Turns are `2 half_turn` apart [rad]; the arc between them is added to the slack.
    """
    bounded = raster.cells.size > 0
    for key in keys:
        for tile in range(tiles.key_first[key], tiles.key_first[key + 1]):
            if not bounded:
                return True
            tx, ty = tiles.tile_x[tile], tiles.tile_y[tile]
            margin = slack + hypot(tx, ty) * half_turn + _ROUNDING
            reach = margin + tiles.tile_radius[tile] * (1.0 + half_turn)
            for turn in range(turns.shape[0]):
                c, s = turns[turn, 0], turns[turn, 1]
                if floor_distance(raster, px + c * tx - s * ty, py + s * tx + c * ty) > reach:
                    continue
                for base in range(tiles.tile_first[tile], tiles.tile_last[tile]):
                    x = px + c * tiles.x[base] - s * tiles.y[base]
                    y = py + s * tiles.x[base] + c * tiles.y[base]
                    if floor_distance(raster, x, y) <= slack + hypot(tiles.x[base], tiles.y[base]) * half_turn:
                        return True
    return False
