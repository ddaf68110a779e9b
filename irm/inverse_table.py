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

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from irm.equations import inverse_reachability_on_floor
from irm.reachability_map import ReachabilityMap

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
    voxel = voxel[order]
    by_voxel = _sorted_descending(voxel, bases[3])
    best: Integers = by_voxel[np.flatnonzero(np.diff(voxel[by_voxel], prepend=-1))]  # of each voxel
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
