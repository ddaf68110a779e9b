"""The inverse reachability map of equation 5, and the fast placement queries."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from irm.errors import QueryError
from irm.floor.free_space import EVERYWHERE, FreeSpace
from irm.maps.reachability import ReachabilityMap
from irm.queries.keys import Key, base_turns, find_key, find_keys, flat_key, nearby_keys, outer_turns
from irm.queries.multi_target import Limits, path_at_target, path_in_world, several_targets
from irm.queries.multi_target_kernel import GroupField, group_field
from irm.queries.placement import (
    FULL_TURN,
    SEPARATION,
    YAW_STEP,
    BasePlacement,
    PlacementBatch,
    as_count,
    as_position,
    as_positions,
    as_yaw_range,
)
from irm.queries.placement_kernel import SAME_PLACE, any_base_near, best_bases, best_bases_batch, turns_of
from irm.queries.status import Status
from irm.queries.tiles import invert_map

__all__ = ["InverseReachabilityMap"]

Floats = NDArray[np.float64]

_OUTER_VOXELS = 1.5 * float(np.sqrt(2.0))
"""Voxels by which the outer map reaches beyond a reachable one: its diagonal neighbour, to that one's far corner."""


class InverseReachabilityMap:
    """Equation 5: bases on the floor, keyed by the hand's height, pitch and roll.

    T_eff = [R(0, β, α), (0, 0, z)], T_base = [Rz(-γ), Rz(π - γ) (x, y, 0)]: only x, y and yaw of the hand are aligned,
    the freedoms of the base. Every base is on the ground by construction.

    Example:
        inverse_map = InverseReachabilityMap(ReachabilityMap.build(FETCH))
        placement = inverse_map.query((0.1, 0.0, 0.85), yaw_range=(-0.5, 0.5), free_space=floor, k=5)
        if placement.status is Status.YES: drive to placement.poses[0]
    """

    def __init__(self, reachability_map: ReachabilityMap) -> None:
        self.reachability_map = reachability_map
        self.tiles = invert_map(reachability_map)
        self._fields: dict[int, GroupField] = {}

    def __len__(self) -> int:
        return len(self.tiles.x)

    def query(
        self,
        position: Iterable[float],
        *,
        pitch: float = 0.0,
        roll: float = 0.0,
        yaw_range: tuple[float, float] = FULL_TURN,
        free_space: FreeSpace | None = None,
        k: int = 1,
        separation: float = SEPARATION,
        yaw_step: float = YAW_STEP,
    ) -> BasePlacement:
        """The bases of highest μ from which the hand reaches a pose.

        Args:
            position: (3,) of the hand in the world, floor at z = 0 [m].
            pitch: of the hand [rad]; positive points the approach down.
            roll: about the approach [rad]; ignored by maps of robots whose wrist rolls freely.
            yaw_range: allowed approach yaws in the world [rad], at most a turn; (3.0, 3.4) crosses π. Ignored for a
                vertical approach of a hand that rolls freely: any yaw of the hand fits any yaw of the base.
            free_space: where the base may stand; None for everywhere.
            k: how many bases to return at most.
            separation: smallest distance between two of them [m].
            yaw_step: largest distance between the approach yaws tried [rad].

        Returns:
            At most k bases, best first. NO if certainly no base exists for any yaw in the range.

        Raises:
            QueryError: a number is not finite, the range is empty, or the map does not cover this height or pitch.
        """
        grid = self.reachability_map.grid
        point, bounds, space = as_position(position), as_yaw_range(yaw_range), free_space or EVERYWHERE
        rows = np.empty((as_count(k), 7))
        key = find_key(grid, point[2], pitch, roll)
        if key is None or space.is_empty:
            return BasePlacement.nothing(Status.NO)
        turns = base_turns(grid, key, bounds, yaw_step)
        found = best_bases(
            self.tiles,
            flat_key(grid, key.layer, key.group),
            point[0],
            point[1],
            key.height_offset,
            key.exact,
            *grid.torso_range,
            *turns,
            key.yaw_shift,
            space.raster,
            max(separation, SAME_PLACE),
            rows,
        )
        if found:
            return BasePlacement.of_rows(rows[:found])
        possible = self.may_exist(point, key, bounds, space)
        return BasePlacement.nothing(Status.UNKNOWN if possible else Status.NO)

    def query_batch(
        self,
        positions: ArrayLike,
        *,
        pitch: float = 0.0,
        roll: float = 0.0,
        yaw_ranges: ArrayLike = FULL_TURN,
        free_space: FreeSpace | None = None,
        k: int = 1,
        separation: float = SEPARATION,
        yaw_step: float = YAW_STEP,
    ) -> PlacementBatch:
        """Many queries at once, without telling NO from UNKNOWN.

        Args:
            positions: (n, 3), or (3,) for one hand position with several yaw ranges [m].
            pitch, roll, free_space, k, separation, yaw_step: as in `query`, for all.
            yaw_ranges: (2,) for all, or (n, 2) one for each [rad].

        Example:
            bins = [(yaw - 0.13, yaw + 0.13) for yaw in np.arange(-1.3, 1.31, 0.26)]
            choices = inverse_map.query_batch(position, yaw_ranges=bins, free_space=floor, k=2)
        """
        grid, space = self.reachability_map.grid, free_space or EVERYWHERE
        points, ranges = as_positions(positions), np.atleast_2d(np.asarray(yaw_ranges, dtype=float))
        n = max(len(points), len(ranges))
        if len(points) not in (1, n) or len(ranges) not in (1, n):
            raise QueryError(f"{len(points)} positions do not go with {len(ranges)} yaw ranges")
        points = np.ascontiguousarray(np.broadcast_to(points, (n, 3)))
        key, keys, rises = find_keys(grid, points[:, 2], pitch, roll)
        windows, window = np.unique(ranges, axis=0, return_inverse=True)
        turns = [base_turns(grid, key, as_yaw_range(bounds), yaw_step) for bounds in windows]
        rows, counts = np.empty((n, as_count(k), 7)), np.empty(n, dtype=np.int64)
        best_bases_batch(
            self.tiles,
            keys,
            points,
            rises,
            key.exact,
            *grid.torso_range,
            np.concatenate([choice.yaws for choice in turns]),
            np.concatenate([choice.directions for choice in turns]),
            np.array([choice.all_around for choice in turns]),
            np.cumsum([0] + [len(choice.yaws) for choice in turns]),
            np.ascontiguousarray(np.broadcast_to(window.reshape(-1), (n,))),
            key.yaw_shift,
            space.raster,
            max(separation, SAME_PLACE),
            rows,
            counts,
        )
        return PlacementBatch.of_rows(rows, counts)

    def query_path(
        self,
        waypoints: ArrayLike,
        *,
        target: Iterable[float] | None = None,
        pitch: float = 0.0,
        roll: float = 0.0,
        yaw_range: tuple[float, float] = FULL_TURN,
        free_space: FreeSpace | None = None,
        k: int = 1,
        separation: float = SEPARATION,
        yaw_step: float = YAW_STEP,
    ) -> BasePlacement:
        """Bases from which the hand reaches every point of a path without turning; μ is the smallest one on it.

        Args:
            waypoints: (m, 3) hand positions in the world [m]; or, with a `target`, offsets from it in the approach
                frame (x along the approach's horizontal direction, y to its left, z up), such as
                [(-0.1, 0, 0), (0, 0, 0), (0, 0, 0.1)] for approach, grasp and lift.
            target: (3,) or None.
            pitch, roll, yaw_range, free_space, k, separation, yaw_step: as in `query`.

        Returns:
            Like `query`; `torso` is (k, m). YES says that every waypoint is reachable, not that one continuous motion
            of the arm links them: see `irm.checks.verification`.
        """
        limits = Limits(pitch, roll, free_space or EVERYWHERE, as_count(k), separation, yaw_step)
        offsets = as_positions(waypoints)
        if target is None:
            return path_in_world(self, offsets, as_yaw_range(yaw_range), limits)
        return path_at_target(self, np.array(as_position(target)), offsets, as_yaw_range(yaw_range), limits)

    def query_multi(
        self,
        targets: ArrayLike,
        *,
        pitch: float = 0.0,
        roll: float = 0.0,
        yaw_ranges: ArrayLike = FULL_TURN,
        free_space: FreeSpace | None = None,
        k: int = 1,
        separation: float = SEPARATION,
        yaw_step: float = YAW_STEP,
    ) -> BasePlacement:
        """Bases from which the hand reaches each of several targets; μ is that of the worst one.

        Args:
            targets: (m, 3) hand positions [m].
            pitch, roll, free_space, k, separation, yaw_step: as in `query`, for all targets.
            yaw_ranges: (2,) for all, or (m, 2) one for each [rad].

        Returns:
            Like `query`; `torso` and `approach_yaw` are (k, m), one for each target.
        """
        limits = Limits(pitch, roll, free_space or EVERYWHERE, as_count(k), separation, yaw_step)
        return several_targets(self, as_positions(targets), yaw_ranges, limits)

    def field(self, group: int) -> GroupField:
        """The map of one orientation group as a dense array, made when first asked for."""
        if group not in self._fields:
            self._fields[group] = group_field(self.reachability_map, group)
        return self._fields[group]

    def may_exist(self, point: Sequence[float], key: Key, yaw_range: tuple[float, float], space: FreeSpace) -> bool:
        """Whether the outer map, that of all cells next to a reachable one, has a base on or near free floor."""
        grid = self.reachability_map.grid
        keys = nearby_keys(grid, key)
        if keys is None:
            return True
        turns, half = outer_turns(grid, key, yaw_range)
        slack = _OUTER_VOXELS * grid.voxel
        return bool(any_base_near(self.tiles, keys, point[0], point[1], turns_of(turns), half, space.raster, slack))
