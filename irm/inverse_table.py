"""The table of equation 5: the bases of every key [z, β, α], sorted so that a query tests few of them.

The key of a TCP pose is a layer of heights and an orientation group (pitch, roll) of the map; its bases are laid out
around the TCP at every allowed yaw. Where a cell's base lies relative to the TCP at approach yaw 0 depends on its yaw,
x and y alone, so one table of places serves all keys with as many yaws. Of each base the number of its cell is stored,
in the order of μ: the first free one is the best. For all approach yaws, only the best base of each voxel is ranked,
which may lie at any angle around the TCP.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import cos, hypot, sin, sqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray

from irm.base_decisions import BaseDecisions
from irm.free_space import FreeSpace
from irm.grid import MapGrid
from irm.query_kernels import (
    PARTS,
    RING_WIDTH,
    RINGS,
    SAME_PLACE,
    SECTORS,
    Bases,
    Places,
    Ranking,
    any_base_near,
    bases_of_key,
    disc_meets_floor,
    mu_of_cells,
    rank_bases,
    turns_of,
)
from irm.query_keys import ANY_YAW, BaseYaws, Key, Order, linspace_angles, nearby_keys, outer_turns
from irm.reachability_map import ReachabilityMap, neighbouring_groups

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
Integers = NDArray[np.int64]
TILE = 0.1
"""[m] Edge of a tile: two voxels, so that about twenty places share one look-up of the floor."""
_OUTER_VOXELS = 1.5 * float(np.sqrt(2.0))
"""Voxels by which the outer map extends beyond a reachable one: to the far corner of its diagonal neighbour."""


class InverseTable:
    """The bases of equation 5, found by the key of a TCP pose: what all queries on them share.

    Attributes:
        reachability_map, grid: the map that was inverted, and its cells.
        bases: as arrays, for kernels.
        decisions: exact ones about bases.
    """

    def __init__(self, reachability_map: ReachabilityMap) -> None:
        self.reachability_map = reachability_map
        self.grid = reachability_map.grid
        self.decisions = BaseDecisions(reachability_map)
        self.bases = invert_map(reachability_map)
        self._in_order: dict[Order, Bases] = {"manipulability": self.bases}

    def bases_in(self, order: Order) -> Bases:
        """The bases in an order; those by certainty are sorted at the first call."""
        if order not in self._in_order:
            self._in_order[order] = in_order(self.bases, order)
        return self._in_order[order]

    def bases_of(self, key: Key) -> tuple[Floats, Floats, Floats, Floats]:
        """x, y [m], yaw [rad] and μ of the bases of a key relative to the TCP at approach yaw 0, best first."""
        x, y, yaw, mu = bases_of_key(self.bases, key.number)
        return x, y, yaw, mu

    def mu_of(self, group: int, layer: int, yaw: Integers, x: Integers, y: Integers) -> Floats:
        """μ of cells of one key, given by the numbers of their yaw, x and y, each (n,)."""
        side = 2 * self.grid.half
        key = layer * len(self.grid.orientations.pitch) + group
        return np.asarray(mu_of_cells(self.bases.cells, key, (yaw * side + x) * side + y))

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
        self,
        point: Sequence[float],
        pitch: float,
        key: Key,
        yaw_range: tuple[float, float],
        space: FreeSpace,
        base_yaws: BaseYaws = ANY_YAW,
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
        return self.may_be_near(point, key, yaw_range, space, base_yaws)

    def may_be_near(
        self,
        point: Sequence[float],
        key: Key,
        yaw_range: tuple[float, float],
        space: FreeSpace,
        base_yaws: BaseYaws = ANY_YAW,
    ) -> bool:
        """The same by the outer map alone, for every TCP pose in the cell of a key."""
        keys = nearby_keys(self.grid, key)
        if keys is None:
            return True
        turns, half = outer_turns(self.grid, key, yaw_range)
        slack = _OUTER_VOXELS * self.grid.voxel
        x, y = float(point[0]), float(point[1])
        return bool(any_base_near(self.bases, keys, x, y, turns, turns_of(turns), half, space.raster, slack, base_yaws))

    def count_of(self, key: Key) -> int:
        """Number of bases of a key."""
        first = self.bases.ranked.first
        return int(first[key.number + 1] - first[key.number])

    def rarest(self, keys: Sequence[Key]) -> int:
        """Index of the key with the fewest bases: the shortest list to search."""
        return int(np.argmin([self.count_of(key) for key in keys]))


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


_NO_RANKING = Ranking(np.empty(0, np.uint16), np.empty(0, np.int64), np.empty((0, 0), np.int32))
for _array in _NO_RANKING:
    _array.setflags(write=False)  # as of every ranking, so that kernels are compiled only once


def invert_map(rm: ReachabilityMap) -> Bases:
    """The bases of equation 5, one for every free pose of a map, by μ."""
    grid, counts = rm.grid, rm.grid.orientations.count
    kinds = np.unique(counts)
    kind = np.searchsorted(kinds, counts)
    torsos = np.array(grid.torsos)
    corner = np.array([*(centre - grid.half * grid.voxel for centre in grid.centre), grid.bottom])
    beside = neighbouring_groups(grid.orientations)
    for array in (kind, torsos, corner, beside):
        array.setflags(write=False)
    numbers = 2 * grid.half, len(counts), grid.layers
    lengths = grid.voxel, grid.thickness, *grid.torso_range
    is_lift_free = rm.chain is None or not rm.parameters.self_collision
    about = rm.packed, _places(grid, kinds), kind, counts, beside, torsos, corner, *numbers, *lengths, is_lift_free
    return _ranked(Bases(*about, False, _NO_RANKING, _NO_RANKING))


def in_order(bases: Bases, order: Order) -> Bases:
    """The same bases in another order.

    In the order of certainty, cells that are reached over their whole height come before all others. μ is that of a
    cell's centre; at other heights the cells above and below say whether the arm still reaches, free of itself. In a
    map of the joints alone a lift follows the height, so that μ alone counts.
    """
    return bases if order == "manipulability" or bases.lift_is_free else _ranked(bases._replace(by_certainty=True))


def _ranked(bases: Bases) -> Bases:
    """The bases with their rankings."""
    fits = int(np.diff(bases.places.first).max()) <= 1 << 16
    rankings, bases = [], bases._replace(ranked=_NO_RANKING, rings=_NO_RANKING)
    for only_rings in (False, True):
        cells = np.empty(len(bases.cells.codes), np.uint16 if fits else np.uint32)
        first, skip = rank_bases(bases, cells, bases.by_certainty, only_rings)
        ranking = Ranking(cells[: first[-1]].copy() if only_rings else cells, first, skip)
        for array in ranking:
            array.setflags(write=False)
        rankings.append(ranking)
    return bases._replace(ranked=rankings[0], rings=rankings[1])


def _places(grid: MapGrid, kinds: Integers) -> Places:
    """Where the bases of keys with each of these numbers of yaws lie."""
    columns: list[list[NDArray[Any]]] = []
    tiles: list[list[NDArray[Any]]] = []
    begun = 0
    for yaws in kinds.tolist():
        g, i, j = (index.ravel() for index in np.indices((yaws, 2 * grid.half, 2 * grid.half)))
        x, y, yaw = inverse_reachability_on_floor(grid.axis(0)[i], grid.axis(1)[j], g * (2 * np.pi / yaws))
        half = int(np.ceil(max(np.abs(x).max(), np.abs(y).max()) / TILE)) + 1
        column, row = np.floor(x / TILE).astype(np.int64) + half, np.floor(y / TILE).astype(np.int64) + half
        tile = column * (2 * half) + row
        by_tile = np.argsort(tile, kind="stable")
        first = np.flatnonzero(np.diff(tile[by_tile], prepend=-1))
        number, size = tile[by_tile][first], np.diff(first, append=len(tile))
        tile_x, tile_y = ((part - half + 0.5) * TILE for part in (number // (2 * half), number % (2 * half)))
        px, py, turn = (values.astype(np.float32) for values in (x, y, yaw))
        apart = np.hypot(px[by_tile] - np.repeat(tile_x, size), py[by_tile] - np.repeat(tile_y, size))
        tiles.append([tile_x, tile_y, np.maximum.reduceat(apart, first), first + begun])
        begun += len(tile)
        radius, parts = np.hypot(px, py), SECTORS * PARTS
        part = (np.arctan2(py, px).astype(float) * (parts / (2 * np.pi)) // 1).astype(np.int64) % parts
        ring = np.minimum((radius.astype(float) / RING_WIDTH).astype(np.int64), RINGS - 1)
        columns.append([px, py, radius, turn, (ring * parts + part).astype(np.uint16), by_tile.astype(np.int32)])
    tile_columns = [np.concatenate(values) for values in zip(*tiles, strict=True)]
    tile_columns[3] = np.append(tile_columns[3], begun)
    ends = (np.cumsum([0, *(len(some[0]) for some in part)]) for part in (columns, tiles))
    arrays = [*(np.concatenate(values) for values in zip(*columns, strict=True)), *tile_columns, *ends]
    for array in arrays:
        array.setflags(write=False)
    return Places._make([*arrays, (2 * grid.half) ** 2])
