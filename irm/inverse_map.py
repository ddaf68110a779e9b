"""Inverse reachability maps of equations 4 and 5, and their placement queries."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from typing import Unpack

import numpy as np
from numpy.typing import ArrayLike, NDArray

from irm.answers import BasePlacement, PlacementBatch, Status
from irm.base_decisions import BaseDecisions
from irm.errors import QueryError
from irm.free_space import FreeSpace
from irm.inverse_table import InverseTable, best_apart
from irm.pose_sets import poses_of_set
from irm.query_kernels import (
    SAME_PLACE,
    Bases,
    PlaceQueries,
    TcpPlace,
    base_turns,
    best_bases,
    best_bases_batch,
    best_bases_of_set,
)
from irm.query_keys import (
    FULL_TURN,
    BaseYaws,
    Key,
    QueryKeywords,
    QueryOptions,
    Range,
    YawWindow,
    as_position,
    as_position_and_angles,
    as_positions,
    as_positions_and_angles,
    as_yaw_range,
    as_yaw_ranges,
    checked_options,
    find_key,
    find_keys,
    yaw_window,
)
from irm.reachability_map import CERTAIN_IN_HEIGHT, CERTAIN_IN_PITCH, ReachabilityMap
from irm.robot_shape import SolidBoxes
from irm.rotations import rotation, rotations, wrap_to_pi

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
_ROWS_AT_A_TIME = 4096
"""Bases computed by one call of a kernel. It takes some milliseconds, after which the interpreter handles Ctrl-C."""
_SQUARE = 0.1
"""[m] Edge of the squares of `_neighbours_together`. Sixteen in a row have the length of a large table."""


class InverseReachabilityMap:
    """Equation 5: bases on the floor, found by height, pitch and roll of the TCP.

    T_eff = [R(0, β, α), (0, 0, z)], T_base = [Rz(-γ), Rz(π - γ) (x, y, 0)]: only x, y and yaw of the TCP are aligned,
    because the base moves in these three. Every base is on the ground by construction.

    All queries take these keyword arguments, for all positions of a call:

        pitch: of the TCP [rad], by default 0. A positive pitch points the approach down. In `query`, (low, high) is a
            range of pitches.
        roll: about the approach [rad], by default 0. Maps of robots whose wrist rolls freely ignore it. In `query`,
            (low, high) is a range of rolls.
        height: in `query`, a range (low, high) of heights of the TCP [m], in place of that of the position.
        base_yaw_range: allowed yaws of the base in the world, (low, high) [rad]. None, the default, allows all.
        free_space: floor where the base may stand. None, the default, allows every place.
        k: most bases to return, 1 to 100,000. By default 1.
        separation: smallest distance between two of them, by default 0.1 [m].
        yaw_step: largest step between two approach yaws [rad], at least 0.001. By default 15°.
        exact: whether exact inverse kinematics decides the bases. Bases that certainly do not reach are dropped,
            `certain` is exact, and μ and torso are those of `configurations`. None, the default, decides paths of arms
            with a closed form. It also decides in `query`, `query_path` and `query_multi` where the map is uncertain
            about the best base. In `query`, μ and order are then still those of the map.
        order: "manipulability", the default: highest μ first, as in the paper. "certainty": bases whose cells are
            reached over their whole height come first, so that fewer need a decision.

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
        """Find the bases of highest μ from which the arm reaches a TCP pose.

        Args:
            position: (3,) of the TCP in the world, floor at z = 0 [m], or its pose, an array (4, 4). A pose replaces
                yaw_range, pitch and roll too. With ranges of pitch, roll or height, the answer has the best bases for
                any pose of this set, each with its height, pitch and roll.
            yaw_range: allowed approach yaws in the world [rad], at most a full turn. (3.0, 3.4) crosses π. Ignored for
                a vertical approach of a wrist that rolls freely: every yaw of the TCP fits every yaw of the base.
            **keywords: of all queries.
        """
        if getattr(position, "ndim", 1) == 2:
            position, yaw_range, keywords = as_position_and_angles(position, yaw_range, keywords)
        options = checked_options(keywords, may_be_set=True)
        point, bounds = as_position(position), as_yaw_range(yaw_range)
        if options.ranges is not None:
            return self._query_set(point, options.ranges, bounds, options)
        table, space, bases = self._table, options.free_space, self._table.bases_in(options.order)
        key = find_key(table.grid, point[2], options.pitch, options.roll)
        if key is None or space.is_empty:
            return BasePlacement.nothing(Status.NO)
        place = TcpPlace(key.number, point[0], point[1], key.height_offset, key.exact)
        window = yaw_window(table.grid, key, bounds, options.yaw_step)

        def ranked(count: int, at_one_turn: bool) -> Floats:
            return _best_bases(bases, place, window, options, count, at_one_turn)

        rows, configurations = table.decisions.settle(ranked, poses_at(point, options), options)
        if len(rows):
            return BasePlacement.of_rows(rows, configurations, self.is_of_joints_alone)
        may_exist = table.may_exist(point, options.pitch, key, bounds, space, options.base_yaws)
        return BasePlacement.nothing(Status.UNKNOWN if may_exist else Status.NO)

    @property
    def is_of_joints_alone(self) -> bool:
        """Whether self-collision is unknown, because the arm has no shapes or the map ignores them."""
        chain = self.reachability_map.chain
        return chain is not None and not len(chain.shapes.pairs)

    def _query_set(
        self,
        point: tuple[float, float, float],
        ranges: tuple[Range, Range, Range | None],
        bounds: Range,
        options: QueryOptions,
    ) -> BasePlacement:
        """`query` for ranges of pitch, roll and height."""
        table, space, (pitch, roll, height) = self._table, options.free_space, ranges
        height = height or (point[2], point[2])
        poses = poses_of_set(table.grid, height, pitch, roll, bounds, options.yaw_step)
        if poses is None or space.is_empty:
            return BasePlacement.nothing(Status.NO)
        bases = table.bases_in(options.order)

        def ranked(count: int, at_one_turn: bool) -> Floats:
            apart = -SAME_PLACE if at_one_turn else max(options.separation, SAME_PLACE)
            rows = np.empty((count, 8))
            about = bases, poses.arrays, poses.windows, point[0], point[1], space.raster, apart, options.base_yaws
            return rows[: best_bases_of_set(*about, rows)]

        def poses_of(rows: Floats) -> Floats:
            T, angles = np.tile(np.eye(4), (len(rows), 1, 1)), poses.angles[rows[:, 7].astype(np.int64)]
            T[:, :3, :3] = rotations(rows[:, 3], angles[:, 1], angles[:, 2])
            T[:, :2, 3], T[:, 2, 3] = point[:2], angles[:, 0]
            return T

        rows, configurations = table.decisions.settle(ranked, poses_of, options)
        if not len(rows):
            keys = poses.keys
            may_exist = any(table.may_be_near(point, key, bounds, space, options.base_yaws) for key in keys)
            return BasePlacement.nothing(Status.UNKNOWN if may_exist else Status.NO)
        found = BasePlacement.of_rows(rows, configurations, self.is_of_joints_alone)
        angles = poses.angles[rows[:, 7].astype(np.int64)]
        angles.setflags(write=False)
        return replace(found, height=angles[:, 0], pitch=angles[:, 1], roll=angles[:, 2])

    def query_batch(
        self, positions: ArrayLike, *, yaw_ranges: ArrayLike = FULL_TURN, **keywords: Unpack[QueryKeywords]
    ) -> PlacementBatch:
        """Answer many queries in one call. The answers have no status.

        Args:
            positions: (n, 3), or (3,) for one TCP position with several yaw ranges [m]. Or TCP poses (n, 4, 4), each
                with its own yaw, pitch and roll.
            yaw_ranges: (2,) for all queries, or (n, 2) one for each [rad].
            **keywords: of all queries.

        Example:
            bins = [(yaw - 0.13, yaw + 0.13) for yaw in np.arange(-1.3, 1.31, 0.26)]
            choices = inverse_map.query_batch(position, yaw_ranges=bins, free_space=floor, k=2)
        """
        options = checked_options(keywords)
        grid = self._table.grid
        if np.ndim(positions) == 3:
            points, ranges, pitches, rolls = as_positions_and_angles(positions, yaw_ranges, keywords)
        else:
            points, ranges = as_positions(positions), as_yaw_ranges(yaw_ranges)
            pitches, rolls = np.full(1, options.pitch), np.full(1, options.roll)
        n = max(len(points), len(ranges))
        if len(points) not in (1, n) or len(ranges) not in (1, n):
            raise QueryError(f"{len(points)} positions do not go with {len(ranges)} yaw ranges")
        points = np.array(np.broadcast_to(points, (n, 3)), order="C")
        keys, offsets, shifts, exact = np.empty(n, np.int64), np.empty(n), np.empty(n), np.empty(n, np.bool_)
        turns, windows = np.empty((n, 2)), dict[YawWindow, list[Integers]]()
        angles, which = np.unique(np.column_stack([pitches, rolls]), axis=0, return_inverse=True)
        for number, (pitch, roll) in enumerate(angles.tolist()):
            mine = np.arange(n) if len(angles) == 1 else np.flatnonzero(which == number)
            key, keys[mine], offsets[mine] = find_keys(grid, points[mine, 2], pitch, roll)
            own = ranges if len(ranges) == 1 else ranges[mine]
            window = yaw_window(grid, key, (float(own[0, 0]), float(own[0, 1])), options.yaw_step)
            has_own = window.low == own[0, 0] - window.shift  # not one that serves all yaws
            turns[mine] = own - window.shift if has_own else (window.low, window.high)
            shifts[mine], exact[mine] = window.shift, key.exact
            windows.setdefault(window._replace(low=0.0, high=0.0, shift=0.0), []).append(mine)
        queries = PlaceQueries(keys, points, offsets, turns, shifts, exact)
        rows, counts = np.empty((n, options.k, 7)), np.empty(n, dtype=np.int64)
        apart, raster = max(options.separation, SAME_PLACE), options.free_space.raster
        block, bases = max(1, _ROWS_AT_A_TIME // options.k), self._table.bases_in(options.order)
        for window, numbers in windows.items():
            order = np.concatenate(numbers)
            if len(ranges) == 1:
                order = order[_neighbours_together(keys[order], points[order])]
            for first in range(0, len(order), block):
                some = order[first : first + block]
                best_bases_batch(bases, queries, some, window, raster, apart, options.base_yaws, rows, counts)
        if self._table.decisions.is_wanted(options, by_default=False):
            self._decide_batch(rows, counts, points, np.broadcast_to(angles[which.reshape(-1)], (n, 2)), options)
        return PlacementBatch.of_rows(rows, counts, self.is_of_joints_alone)

    def query_path(
        self,
        waypoints: ArrayLike,
        *,
        target: Iterable[float] | None = None,
        solids: SolidBoxes | None = None,
        yaw_range: tuple[float, float] = FULL_TURN,
        **keywords: Unpack[QueryKeywords],
    ) -> BasePlacement:
        """Find bases from which the TCP reaches every point of a path at a constant orientation.

        μ of a base is the smallest μ on the path.

        Args:
            waypoints: (m, 3) TCP positions in the world [m]. With a `target`, offsets from it in the approach frame: x
                along the approach's horizontal direction, y to its left, z up. Approach, grasp and lift are for
                instance [(-0.1, 0, 0), (0, 0, 0), (0, 0, 0.1)].
            target: (3,) in the world [m], or None.
            solids: boxes, such as table tops, that gripper and wrist must not penetrate. None if there are no boxes.
            yaw_range: as in `query`.
            **keywords: of all queries.

        Returns:
            Bases whose `torso` is (k, m). YES says that every waypoint is reachable. It does not say that one
            continuous motion of the arm connects them: see `irm.verify`.

        Raises:
            QueryError: as for all queries, or a vertical approach with offsets that are not vertical.
        """
        from irm.common_bases import place_for_path  # kernels and inverse kinematics are imported at the first use

        options = checked_options(keywords)
        points, bounds = as_positions(waypoints), as_yaw_range(yaw_range)
        origin = None if target is None else np.array(as_position(target))
        found = place_for_path(self._table, points, origin, bounds, options, solids)
        return replace(found, joints_alone=self.is_of_joints_alone)

    def query_multi(
        self,
        targets: ArrayLike,
        *,
        yaw_ranges: ArrayLike = FULL_TURN,
        pitches: ArrayLike | None = None,
        rolls: ArrayLike | None = None,
        arms: Sequence[InverseReachabilityMap] = (),
        **keywords: Unpack[QueryKeywords],
    ) -> BasePlacement:
        """Find bases from which the TCP reaches each of several targets. μ of a base is the smallest μ of the targets.

        Args:
            targets: (m, 3) TCP positions [m], or TCP poses (m, 4, 4), each with its own angles.
            yaw_ranges: (2,) for all targets, or (m, 2) one for each [rad].
            pitches, rolls: (m,) one for each target, in place of `pitch` and `roll` [rad].
            arms: m maps, one arm per target. The arms reach their targets at the same time, with the torso at one
                height, and answers are exact. By default this map's arm reaches all targets, one after another.
            **keywords: of all queries.

        Returns:
            Bases whose `torso` and `approach_yaw` are (k, m), one for each target.

        Example:
            both = left.query_multi([tray_left, tray_right], arms=(left, right), free_space=floor)
        """
        from irm.common_bases import place_for_targets, targets_of  # see `query_path`
        from irm.several_arms import place_for_arms

        options = checked_options(keywords)
        if not isinstance(arms, Sequence) or not all(isinstance(arm, InverseReachabilityMap) for arm in arms):
            raise QueryError("arms are a sequence of InverseReachabilityMap, one for each target")
        if arms:
            tables = [arm._table for arm in arms]
            found = place_for_arms(tables, *targets_of(targets, yaw_ranges, pitches, rolls, options), options)
            return replace(found, joints_alone=any(arm.is_of_joints_alone for arm in arms))
        found = place_for_targets(self._table, targets, yaw_ranges, pitches, rolls, options)
        return replace(found, joints_alone=self.is_of_joints_alone)

    def _decide_batch(
        self, rows: Floats, counts: Integers, points: Floats, angles: Floats, options: QueryOptions
    ) -> None:
        """Decide the bases (n, k, 7) of a batch exactly, in place. Bases that do not reach are dropped.

        `points` (n, 3), and `angles` (n, 2), pitch and roll, are those of the queries.
        """
        rank = np.arange(options.k)
        kept = rank < counts[:, None]
        found, query = rows[kept], np.nonzero(kept)[0]
        T = np.tile(np.eye(4), (len(found), 1, 1))
        T[:, :3, :3], T[:, :3, 3] = rotations(found[:, 3], *angles[query].T), points[query]
        may_reach = np.zeros(len(found), dtype=bool)
        may_reach[self._table.decisions.decide_rows(found, T, options)[0]] = True
        kept[kept] = may_reach
        rows[rank < counts[:, None]] = found
        order = np.lexsort((-rows[..., 4], -rows[..., 6], ~kept), axis=1)
        rows[:] = np.take_along_axis(rows, order[..., None], axis=1)
        counts[:] = kept.sum(axis=1)
        rows[rank >= counts[:, None]] = (*[np.nan] * 6, 0.0)


def poses_at(point: Sequence[float], options: QueryOptions) -> Callable[[Floats], Floats]:
    """T_world_tcp (m, 4, 4) of rows (m, 7), at a point and with the pitch and roll of the options."""

    def poses_of(rows: Floats) -> Floats:
        T, angle = np.tile(np.eye(4), (len(rows), 1, 1)), np.ones(len(rows))
        T[:, :3, :3] = rotations(rows[:, 3], options.pitch * angle, options.roll * angle)
        T[:, :3, 3] = point
        return T

    return poses_of


def _best_bases(
    bases: Bases, place: TcpPlace, window: YawWindow, options: QueryOptions, count: int, at_one_turn: bool
) -> Floats:
    """(m, 7) rows of the kernel, m ≤ count. Large counts are computed in parts, so that Ctrl-C is handled in
    between."""
    rows, progress = np.empty((count, 7)), np.zeros(3, dtype=np.int64)
    apart, raster = -SAME_PLACE if at_one_turn else max(options.separation, SAME_PLACE), options.free_space.raster
    while progress[0] == progress[2] < count:
        progress[2] += _ROWS_AT_A_TIME
        best_bases(bases, place, window, raster, apart, options.base_yaws, rows, progress)
    return rows[: progress[0]]


def _neighbours_together(keys: Integers, points: Floats) -> Integers:
    """(n,) order of queries that brings together queries of one key and one square of floor.

    Kernels then find most data in the processor's cache, which saves a fifth of their time.
    """
    column, row = np.floor(points[:, :2].T * (1.0 / _SQUARE)).astype(np.int64) & 15
    place = ((keys - keys.min()) << 8) | (column << 4) | row
    if place.max() < 1 << 16:
        place = place.astype(np.uint16)
    return np.argsort(place, kind="stable")


_UPRIGHT = 1e-6
"""1 - cos of the largest tilt of an upright base: larger than rounding, smaller than the step of pitch."""
_YAW_ROUNDING = 1e-5
"""[rad]"""
_BLOCK = 16_384
"""Transforms that are multiplied at a time, so that their result stays in the processor's cache."""


class ClassicalInverseReachabilityMap:
    """Equation 4: T_eff = I, T_base = T_eff⁻¹ for every pose of the reachability map.

    Only a query can tell which bases stand on the ground. For every allowed approach yaw, it moves the whole map to the
    TCP. It keeps the bases that are upright and at most half a layer from the floor.

    The half layer, and the nearest ring in place of the TCP's own pitch and roll, are the same as in the key of
    equation 5. So both maps have the same candidates and give the same best μ.

    Example:
        classical_map = ClassicalInverseReachabilityMap(ReachabilityMap.build(FETCH))
        placement = classical_map.query((0.1, 0.0, 0.85), yaw_range=(-0.5, 0.5), free_space=floor)
    """

    def __init__(self, reachability_map: ReachabilityMap) -> None:
        self.reachability_map = rm = reachability_map.subset(reachability_map.manipulability > 0)
        self._mu, self._torso, self._flags = rm.manipulability, rm.torso, rm.flags
        # In the order of certainty, bases whose cell is reached over its whole height come before all others. A map of
        # the joints alone is excepted: there a lift follows the height.
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
        """Find the bases of highest μ that reach a TCP pose. Arguments as in `InverseReachabilityMap.query`.

        The status is NO only if the TCP is out of the map's heights or no floor is free, because a base outside the map
        may exist. By default bases are decided as in that method, so that both maps give the same answers.

        Raises:
            QueryError: as in `InverseReachabilityMap.query`, or `exact` is true.
        """
        if getattr(position, "ndim", 1) == 2:
            position, yaw_range, keywords = as_position_and_angles(position, yaw_range, keywords)
        options = checked_options(keywords)
        if options.exact:
            raise QueryError("exact=True is for the map of equation 5: InverseReachabilityMap")
        grid, space = self.reachability_map.grid, options.free_space
        point, bounds = as_position(position), as_yaw_range(yaw_range)
        key = find_key(grid, point[2], options.pitch, options.roll)
        if key is None or space.is_empty:
            return BasePlacement.nothing(Status.NO)
        angles = grid.orientations.pitch[key.group], grid.orientations.roll[key.group]
        turns = base_turns(yaw_window(grid, key, bounds, options.yaw_step))
        per_yaw = [self._candidates(point, yaw, angles, space, options.base_yaws) for yaw in turns]
        base, x, y, base_yaw, approach = (np.concatenate(column) for column in zip(*per_yaw, strict=True))
        mu = self._mu[base]
        score = (self._mu if options.order == "manipulability" else self._by_certainty)[base]

        def ranked(count: int, at_one_turn: bool) -> Floats:
            if at_one_turn:  # the first turn of each base, in the order of the score
                _, first = np.unique(base, return_index=True)
                chosen = first[np.argsort(-score[first], kind="stable")][:count]
            else:
                chosen = best_apart(x, y, score, count, options.separation)
            torso, certain = self._torso_and_certainty(base[chosen], key)
            poses = np.column_stack([x, y, base_yaw, wrap_to_pi(approach + key.yaw_shift), mu])[chosen]
            return np.column_stack([poses, torso, certain])

        rows, configurations = self._decisions.settle(ranked, poses_at(point, options), options)
        if not len(rows):
            return BasePlacement.nothing(Status.UNKNOWN)
        chain = self.reachability_map.chain
        return BasePlacement.of_rows(rows, configurations, chain is not None and not len(chain.shapes.pairs))

    def _candidates(
        self,
        point: tuple[float, float, float],
        yaw: float,
        angles: tuple[float, float],
        space: FreeSpace,
        yaws: BaseYaws,
    ) -> tuple[Integers, Floats, Floats, Floats, Floats]:
        """Index, x, y, yaw and approach yaw of the bases on free ground, for the map moved to the TCP."""
        T_world_tcp = np.eye(4)
        T_world_tcp[:3, :3], T_world_tcp[:3, 3] = rotation(yaw, *angles), point
        on_ground = [self._on_ground(T_world_tcp, block) for block in self._blocks]
        base = np.concatenate([some + k * _BLOCK for k, (some, _) in enumerate(on_ground)] or [np.empty(0, np.int64)])
        x, y, base_yaw = np.concatenate([places for _, places in on_ground] or [np.empty((3, 0))], axis=1)
        free = space.are_free(x, y)
        if np.isfinite(yaws.span):
            free &= (base_yaw - yaws.low + _YAW_ROUNDING) % (2 * np.pi) <= yaws.span + 2 * _YAW_ROUNDING
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
