"""The inverse reachability map of equation 5, and the fast placement queries."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Unpack

import numpy as np
from numpy.typing import ArrayLike, NDArray

from irm.errors import QueryError
from irm.floor.free_space import FreeSpace
from irm.floor.solid_boxes import SolidBoxes
from irm.maps.reachability import ReachabilityMap
from irm.queries.arguments import (
    FULL_TURN,
    QueryKeywords,
    QueryOptions,
    as_position,
    as_positions,
    as_yaw_range,
    as_yaw_ranges,
)
from irm.queries.exact_bases import SPARE_BASES
from irm.queries.keyed_bases import KeyedBases
from irm.queries.keys import YawWindow, find_key, find_keys, flat_key, yaw_window
from irm.queries.multi_target import place_for_path, place_for_path_at, place_for_targets
from irm.queries.placement import BasePlacement, PlacementBatch
from irm.queries.placement_kernel import SAME_PLACE, PlaceQueries, best_bases_batch, best_bases_in_window
from irm.queries.search_kernel import TcpPlace
from irm.queries.status import Status
from irm.queries.tiles import Tiles
from irm.visibility.tie_break import OrderedRows, most_visible_first

__all__ = ["InverseReachabilityMap"]

Floats = NDArray[np.float64]

_ROWS_AT_A_TIME = 4096
"""Bases computed by one call of a kernel: some milliseconds, after which the interpreter handles Ctrl-C."""

_SQUARE = 0.1
"""[m] Edge of the squares of `_neighbours_together`; a row of sixteen has the length of a large table."""

_CLOSE_BASES = 64
"""Bases decided exactly, beyond the number wanted, before an answer is given without a certain base."""


class InverseReachabilityMap:
    """Equation 5: bases on the floor, found by height, pitch and roll of the TCP.

    T_eff = [R(0, β, α), (0, 0, z)], T_base = [Rz(-γ), Rz(π - γ) (x, y, 0)]: only x, y and yaw of the TCP are aligned,
    because the base moves in these three. Every base is on the ground by construction.

    All queries take the keyword arguments of `query`. An unknown keyword is a `QueryError` that lists the valid
    ones.

    Attributes:
        reachability_map: the map that was inverted.
        tiles: the bases as arrays, for kernels.

    Example:
        inverse_map = InverseReachabilityMap(ReachabilityMap.build(FETCH))
        placement = inverse_map.query((0.1, 0.0, 0.85), yaw_range=(-0.5, 0.5), free_space=floor, k=5)
        if placement.status is Status.YES: drive to placement.poses[0]
    """

    def __init__(self, reachability_map: ReachabilityMap) -> None:
        self.reachability_map = reachability_map
        self._bases = KeyedBases(reachability_map)
        self.tiles: Tiles = self._bases.tiles

    def __len__(self) -> int:
        return len(self.tiles.x)

    def query(
        self,
        position: Iterable[float],
        *,
        yaw_range: tuple[float, float] = FULL_TURN,
        **keywords: Unpack[QueryKeywords],
    ) -> BasePlacement:
        """The bases of highest μ from which the arm reaches a TCP pose.

        Args:
            position: (3,) of the TCP in the world, floor at z = 0 [m].
            yaw_range: allowed approach yaws in the world [rad], at most a full turn; (3.0, 3.4) crosses π. Ignored for
                a vertical approach of a wrist that rolls freely: every yaw of the TCP fits every yaw of the base.
            **keywords: the fields of `QueryOptions`:
                pitch: of the TCP [rad], 0 by default; a positive pitch points the approach down.
                roll: about the approach [rad], 0 by default; ignored by maps of robots whose wrist rolls freely.
                free_space: a `FreeSpace` where the base may stand; None, the default, for everywhere.
                k: number of bases to return at most, 1 by default.
                separation: smallest distance between two of them, 0.1 by default [m].
                yaw_step: largest distance between two approach yaws that are tried, 15 degrees by default [rad].
                exact: True to decide the bases by exact inverse kinematics: see `QueryOptions`.
                prefer: a `VisibilityMap`, to order bases of about the same μ by what the camera sees of the target.

        Returns:
            At most k bases, best first. The status is NO if certainly no base exists for any yaw in the range.

        Raises:
            QueryError: a number is not finite, the range is empty, a keyword is unknown, or the map does not cover this
                height or pitch.
        """
        options, bases = QueryOptions.of(keywords, "yaw_range"), self._bases
        grid, space = bases.grid, options.floor
        point, bounds = as_position(position), as_yaw_range(yaw_range)
        key = find_key(grid, point[2], options.pitch, options.roll)
        if key is None or space.is_empty:
            return BasePlacement.nothing(Status.NO)
        place = TcpPlace(flat_key(grid, key.layer, key.group), point[0], point[1], key.height_offset, key.exact)
        window = yaw_window(grid, key, bounds, options.yaw_step)
        if bases.exact.is_wanted(options, by_default=False):
            rows = self._decided_bases(place, window, space, point, options)
        else:
            rows = self._best_bases(place, window, space, options.compared, options.separation)
        if len(rows):
            if options.prefer is not None:
                rows = _preferred(rows[None], np.array([len(rows)]), np.array([point]), options).rows[0]
            return BasePlacement.of_rows(rows)
        possible = bases.may_exist(point, options.pitch, key, bounds, space)
        return BasePlacement.nothing(Status.UNKNOWN if possible else Status.NO)

    def query_batch(
        self,
        positions: ArrayLike,
        *,
        yaw_ranges: ArrayLike = FULL_TURN,
        **keywords: Unpack[QueryKeywords],
    ) -> PlacementBatch:
        """Many queries in one call; the answers have no status.

        Args:
            positions: (n, 3), or (3,) for one TCP position with several yaw ranges [m].
            yaw_ranges: (2,) for all queries, or (n, 2) one for each [rad].
            **keywords: as in `query`, for all queries.

        Raises:
            QueryError: as in `query`, or the numbers of positions and of yaw ranges do not match.

        Example:
            bins = [(yaw - 0.13, yaw + 0.13) for yaw in np.arange(-1.3, 1.31, 0.26)]
            choices = inverse_map.query_batch(position, yaw_ranges=bins, free_space=floor, k=2)
        """
        options = QueryOptions.of(keywords, "yaw_ranges")
        points, ranges = as_positions(positions), as_yaw_ranges(yaw_ranges)
        n = max(len(points), len(ranges))
        if len(points) not in (1, n) or len(ranges) not in (1, n):
            raise QueryError(f"{len(points)} positions do not go with {len(ranges)} yaw ranges")
        points = np.array(np.broadcast_to(points, (n, 3)), order="C")
        key, keys, height_offsets = find_keys(self._bases.grid, points[:, 2], options.pitch, options.roll)
        window = yaw_window(self._bases.grid, key, (float(ranges[0, 0]), float(ranges[0, 1])), options.yaw_step)
        queries = PlaceQueries(keys, points, height_offsets, self._turned_ranges(window, ranges, n), key.exact)
        order = _neighbours_together(keys, points) if len(ranges) == 1 else np.arange(n)
        rows, counts = np.empty((n, options.compared, 7)), np.empty(n, dtype=np.int64)
        apart = max(options.separation, SAME_PLACE)
        block = max(1, _ROWS_AT_A_TIME // options.compared)
        for first in range(0, n, block):
            some = order[first : first + block]
            best_bases_batch(self.tiles, queries, some, window, options.floor.raster, apart, rows, counts)
        if self._bases.exact.is_wanted(options, by_default=False):
            self._decide_batch(rows, counts, points, options)
        if options.prefer is not None:
            rows, counts = _preferred(rows, counts, points, options)
        return PlacementBatch.of_rows(rows, counts)

    def query_path(
        self,
        waypoints: ArrayLike,
        *,
        target: Iterable[float] | None = None,
        solids: SolidBoxes | None = None,
        yaw_range: tuple[float, float] = FULL_TURN,
        **keywords: Unpack[QueryKeywords],
    ) -> BasePlacement:
        """Bases from which the TCP reaches every point of a path at a constant orientation.

        μ of a base is the smallest one on the path.

        Args:
            waypoints: (m, 3) TCP positions in the world [m]; or, with a `target`, offsets from it in the approach
                frame (x along the approach's horizontal direction, y to its left, z up), such as
                [(-0.1, 0, 0), (0, 0, 0), (0, 0, 0.1)] for approach, grasp and lift.
            target: (3,) in the world [m], or None.
            solids: boxes, such as table tops, that gripper and wrist must not penetrate; None for none.
            yaw_range: as in `query`.
            **keywords: as in `query`.

        Returns:
            As `query`; `torso` is (k, m). YES says that every waypoint is reachable. It does not say that one
            continuous motion of the arm connects them: see `irm.checks.verification`.

        Raises:
            QueryError: as in `query`, or a vertical approach comes with offsets that are not vertical.
        """
        options = QueryOptions.of(keywords, "target", "solids", "yaw_range").without_preference("query_path")
        points, bounds = as_positions(waypoints), as_yaw_range(yaw_range)
        if target is None:
            return place_for_path(self._bases, points, bounds, options, solids)
        return place_for_path_at(self._bases, np.array(as_position(target)), points, bounds, options, solids)

    def query_multi(
        self,
        targets: ArrayLike,
        *,
        yaw_ranges: ArrayLike = FULL_TURN,
        **keywords: Unpack[QueryKeywords],
    ) -> BasePlacement:
        """Bases from which the TCP reaches each of several targets; μ of a base is the smallest one of the targets.

        Args:
            targets: (m, 3) TCP positions [m].
            yaw_ranges: (2,) for all targets, or (m, 2) one for each [rad].
            **keywords: as in `query`, for all targets.

        Returns:
            As `query`; `torso` and `approach_yaw` are (k, m), one for each target.

        Raises:
            QueryError: as in `query`, or the numbers of targets and of yaw ranges do not match.
        """
        options = QueryOptions.of(keywords, "yaw_ranges").without_preference("query_multi")
        return place_for_targets(self._bases, as_positions(targets), yaw_ranges, options)

    def _best_bases(
        self, place: TcpPlace, window: YawWindow, space: FreeSpace, count: int, separation: float
    ) -> Floats:
        """(m, 7) rows of `best_bases`, m ≤ count. Many are computed in parts, between which Ctrl-C is handled."""
        rows, progress = np.empty((count, 7)), np.zeros(3, dtype=np.int64)
        apart = max(separation, SAME_PLACE)
        while progress[0] == progress[2] < count:
            progress[2] += _ROWS_AT_A_TIME
            best_bases_in_window(self.tiles, place, window, space.raster, apart, rows, progress)
        return rows[: progress[0]]

    def _decided_bases(
        self,
        place: TcpPlace,
        window: YawWindow,
        space: FreeSpace,
        point: tuple[float, float, float],
        options: QueryOptions,
    ) -> Floats:
        """As `_best_bases`, decided exactly. If none of the bases reaches, more of them are tried, closer together."""
        tries = ((options.compared + SPARE_BASES, options.separation), (options.compared + _CLOSE_BASES, 0.0))
        for count, separation in tries:
            rows = self._best_bases(place, window, space, count, separation)
            rows = rows[self._decide(rows, np.tile(point, (len(rows), 1)), options)][: options.compared]
            if rows[:, 6].any():
                break
        return rows

    def _decide(self, rows: Floats, points: Floats, options: QueryOptions) -> NDArray[np.bool_]:
        """Whether the bases of rows (m, 7) may reach their points (m, 3); sets exact torso heights and certainty."""
        decided = self._bases.exact.decide(rows[:, :3], points[:, None], rows[:, 3, None], options)
        rows[:, 6] = decided.certain
        rows[decided.certain, 5] = decided.torso[decided.certain, 0]
        return decided.may_reach

    def _decide_batch(self, rows: Floats, counts: NDArray[np.int64], points: Floats, options: QueryOptions) -> None:
        """Decide the bases (n, k, 7) of a batch exactly, in place; those that do not reach are dropped."""
        rank = np.arange(options.compared)
        kept = rank < counts[:, None]
        found, some = rows[kept], points[np.nonzero(kept)[0]]
        kept[kept] = self._decide(found, some, options)
        rows[rank < counts[:, None]] = found
        order = np.argsort(np.logical_not(kept), axis=1, kind="stable")
        rows[:] = np.take_along_axis(rows, order[..., None], axis=1)
        counts[:] = kept.sum(axis=1)
        rows[rank >= counts[:, None]] = (*[np.nan] * 6, 0.0)

    def _turned_ranges(self, window: YawWindow, ranges: Floats, n: int) -> Floats:
        """(n, 2) lowest and highest turn of each query [rad]; `window` is that of the first range."""
        if len(ranges) == 1 or window.low != ranges[0, 0] - window.shift:
            return np.tile((window.low, window.high), (n, 1))
        return np.array(np.broadcast_to(ranges - window.shift, (n, 2)), order="C")


def _neighbours_together(keys: NDArray[np.int64], points: Floats) -> NDArray[np.int64]:
    """(n,) order of queries in which those of one key and one square of floor follow each other.

    Kernels then find most of what they look up in the processor's nearest memory, which saves a fifth of their time.
    """
    column, row = np.floor(points[:, :2].T * (1.0 / _SQUARE)).astype(np.int64) & 15
    place = ((keys - keys.min()) << 8) | (column << 4) | row
    if place.max() < 1 << 16:
        place = place.astype(np.uint16)
    return np.argsort(place, kind="stable")


def _preferred(rows: Floats, counts: NDArray[np.int64], points: Floats, options: QueryOptions) -> OrderedRows:
    """The first k of the bases (n, m, 7) of each of n points (n, 3), those preferred from which more is visible."""
    assert options.prefer is not None
    shares = np.zeros(rows.shape[:2])
    is_there = np.arange(rows.shape[1]) < counts[:, None]
    found, where = rows[is_there], points[np.nonzero(is_there)[0]]
    shares[is_there] = options.prefer.visible(found[:, :3], where, found[:, 3], options.pitch, options.roll)
    return most_visible_first(rows, counts, shares, options.k)
