"""Compiled placement queries: the turns of a range of yaws, and the best bases for one TCP pose or for many."""

from __future__ import annotations

from math import ceil, cos, floor, pi, sin
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from irm.arm.angles import wrap
from irm.compilation import WITHOUT_REFERENCE_COUNTS, njit
from irm.floor.raster import Raster
from irm.maps.reachability import CERTAIN_IN_HEIGHT, CERTAIN_IN_PITCH
from irm.queries.keys import YawWindow
from irm.queries.search_kernel import SECTOR_WIDTH, RingMasks, TcpPlace, Turns, forget, new_masks, next_in_order
from irm.queries.tiles import PARTS, SECTORS, Ranking, Tiles

__all__ = ["SAME_PLACE", "PlaceQueries", "best_bases_batch", "best_bases_in_window", "lay_out_turns", "turns_of"]

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

SAME_PLACE = 1e-6
"""[m] Two bases closer than this are the same base."""

_SAME_ANGLE = 1e-9
"""[rad] As in `irm.queries.arguments`: rounding of a range of yaws."""


class PlaceQueries(NamedTuple):
    """n TCP poses for kernels.

    `keys` (n,): their numbers, -1 where the TCP is out of reach; `positions` (n, 3) of the TCP [m]; `height_offsets`
    (n,) [m]; `ranges` (n, 2): lowest and highest turn of each [rad]; `exact` as in `TcpPlace`, for all.
    """

    keys: Integers
    positions: Floats
    height_offsets: Floats
    ranges: Floats
    exact: bool


@njit(cache=True)
def turns_of(yaws: Floats) -> Floats:
    """(n, 2) cosines and sines."""
    turns = np.empty((yaws.shape[0], 2))
    for k in range(yaws.shape[0]):
        turns[k, 0], turns[k, 1] = cos(yaws[k]), sin(yaws[k])
    return turns


@njit(cache=True, inline="always")
def _outward(k: int, count: int) -> int:
    """The k-th of the numbers below `count` in the order of their distance from the middle, the lower one first."""
    half = (k + 1) // 2
    return (count - 1) // 2 + (half if (k + count) % 2 else -half)


@njit(cache=True)
def lay_out_turns(window: YawWindow) -> Turns:
    """The turns of a window, as `irm.queries.keys.base_turns` lays them out.

    Those nearest to the middle of the window come first. Turns that cover all yaws are equally good.
    """
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
        yaws[k] = first + (k if all_around else _outward(k, count)) * apart
        turned = yaws[k] / SECTOR_WIDTH
        for part in range(PARTS):
            low, high = floor(turned + part / PARTS), floor(turned + (part + 1) / PARTS)
            sectors[part, k] = np.uint64(1) << np.uint64(low % SECTORS) | np.uint64(1) << np.uint64(high % SECTORS)
            all_sectors[part] |= sectors[part, k]
    return Turns(yaws, turns_of(yaws), sectors, all_sectors, all_around, window.shift)


@njit(cache=True, inline="always")
def best_bases(
    tiles: Tiles,
    ranking: Ranking,
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
        ranking: of its bases, for these turns.
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
    turn = 0
    while turn >= 0 and progress[0] < min(progress[2], rows.shape[0]):
        k = progress[0]
        rank, turn = next_in_order(ranking, progress[1], place, turns, raster, masks, rows, k, apart)
        progress[1] = rank
        if turn >= 0:
            base = ranking.base[rank]
            c, s = turns.directions[turn, 0], turns.directions[turn, 1]
            rows[k, 0] = place.x + c * ranking.x[rank] - s * ranking.y[rank]
            rows[k, 1] = place.y + s * ranking.x[rank] + c * ranking.y[rank]
            rows[k, 2] = wrap(turns.yaws[turn] + tiles.yaw[base])
            rows[k, 3] = wrap(turns.yaws[turn] + turns.yaw_shift)
            rows[k, 4] = tiles.mu[base]
            torso = tiles.torso[base] + place.height_offset
            rows[k, 5] = min(upper, max(lower, torso)) if torso_follows else tiles.torso[base]
            in_range = torso_follows and lower <= torso <= upper
            inside = abs(place.height_offset) < 1e-9 or in_range or tiles.flags[base] & CERTAIN_IN_HEIGHT != 0
            rows[k, 6] = 1.0 if (place.exact and inside) or tiles.flags[base] & CERTAIN_IN_PITCH != 0 else 0.0
            progress[0] += 1


@njit(cache=True, **WITHOUT_REFERENCE_COUNTS)
def _best_bases_of_one(
    tiles: Tiles,
    ranking: Ranking,
    place: TcpPlace,
    turns: Turns,
    raster: Raster,
    masks: RingMasks,
    apart: float,
    rows: Floats,
    progress: Integers,
) -> None:
    best_bases(tiles, ranking, place, turns, raster, masks, apart, rows, progress)


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
    turns = lay_out_turns(window)
    ranking = tiles.rings if turns.all_around else tiles.ranked
    _best_bases_of_one(tiles, ranking, place, turns, raster, new_masks(), apart, rows, progress)


@njit(cache=True, **WITHOUT_REFERENCE_COUNTS)
def _best_bases_of_some(
    tiles: Tiles,
    ranking: Ranking,
    queries: PlaceQueries,
    order: Integers,
    turns: Turns,
    raster: Raster,
    masks: RingMasks,
    apart: float,
    rows: Floats,
    counts: Integers,
    progress: Integers,
) -> None:
    """`best_bases` of those queries whose numbers are in `order`, with the same turns."""
    for i in order:
        progress[0], progress[1], progress[2] = 0, 0, rows.shape[1]
        if queries.keys[i] >= 0:
            x, y, offset = queries.positions[i, 0], queries.positions[i, 1], queries.height_offsets[i]
            place = TcpPlace(queries.keys[i], x, y, offset, queries.exact)
            forget(masks)
            best_bases(tiles, ranking, place, turns, raster, masks, apart, rows[i], progress)
        counts[i] = progress[0]
        for k in range(counts[i], rows.shape[1]):
            rows[i, k, :6] = np.nan
            rows[i, k, 6] = 0.0


@njit(cache=True)
def best_bases_batch(
    tiles: Tiles,
    queries: PlaceQueries,
    order: Integers,
    window: YawWindow,
    raster: Raster,
    apart: float,
    rows: Floats,
    counts: Integers,
) -> None:
    """`best_bases` of some of n queries.

    Args:
        tiles: of the inverse map.
        queries: n of them.
        order: (m,) numbers of those to answer, in this order. Neighbours with the same range share their turns.
        window: the rest of the window of all queries.
        raster, apart: as in `best_bases`, for all.
        rows: (n, k, 7) filled as in `best_bases`, with NaN where no base was found.
        counts: (n,) filled with the number of bases found.
    """
    progress, masks, ranges = np.zeros(3, np.int64), new_masks(), queries.ranges
    first, end = 0, order.shape[0]
    while first < end:
        low, high = ranges[order[first], 0], ranges[order[first], 1]
        last = first + 1
        while last < end and ranges[order[last], 0] == low and ranges[order[last], 1] == high:
            last += 1
        turns = lay_out_turns(YawWindow(low, high, window.step, window.samples, window.shift))
        ranking = tiles.rings if turns.all_around else tiles.ranked
        some = order[first:last]
        _best_bases_of_some(tiles, ranking, queries, some, turns, raster, masks, apart, rows, counts, progress)
        first = last
