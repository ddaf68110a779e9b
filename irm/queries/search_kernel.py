"""Compiled search for the best free base of a key: in the order of μ, over `Ranking` and `Raster`.

To test a base at a turn is to look up one place on the floor. Where little floor is free, most places of the best bases
are not. So the floor around the TCP is divided into sectors of rings. A mask of 64 bits says for each ring which of its
sectors may contain free floor; it is computed when the first base on that ring is tested. One operation on masks then
rejects a base at all its turns.
"""

from __future__ import annotations

from math import hypot, pi
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from irm.compilation import WITHOUT_REFERENCE_COUNTS, njit
from irm.floor.raster import Raster, floor_gap, point_is_free
from irm.queries.tiles import PARTS, RADIUS_STEP, RING_WIDTH, RINGS, SECTORS, Ranking

__all__ = [
    "ROUNDING",
    "SECTOR_WIDTH",
    "SHORT",
    "RingMasks",
    "TcpPlace",
    "Turns",
    "forget",
    "is_apart",
    "new_masks",
    "next_in_order",
]

Floats = NDArray[np.float64]

ROUNDING = 1e-5
"""[m] added to distances that must not be underestimated: bases are stored in single precision."""

SHORT = 0.999
"""Share of a distance to free floor by which the kernels step over places that cannot be free."""

_SECTOR_SHIFT, _RING_SHIFT = np.uint64(PARTS.bit_length() - 1), np.uint64((SECTORS * PARTS).bit_length() - 1)
_SECTOR_BITS, _PART_BITS = np.uint64(SECTORS - 1), np.uint64(PARTS - 1)
"""Where ring, sector and part are in `Ranking.where`."""

_FIRST = 2
"""Bases that are tested before any mask is computed: mostly one of them is free."""

SECTOR_WIDTH = 2.0 * pi / SECTORS
"""[rad] of a sector."""

_COS, _SIN = (f((np.arange(SECTORS) + 0.5) * SECTOR_WIDTH) for f in (np.cos, np.sin))
"""Directions of the middles of the sectors."""

_ALL = np.uint64(0xFFFFFFFFFFFFFFFF)
"""Every sector."""

_ONE = np.uint64(1)
"""Indices without a sign are never counted from the end, which a kernel must otherwise test."""


class TcpPlace(NamedTuple):
    """A TCP pose for kernels: number of its `key`, position `x`, `y` [m], `height_offset` above the middle of the key's
    layer [m], and whether its pitch and roll are `exact`ly those of the key."""

    key: int
    x: float
    y: float
    height_offset: float
    exact: bool


class Turns(NamedTuple):
    """The yaws at which a key's bases are laid out around the TCP, the preferred ones first.

    `yaws` (n,) [rad]; `directions` (n, 2): their cosines and sines; `sectors` (`PARTS`, n): the
    sectors, one or two, in one of which a base of each part of sector 0 is after the turn; `all_sectors` (`PARTS`,):
    these together; `all_around`: whether the turns cover all yaws in the steps of the map's own yaw samples, or of a
    divisor of these; `yaw_shift`: what to add to a turn to get the approach yaw [rad].
    """

    yaws: Floats
    directions: Floats
    sectors: NDArray[np.uint64]
    all_sectors: NDArray[np.uint64]
    all_around: bool
    yaw_shift: float


class RingMasks(NamedTuple):
    """The rings of floor around a TCP, `RING_WIDTH` wide: `sectors` (b,) that may contain free floor, one bit each, all
    of them while it is not computed; `is_known` (b,) whether it is."""

    sectors: NDArray[np.uint64]
    is_known: NDArray[np.bool_]


@njit(cache=True)
def new_masks() -> RingMasks:
    """Masks that are not computed yet, for all radii of a ranking."""
    return RingMasks(np.full(RINGS, _ALL), np.zeros(RINGS, np.bool_))


@njit(cache=True, inline="always")
def forget(masks: RingMasks) -> None:
    """Let masks be those of a new TCP."""
    for ring in range(RINGS):
        masks.sectors[ring], masks.is_known[ring] = _ALL, False


@njit(cache=True, **WITHOUT_REFERENCE_COUNTS)
def _free_sectors(raster: Raster, px: float, py: float, gap: float, ring: int) -> np.uint64:
    """The mask of one ring around a TCP at (px, py), from which no free floor is nearer than `gap` [m].

    A point outside the raster is at least as far from free floor as the nearest point of the raster is.
    """
    if ring == RINGS - 1:
        return _ALL
    if (ring + 1) * RING_WIDTH < gap:
        return np.uint64(0)
    radius = (ring + 0.5) * RING_WIDTH
    reach = hypot(0.5 * RING_WIDTH, 0.5 * (radius + RING_WIDTH) * SECTOR_WIDTH) + ROUNDING
    inverse = 1.0 / raster.resolution
    near = np.float32(reach + 1.4143 * raster.resolution)
    cx, cy, r = (px - raster.x0) * inverse, (py - raster.y0) * inverse, radius * inverse
    last_i, last_j = raster.distance.shape[0] - 1, raster.distance.shape[1] - 1
    mask = np.uint64(0)
    for k in range(SECTORS):
        i = int(min(max(cx + r * _COS[k], 0.0), float(last_i)))
        j = int(min(max(cy + r * _SIN[k], 0.0), float(last_j)))
        mask |= np.uint64(raster.distance[np.uint64(i), np.uint64(j)] <= near) << np.uint64(k)
    return mask


