"""The table of equation 5: the bases of every key [z, β, α], sorted so that a query tests few of them.

The key of a TCP pose is a layer of heights and an orientation group (pitch, roll) of the map; its bases are laid out
around the TCP at every allowed yaw. The bases of one key are grouped into square tiles by their position relative to
the TCP at approach yaw 0. Within a tile they are sorted by μ, and the tiles are sorted by their best μ. A query takes
the tiles in this order until no tile can contain a better base than the best one found so far. It skips tiles without
free floor nearby. This serves several positions at once. For a single one, the bases are ranked by μ: the first free
one is the best. For all approach yaws, only the best base of each voxel is ranked, which may lie at any angle around
the TCP.
"""

from __future__ import annotations

from functools import lru_cache
from math import copysign, pi
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from irm.equations import inverse_reachability_on_floor
from irm.errors import QueryError
from irm.grid import MapGrid, Orientations
from irm.query_options import approach_yaws
from irm.reachability_map import ReachabilityMap
from irm.rotations import wrap_to_pi

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
Integers = NDArray[np.int64]
TILE = 0.1
"""[m] Edge of a tile: two voxels, so that about twenty bases share one look-up of the floor."""
RADIUS_STEP = 0.025
"""[m] Step of the distances in `Ranking.skip`."""
SECTORS = 64
"""Directions around the TCP: the bits of one number."""
PARTS = 4
"""Parts of a sector: a base is known to lie in one of 256 directions."""
RING_WIDTH = 0.05
"""[m] of a ring of floor around the TCP."""
RINGS = 64
"""Number of rings; bases farther than all of them count for the last one."""


class Ranking(NamedTuple):
    """Bases of every key, best first.

    `base` (n,): their numbers; `radius` (n,): their distances from the TCP [m]; `first` (keys + 1,): where each key's
    bases begin; `skip` (keys, b): the first of a key's bases that is b `RADIUS_STEP` or farther from the TCP; `where`
    (n,): in which ring, `RING_WIDTH` wide, in which of the `SECTORS` around the TCP, and in which of its `PARTS` they
    are, (ring * SECTORS + sector) * PARTS + part.
    """

    base: NDArray[np.int32]
    x: Singles
    y: Singles
    radius: Singles
    where: NDArray[np.uint16]
    first: Integers
    skip: NDArray[np.int32]


class Tiles(NamedTuple):
    """Arrays for kernels.

    Per base, in order: `x`, `y` [m] and `yaw` [rad] relative to the TCP at approach yaw 0, `mu`, `torso` [m], `flags`.
    Per tile: its centre `tile_x`, `tile_y`, the distance `tile_radius` from there to its farthest base [m], its best
    `tile_mu`, and its bases `tile_first` to `tile_last`. Per key: `key_first` (keys + 1,) tiles and `base_first`
    (keys + 1,) bases. `ranked`: all bases by μ; `rings`: the best base of each voxel by μ. `torso_lower`,
    `torso_upper`: range in which the torso can follow the TCP's height [m]; equal if it is fixed.
    """

    x: Singles
    y: Singles
    yaw: Singles
    mu: Singles
    torso: Singles
    flags: NDArray[np.uint8]
    tile_x: Floats
    tile_y: Floats
    tile_radius: Floats
    tile_mu: Singles
    tile_first: Integers
    tile_last: Integers
    key_first: Integers
    base_first: Integers
    ranked: Ranking
    rings: Ranking
    torso_lower: float
    torso_upper: float


def invert_map(rm: ReachabilityMap) -> Tiles:
    """The bases of equation 5, one for every pose of a map, in tiles."""
    grid = rm.grid
    z, orientation, i, j = rm.indices()
    group = np.searchsorted(grid.orientations.start, orientation, side="right") - 1
    groups = len(grid.orientations.pitch)
    tcp_yaw = grid.orientations.yaw[orientation]
    x, y, yaw = inverse_reachability_on_floor(grid.axis(0)[i], grid.axis(1)[j], tcp_yaw)
    key, keys = z * groups + group, grid.layers * groups
    order, tiles = _tiles(key, keys, x, y, rm.manipulability)
    columns: tuple[NDArray[Any], ...] = (x, y, yaw, rm.manipulability, rm.torso)
    bases: list[NDArray[Any]] = [values[order].astype(np.float32) for values in columns]
    voxel = (key * grid.shape[2] + i) * grid.shape[3] + j
    best = _best_of_each(voxel[order], bases[3])
    base_first = np.searchsorted(key[order], np.arange(keys + 1))
    arrays = [*bases, rm.flags[order], *tiles, base_first]
    rankings = [_ranking(some, key[order], keys, bases) for some in (np.arange(len(order)), best)]
    for array in (*arrays, *rankings[0], *rankings[1]):
        array.setflags(write=False)
    return Tiles._make([*arrays, *rankings, *grid.torso_range])


