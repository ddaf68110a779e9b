"""The inverse reachability maps of equations 4 and 5, and their placement queries."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Unpack

import numpy as np
from numpy.typing import ArrayLike, NDArray

from irm.answers import BasePlacement, PlacementBatch, Status
from irm.base_decisions import BaseDecisions
from irm.errors import QueryError
from irm.free_space import FreeSpace
from irm.inverse_table import InverseTable, best_apart
from irm.query_kernels import (
    ANY_YAW,
    SAME_PLACE,
    Bases,
    PlaceQueries,
    TcpPlace,
    base_turns,
    best_bases,
    best_bases_batch,
)
from irm.query_keys import (
    FULL_TURN,
    Key,
    QueryKeywords,
    QueryOptions,
    YawWindow,
    as_position,
    as_position_and_angles,
    as_positions,
    as_yaw_range,
    as_yaw_ranges,
    checked_options,
    find_key,
    find_keys,
    yaw_window,
)
from irm.reachability_map import CERTAIN_IN_HEIGHT, CERTAIN_IN_PITCH, ReachabilityMap
from irm.robot_shape import SolidBoxes
from irm.rotations import rotation, wrap_to_pi

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
_ROWS_AT_A_TIME = 4096
"""Bases computed by one call of a kernel: some milliseconds, after which the interpreter handles Ctrl-C."""
_SQUARE = 0.1
"""[m] Edge of the squares of `_neighbours_together`; a row of sixteen has the length of a large table."""


class InverseReachabilityMap:
    """Equation 5: bases on the floor, found by height, pitch and roll of the TCP.

    T_eff = [R(0, β, α), (0, 0, z)], T_base = [Rz(-γ), Rz(π - γ) (x, y, 0)]: only x, y and yaw of the TCP are aligned,
    because the base moves in these three. Every base is on the ground by construction.

    All queries take these keyword arguments, for all positions of a call:

        pitch: of the TCP [rad], by default 0; a positive pitch points the approach down.
        roll: about the approach [rad], by default 0; ignored by maps of robots whose wrist rolls freely.
        free_space: where the base may stand; None, the default, for everywhere.
        k: number of bases to return at most, 1 to 100,000; by default 1.
        separation: smallest distance between two of them, by default 0.1 [m].
        yaw_step: largest distance between two approach yaws that are tried, at least 0.001; by default 15° [rad].
        exact: whether the bases are decided by exact inverse kinematics. Those that certainly do not reach are
            dropped, `certain` is exact, and μ and torso are those of `configurations`. None, the default: for paths of
            arms with a closed form; and in `query`, `query_path` and `query_multi` where the map is not certain of the
            best base. In `query` μ and order are then those of the map still.
        order: "manipulability", the default: highest μ first, as in the paper. "certainty": first those whose cells are
            reached over their whole height, so that fewer have to be decided.

    Their answers hold at most k bases, best first. The status is NO if certainly no base exists for any allowed yaw.
    They raise `QueryError` if a number is not finite, a range is empty, numbers of positions and ranges do not match,
    or the map does not cover this height or pitch.

    Attributes:
        reachability_map: the map that was inverted.
        bases: as arrays, for kernels.

    Example:
        inverse_map = InverseReachabilityMap(ReachabilityMap.build(FETCH))
        placement = inverse_map.query((0.1, 0.0, 0.85), yaw_range=(-0.5, 0.5), free_space=floor, k=5)
        if placement.status is Status.YES: drive to placement.poses[0]
    """

    def __init__(self, reachability_map: ReachabilityMap) -> None:
        self.reachability_map = reachability_map
        self._table = InverseTable(reachability_map)
        self.bases: Bases = self._table.bases

    def __len__(self) -> int:
        return len(self.reachability_map)

    def query(
        self,
        position: Iterable[float],
        *,
        yaw_range: tuple[float, float] = FULL_TURN,
        **keywords: Unpack[QueryKeywords],
    ) -> BasePlacement:
        """The bases of highest μ from which the arm reaches a TCP pose.

        Args:
            position: (3,) of the TCP in the world, floor at z = 0 [m]; or its pose, an array (4, 4), which stands for
                yaw_range, pitch and roll too.
            yaw_range: allowed approach yaws in the world [rad], at most a full turn; (3.0, 3.4) crosses π. Ignored for
                a vertical approach of a wrist that rolls freely: every yaw of the TCP fits every yaw of the base.
            **keywords: of all queries.
        """
        if getattr(position, "ndim", 1) == 2:
            position, yaw_range, keywords = as_position_and_angles(position, yaw_range, keywords)
        options = checked_options(keywords)
        table, space, bases = self._table, options.free_space, self._table.bases_in(options.order)
        grid = table.grid
        point, bounds = as_position(position), as_yaw_range(yaw_range)
        key = find_key(grid, point[2], options.pitch, options.roll)
        if key is None or space.is_empty:
            return BasePlacement.nothing(Status.NO)
        place = TcpPlace(key.number, point[0], point[1], key.height_offset, key.exact)
        window = yaw_window(grid, key, bounds, options.yaw_step)

        def ranked(count: int, at_one_turn: bool) -> Floats:
            separation = -SAME_PLACE if at_one_turn else options.separation
            return _best_bases(bases, place, window, space, count, separation)

        rows, configurations = table.decisions.settle(ranked, point, options)
        if len(rows):
            return BasePlacement.of_rows(rows, configurations)
        possible = table.may_exist(point, options.pitch, key, bounds, space)
        return BasePlacement.nothing(Status.UNKNOWN if possible else Status.NO)

    def query_batch(
        self, positions: ArrayLike, *, yaw_ranges: ArrayLike = FULL_TURN, **keywords: Unpack[QueryKeywords]
    ) -> PlacementBatch:
        """Many queries in one call; the answers have no status.

        Args:
            positions: (n, 3), or (3,) for one TCP position with several yaw ranges [m].
            yaw_ranges: (2,) for all queries, or (n, 2) one for each [rad].
            **keywords: of all queries.

        Example:
            bins = [(yaw - 0.13, yaw + 0.13) for yaw in np.arange(-1.3, 1.31, 0.26)]
            choices = inverse_map.query_batch(position, yaw_ranges=bins, free_space=floor, k=2)
        """
        options = checked_options(keywords)
        points, ranges = as_positions(positions), as_yaw_ranges(yaw_ranges)
        n = max(len(points), len(ranges))
        if len(points) not in (1, n) or len(ranges) not in (1, n):
            raise QueryError(f"{len(points)} positions do not go with {len(ranges)} yaw ranges")
        points = np.array(np.broadcast_to(points, (n, 3)), order="C")
        key, keys, height_offsets = find_keys(self._table.grid, points[:, 2], options.pitch, options.roll)
        window = yaw_window(self._table.grid, key, (float(ranges[0, 0]), float(ranges[0, 1])), options.yaw_step)
        if len(ranges) == 1 or window.low != ranges[0, 0] - window.shift:  # one window serves all
            turns = np.tile((window.low, window.high), (n, 1))
        else:
            turns = np.array(np.broadcast_to(ranges - window.shift, (n, 2)), order="C")
        shifts, exact = np.full(n, window.shift), np.full(n, key.exact)
        queries = PlaceQueries(keys, points, height_offsets, turns, shifts, exact)
        order = _neighbours_together(keys, points) if len(ranges) == 1 else np.arange(n)
        rows, counts = np.empty((n, options.k, 7)), np.empty(n, dtype=np.int64)
        apart = max(options.separation, SAME_PLACE)
        block, bases = max(1, _ROWS_AT_A_TIME // options.k), self._table.bases_in(options.order)
        for first in range(0, n, block):
            some = order[first : first + block]
            best_bases_batch(bases, queries, some, window, options.free_space.raster, apart, ANY_YAW, rows, counts)
        if self._table.decisions.is_wanted(options, by_default=False):
            self._decide_batch(rows, counts, points, options)
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
            **keywords: of all queries.

        Returns:
            Bases whose `torso` is (k, m). YES says that every waypoint is reachable. It does not say that one
            continuous motion of the arm connects them: see `irm.verify`.

        Raises:
            QueryError: see the class; or a vertical approach comes with offsets that are not vertical.
        """
        from irm.common_bases import place_for_path  # its kernels, and inverse kinematics, when first asked for

        options = checked_options(keywords)
        points, bounds = as_positions(waypoints), as_yaw_range(yaw_range)
        origin = None if target is None else np.array(as_position(target))
        return place_for_path(self._table, points, origin, bounds, options, solids)

    def query_multi(
        self,
        targets: ArrayLike,
        *,
        yaw_ranges: ArrayLike = FULL_TURN,
        arms: Sequence[InverseReachabilityMap] = (),
        **keywords: Unpack[QueryKeywords],
    ) -> BasePlacement:
        """Bases from which the TCP reaches each of several targets; μ of a base is the smallest one of the targets.

        Args:
            targets: (m, 3) TCP positions [m].
            yaw_ranges: (2,) for all targets, or (m, 2) one for each [rad].
            arms: m maps, the arm for each target at the same time, with the torso at one height; answers are then
                exact. By default this map's arm reaches all of them, one after another.
            **keywords: of all queries.

        Returns:
            Bases whose `torso` and `approach_yaw` are (k, m), one for each target.

        Example:
            both = left.query_multi([tray_left, tray_right], arms=(left, right), free_space=floor)
        """
        from irm.common_bases import place_for_targets  # see `query_path`
        from irm.several_arms import place_for_arms

        if arms:
            tables = [arm._table for arm in arms]
            return place_for_arms(tables, as_positions(targets), yaw_ranges, checked_options(keywords))
        return place_for_targets(self._table, as_positions(targets), yaw_ranges, checked_options(keywords))

    def _decide_batch(self, rows: Floats, counts: Integers, points: Floats, options: QueryOptions) -> None:
        """Decide the bases (n, k, 7) of a batch exactly, in place; those that do not reach are dropped."""
        rank = np.arange(options.k)
        kept = rank < counts[:, None]
        found, some = rows[kept], points[np.nonzero(kept)[0]]
        may_reach = np.zeros(len(found), dtype=bool)
        may_reach[self._table.decisions.decide_rows(found, some, options)[0]] = True
        kept[kept] = may_reach
        rows[rank < counts[:, None]] = found
        order = np.lexsort((-rows[..., 4], -rows[..., 6], ~kept), axis=1)
        rows[:] = np.take_along_axis(rows, order[..., None], axis=1)
        counts[:] = kept.sum(axis=1)
        rows[rank >= counts[:, None]] = (*[np.nan] * 6, 0.0)


