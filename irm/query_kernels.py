"""Compiled queries for one or many TCP poses: the best free bases of a key, and the proof that no base exists.

Bases are tested in the order of μ (`Ranking`). The test of a base at a turn looks up one place on the floor. Where
little floor is free, most places of the best bases are blocked. So the floor around the TCP is divided into sectors of
rings. For each ring, a mask of 64 bits marks the sectors that may contain free floor. It is computed when the first
base on that ring is tested. One operation on masks then rejects a base at all its turns.
"""

from __future__ import annotations

from functools import lru_cache
from math import ceil, cos, floor, hypot, inf, pi, sin, sqrt
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from irm.compilation import WITHOUT_REFERENCE_COUNTS, njit
from irm.free_space import Raster, floor_distance, floor_gap, point_is_free
from irm.kinematics import wrap
from irm.packed_cells import PackedCells, code_of, has_cell, mu_of
from irm.query_keys import BaseYaws, YawWindow

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
Integers = NDArray[np.int64]
RADIUS_STEP = 0.025
"""[m] Step of the distances in `Ranking.skip`."""
SECTORS = 64
"""Directions around the TCP: the bits of one number."""
PARTS = 4
"""Parts of a sector. So the direction of a base is stored as one of 256."""
RING_WIDTH = 0.05
"""[m] of a ring of floor around the TCP."""
RINGS = 64
"""Number of rings. Bases farther away belong to the last ring."""
SAME_PLACE = 1e-6
"""[m] Two bases closer than this are the same base."""
_SAME_ANGLE = 1e-9
"""[rad] As in `irm.query_keys`: rounding of a range of yaws."""
ROUNDING = 1e-5
"""[m] Margin on distances that must not be underestimated. Bases are stored in single precision."""
SHORT = 0.999
"""Share of a distance to free floor that kernels skip, because places on it cannot be free."""
_SECTOR_SHIFT, _RING_SHIFT = np.uint64(PARTS.bit_length() - 1), np.uint64((SECTORS * PARTS).bit_length() - 1)
_SECTOR_BITS, _PART_BITS = np.uint64(SECTORS - 1), np.uint64(PARTS - 1)
"""Bit positions of ring, sector and part in `Places.where`."""
_FIRST = 2
"""Bases tested before any mask is computed. In most queries one of them is free."""
SECTOR_WIDTH = 2.0 * pi / SECTORS
"""[rad] of a sector."""
_COS, _SIN = (f((np.arange(SECTORS) + 0.5) * SECTOR_WIDTH) for f in (np.cos, np.sin))
"""Directions of the middles of the sectors."""
_ALL = np.uint64(0xFFFFFFFFFFFFFFFF)
"""Every sector."""
_ONE = np.uint64(1)
"""Unsigned one. Unsigned indices spare the kernel numba's test for negative indices."""


class Places(NamedTuple):
    """Places of bases relative to the TCP at approach yaw 0, for each number of yaws that a key may have.

    The places of all numbers of yaws are concatenated. `x`, `y`, `radius` (p,): position and distance from the TCP [m].
    `yaw` (p,): [rad]. `where` (p,): (ring * SECTORS + sector) * PARTS + part, with the number of the ring, the sector,
    and its part. `by_tile` (p,): numbers of the places, tile by tile. Tiles are squares of floor. `tile_x`, `tile_y`
    (t,): their middles. `tile_radius` (t,): distance from the middle to the farthest place [m]. `tile_first` (t + 1,):
    their start in `by_tile`. `first` and `first_tile`: start of the places and tiles of each number of yaws. `area`:
    voxels of a layer.
    """

    x: Singles
    y: Singles
    radius: Singles
    yaw: Singles
    where: NDArray[np.uint16]
    by_tile: NDArray[np.int32]
    tile_x: Floats
    tile_y: Floats
    tile_radius: Floats
    tile_first: Integers
    first: Integers
    first_tile: Integers
    area: int


class Ranking(NamedTuple):
    """Bases of every key, best first.

    `cell` (n,): local numbers of their cells, see `irm.packed_cells`. `first` (keys + 1,): start of each key's bases.
    `skip` (keys, b): rank of a key's first base at distance b `RADIUS_STEP` or farther from the TCP.
    """

    cell: NDArray[Any]
    first: Integers
    skip: NDArray[np.int32]


