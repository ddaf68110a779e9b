"""Compiled placement queries: the turns of a range of yaws, and the best bases for one TCP pose or for many."""

from __future__ import annotations

from math import ceil, cos, floor, pi, sin

import numpy as np
from numpy.typing import NDArray

from irm.arm.angles import wrap
from irm.compilation import njit
from irm.floor.raster import Raster
from irm.maps.reachability import CERTAIN_IN_HEIGHT, CERTAIN_IN_PITCH
from irm.queries.keys import YawWindow
from irm.queries.search_kernel import SECTOR_WIDTH, RingMasks, TcpPlace, Turns, forget, new_masks, next_in_order
from irm.queries.tiles import PARTS, SECTORS, Tiles

__all__ = ["SAME_PLACE", "best_bases_batch", "best_bases_in_window", "lay_out_turns", "turns_of"]

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

SAME_PLACE = 1e-6
"""[m] Two bases closer than this are the same base."""

_SAME_ANGLE = 1e-9
"""[rad] As in `irm.queries.arguments`: rounding of a range of yaws."""


@njit(cache=True)
def turns_of(yaws: Floats) -> Floats:
    """(n, 2) cosines and sines."""
    turns = np.empty((yaws.shape[0], 2))
    for k in range(yaws.shape[0]):
        turns[k, 0], turns[k, 1] = cos(yaws[k]), sin(yaws[k])
    return turns


@njit(cache=True)
def lay_out_turns(window: YawWindow) -> Turns:
    """The turns of a window, as `irm.queries.keys.base_turns` lays them out."""
    length = window.high - window.low
    all_around = length >= 2.0 * pi - _SAME_ANGLE
    if all_around:
        count = window.samples * ceil(2.0 * pi / window.step / window.samples - _SAME_ANGLE)
        first, apart = window.low, 2.0 * pi / count
    else:
        count = ceil(length / window.step - _SAME_ANGLE) + 1
        first = window.low if count > 1 else 0.5 * (window.low + window.high)
        apart = length / (count - 1) if count > 1 else 0.0
    yaws, sectors, all_sectors = np.empty(count), np.empty((PARTS, count), np.uint64), np.zeros(PARTS, np.uint64)
    for k in range(count):
        yaws[k] = first + k * apart
        turned = yaws[k] / SECTOR_WIDTH
        for part in range(PARTS):
            low, high = floor(turned + part / PARTS), floor(turned + (part + 1) / PARTS)
            sectors[part, k] = np.uint64(1) << np.uint64(low % SECTORS) | np.uint64(1) << np.uint64(high % SECTORS)
            all_sectors[part] |= sectors[part, k]
    return Turns(yaws, turns_of(yaws), sectors, all_sectors, all_around, window.shift)


@njit(cache=True, inline="always")
def best_bases(
    tiles: Tiles,
    place: TcpPlace,
    turns: Turns,
    raster: Raster,
    masks: RingMasks,
    apart: float,
    rows: Floats,
    progress: Integers,
) -> None:
    """The k best bases for one TCP pose, each farther than `apart` from the better ones.

    Args:
        tiles: of the inverse map.
        place: of the TCP.
        turns: yaws to try.
        raster: of the free floor.
        masks: of the floor around the TCP.
        apart: [m].
        rows: (k, 7) filled with x, y, yaw, approach yaw, μ, torso, certain (0 or 1).
        progress: (3,) rows filled, rank where the search goes on, and the number of rows at which to pause. The
            search is over if fewer rows than that are filled.
    """
    lower, upper = tiles.torso_lower, tiles.torso_upper
    torso_follows = upper > lower
    ranking = tiles.rings if turns.all_around else tiles.ranked
    while progress[0] < min(progress[2], rows.shape[0]):
        k = progress[0]
        rank, turn = next_in_order(tiles, ranking, progress[1], place, turns, raster, masks, rows[:k], apart)
        progress[1] = rank
        if turn < 0:
            return
        base = ranking.base[rank]
        c, s = turns.directions[turn, 0], turns.directions[turn, 1]
        rows[k, 0] = place.x + c * tiles.x[base] - s * tiles.y[base]
        rows[k, 1] = place.y + s * tiles.x[base] + c * tiles.y[base]
        rows[k, 2] = wrap(turns.yaws[turn] + tiles.yaw[base])
        rows[k, 3] = wrap(turns.yaws[turn] + turns.yaw_shift)
        rows[k, 4] = tiles.mu[base]
        torso = tiles.torso[base] + place.height_offset
        rows[k, 5] = min(upper, max(lower, torso)) if torso_follows else tiles.torso[base]
        in_range = torso_follows and lower <= torso <= upper
        inside = abs(place.height_offset) < 1e-9 or in_range or tiles.flags[base] & CERTAIN_IN_HEIGHT != 0
        rows[k, 6] = 1.0 if (place.exact and inside) or tiles.flags[base] & CERTAIN_IN_PITCH != 0 else 0.0
        progress[0] += 1


@njit(cache=True)
def best_bases_in_window(
    tiles: Tiles,
    place: TcpPlace,
    window: YawWindow,
    raster: Raster,
    apart: float,
    rows: Floats,
    progress: Integers,
) -> None:
    """`best_bases` for the turns of a window."""
    best_bases(tiles, place, lay_out_turns(window), raster, new_masks(), apart, rows, progress)


@njit(cache=True)
def best_bases_batch(
    tiles: Tiles,
    keys: Integers,
    positions: Floats,
    height_offsets: Floats,
    ranges: Floats,
    window: YawWindow,
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
        ranges: (n, 2) lowest and highest turn of each query [rad].
        window: the rest of the window of all queries.
        exact, raster, apart: as in `best_bases`, for all.
        rows: (n, k, 7) filled as in `best_bases`, with NaN where no base was found.
        counts: (n,) filled with the number of bases found.
    """
    turns = lay_out_turns(window)
    low, high = window.low, window.high
    progress, masks = np.zeros(3, np.int64), new_masks()
    for i in range(keys.shape[0]):
        if ranges[i, 0] != low or ranges[i, 1] != high:
            low, high = ranges[i, 0], ranges[i, 1]
            turns = lay_out_turns(YawWindow(low, high, window.step, window.samples, window.shift))
        progress[0], progress[1], progress[2] = 0, 0, rows.shape[1]
        if keys[i] >= 0:
            place = TcpPlace(keys[i], positions[i, 0], positions[i, 1], height_offsets[i], exact)
            forget(masks)
            best_bases(tiles, place, turns, raster, masks, apart, rows[i], progress)
        counts[i] = progress[0]
        for k in range(counts[i], rows.shape[1]):
            rows[i, k, :6] = np.nan
            rows[i, k, 6] = 0.0