def _best_bases(
    bases: Bases, place: TcpPlace, window: YawWindow, space: FreeSpace, count: int, separation: float
) -> Floats:
    """(m, 7) rows of the kernel, m ≤ count. Many are computed in parts, between which Ctrl-C is handled."""
    rows, progress = np.empty((count, 7)), np.zeros(3, dtype=np.int64)
    apart = separation if separation < 0.0 else max(separation, SAME_PLACE)
    while progress[0] == progress[2] < count:
        progress[2] += _ROWS_AT_A_TIME
        best_bases(bases, place, window, space.raster, apart, ANY_YAW, rows, progress)
    return rows[: progress[0]]


def _neighbours_together(keys: Integers, points: Floats) -> Integers:
    """(n,) order of queries in which those of one key and one square of floor follow each other.

    Kernels then find most of what they look up in the processor's nearest memory, which saves a fifth of their time.
    """
    column, row = np.floor(points[:, :2].T * (1.0 / _SQUARE)).astype(np.int64) & 15
    place = ((keys - keys.min()) << 8) | (column << 4) | row
    if place.max() < 1 << 16:
        place = place.astype(np.uint16)
    return np.argsort(place, kind="stable")


_UPRIGHT = 1e-6
"""1 - cos of the tilt up to which a base counts as upright: larger than rounding, smaller than the step of pitch."""
_BLOCK = 16_384
"""Transforms that are multiplied at a time, so that their result stays in the processor's cache."""