def _tiles(key: Integers, keys: int, x: Floats, y: Floats, mu: Singles) -> tuple[Integers, tuple[NDArray[Any], ...]]:
    """The order of the bases, given each one's `key` in 0 … keys - 1, and `tile_x` to `key_first`."""
    half = int(np.ceil(max(np.abs(x).max(initial=0.0), np.abs(y).max(initial=0.0)) / TILE)) + 1
    column, row = np.floor(x / TILE).astype(np.int64) + half, np.floor(y / TILE).astype(np.int64) + half
    tile = (key * (2 * half) + column) * (2 * half) + row
    order = _sorted_descending(tile, mu)
    tile = tile[order]
    first = np.flatnonzero(np.diff(tile, prepend=-1))
    last = np.append(first[1:], len(tile)) if len(first) else first
    tile_x = (tile[first] // (2 * half) % (2 * half) - half + 0.5) * TILE
    tile_y = (tile[first] % (2 * half) - half + 0.5) * TILE
    size = last - first
    apart = np.hypot(x[order] - np.repeat(tile_x, size), y[order] - np.repeat(tile_y, size))
    radius = np.maximum.reduceat(apart, first) if len(first) else apart
    tile_mu = mu[order][first]
    tile_key = tile[first] // (2 * half) ** 2
    rank = _sorted_descending(tile_key, tile_mu)
    key_first = np.searchsorted(tile_key[rank], np.arange(keys + 1))
    return order, (*(values[rank] for values in (tile_x, tile_y, radius, tile_mu, first, last)), key_first)


def _best_of_each(voxel: Integers, mu: Singles) -> Integers:
    """The best base of each voxel."""
    by_voxel = _sorted_descending(voxel, mu)
    best: Integers = by_voxel[np.flatnonzero(np.diff(voxel[by_voxel], prepend=-1))]
    return best


def _ranking(some: Integers, key: Integers, keys: int, bases: list[NDArray[Any]]) -> Ranking:
    """Some of the bases, by key and μ.

    `key` (n,) of 0 … keys - 1, and `bases`, the columns `x`, `y`, `yaw`, `mu` and `torso` (n,), are those of all.
    """
    base = some[_sorted_descending(key[some], bases[3][some])]
    x, y, own_key = bases[0][base], bases[1][base], key[base]
    radius = np.hypot(x, y)
    first = np.searchsorted(own_key, np.arange(keys + 1))
    step = (radius.astype(float) / RADIUS_STEP).astype(np.int64)
    skip = np.repeat(first[1:, None], int(step.max(initial=0)) + 2, axis=1)
    rank = np.arange(len(base))[::-1]
    skip[own_key[rank], step[rank]] = rank
    skip = np.minimum.accumulate(skip[:, ::-1], axis=1)[:, ::-1]
    parts = SECTORS * PARTS
    part = (np.arctan2(y, x).astype(float) * (parts / (2 * np.pi)) // 1).astype(np.int64) % parts
    ring = np.minimum((radius.astype(float) / RING_WIDTH).astype(np.int64), RINGS - 1)
    return Ranking(
        base.astype(np.int32),
        x,
        y,
        radius,
        (ring * parts + part).astype(np.uint16),
        first,
        np.ascontiguousarray(skip, dtype=np.int32),
    )


def _sorted_descending(major: Integers, mu: Singles) -> Integers:
    """Order by `major`, then by decreasing `mu`: positive floats sort like their bits."""
    bits = mu.astype(np.float32).view(np.uint32).astype(np.uint64)
    return np.argsort((major.astype(np.uint64) << np.uint64(32)) | (np.uint64(0xFFFFFFFF) - bits), kind="stable")


_EXACT = 1e-6
"""[rad] within which a TCP orientation counts as that of the map's ring."""
_POLE_STEP = float(np.radians(15))
"""[rad] Largest distance between the turns around a vertical approach."""
_OUTER_STEP = float(np.radians(5))
"""[rad] between the turns at which the outer map is searched."""
_OUTER_STEPS = 1.5
"""Yaw samples by which the outer map extends beyond a reachable one: to the far edge of its neighbour."""


class Key(NamedTuple):
    """A layer and an orientation group of the map, and the TCP's offsets from them.

    `height_offset`: of the TCP above the layer's middle [m]. `exact`: whether pitch and roll are those of the group.
    `yaw_shift`: what to subtract from the approach yaw to get the turn; at a pole, the roll [rad].
    """

    layer: int
    group: int
    height_offset: float
    exact: bool
    yaw_shift: float


class YawWindow(NamedTuple):
    """A range of turns: yaws at which a key's bases are laid out around the TCP. Kernels lay out the turns themselves.

    `low`, `high` and the largest `step` between two turns [rad]; `samples`: for a full turn, the number of turns is a
    multiple of this; `shift`: what to add to a turn to get the approach yaw [rad].
    """

    low: float
    high: float
    step: float
    samples: int
    shift: float


def find_key(grid: MapGrid, z: float, pitch: float, roll: float) -> Key | None:
    """The key of a TCP at height `z` [m]; None if no arm configuration reaches this height.

    Raises:
        QueryError: an angle is not finite, or the map was built without this height or pitch.
    """
    group, exact, shift = _find_group(grid.orientations, pitch, roll)
    layer = grid.layer(z)
    if not 0 <= layer < grid.layers:
        _require_covered(grid, z)
        return None
    return Key(layer, group, z - grid.layer_height(layer), exact, shift)


def find_keys(grid: MapGrid, z: Floats, pitch: float, roll: float) -> tuple[Key, Integers, Floats]:
    """Keys of many TCP heights (n,) at one pitch and roll.

    Returns:
        A key whose layer and height offset have no meaning; key numbers (n,), -1 where the height is out of reach; and
        height offsets (n,) [m].

    Raises:
        QueryError: as `find_key`, for the lowest or the highest of them.
    """
    for height in (float(z.min()), float(z.max())):
        if not 0 <= grid.layer(height) < grid.layers:
            _require_covered(grid, height)
    group, exact, shift = _find_group(grid.orientations, pitch, roll)
    layers = np.floor((z - grid.bottom) / grid.thickness).astype(np.int64)
    keys = layers * len(grid.orientations.pitch) + group
    keys[(layers < 0) | (layers >= grid.layers)] = -1
    return Key(0, group, 0.0, exact, shift), keys, z - (grid.bottom + (layers + 0.5) * grid.thickness)


@lru_cache(maxsize=1024)
def _find_group(orientations: Orientations, pitch: float, roll: float) -> tuple[int, bool, float]:
    """Group of a pitch and a roll, whether they are exactly those of the group, and the yaw shift."""
    group = orientations.nearest(pitch, roll)
    exact = abs(pitch - float(orientations.pitch[group])) < _EXACT
    if orientations.free_roll:
        return group, exact, 0.0
    if orientations.is_pole(group):
        return group, exact, copysign(roll, pitch)
    off_roll = wrap_to_pi(roll - float(orientations.roll[group]))
    return group, exact and abs(off_roll) < _EXACT, 0.0


def _require_covered(grid: MapGrid, z: float) -> None:
    """Raise if a height is outside the grid because of the map's parameters, not because of the arm's reach."""
    if grid.cut_below if z < grid.bottom else grid.cut_above:
        raise QueryError(f"this map covers TCP heights {grid.bottom:.2f} to {grid.top:.2f} m, not {z:.3f} m")


def flat_key(grid: MapGrid, layer: int, group: int) -> int:
    """Number of a key; the groups of one layer have consecutive numbers."""
    return layer * len(grid.orientations.pitch) + group


def yaw_window(grid: MapGrid, key: Key, yaw_range: tuple[float, float], step: float) -> YawWindow:
    """The window of turns for a checked range of approach yaws.

    For a vertical approach of a wrist that rolls freely it is a full turn: the wrist makes up for the yaw.
    """
    orientations, shift = grid.orientations, key.yaw_shift
    samples = int(orientations.count[key.group])
    if orientations.free_roll and orientations.is_pole(key.group):
        return YawWindow(-pi, pi, min(step, _POLE_STEP), samples, shift)
    return YawWindow(yaw_range[0] - shift, yaw_range[1] - shift, step, samples, shift)


def base_turns(grid: MapGrid, key: Key, yaw_range: tuple[float, float], step: float) -> Floats:
    """(n,) turns for a checked range of approach yaws, as kernels lay them out, read-only; see `yaw_window`."""
    window = yaw_window(grid, key, yaw_range, step)
    return _turns(window.low, window.high, window.step, window.samples)


@lru_cache(maxsize=256)
def _turns(low: float, high: float, step: float, samples: int) -> Floats:
    turns = approach_yaws((low, high), step, samples)
    turns.setflags(write=False)
    return turns


def nearby_keys(grid: MapGrid, key: Key) -> Integers | None:
    """Numbers of the keys whose cells touch those of a key; None if the map was built without some of them."""
    orientations = grid.orientations
    if (key.layer == 0 and grid.cut_below) or (key.layer == grid.layers - 1 and grid.cut_above):
        return None
    layers = range(max(0, key.layer - 1), min(grid.layers, key.layer + 2))
    near = np.abs(orientations.pitch - orientations.pitch[key.group]) < 1.01 * orientations.step
    sides = len(np.unique(np.round(orientations.pitch[near] / orientations.step)))
    if not key.exact and sides < (2 if orientations.is_pole(key.group) else 3):
        return None
    return np.array([flat_key(grid, layer, int(group)) for layer in layers for group in np.flatnonzero(near)])


def outer_turns(grid: MapGrid, key: Key, yaw_range: tuple[float, float]) -> tuple[Floats, float]:
    """Turns (n,) for the outer map, and the largest distance of any yaw in the range from the nearest of them [rad]."""
    widening = _OUTER_STEPS * 2 * np.pi / grid.orientations.count[key.group]
    return linspace_angles((yaw_range[0] - key.yaw_shift - widening, yaw_range[1] - key.yaw_shift + widening))


def linspace_angles(span: tuple[float, float]) -> tuple[Floats, float]:
    """Yaws (n,) over a span, a full turn at most, and half their distance [rad]."""
    low, high = span if span[1] - span[0] < 2 * np.pi else (-np.pi, np.pi)
    count = max(1, int(np.ceil((high - low) / _OUTER_STEP)))
    return np.linspace(low, high, count + 1), (high - low) / count / 2
