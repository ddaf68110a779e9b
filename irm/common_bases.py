"""Base poses common to several TCP positions: the waypoints of a path, or several targets.

The search goes through the bases of one position, the reference, by decreasing μ. For each base, it reads μ of every
other position from the voxel that contains the position in the base frame. The score of a base is the smallest μ. It
cannot exceed μ of the reference, so the search ends as early as for a single position.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import cos, floor, pi, sin
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from irm.answers import BasePlacement, Status
from irm.base_decisions import SPARE_BASES, best_first
from irm.compilation import njit
from irm.errors import QueryError
from irm.free_space import Raster, point_is_free
from irm.ik.solvers import all_solutions
from irm.inverse_table import InverseTable
from irm.kinematics import wrap
from irm.packed_cells import code_of, has_cell, mu_of
from irm.query_kernels import SAME_PLACE, Bases, base_turns, is_allowed, is_apart
from irm.query_keys import FULL_TURN, BaseYaws, Key, QueryOptions, as_positions, as_yaw_ranges, find_key, yaw_window
from irm.robot_shape import SolidBoxes
from irm.rotations import as_poses, rotation, rotations, world_to_base, wrap_to_pi, yaw_pitch_roll

Floats = NDArray[np.float64]
_ROUNDING = 1e-5
"""Rounding of bases stored in single precision [m], and the excess allowed of a yaw beyond its window [rad]."""
_BASES_AT_A_TIME = 16
"""Bases computed by one call of the kernel: some milliseconds, after which the interpreter handles Ctrl-C."""
_TORSOS, _ROLLS = 8, 36
"""Torso heights and upper-arm rolls of the configurations whose wrist and forearm are tested against solid boxes."""


def place_for_path(
    table: InverseTable,
    waypoints: Floats,
    target: Floats | None,
    yaw_range: tuple[float, float],
    options: QueryOptions,
    solids: SolidBoxes | None,
) -> BasePlacement:
    """`InverseReachabilityMap.query_path` for waypoints (m, 3) in the world or, with a target, offsets from it."""
    in_world = waypoints if target is None else target + waypoints * (0, 0, 1)
    pitches, rolls = (np.full(len(waypoints), angle) for angle in (options.pitch, options.roll))
    keys = _keys(table, in_world, pitches, rolls, options)
    if keys is None:
        return BasePlacement.nothing(Status.NO, (len(waypoints),)).with_first_yaw()
    reference = table.rarest(keys)
    vertical = np.logical_not(waypoints[:, :2].any(axis=1))
    orientations = table.grid.orientations
    if target is not None and orientations.is_pole(keys[0].group) and orientations.free_roll and not vertical.all():
        raise QueryError(
            "a vertical approach has no horizontal direction: give offsets along z only, or the waypoints in the world"
        )
    turns = base_turns(yaw_window(table.grid, keys[reference], yaw_range, options.yaw_step))
    windows = np.tile(np.array([yaw_range]), (len(waypoints), 1))
    if target is None:
        points = pivots = np.repeat(waypoints[None], len(turns), axis=0)
        fixed = np.ones(len(waypoints), dtype=bool)
    else:
        yaws = turns + keys[reference].yaw_shift
        c, s = np.cos(yaws)[:, None], np.sin(yaws)[:, None]
        x, y, z = waypoints.T
        points = target + np.stack([c * x - s * y, s * x + c * y, np.broadcast_to(z, (len(turns), len(z)))], axis=2)
        pivots, fixed = np.broadcast_to(target, points.shape), vertical
    search = _Search(table, options, keys, reference, turns, points, windows, pitches, rolls, True, fixed)
    return (search.find() if solids is None else search.find_clear_of(solids, pivots)).with_first_yaw()


def place_for_targets(
    table: InverseTable, targets: ArrayLike, yaw_ranges: ArrayLike, pitches: Any, rolls: Any, options: QueryOptions
) -> BasePlacement:
    """`InverseReachabilityMap.query_multi` for targets (m, 3), or poses (m, 4, 4)."""
    points, windows, pitches, rolls = targets_of(targets, yaw_ranges, pitches, rolls, options)
    keys = _keys(table, points, pitches, rolls, options)
    if keys is None:
        return BasePlacement.nothing(Status.NO, (len(points),))
    reference = table.rarest(keys)
    low, high = windows[reference].tolist()
    turns = base_turns(yaw_window(table.grid, keys[reference], (low, high), options.yaw_step))
    at_turns, fixed = np.repeat(points[None], len(turns), axis=0), np.ones(len(points), dtype=bool)
    return _Search(table, options, keys, reference, turns, at_turns, windows, pitches, rolls, False, fixed).find()


def targets_of(
    targets: ArrayLike, yaw_ranges: ArrayLike, pitches: Any, rolls: Any, options: QueryOptions
) -> tuple[Floats, Floats, Floats, Floats]:
    """Positions (m, 3), ranges of yaws (m, 2), pitches and rolls (m,) of several targets, or of TCP poses (m, 4, 4).

    Raises:
        QueryError: these are no targets, or they do not go together.
    """
    if np.ndim(targets) == 3:
        if not (yaw_ranges is FULL_TURN and pitches is None and rolls is None):
            raise QueryError("poses (m, 4, 4) have their own angles; they go without yaw_ranges, pitches and rolls")
        T = as_poses(targets)
        yaw, pitch, roll = yaw_pitch_roll(T[:, :3, :3]).T
        return T[:, :3, 3], np.column_stack([yaw, yaw]), pitch, roll
    points, ranges = as_positions(targets), as_yaw_ranges(yaw_ranges)
    if len(ranges) not in (1, len(points)):
        raise QueryError(f"{len(points)} targets do not go with {len(ranges)} yaw ranges")
    angles: list[Floats] = []
    for name, given, common in (("pitches", pitches, options.pitch), ("rolls", rolls, options.roll)):
        try:
            values = np.broadcast_to(np.asarray(common if given is None else given, dtype=float), (len(points),))
        except (TypeError, ValueError):
            values = np.array([np.nan])
        if not np.isfinite(values).all():
            raise QueryError(f"{name} are finite numbers [rad], one for each of {len(points)} targets, not {given!r}")
        angles.append(np.array(values))
    return points, np.array(np.broadcast_to(ranges, (len(points), 2))), angles[0], angles[1]


def _keys(
    table: InverseTable, points: Floats, pitches: Floats, rolls: Floats, options: QueryOptions
) -> list[Key] | None:
    """The key of every position. None if a position is out of reach, or if no floor is free."""
    rows = zip(points[:, 2].tolist(), pitches.tolist(), rolls.tolist(), strict=True)
    found = [find_key(table.grid, z, pitch, roll) for z, pitch, roll in rows]
    keys = [key for key in found if key is not None]
    return None if len(keys) < len(found) or options.free_space.is_empty else keys


class _Found(NamedTuple):
    """k bases. `rows` (k, 5): x, y, yaw, smallest μ, certain. `torsos` and approach `yaws`: (k, m). `configurations`:
    (k, m, 1 + n) of exact answers."""

    rows: Floats
    torsos: Floats
    yaws: Floats
    configurations: Floats | None = None


@dataclass(frozen=True, eq=False)
class _Search:
    """One search for a base common to m positions.

    `keys`: (m,) keys of the positions. `reference`: index of the position whose bases are searched. `turns` (n,): turns
    of these bases. `points` (n, m, 3): the positions at each turn. `windows` (m, 2): range of approach yaws of each
    position. `pitches`, `rolls` (m,): angles of each position. `same_yaw`: whether all positions have one approach yaw.
    `fixed` (m,): whether a position is the same at every turn.
    """

    table: InverseTable
    options: QueryOptions
    keys: list[Key]
    reference: int
    turns: Floats
    points: Floats
    windows: Floats
    pitches: Floats
    rolls: Floats
    same_yaw: bool
    fixed: NDArray[np.bool_]

    def find(self) -> BasePlacement:
        """The best bases common to all positions."""
        k = self.options.k
        found = self._common_bases(k)
        if len(found.rows) and self._is_exact_wanted(found):
            kept = self._decided(found)
            if kept.rows[:, 4].sum() < len(found.rows):  # others may replace uncertain bases
                kept = self._decided(self._common_bases(k + SPARE_BASES))
            found = kept
        if len(found.rows):
            status = Status.YES if found.rows[:, 4].any() else Status.UNKNOWN
        else:
            status = Status.NO if self._is_out_of_reach() else Status.UNKNOWN
        return BasePlacement.of_multi_rows(*found[:3], status, found.configurations)

    def _is_exact_wanted(self, found: _Found) -> bool:
        """Whether to decide exactly. By default, for paths of arms with a fast closed form, and where no base is
        certain."""
        decisions = self.table.decisions
        by_default = (self.same_yaw and decisions.is_fast) or not found.rows[:, 4].any()
        return decisions.is_wanted(self.options, by_default)

    def find_clear_of(self, solids: SolidBoxes, pivots: Floats) -> BasePlacement:
        """The best common bases at the turns that keep gripper and wrist out of solid boxes.

        `pivots` (n, m, 3): points about which each position turns with the approach yaw.
        """
        n, m = self.points.shape[:2]
        axes = pivots.reshape(-1, 3)[:, :2]
        poses = self._poses()
        free = ~solids.block(poses, axes).reshape(n, m).any(axis=1)
        if not free.any():
            half = 0.5 * float(self.turns[1] - self.turns[0]) if n > 1 else 0.0
            blocked = solids.block(poses, axes, half).reshape(n, m).any(axis=1)
            is_no = blocked.all() or self._is_out_of_reach()
            return BasePlacement.nothing(Status.NO if is_no else Status.UNKNOWN, (m,))
        turns = self.turns[free]
        turns.setflags(write=False)  # as all turns, so that kernels are compiled only once
        search = replace(self, turns=turns, points=self.points[free])
        found = search.find()
        poses = search._poses().reshape(-1, m, 4, 4)
        certain = found.certain.copy()
        for rank in np.flatnonzero(certain):
            turn = search._turn_numbers(found.approach_yaw[rank : rank + 1, 0])[0]
            certain[rank] = search._is_clear(found.poses[rank], poses[turn], solids)
        certain.setflags(write=False)
        status = Status.UNKNOWN if found.status is Status.YES and not certain.any() else found.status
        return replace(found, status=status, certain=certain)

    def _common_bases(self, count: int) -> _Found:
        """At most `count` bases common to all positions, by the map."""
        table, key, windows = self.table, self.keys[self.reference], self.windows
        order = np.concatenate([[self.reference], np.delete(np.arange(len(self.keys)), self.reference)])
        shifts = np.array([one.yaw_shift for one in self.keys])
        spans = np.column_stack([windows[:, 0] - shifts, windows[:, 1] - windows[:, 0]])
        orientations = table.grid.orientations
        if orientations.free_roll:
            spans[[orientations.is_pole(one.group) for one in self.keys]] = -np.pi, 2 * np.pi
        points, apart = np.ascontiguousarray(self.points[:, order]), max(self.options.separation, SAME_PLACE)
        groups, exact = np.array([one.group for one in self.keys]), all(one.exact for one in self.keys)
        about = points, self.turns, spans[order], groups[order], self.same_yaw, apart, self.options.base_yaws
        query = MultiTargetQuery(key.number, exact, *about)
        rows, torsos, yaws = (np.empty((count, width)) for width in (5, len(self.keys), len(self.keys)))
        kernel = (table.bases_in(self.options.order), query, self.options.free_space.raster)
        found = wanted = 0
        while found == wanted < count:
            wanted = min(count, wanted + _BASES_AT_A_TIME)
            found = best_common_bases(*kernel, rows, torsos, yaws, found, wanted)
        back = np.argsort(order)
        return _Found(
            rows[:found], torsos[:found, back], np.asarray(wrap_to_pi(yaws[:found, back] + shifts), dtype=float)
        )

    def _decided(self, found: _Found) -> _Found:
        """The bases that may reach all positions, with exact configurations, their μ, and certainty."""
        points = self.points[self._turn_numbers(found.yaws[:, self.reference])]
        T = np.tile(np.eye(4), (*found.yaws.shape, 1, 1))
        pitches, rolls = (np.tile(angles, len(points)) for angles in (self.pitches, self.rolls))
        T[..., :3, :3] = rotations(found.yaws.reshape(-1), pitches, rolls).reshape(*found.yaws.shape, 3, 3)
        T[..., :3, 3] = points
        decided = self.table.decisions.decide(found.rows[:, :3], T)
        found.rows[:, 4] = certain = decided.certain
        order = best_first(found.rows[:, 3], certain, decided.may_reach)[: self.options.k]
        rows, torsos, q = found.rows[order], found.torsos[order], decided.configurations[order]
        sure = certain[order]
        q[sure], mu = self.table.decisions.improve(decided, order[sure], torsos[sure])
        rows[sure, 3], torsos[sure] = mu.min(axis=1), q[sure][..., 0]
        by_mu = best_first(rows[:, 3], sure, np.ones(len(rows), dtype=bool))
        return _Found(rows[by_mu], torsos[by_mu], found.yaws[order][by_mu], q[by_mu])

    def _turn_numbers(self, yaws: Floats) -> NDArray[np.int64]:
        """(k,) indices of the turns that belong to the approach yaws (k,) of the reference."""
        turns = yaws - self.keys[self.reference].yaw_shift
        return np.asarray(np.abs(wrap_to_pi(turns[:, None] - self.turns)).argmin(axis=1))

    def _poses(self) -> Floats:
        """(n * m, 4, 4) T_world_tcp at each turn and position of a path."""
        T = np.tile(np.eye(4), (*self.points.shape[:2], 1, 1))
        for turn, yaw in enumerate(self.turns + self.keys[self.reference].yaw_shift):
            T[turn, :, :3, :3] = rotation(float(yaw), self.options.pitch, self.options.roll)
        T[..., :3, 3] = self.points
        return T.reshape(-1, 4, 4)

    def _is_clear(self, base: Floats, T_world_tcp: Floats, solids: SolidBoxes) -> bool:
        """Whether open fingers avoid all boxes at TCP poses (m, 4, 4), and wrist and forearm in some configuration."""
        chain = self.table.reachability_map.chain
        if solids.block_open_fingers(T_world_tcp).any():
            return False
        for T in T_world_tcp[solids.may_block(T_world_tcp)]:
            if chain is None or not chain.has_closed_form:
                return False
            torsos = np.linspace(*self.table.grid.torso_range, _TORSOS)
            rolls = np.linspace(-np.pi, np.pi, _ROLLS, endpoint=False)
            if not solids.are_clear(T, all_solutions(chain, world_to_base(base) @ T, torsos, rolls)).any():
                return False
        return True

    def _is_out_of_reach(self) -> bool:
        """Whether a position certainly has no base, or two positions are too far apart for a common base."""
        points, options = self.points[0], self.options
        discs = [self.table.disc(point[2], pitch) for point, pitch in zip(points, self.pitches.tolist(), strict=True)]
        farthest = np.array([-np.inf if disc is None else sum(disc) for disc in discs])
        apart = np.linalg.norm(points[:, None, :2] - points[None, :, :2], axis=2)
        if np.any(apart > farthest[:, None] + farthest):
            return True
        return any(
            is_fixed and not self.table.may_exist(point, pitch, key, (low, high), options.free_space, options.base_yaws)
            for is_fixed, point, pitch, key, (low, high) in zip(
                self.fixed, points, self.pitches.tolist(), self.keys, self.windows, strict=True
            )
        )


class MultiTargetQuery(NamedTuple):
    """The positions that the base must reach, for kernels.

    `key`: key of the reference. `exact`: whether pitch and roll are exactly those of the map. `points` (n, m, 3): the m
    TCP positions at each of the n yaws of the reference, the reference first. `yaws` (n,): yaws of the reference [rad].
    `windows` (m, 2): lower end and length of each position's range of yaws [rad]. `groups` (m,): group (pitch, roll) of
    each position. `same_yaw`: whether all positions have the yaw of the reference. `apart`: smallest distance between
    two bases [m]. `base_yaws`: allowed yaws of the base.
    """

    key: int
    exact: bool
    points: Floats
    yaws: Floats
    windows: Floats
    groups: NDArray[np.int64]
    same_yaw: bool
    apart: float
    base_yaws: BaseYaws


@njit(cache=True, inline="always")
def _cell(bases: Bases, x: float, y: float, yaw: float, point: Floats, shift: float) -> tuple[int, int, int, bool]:
    """Layer, x and y index of the voxel that contains a point in a base frame, and whether it exists.

    `shift` 0.5 gives the lowest of the eight voxels whose centres surround the point, and whether all eight exist.
    """
    c, s = cos(yaw), sin(yaw)
    dx, dy = point[0] - x, point[1] - y
    layer = floor((point[2] - bases.corner[2]) / bases.thickness - shift)
    i = floor((c * dx + s * dy - bases.corner[0]) / bases.voxel - shift)
    j = floor((c * dy - s * dx - bases.corner[1]) / bases.voxel - shift)
    more = 1 if shift > 0.0 else 0
    side, layers = bases.side, bases.layers
    inside = 0 <= i < side - more and 0 <= j < side - more and 0 <= layer < layers - more
    return layer, i, j, inside


@njit(cache=True)
def _best_yaw(
    bases: Bases, group: int, x: float, y: float, yaw: float, point: Floats, low: float, span: float
) -> tuple[float, int]:
    """Best μ of a TCP position in the frame of a base over the yaw samples in the window, and its sample."""
    yaws, side = bases.yaws[group], bases.side
    layer, i, j, inside = _cell(bases, x, y, yaw, point, 0.0)
    best, sample = 0.0, -1
    if not inside:
        return best, sample
    key = layer * bases.groups + group
    for g in range(yaws):
        mu = mu_of(bases.cells, key, (g * side + i) * side + j)
        if mu > best:
            beyond = wrap(yaw + 2.0 * pi * g / yaws - low - pi) + pi
            if beyond <= span + _ROUNDING or beyond >= 2.0 * pi - _ROUNDING:
                best, sample = mu, g
    return best, sample


@njit(cache=True)
def _mu_at(bases: Bases, group: int, x: float, y: float, yaw: float, point: Floats, sample: int) -> float:
    """μ of a TCP position in the frame of a base at one yaw sample. Zero out of reach."""
    layer, i, j, inside = _cell(bases, x, y, yaw, point, 0.0)
    mu, side = 0.0, bases.side
    if inside:
        mu = mu_of(bases.cells, layer * bases.groups + group, (sample * side + i) * side + j)
    return mu


@njit(cache=True)
def _is_enclosed(bases: Bases, group: int, x: float, y: float, yaw: float, point: Floats, sample: int) -> bool:
    """Whether the eight cell centres around a TCP position are all reachable at one yaw sample."""
    layer, i, j, inside = _cell(bases, x, y, yaw, point, 0.5)
    if not inside:
        return False
    side = bases.side
    for a in range(2):
        offset = bases.cells.offset[(layer + a) * bases.groups + group]
        for b in range(2):
            for d in range(2):
                if not has_cell(bases.cells.free, offset, (sample * side + i + b) * side + j + d):
                    return False
    return True


@njit(cache=True)
def _best_common_base(
    bases: Bases, query: MultiTargetQuery, raster: Raster, taken: Floats, count: int
) -> tuple[float, int, int]:
    """Score, index and turn of the best free base that is apart from the first `count` rows of `taken`.

    Bases of the reference come by decreasing μ. Their score cannot exceed this μ.
    """
    best, best_base, best_turn = 0.0, -1, -1
    key, places, side = query.key, bases.places, bases.side
    group = key % bases.groups
    table = places.first[bases.kind[group]]
    points, yaws, windows = query.points, query.yaws, query.windows
    for rank in range(bases.ranked.first[key], bases.ranked.first[key + 1]):
        local = int(bases.ranked.cell[rank])
        own_mu = mu_of(bases.cells, key, local)
        if own_mu <= best:
            break
        at, own = table + local, local // (side * side)
        for turn in range(yaws.shape[0]):
            c, s = cos(yaws[turn]), sin(yaws[turn])
            x = points[turn, 0, 0] + c * places.x[at] - s * places.y[at]
            y = points[turn, 0, 1] + s * places.x[at] + c * places.y[at]
            if not point_is_free(raster, x, y) or not is_apart(taken, count, x, y, query.apart):
                continue
            yaw = yaws[turn] + places.yaw[at]
            if not is_allowed(query.base_yaws, yaw):
                continue
            score = own_mu
            for m in range(1, points.shape[1]):
                if query.same_yaw:
                    mu = _mu_at(bases, group, x, y, yaw, points[turn, m], own)
                else:
                    other = query.groups[m]
                    mu, _ = _best_yaw(bases, other, x, y, yaw, points[turn, m], windows[m, 0], windows[m, 1])
                score = min(score, mu)
                if score <= best:
                    break
            if score > best:
                best, best_base, best_turn = score, local, turn
    return best, best_base, best_turn


@njit(cache=True)
def best_common_bases(
    bases: Bases,
    query: MultiTargetQuery,
    raster: Raster,
    rows: Floats,
    torsos: Floats,
    yaws: Floats,
    done: int,
    last: int,
) -> int:
    """Write the best bases that reach every position into rows `done` to `last`. Earlier rows are filled already.

    `rows` (k, 5): x, y, yaw, smallest μ, certain (0 or 1). `torsos`, `yaws` (k, m): torso height and approach yaw of
    each position. Returns the number of filled rows: fewer than `last` if no more bases exist.
    """
    side, group, places = bases.side, query.key % bases.groups, bases.places
    for k in range(done, last):
        score, local, turn = _best_common_base(bases, query, raster, rows, k)
        if local < 0:
            return k
        c, s = cos(query.yaws[turn]), sin(query.yaws[turn])
        at, own = places.first[bases.kind[group]] + local, local // (side * side)
        x = query.points[turn, 0, 0] + c * places.x[at] - s * places.y[at]
        y = query.points[turn, 0, 1] + s * places.x[at] + c * places.y[at]
        yaw = query.yaws[turn] + places.yaw[at]
        certain = query.exact
        for m in range(query.points.shape[1]):
            point, sample, other = query.points[turn, m], own, query.groups[m]
            if not query.same_yaw and m > 0:
                _, sample = _best_yaw(bases, other, x, y, yaw, point, query.windows[m, 0], query.windows[m, 1])
            layer, i, j, _ = _cell(bases, x, y, yaw, point, 0.0)
            certain = certain and _is_enclosed(bases, other, x, y, yaw, point, sample)
            height_offset = point[2] - bases.corner[2] - (layer + 0.5) * bases.thickness
            code = code_of(bases.cells, layer * bases.groups + other, (sample * side + i) * side + j)
            torso = bases.torsos[code & ((1 << bases.cells.torso_bits) - 1)] + height_offset
            torsos[k, m] = min(bases.torso_upper, max(bases.torso_lower, torso))
            yaws[k, m] = wrap(yaw + 2.0 * pi * sample / bases.yaws[other])
        rows[k, 0], rows[k, 1], rows[k, 2], rows[k, 3] = x, y, wrap(yaw), score
        rows[k, 4] = 1.0 if certain else 0.0
    return last