class ClassicalInverseReachabilityMap:
    """Equation 4: T_eff = I, T_base = T_eff⁻¹ for every pose of the reachability map.

    Which of these bases stand on the ground is known only at the query. The query moves the whole map to the TCP and
    keeps the bases that are upright and at most half a layer from the floor. It does so for every allowed approach yaw.

    The half layer, and the nearest ring in place of the TCP's own pitch and roll, are the same as in the key of
    equation 5. So both maps have the same candidates and give the same best μ.

    Example:
        classical_map = ClassicalInverseReachabilityMap(ReachabilityMap.build(FETCH))
        placement = classical_map.query((0.1, 0.0, 0.85), yaw_range=(-0.5, 0.5), free_space=floor)
    """

    def __init__(self, reachability_map: ReachabilityMap) -> None:
        self.reachability_map = rm = reachability_map.subset(reachability_map.manipulability > 0)
        self._mu, self._torso, self._flags = rm.manipulability, rm.torso, rm.flags
        # In the other order, bases whose cell is reached over its whole height come before all others; not where a lift
        # follows the height, in a map of the joints alone.
        is_first = (self._flags & CERTAIN_IN_HEIGHT > 0) & (rm.chain is not None) & rm.parameters.self_collision
        self._by_certainty = np.ldexp(self._mu, 64 * is_first)
        self._decisions = BaseDecisions(rm)
        T = _inverse_transforms(rm)
        self._blocks = [np.ascontiguousarray(T[:, k : k + _BLOCK]) for k in range(0, len(rm), _BLOCK)]

    def __len__(self) -> int:
        return len(self._mu)

    def query(
        self,
        position: Iterable[float],
        *,
        yaw_range: tuple[float, float] = FULL_TURN,
        **keywords: Unpack[QueryKeywords],
    ) -> BasePlacement:
        """The bases of highest μ from which the arm reaches a TCP pose; arguments as of `InverseReachabilityMap.query`.

        The status is NO only if the TCP is out of the map's height or no floor is free: a base that this map does not
        contain may still exist.

        Raises:
            QueryError: as of `InverseReachabilityMap.query`.
        """
        if getattr(position, "ndim", 1) == 2:
            position, yaw_range, keywords = as_position_and_angles(position, yaw_range, keywords)
        options = checked_options(keywords)
        grid, space = self.reachability_map.grid, options.free_space
        point, bounds = as_position(position), as_yaw_range(yaw_range)
        key = find_key(grid, point[2], options.pitch, options.roll)
        if key is None or space.is_empty:
            return BasePlacement.nothing(Status.NO)
        angles = grid.orientations.pitch[key.group], grid.orientations.roll[key.group]
        turns = base_turns(yaw_window(grid, key, bounds, options.yaw_step))
        per_yaw = [self._candidates(point, yaw, angles, space) for yaw in turns]
        base, x, y, base_yaw, approach = (np.concatenate(column) for column in zip(*per_yaw, strict=True))
        mu = self._mu[base]
        score = (self._mu if options.order == "manipulability" else self._by_certainty)[base]

        def ranked(count: int, at_one_turn: bool) -> Floats:
            if at_one_turn:  # the first one of each, in the order of the score
                _, first = np.unique(base, return_index=True)
                chosen = first[np.argsort(-score[first], kind="stable")][:count]
            else:
                chosen = best_apart(x, y, score, count, options.separation)
            torso, certain = self._torso_and_certainty(base[chosen], key)
            poses = np.column_stack([x, y, base_yaw, wrap_to_pi(approach + key.yaw_shift), mu])[chosen]
            return np.column_stack([poses, torso, certain])

        rows, configurations = self._decisions.settle(ranked, point, options)
        return BasePlacement.of_rows(rows, configurations) if len(rows) else BasePlacement.nothing(Status.UNKNOWN)

    def _candidates(
        self, point: tuple[float, float, float], yaw: float, angles: tuple[float, float], space: FreeSpace
    ) -> tuple[Integers, Floats, Floats, Floats, Floats]:
        """Index, x, y, yaw and approach yaw of the bases on free ground, for the map moved to the TCP."""
        T_world_tcp = np.eye(4)
        T_world_tcp[:3, :3], T_world_tcp[:3, 3] = rotation(yaw, *angles), point
        on_ground = [self._on_ground(T_world_tcp, block) for block in self._blocks]
        base = np.concatenate([some + k * _BLOCK for k, (some, _) in enumerate(on_ground)] or [np.empty(0, np.int64)])
        x, y, base_yaw = np.concatenate([places for _, places in on_ground] or [np.empty((3, 0))], axis=1)
        free = space.are_free(x, y)
        return base[free], x[free], y[free], base_yaw[free], np.full(np.count_nonzero(free), yaw)

    def _on_ground(self, T_world_tcp: Floats, block: Floats) -> tuple[Integers, Floats]:
        """Indices (m,) and x, y, yaw (3, m) of the bases that stand on the ground, for one block moved to the TCP."""
        T_world_base = (T_world_tcp @ block.reshape(4, -1)).reshape(block.shape)
        half = self.reachability_map.grid.thickness / 2
        height = T_world_base[2, :, 3]
        upright = (height >= -half) & (height < half) & (T_world_base[2, :, 2] > 1 - _UPRIGHT)
        base = np.flatnonzero(upright)
        yaw = np.arctan2(T_world_base[1, base, 0], T_world_base[0, base, 0])
        return base, np.stack([T_world_base[0, base, 3], T_world_base[1, base, 3], yaw])

    def _torso_and_certainty(self, base: Integers, key: Key) -> tuple[Floats, NDArray[np.bool_]]:
        """Torso height [m] of the chosen bases, and whether the arm certainly reaches from them."""
        rm = self.reachability_map
        lower, upper = rm.grid.torso_range
        torso, flags = self._torso[base], self._flags[base]
        follows = (torso + key.height_offset >= lower) & (torso + key.height_offset <= upper) & (upper > lower)
        inside = follows | (abs(key.height_offset) < 1e-9) | (flags & CERTAIN_IN_HEIGHT > 0)
        certain = (inside & key.exact) | (flags & CERTAIN_IN_PITCH > 0)
        return (np.clip(torso + key.height_offset, lower, upper) if upper > lower else torso), certain


def inverse_reachability(R: Floats, p: Floats) -> tuple[Floats, Floats]:
    """Equation 4: T_eff = I, T_base = T_eff⁻¹, for TCP orientations `R` (n, 3, 3) and positions `p` (n, 3) [m].

    Returns:
        Orientations (n, 3, 3) and positions (n, 3) of the base in the TCP frame.
    """
    R_base = R.transpose(0, 2, 1)
    return R_base, -np.einsum("nij,nj->ni", R_base, p)


def _inverse_transforms(rm: ReachabilityMap) -> Floats:
    """T_base of every pose (4, n, 4): row r of transform k is [r, k], so that one product transforms all of them."""
    R = np.array([rotation(*angles) for angles in rm.grid.orientations.angles])
    _, orientation, _, _ = rm.indices()
    R_base, p_base = inverse_reachability(R[orientation], rm.positions)
    T = np.zeros((4, len(rm), 4))
    T[:3, :, :3] = R_base.transpose(1, 0, 2)
    T[:3, :, 3] = p_base.T
    T[3, :, 3] = 1.0
    return T