@njit(cache=True, inline="always")
def _turned_back(mask: np.uint64, sector: np.uint64) -> np.uint64:
    """A mask of sectors seen from one of them."""
    return (mask >> sector) | (mask << ((np.uint64(SECTORS) - sector) & np.uint64(SECTORS - 1)))


@njit(cache=True, inline="always")
def is_apart(taken: Floats, count: int, x: float, y: float, apart: float) -> bool:
    """Whether a point is farther than `apart` from the first `count` rows of `taken`."""
    near = 0
    limit = apart * apart
    for k in range(count):
        dx, dy = x - taken[k, 0], y - taken[k, 1]
        near += dx * dx + dy * dy <= limit
    return near == 0


@njit(cache=True, **WITHOUT_REFERENCE_COUNTS)
def _next_candidate(
    where: NDArray[np.uint16], sectors: NDArray[np.uint64], rank: int, end: int, all_turns: NDArray[np.uint64]
) -> np.int64:
    """The first rank in `rank` … `end` whose base may be on free floor, as far as the masks are known; else `end`."""
    at, last = np.uint64(rank), np.uint64(end)
    while at < last:
        place = np.uint64(where[at])
        sector = (place >> _SECTOR_SHIFT) & _SECTOR_BITS
        if _turned_back(sectors[place >> _RING_SHIFT], sector) & all_turns[place & _PART_BITS] != 0:
            break
        at += _ONE
    return np.int64(at)


@njit(cache=True, inline="always")
def _free_turn(
    x: float,
    y: float,
    place: TcpPlace,
    turns: Turns,
    part: int,
    free_sectors: np.uint64,
    raster: Raster,
    taken: Floats,
    count: int,
    apart: float,
) -> int:
    """The first turn at which a base at (x, y) from the TCP is free and farther than `apart` from the first `count`
    rows of `taken`; -1 if there is none."""
    directions, sectors, found, turn = turns.directions, turns.sectors, -1, 0
    while found < 0 and turn < directions.shape[0]:
        if sectors[part, turn] & free_sectors != 0:
            c, s = directions[turn, 0], directions[turn, 1]
            at_x, at_y = place.x + c * x - s * y, place.y + s * x + c * y
            if point_is_free(raster, at_x, at_y) and is_apart(taken, count, at_x, at_y, apart):
                found = turn
        turn += 1
    return found


@njit(cache=True, inline="always")
def next_in_order(
    ranking: Ranking,
    start: int,
    place: TcpPlace,
    turns: Turns,
    raster: Raster,
    masks: RingMasks,
    taken: Floats,
    count: int,
    apart: float,
) -> tuple[int, int]:
    """The first base of a ranking, from `start` on, that is free and farther than `apart` from the first `count` rows
    of `taken`.

    Returns the rank of the base and its turn, or (end of the key's ranking, -1) if there is no such base.

    On the rings a turn by one yaw sample of the map is the same as the next yaw sample of the same voxel. So only the
    best sample of each voxel is needed, and all its positions around the TCP are equally good.
    """
    bounded = raster.cells.size > 0
    gap = floor_gap(raster, place.x, place.y) - ROUNDING if bounded else 0.0
    end, steps = ranking.first[place.key + 1], ranking.skip.shape[1] - 1
    rank = max(start, ranking.skip[place.key, min(int(gap / RADIUS_STEP), steps)])
    tests, turn = 0, -1
    while rank < end:
        free_sectors = _ALL
        if bounded and tests >= _FIRST:
            rank = _next_candidate(ranking.where, masks.sectors, rank, end, turns.all_sectors)
            if rank == end:
                break
            ring = ranking.where[rank] // (SECTORS * PARTS)
            if not masks.is_known[ring]:
                masks.sectors[ring], masks.is_known[ring] = _free_sectors(raster, place.x, place.y, gap, ring), True
                continue
            sector = np.uint64(ranking.where[rank] // PARTS % SECTORS)
            free_sectors = _turned_back(masks.sectors[ring], sector)
        if ranking.radius[rank] >= gap:
            part = ranking.where[rank] % PARTS
            turn = _free_turn(
                ranking.x[rank], ranking.y[rank], place, turns, part, free_sectors, raster, taken, count, apart
            )
            if turn >= 0:
                break
            tests += 1
        rank += 1
    return rank, turn
