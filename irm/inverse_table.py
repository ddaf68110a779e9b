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

from collections.abc import Sequence
from math import cos, hypot, sin, sqrt
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from irm.base_decisions import BaseDecisions
from irm.free_space import FreeSpace
from irm.query_kernels import (
    PARTS,
    RADIUS_STEP,
    RING_WIDTH,
    RINGS,
    SAME_PLACE,
    SECTORS,
    Ranking,
    Tiles,
    any_base_near,
    disc_meets_floor,
    turns_of,
)
from irm.query_keys import Key, Order, linspace_angles, nearby_keys, outer_turns
from irm.reachability_map import CERTAIN_IN_HEIGHT, ReachabilityMap

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
Integers = NDArray[np.int64]
TILE = 0.1
"""[m] Edge of a tile: two voxels, so that about twenty bases share one look-up of the floor."""
_OUTER_VOXELS = 1.5 * float(np.sqrt(2.0))
"""Voxels by which the outer map extends beyond a reachable one: to the far corner of its diagonal neighbour."""


class GroupField(NamedTuple):
    """The map of one pitch and roll as dense arrays `mu` and `torso` (layer, yaw, x, y), for kernels.

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


class InverseTable:
    """The bases of equation 5, found by the key of a TCP pose: what all queries on them share.

    Attributes:
        reachability_map, grid: the map that was inverted, and its cells.
        tiles: the bases as arrays, for kernels.
        decisions: exact ones about bases.
    """

    def __init__(self, reachability_map: ReachabilityMap) -> None:
        self.reachability_map = reachability_map
        self.decisions = BaseDecisions(reachability_map)
        self.grid = reachability_map.grid
        self.tiles = invert_map(reachability_map)
        self._fields: dict[int, GroupField] = {}
        self._in_order: dict[Order, Tiles] = {"manipulability": self.tiles}

    def tiles_in(self, order: Order) -> Tiles:
        """The bases in an order; those by certainty are sorted at the first call."""
        if order not in self._in_order:
            self._in_order[order] = invert_map(self.reachability_map, order)
        return self._in_order[order]

    def field(self, group: int) -> GroupField:
        """The map of one orientation group as a dense array, made at the first call."""
        if group not in self._fields:
            rm, grid, start = self.reachability_map, self.grid, self.grid.orientations.start
            layers, _, width, depth = grid.shape
            z, orientation, x, y = rm.indices()
            mine = (orientation >= start[group]) & (orientation < start[group + 1])
            place = z[mine], orientation[mine] - start[group], x[mine], y[mine]
            shape = layers, int(start[group + 1] - start[group]), width, depth
            mu, torso = np.zeros(shape, np.float32), np.zeros(shape, np.float32)
            mu[place], torso[place] = rm.manipulability[mine], rm.torso[mine]
            x0, y0 = (centre - grid.half * grid.voxel for centre in grid.centre)
            self._fields[group] = GroupField(mu, torso, x0, y0, grid.bottom, grid.voxel, grid.thickness)
        return self._fields[group]

    def disc(self, z: float, pitch: float) -> tuple[float, float] | None:
        """Where the arm's lengths allow the base to be for a TCP at a height [m] and pitch [rad]; None for nowhere.

        The base's centre is at most a radius from the wrist centre, which is a level distance behind the TCP. With a
        closed form, the wrist centre is at most upper arm + forearm away from the lift axis. For any other arm, the TCP
        is at most the sum of all link lengths away from the first joint. Without the arm's lengths, for the map of
        somebody else, the base may be everywhere.

        Returns:
            That distance and that radius, both horizontal [m].
        """
        chain = self.reachability_map.chain
        if chain is None:
            return 0.0, np.inf
        if chain.has_closed_form:
            pan_x, pan_z, shoulder_x, shoulder_z, upper_arm, forearm, gripper = chain.links.tolist()
            level, inner, reach = gripper * cos(pitch), abs(pan_x) + shoulder_x, upper_arm + forearm
            height = z + gripper * sin(pitch) - pan_z - shoulder_z
        else:
            x, y, shoulder = chain.shoulder.tolist()
            level, inner, reach, height = 0.0, hypot(x, y), chain.reach, z - shoulder
        low, high = self.grid.torso_range
        above = max(low - height, height - high, 0.0)
        return (level, inner + sqrt(reach * reach - above * above)) if above <= reach else None

    def may_exist(
        self, point: Sequence[float], pitch: float, key: Key, yaw_range: tuple[float, float], space: FreeSpace
    ) -> bool:
        """Whether a base may exist for a TCP at `point` (3,) [m]: within the arm's lengths, and in the outer map, on or
        near free floor. The outer map consists of all cells next to a reachable one."""
        disc, raster = self.disc(point[2], pitch), space.raster
        if disc is None:
            return False
        level, radius = disc
        yaws, half = linspace_angles((yaw_range[0], yaw_range[1]))
        if not disc_meets_floor(point[0], point[1], level, radius, yaws, half, raster):
            return False
        keys = nearby_keys(self.grid, key)
        if keys is None:
            return True
        turns, half = outer_turns(self.grid, key, yaw_range)
        slack = _OUTER_VOXELS * self.grid.voxel
        return bool(any_base_near(self.tiles, keys, point[0], point[1], turns_of(turns), half, raster, slack))

    def rarest(self, keys: Sequence[Key]) -> int:
        """Index of the key with the fewest bases: the shortest list to search."""
        numbers = np.array([key.number for key in keys])
        return int((self.tiles.base_first[numbers + 1] - self.tiles.base_first[numbers]).argmin())


def best_apart(x: Floats, y: Floats, score: NDArray[Any], count: int, separation: float) -> Integers:
    """Indices of at most `count` bases of highest score, each farther than `separation` [m] from the better ones."""
    chosen: list[int] = []
    left = score.astype(float)
    while len(chosen) < count and len(left) and left.max() > 0:
        best = int(left.argmax())
        chosen.append(best)
        if len(chosen) < count:
            left[np.hypot(x - x[best], y - y[best]) <= max(separation, SAME_PLACE)] = 0.0
    return np.array(chosen, dtype=np.int64)


def inverse_reachability_on_floor(x: Floats, y: Floats, yaw: Floats) -> tuple[Floats, Floats, Floats]:
    """Equation 5: T_eff = [R(0, β, α), (0, 0, z)], T_base = [Rz(-γ), Rz(π - γ) (x, y, 0)].

    The base stays on the floor, under a TCP at the origin with approach yaw 0. Height z, pitch β and roll α of the TCP
    do not change: they are the key by which the bases are found.

    Args:
        x, y: (n,) TCP positions in the base frame [m].
        yaw: (n,) TCP yaws γ in the base frame [rad].

    Returns:
        x, y [m] and yaw [rad] of the bases, each (n,).
    """
    c, s = np.cos(np.pi - yaw), np.sin(np.pi - yaw)
    return c * x - s * y, s * x + c * y, -yaw


def invert_map(rm: ReachabilityMap, bases_order: Order = "manipulability") -> Tiles:
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
    score = ranking_score(rm, bases[3], rm.flags[order], bases_order)
    by_voxel = _sorted_descending(voxel, score)
    best: Integers = by_voxel[np.flatnonzero(np.diff(voxel[by_voxel], prepend=-1))]  # of each voxel
    free = bases[3] > 0.0  # the others are in the tiles alone, where it is asked whether there is certainly no base
    base_first = np.searchsorted(key[order], np.arange(keys + 1))
    arrays = [*bases, rm.flags[order], *tiles, base_first]
    rankings = [_ranking(some, key[order], keys, bases, score) for some in (np.flatnonzero(free), best[free[best]])]
    for array in (*arrays, *rankings[0], *rankings[1]):
        array.setflags(write=False)
    return Tiles._make([*arrays, *rankings, *grid.torso_range, _lift_is_free(rm)])


def _lift_is_free(rm: ReachabilityMap) -> bool:
    """Whether a base is certain at other heights because the lift follows: not if the arm may touch the robot."""
    return rm.chain is None or not rm.parameters.self_collision


def ranking_score(rm: ReachabilityMap, mu: Singles, flags: NDArray[np.uint8], order: Order) -> Singles:
    """By what bases (n,) are ranked: μ; or, in the order of certainty, with cells that are reached over their whole
    height before all others.

    μ is that of a cell's centre. At other heights the cells above and below say whether the arm still reaches, free of
    itself. In a map of the joints alone a lift follows the height, so that μ alone counts.
    """
    if order == "manipulability" or _lift_is_free(rm):
        return mu
    return np.ldexp(mu, 64 * (flags & CERTAIN_IN_HEIGHT > 0))


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


def _ranking(some: Integers, key: Integers, keys: int, bases: list[NDArray[Any]], score: Singles) -> Ranking:
    """Some of the bases, by key and score.

    `key` (n,) of 0 … keys - 1, `bases`, the columns `x`, `y`, `yaw`, `mu` and `torso` (n,), and `score` (n,) are those
    of all.
    """
    base = some[_sorted_descending(key[some], score[some])]
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