class Bases(NamedTuple):
    """Bases of equation 5 as arrays for kernels.

    `cells`: cells of the map. `places`: places of bases around the TCP. `kind` (g,): number of each group's table of
    places. `yaws` (g,): number of yaws of each group. `beside` (g, m): groups within one step of pitch and roll, padded
    with -1, all -1 where the map lacks a neighbour. `torsos` (t,): heights [m]. `corner` (3,): lowest corner of the
    grid in the base frame [m]. `side`: voxels along x and y. `groups`, `layers`: their numbers. `voxel`, `thickness`:
    edges of the cells [m]. `torso_lower`, `torso_upper`: range in which the torso can follow the TCP's height [m],
    equal for a fixed torso. `lift_is_free`: whether a base is certain where the torso follows, because self-collision
    is ignored. `by_certainty`: whether bases whose cell is reached over its whole height come first. `ranked`: all
    bases. `rings`: the best base of each voxel.
    """

    cells: PackedCells
    places: Places
    kind: Integers
    yaws: Integers
    beside: Integers
    torsos: Floats
    corner: Floats
    side: int
    groups: int
    layers: int
    voxel: float
    thickness: float
    torso_lower: float
    torso_upper: float
    lift_is_free: bool
    by_certainty: bool
    ranked: Ranking
    rings: Ranking


class TcpPlace(NamedTuple):
    """A TCP pose for kernels. `key`: number of its key. `x`, `y`: position [m]. `height_offset`: height above the
    middle of the key's layer [m]. `exact`: whether its pitch and roll are exactly those of the key."""

    key: int
    x: float
    y: float
    height_offset: float
    exact: bool


class PlaceQueries(NamedTuple):
    """n TCP poses for kernels.

    `keys` (n,): their numbers, -1 where the TCP is out of reach. `positions` (n, 3): TCP positions [m].
    `height_offsets` (n,): as in `TcpPlace` [m]. `ranges` (n, 2): lowest and highest turn of each pose [rad]. `shifts`
    (n,): approach yaw minus turn [rad]. `exact` (n,): as in `TcpPlace`.
    """

    keys: Integers
    positions: Floats
    height_offsets: Floats
    ranges: Floats
    shifts: Floats
    exact: NDArray[np.bool_]


class Turns(NamedTuple):
    """Yaws at which a key's bases are laid out around the TCP, by preference.

    `yaws` (n,): the turns [rad]. `directions` (n, 2): their cosines and sines. `sectors` (`PARTS`, n): mask of the one
    or two sectors that may contain a base of each part of sector 0 after the turn. `all_sectors` (`PARTS`,): union of
    these masks. `all_around`: whether the turns cover all yaws in the steps of the map's yaw samples, or in a divisor
    of this step. `yaw_shift`: approach yaw minus turn [rad].
    """

    yaws: Floats
    directions: Floats
    sectors: NDArray[np.uint64]
    all_sectors: NDArray[np.uint64]
    all_around: bool
    yaw_shift: float


class RingMasks(NamedTuple):
    """Rings of floor around a TCP, `RING_WIDTH` wide. `sectors` (b,): mask of the sectors that may contain free floor,
    all bits set until it is computed. `is_known` (b,): whether it is computed."""

    sectors: NDArray[np.uint64]
    is_known: NDArray[np.bool_]


class FloorAround(NamedTuple):
    """Free floor around a TCP, the least distance `apart` of two bases [m], and the allowed `yaws` of bases."""

    raster: Raster
    masks: RingMasks
    apart: float
    yaws: BaseYaws


@njit(cache=True)
def floor_around(raster: Raster, apart: float, yaws: BaseYaws) -> FloorAround:
    """Prepare the floor around a TCP, with no mask computed yet."""
    return FloorAround(raster, RingMasks(np.full(RINGS, _ALL), np.zeros(RINGS, np.bool_)), apart, yaws)


