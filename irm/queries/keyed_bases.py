"""What all queries on equation 5 share: the bases in tiles, the dense map of a key, and the test for NO."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from irm.arm.reach_bound import WristDisc, wrist_disc
from irm.floor.free_space import FreeSpace
from irm.maps.grid import MapGrid
from irm.maps.reachability import ReachabilityMap
from irm.queries.exact_bases import ExactBases
from irm.queries.keys import Key, evenly, flat_key, nearby_keys, outer_turns
from irm.queries.multi_target_kernel import GroupField, group_field
from irm.queries.outer_map_kernel import any_base_near, disc_meets_floor
from irm.queries.placement_kernel import turns_of
from irm.queries.tiles import Tiles, invert_map

__all__ = ["KeyedBases"]

_OUTER_VOXELS = 1.5 * float(np.sqrt(2.0))
"""Voxels by which the outer map extends beyond a reachable one: to the far corner of its diagonal neighbour."""


class KeyedBases:
    """The bases of equation 5, found by the key of a TCP pose.

    Attributes:
        reachability_map: the map that was inverted.
        grid: its cells.
        tiles: the bases.
        exact: what decides bases by exact inverse kinematics.
    """

    def __init__(self, reachability_map: ReachabilityMap) -> None:
        self.reachability_map = reachability_map
        self.grid: MapGrid = reachability_map.grid
        self.tiles: Tiles = invert_map(reachability_map)
        self.exact = ExactBases(reachability_map)
        self._fields: dict[int, GroupField] = {}

    def field(self, group: int) -> GroupField:
        """The map of one orientation group as a dense array, made at the first call."""
        if group not in self._fields:
            self._fields[group] = group_field(self.reachability_map, group)
        return self._fields[group]

    def disc(self, z: float, pitch: float) -> WristDisc | None:
        """Where the arm's lengths allow the base to be for a TCP at a height [m] and pitch [rad]; None for nowhere.

        Without the arm's lengths, for the map of somebody else, it is everywhere.
        """
        chain = self.reachability_map.chain
        if chain is None:
            return WristDisc(0.0, np.inf)
        return wrist_disc(chain, self.grid.torso_range, z, pitch)

    def may_exist(
        self, point: Sequence[float], pitch: float, key: Key, yaw_range: tuple[float, float], space: FreeSpace
    ) -> bool:
        """Whether a base may exist: within the arm's lengths, and in the outer map, on or near free floor.

        The outer map consists of all cells next to a reachable one.

        Args:
            point: (3,) TCP position [m].
            pitch: of the TCP [rad].
            key: of the TCP pose.
            yaw_range: checked range of approach yaws [rad].
            space: the free floor.
        """
        disc, raster = self.disc(point[2], pitch), space.raster
        if disc is None:
            return False
        yaws, half = evenly((yaw_range[0], yaw_range[1]))
        if not disc_meets_floor(point[0], point[1], disc.level, disc.radius, yaws, half, raster):
            return False
        keys = nearby_keys(self.grid, key)
        if keys is None:
            return True
        turns, half = outer_turns(self.grid, key, yaw_range)
        slack = _OUTER_VOXELS * self.grid.voxel
        return bool(any_base_near(self.tiles, keys, point[0], point[1], turns_of(turns), half, raster, slack))

    def rarest(self, keys: Sequence[Key]) -> int:
        """Index of the key with the fewest bases: the shortest list to search."""
        flat = np.array([flat_key(self.grid, key.layer, key.group) for key in keys])
        return int((self.tiles.base_first[flat + 1] - self.tiles.base_first[flat]).argmin())