@njit(cache=True, inline="always")
def is_allowed(yaws: BaseYaws, yaw: float) -> bool:
    """Whether a base may have a yaw."""
    beyond = wrap(yaw - yaws.low - pi) + pi if yaws.span < inf else 0.0
    return beyond <= yaws.span + ROUNDING or beyond >= 2.0 * pi - ROUNDING


@njit(cache=True, **WITHOUT_REFERENCE_COUNTS)
def _free_sectors(raster: Raster, px: float, py: float, gap: float, ring: int) -> np.uint64:
    """The mask of one ring around a TCP at (px, py). The nearest free floor is at least `gap` [m] away.

    A point outside the raster is at least as far from free floor as the nearest point of the raster.
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
    """Rotate a mask of sectors so that `sector` becomes the first."""
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
    cell: NDArray[Any],
    where: NDArray[np.uint16],
    table: int,
    sectors: NDArray[np.uint64],
    rank: int,
    end: int,
    all_turns: NDArray[np.uint64],
) -> np.int64:
    """First rank from `rank` on whose base may be on free floor by the known masks, or `end`."""
    at, last, start = np.uint64(rank), np.uint64(end), np.uint64(table)
    while at < last:
        place = np.uint64(where[start + np.uint64(cell[at])])
        sector = (place >> _SECTOR_SHIFT) & _SECTOR_BITS
        if _turned_back(sectors[place >> _RING_SHIFT], sector) & all_turns[place & _PART_BITS] != 0:
            break
        at += _ONE
    return np.int64(at)


@njit(cache=True, inline="always")
def _next_in_order(
    bases: Bases,
    ranking: Ranking,
    start: int,
    place: TcpPlace,
    turns: Turns,
    around: FloorAround,
    taken: Floats,
    count: int,
) -> tuple[int, int]:
    """First base of a ranking, from `start` on, that is free and apart from the first `count` rows of `taken`.

    Returns the rank of the base and its turn, or (end of the key's ranking, -1) without such a base.

    In the ranking `rings`, a turn by one yaw sample of the map equals the next yaw sample of the same voxel. So only
    the best sample of each voxel is needed, and all its positions around the TCP are equally good.
    """
    raster, masks, places = around.raster, around.masks, bases.places
    cell, where = ranking.cell, places.where
    table = places.first[bases.kind[place.key % bases.groups]]
    bounded = raster.cells.size > 0
    gap = floor_gap(raster, place.x, place.y) - ROUNDING if bounded else 0.0
    end, steps = ranking.first[place.key + 1], ranking.skip.shape[1] - 1
    rank = max(start, ranking.skip[place.key, min(int(gap / RADIUS_STEP), steps)])
    tests, found = 0, -1
    while rank < end:
        free_sectors = _ALL
        if bounded and tests >= _FIRST:
            rank = _next_candidate(cell, where, table, masks.sectors, rank, end, turns.all_sectors)
            if rank == end:
                break
            spot = where[table + cell[rank]]
            ring = spot // (SECTORS * PARTS)
            if not masks.is_known[ring]:
                masks.sectors[ring], masks.is_known[ring] = _free_sectors(raster, place.x, place.y, gap, ring), True
                continue
            free_sectors = _turned_back(masks.sectors[ring], np.uint64(spot // PARTS % SECTORS))
        at = table + cell[rank]
        if places.radius[at] >= gap:
            part, x, y, turn = where[at] % PARTS, places.x[at], places.y[at], 0
            while found < 0 and turn < turns.directions.shape[0]:
                if turns.sectors[part, turn] & free_sectors != 0:
                    c, s = turns.directions[turn, 0], turns.directions[turn, 1]
                    at_x, at_y = place.x + c * x - s * y, place.y + s * x + c * y
                    if (
                        point_is_free(raster, at_x, at_y)
                        and is_apart(taken, count, at_x, at_y, around.apart)
                        and is_allowed(around.yaws, turns.yaws[turn] + places.yaw[at])
                    ):
                        found = turn
                turn += 1
            if found >= 0:
                break
            tests += 1
        rank += 1
    return rank, found


@njit(cache=True)
def turns_of(yaws: Floats) -> Floats:
    """(n, 2) cosines and sines."""
    turns = np.empty((yaws.shape[0], 2))
    for k in range(yaws.shape[0]):
        turns[k, 0], turns[k, 1] = cos(yaws[k]), sin(yaws[k])
    return turns


@njit(cache=True, inline="always")
def _outward(k: int, count: int) -> int:
    """The k-th of the numbers below `count`, ordered by distance from the middle, the lower number first."""
    half = (k + 1) // 2
    return (count - 1) // 2 + (half if (k + count) % 2 else -half)


@njit(cache=True)
def lay_out_turns(window: YawWindow) -> Turns:
    """Lay out the turns of a window.

    Turns nearest to the middle of the window come first. Turns that cover all yaws are equally good.
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


@njit(cache=True, **WITHOUT_REFERENCE_COUNTS)
def is_upright(bases: Bases, layer: int, group: int, local: int) -> bool:
    """Whether a cell and those above and below are reached, free of self-collision: CERTAIN_IN_HEIGHT."""
    upright = 0 < layer < bases.layers - 1
    for z in range(layer - 1, layer + 2):
        upright = upright and has_cell(bases.cells.free, bases.cells.offset[z * bases.groups + group], local)
    return upright


@njit(cache=True, **WITHOUT_REFERENCE_COUNTS)
def _is_certain_in_pitch(bases: Bases, layer: int, group: int, local: int) -> bool:
    """Whether `is_upright` holds at the neighbouring pitches and rolls too: CERTAIN_IN_PITCH."""
    beside, area = bases.beside, bases.places.area
    if beside[group, 0] < 0:
        return False
    for k in range(beside.shape[1]):
        other = beside[group, k]
        if other < 0:
            break
        if bases.yaws[other] == bases.yaws[group]:
            if not is_upright(bases, layer, other, local):
                return False
        else:
            for yaw in range(bases.yaws[other]):
                if not is_upright(bases, layer, other, yaw * area + local % area):
                    return False
    return True


@njit(cache=True, **WITHOUT_REFERENCE_COUNTS)
def _fill_row(bases: Bases, place: TcpPlace, turns: Turns, turn: int, local: int, row: Floats) -> None:
    """Write x, y, yaw, approach yaw, μ, torso, certain (0 or 1) of a base at a turn into `row` (7,)."""
    places, lower, upper = bases.places, bases.torso_lower, bases.torso_upper
    layer, group = place.key // bases.groups, place.key % bases.groups
    at = places.first[bases.kind[group]] + local
    c, s = turns.directions[turn, 0], turns.directions[turn, 1]
    code = code_of(bases.cells, place.key, local)
    height = bases.torsos[code & ((1 << bases.cells.torso_bits) - 1)]
    row[0] = place.x + c * places.x[at] - s * places.y[at]
    row[1] = place.y + s * places.x[at] + c * places.y[at]
    row[2] = wrap(turns.yaws[turn] + places.yaw[at])
    row[3] = wrap(turns.yaws[turn] + turns.yaw_shift)
    row[4] = bases.cells.levels[code >> bases.cells.torso_bits]
    torso = height + place.height_offset
    row[5] = min(upper, max(lower, torso)) if upper > lower else height
    in_range = bases.lift_is_free and upper > lower and lower <= torso <= upper
    inside = abs(place.height_offset) < 1e-9 or in_range
    certain = place.exact and (inside or is_upright(bases, layer, group, local))
    row[6] = 1.0 if certain or _is_certain_in_pitch(bases, layer, group, local) else 0.0


@njit(cache=True, inline="always")
def _best_bases(
    bases: Bases, ranking: Ranking, place: TcpPlace, turns: Turns, around: FloorAround, rows: Floats, progress: Integers
) -> None:
    """Write the k best bases for one TCP pose, each apart from all better bases, into `rows`.

    `rows` (k, 7): x, y, yaw, approach yaw, μ, torso, certain (0 or 1). `progress` (3,): rows filled, rank where the
    search continues, and the number of rows at which to pause. The search is over if fewer rows are filled.
    """
    turn = 0
    while turn >= 0 and progress[0] < min(progress[2], rows.shape[0]):
        k = progress[0]
        rank, turn = _next_in_order(bases, ranking, progress[1], place, turns, around, rows, k)
        progress[1] = rank + (around.apart < 0.0)
        if turn >= 0:
            _fill_row(bases, place, turns, turn, np.int64(ranking.cell[rank]), rows[k])
            progress[0] += 1


@njit(cache=True, **WITHOUT_REFERENCE_COUNTS)
def _best_bases_at_turns(
    bases: Bases, place: TcpPlace, turns: Turns, around: FloorAround, rows: Floats, progress: Integers
) -> None:
    """`_best_bases` in a kernel of its own. The layout of the turns allocates memory, and its reference counting would
    slow the search down."""
    ranking = bases.rings if turns.all_around and around.apart >= 0.0 else bases.ranked
    _best_bases(bases, ranking, place, turns, around, rows, progress)


@njit(cache=True)
def best_bases(
    bases: Bases,
    place: TcpPlace,
    window: YawWindow,
    raster: Raster,
    apart: float,
    yaws: BaseYaws,
    rows: Floats,
    progress: Integers,
) -> None:
    """Write the best bases for the turns of a window, `apart` from each other [m]. `rows` and `progress` as in
    `_best_bases`. If `apart` is negative, each ranked base is found at a single turn, because its other turns are the
    same for the arm."""
    _best_bases_at_turns(bases, place, lay_out_turns(window), floor_around(raster, apart, yaws), rows, progress)


@njit(cache=True, **WITHOUT_REFERENCE_COUNTS)
def _best_bases_of_some(
    bases: Bases,
    queries: PlaceQueries,
    order: Integers,
    turns: Turns,
    around: FloorAround,
    rows: Floats,
    counts: Integers,
    progress: Integers,
) -> None:
    """Write the best bases of the queries whose numbers are in `order`, all with the same turns."""
    ranking = bases.rings if turns.all_around else bases.ranked
    for i in order:
        progress[0], progress[1], progress[2] = 0, 0, rows.shape[1]
        if queries.keys[i] >= 0:
            x, y, offset = queries.positions[i, 0], queries.positions[i, 1], queries.height_offsets[i]
            place = TcpPlace(queries.keys[i], x, y, offset, queries.exact[i])
            for ring in range(RINGS):  # masks belong to one TCP
                around.masks.sectors[ring], around.masks.is_known[ring] = _ALL, False
            _best_bases(bases, ranking, place, turns, around, rows[i], progress)
        counts[i] = progress[0]
        for k in range(counts[i], rows.shape[1]):
            rows[i, k, :6] = np.nan
            rows[i, k, 6] = 0.0


@njit(cache=True)
def best_bases_batch(
    bases: Bases,
    queries: PlaceQueries,
    order: Integers,
    window: YawWindow,
    raster: Raster,
    apart: float,
    yaws: BaseYaws,
    rows: Floats,
    counts: Integers,
) -> None:
    """Write the best bases of the queries whose numbers are in `order` (m,), in this order.

    Neighbours with the same range share their turns. All queries share the rest of the `window`. `rows` (n, k, 7): as
    in `_best_bases`, with NaN where no base was found. `counts` (n,): bases found.
    """
    progress, around, ranges = np.zeros(3, np.int64), floor_around(raster, apart, yaws), queries.ranges
    first, end, shifts = 0, order.shape[0], queries.shifts
    while first < end:
        low, high, shift = ranges[order[first], 0], ranges[order[first], 1], shifts[order[first]]
        last = first + 1
        while (
            last < end
            and ranges[order[last], 0] == low
            and ranges[order[last], 1] == high
            and shifts[order[last]] == shift
        ):
            last += 1
        turns = lay_out_turns(YawWindow(low, high, window.step, window.samples, shift))
        _best_bases_of_some(bases, queries, order[first:last], turns, around, rows, counts, progress)
        first = last


class KeySet(NamedTuple):
    """n keys for kernels, of a set of gripper poses at one place. `numbers` (n,): numbers of the keys. `height_offsets`
    (n,): TCP height above the middles of their layers [m]. `exact` (n,): whether pitch and roll are exactly the key's.
    `window` (n,): index of each key's window of turns."""

    numbers: Integers
    height_offsets: Floats
    exact: NDArray[np.bool_]
    window: Integers


@njit(cache=True)
def best_bases_of_set(
    bases: Bases,
    keys: KeySet,
    windows: Floats,
    x: float,
    y: float,
    raster: Raster,
    apart: float,
    yaws: BaseYaws,
    rows: Floats,
) -> int:
    """Write the best bases of several keys together, `apart` from each other [m], into `rows` (k, 8): seven columns as
    in `_best_bases`, and the index of the key. Returns the number of bases.

    `windows` (w, 5): windows of turns, with the columns of `YawWindow`. Each key's upper bound is μ of its next base.
    The search takes the key with the highest bound and finds its next base that is free and apart. Its μ becomes the
    key's bound. This repeats until the base found is the best.
    """
    turns = [
        lay_out_turns(YawWindow(windows[w, 0], windows[w, 1], windows[w, 2], int(windows[w, 3]), windows[w, 4]))
        for w in range(windows.shape[0])
    ]
    around, count = floor_around(raster, apart, yaws), keys.numbers.shape[0]
    at, turn, bound = np.empty(count, np.int64), np.full(count, -1), np.empty(count)
    for n in range(count):
        at[n] = bases.ranked.first[keys.numbers[n]]
        if turns[keys.window[n]].all_around and apart >= 0.0:
            at[n] = bases.rings.first[keys.numbers[n]]
        bound[n] = inf
    filled = 0
    while filled < rows.shape[0]:
        n = int(np.argmax(bound))
        if bound[n] <= 0.0:
            break
        own = turns[keys.window[n]]
        ranking = bases.rings if own.all_around and apart >= 0.0 else bases.ranked
        place = TcpPlace(keys.numbers[n], x, y, keys.height_offsets[n], keys.exact[n])
        if turn[n] >= 0:
            local = np.int64(ranking.cell[at[n]])
            _fill_row(bases, place, own, turn[n], local, rows[filled])
            turn[n] = -1
            if is_apart(rows, filled, rows[filled, 0], rows[filled, 1], apart):
                rows[filled, 7] = n
                filled += 1
                at[n] += apart < 0.0
            bound[n] = _score(bases, place.key, ranking, at[n])
        else:
            at[n], turn[n] = _next_in_order(bases, ranking, at[n], place, own, around, rows, filled)
            bound[n] = _score(bases, place.key, ranking, at[n]) if turn[n] >= 0 else -1.0
    return filled


@njit(cache=True, **WITHOUT_REFERENCE_COUNTS)
def _score(bases: Bases, key: int, ranking: Ranking, rank: int) -> float:
    """Score to compare the base at a rank of a key with those of other keys. Negative at the ranking's end."""
    if rank >= ranking.first[key + 1]:
        return -1.0
    local = np.int64(ranking.cell[rank])
    mu = mu_of(bases.cells, key, local)
    if bases.by_certainty and is_upright(bases, key // bases.groups, key % bases.groups, local):
        mu += 1.0
    return mu


@lru_cache(maxsize=256)
def base_turns(window: YawWindow) -> Floats:
    """(n,) turns of a window, increasing, read-only."""
    turns = np.sort(lay_out_turns(window).yaws)
    turns.setflags(write=False)
    return turns


@njit(cache=True)
def disc_meets_floor(
    px: float, py: float, level: float, radius: float, turns: Floats, half_turn: float, raster: Raster
) -> bool:
    """Whether free floor lies within `radius` of the wrist centre, `level` behind the TCP [m], at any approach yaw.

    `turns` (n,): approach yaws, `2 half_turn` apart [rad].
    """
    if raster.cells.size == 0:
        return True
    slack = radius + level * half_turn + ROUNDING
    nearest = np.inf
    for turn in turns:
        nearest = min(nearest, floor_gap(raster, px - level * cos(turn), py - level * sin(turn)))
    return nearest <= slack


@njit(cache=True)
def any_base_near(
    bases: Bases,
    keys: Integers,
    px: float,
    py: float,
    yaws: Floats,
    turns: Floats,
    half_turn: float,
    raster: Raster,
    slack: float,
    allowed: BaseYaws,
) -> bool:
    """Whether any base of the `keys`, free of self-collision or not, lies within `slack` of free floor at a turn, with
    an `allowed` yaw.

    `yaws` (n,): the turns, `2 half_turn` apart [rad]. `turns` (n, 2): their cosines and sines. The slack is extended by
    the arc between two turns. The allowed yaws are extended by half a turn step and one and a half yaw samples.
    """
    places, first_tile = bases.places, bases.places.first_tile
    for kind in range(first_tile.shape[0] - 1):
        table = places.first[kind]
        some, samples = np.zeros(-(-(places.first[kind + 1] - table) // 64), np.uint64), 0
        for key in keys:
            if bases.kind[key % bases.groups] == kind:
                offset, samples = bases.cells.offset[key], bases.yaws[key % bases.groups]
                for k in range(some.shape[0]):
                    some[k] |= bases.cells.reached[offset + k]
        if samples == 0:
            continue
        wider = half_turn + 3.0 * pi / samples
        widened = BaseYaws(allowed.low - wider, allowed.span + 2.0 * wider)
        if widened.span >= 2.0 * pi:
            widened = BaseYaws(allowed.low, inf)
        for tile in range(first_tile[kind], first_tile[kind + 1]):
            if _is_tile_near(places, table, tile, some, px, py, yaws, turns, half_turn, raster, slack, widened):
                return True
    return False


@njit(cache=True, **WITHOUT_REFERENCE_COUNTS)
def _is_tile_near(
    places: Places,
    table: int,
    tile: int,
    some: NDArray[np.uint64],
    px: float,
    py: float,
    yaws: Floats,
    turns: Floats,
    half_turn: float,
    raster: Raster,
    slack: float,
    allowed: BaseYaws,
) -> bool:
    """`any_base_near` for the places of one tile whose bits are set in `some`."""
    first, last = places.tile_first[tile], places.tile_first[tile + 1]
    empty = True
    for k in range(first, last):
        empty = empty and not has_cell(some, 0, places.by_tile[k])
    if empty:
        return False
    bounded = raster.cells.size > 0
    tx, ty = places.tile_x[tile], places.tile_y[tile]
    distance = sqrt(tx * tx + ty * ty)
    reach = slack + distance * half_turn + places.tile_radius[tile] * (1.0 + half_turn) + ROUNDING
    if bounded and distance + reach < floor_gap(raster, px, py):
        return False
    turn = 0
    while turn < turns.shape[0]:
        c, s = turns[turn, 0], turns[turn, 1]
        if bounded:
            away = floor_distance(raster, px + c * tx - s * ty, py + s * tx + c * ty) - reach
            if away > 0.0:
                turn += 1 + int(SHORT * away / (distance * 2.0 * half_turn + ROUNDING))
                continue
        for k in range(first, last):
            local = places.by_tile[k]
            at = table + local
            if has_cell(some, 0, local) and is_allowed(allowed, yaws[turn] + places.yaw[at]):
                x = px + c * places.x[at] - s * places.y[at]
                y = py + s * places.x[at] + c * places.y[at]
                if not bounded or floor_distance(raster, x, y) <= slack + places.radius[at] * half_turn + ROUNDING:
                    return True
        turn += 1
    return False


_DIGIT = 11
"""Bits per pass of the radix sort. Two such digits hold every level of μ, see `irm.packed_cells`."""


@njit(cache=True)
def _descending(value: Integers, space: Integers) -> Integers:
    """Stable descending order of numbers ≥ 0 by radix sort. `space` (2, count or more) is scratch space."""
    starts, order, count = np.empty((1 << _DIGIT) + 1, np.int64), space[0], value.shape[0]
    for digit in range(2):
        starts[:] = 0
        for k in range(count):
            starts[(1 << _DIGIT) - (value[k] >> (digit * _DIGIT) & ((1 << _DIGIT) - 1))] += 1
        for k in range(1 << _DIGIT):
            starts[k + 1] += starts[k]
        order = space[digit]
        for k in range(count):
            at = k if digit == 0 else space[0, k]
            place = (1 << _DIGIT) - 1 - (value[at] >> (digit * _DIGIT) & ((1 << _DIGIT) - 1))
            order[starts[place]] = at
            starts[place] += 1
    return order


@njit(cache=True)
def rank_bases(  # noqa: C901  compiled: one loop over one state
    bases: Bases, cells: NDArray[Any], by_certainty: bool, only_rings: bool
) -> tuple[Integers, NDArray[np.int32]]:
    """Sort the bases of every key into `cells` (n,), best first. Returns `first` and `skip` of their `Ranking`.

    All free cells are ranked, or with `only_rings` the best cell of each voxel. Equal cells follow the order of tiles,
    or of voxels.
    """
    places, packed, groups = bases.places, bases.cells, bases.groups
    keys = bases.layers * groups
    width, steps = 0, 0
    for kind in range(places.first.shape[0] - 1):
        width = max(width, places.first[kind + 1] - places.first[kind])
    for at in range(places.radius.shape[0]):
        steps = max(steps, int(float(places.radius[at]) / RADIUS_STEP))
    first, skip = np.zeros(keys + 1, np.int64), np.zeros((keys, steps + 2), np.int32)
    local, value, space = np.empty(width, np.int64), np.empty(width, np.int64), np.empty((2, width), np.int64)
    best, best_value = np.empty(places.area, np.int64), np.empty(places.area, np.int64)
    filled = 0
    for key in range(keys):
        layer, group = key // groups, key % groups
        table, end = places.first[bases.kind[group]], places.first[bases.kind[group] + 1]
        count = 0
        if packed.offset[key] > 0:
            best[:] = -1
            for k in range(table, end):
                cell: int = np.int64(places.by_tile[k])  # type: ignore[assignment]  # int() would leave it at 32 bits
                if has_cell(packed.free, packed.offset[key], cell):
                    level = code_of(packed, key, cell) >> packed.torso_bits
                    if by_certainty and is_upright(bases, layer, group, cell):
                        level += packed.levels.shape[0]
                    voxel = cell % places.area
                    if not only_rings:
                        local[count], value[count] = cell, level
                        count += 1
                    elif best[voxel] < 0 or level > best_value[voxel]:
                        best[voxel], best_value[voxel] = cell, level
            if only_rings:
                for voxel in range(places.area):
                    if best[voxel] >= 0:
                        local[count], value[count] = best[voxel], best_value[voxel]
                        count += 1
        order = _descending(value[:count], space)
        first[key + 1] = filled + count
        for step in range(skip.shape[1]):
            skip[key, step] = filled + count
        for rank in range(count - 1, -1, -1):
            own = local[order[rank]]
            cells[filled + rank] = own
            skip[key, int(float(places.radius[table + own]) / RADIUS_STEP)] = filled + rank
        for step in range(skip.shape[1] - 2, -1, -1):
            skip[key, step] = min(skip[key, step], skip[key, step + 1])
        filled += count
    return first, skip


@njit(cache=True)
def bases_of_key(bases: Bases, key: int) -> tuple[Floats, Floats, Floats, Floats]:
    """x, y [m], yaw [rad] and μ, each (n,), of a key's bases relative to the TCP at approach yaw 0, best first."""
    first, last = bases.ranked.first[key], bases.ranked.first[key + 1]
    table = bases.places.first[bases.kind[key % bases.groups]]
    x, y, yaw, mu = np.empty(last - first), np.empty(last - first), np.empty(last - first), np.empty(last - first)
    for k in range(last - first):
        local = np.int64(bases.ranked.cell[first + k])
        at = table + local
        x[k], y[k], yaw[k] = bases.places.x[at], bases.places.y[at], bases.places.yaw[at]
        mu[k] = mu_of(bases.cells, key, local)
    return x, y, yaw, mu


@njit(cache=True)
def mu_of_cells(cells: PackedCells, key: int, local: Integers) -> Floats:
    """μ (n,) of cells of one key, given by their local numbers (n,)."""
    mu = np.empty(local.shape[0])
    for k in range(local.shape[0]):
        mu[k] = mu_of(cells, key, local[k])
    return mu
