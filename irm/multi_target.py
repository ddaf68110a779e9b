"""Placement queries for several TCP positions at once: a path, or several targets."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from irm.errors import QueryError
from irm.ik.closed_form import inverse
from irm.inverse_table import Key, base_turns, find_key, flat_key
from irm.keyed_bases import SPARE_BASES, KeyedBases
from irm.multi_target_kernel import MultiTargetQuery, best_common_bases
from irm.placement import BasePlacement
from irm.query_kernels import SAME_PLACE
from irm.query_options import QueryOptions, as_yaw_ranges
from irm.rotations import rotation, wrap_to_pi
from irm.solid_boxes import SolidBoxes
from irm.status import Status

Floats = NDArray[np.float64]

_BASES_AT_A_TIME = 16
"""Bases computed by one call of the kernel: some milliseconds, after which the interpreter handles Ctrl-C."""


_TORSOS, _ROLLS = 8, 36
"""Torso heights and upper-arm rolls of the configurations whose wrist and forearm are tested against solid boxes."""


class _Search(NamedTuple):
    """One search for a base common to m positions.

    `keys` m of them; `reference`: index of the position whose bases are searched; `turns` (n,) of these bases;
    `points` (n, m, 3): the positions at each turn; `windows` (m, 2): range of approach yaws of each; `same_yaw`:
    whether all positions have one approach yaw; `fixed` (m,): which positions are the same at every turn.
    """

    keys: list[Key]
    reference: int
    turns: Floats
    points: Floats
    windows: Floats
    same_yaw: bool
    fixed: NDArray[np.bool_]


class _Found(NamedTuple):
    """k bases: `rows` (k, 5) of x, y, yaw, smallest μ, certain; `torsos` and approach `yaws` (k, m)."""

    rows: Floats
    torsos: Floats
    yaws: Floats


def place_for_path(
    bases: KeyedBases,
    waypoints: Floats,
    yaw_range: tuple[float, float],
    options: QueryOptions,
    solids: SolidBoxes | None,
) -> BasePlacement:
    """`InverseReachabilityMap.query_path` for waypoints (m, 3) in the world."""
    keys = _keys(bases, waypoints, options)
    if keys is None:
        return _nothing(Status.NO, len(waypoints)).with_first_yaw()
    reference = bases.rarest(keys)
    turns = base_turns(bases.grid, keys[reference], yaw_range, options.yaw_step)
    points = np.repeat(waypoints[None], len(turns), axis=0)
    windows = np.tile(np.array([yaw_range]), (len(waypoints), 1))
    fixed = np.ones(len(waypoints), dtype=bool)
    search = _Search(keys, reference, turns, points, windows, True, fixed)
    return _find_path(bases, search, options, solids, points)


def place_for_path_at(
    bases: KeyedBases,
    target: Floats,
    offsets: Floats,
    yaw_range: tuple[float, float],
    options: QueryOptions,
    solids: SolidBoxes | None,
) -> BasePlacement:
    """`InverseReachabilityMap.query_path` for offsets (m, 3) from a target (3,), in the approach frame."""
    keys = _keys(bases, target + offsets * (0, 0, 1), options)
    if keys is None:
        return _nothing(Status.NO, len(offsets)).with_first_yaw()
    vertical = np.logical_not(offsets[:, :2].any(axis=1))
    orientations = bases.grid.orientations
    if orientations.is_pole(keys[0].group) and orientations.free_roll and not vertical.all():
        raise QueryError(
            "a vertical approach has no horizontal direction: give offsets along z only, or the waypoints in the world"
        )
    reference = bases.rarest(keys)
    turns = base_turns(bases.grid, keys[reference], yaw_range, options.yaw_step)
    yaws = turns + keys[reference].yaw_shift
    c, s = np.cos(yaws)[:, None], np.sin(yaws)[:, None]
    x, y, z = offsets.T
    points = target + np.stack([c * x - s * y, s * x + c * y, np.broadcast_to(z, (len(turns), len(z)))], axis=2)
    windows = np.tile(np.array([yaw_range]), (len(offsets), 1))
    search = _Search(keys, reference, turns, points, windows, True, vertical)
    return _find_path(bases, search, options, solids, np.broadcast_to(target, points.shape))


def place_for_targets(
    bases: KeyedBases, targets: Floats, yaw_ranges: ArrayLike, options: QueryOptions
) -> BasePlacement:
    """`InverseReachabilityMap.query_multi` for targets (m, 3)."""
    ranges = as_yaw_ranges(yaw_ranges)
    if len(ranges) not in (1, len(targets)):
        raise QueryError(f"{len(targets)} targets do not go with {len(ranges)} yaw ranges")
    windows = np.array(np.broadcast_to(ranges, (len(targets), 2)))
    keys = _keys(bases, targets, options)
    if keys is None:
        return _nothing(Status.NO, len(targets))
    reference = bases.rarest(keys)
    low, high = windows[reference]
    turns = base_turns(bases.grid, keys[reference], (float(low), float(high)), options.yaw_step)
    points = np.repeat(targets[None], len(turns), axis=0)
    fixed = np.ones(len(targets), dtype=bool)
    return _find(bases, _Search(keys, reference, turns, points, windows, False, fixed), options)


def _nothing(status: Status, positions: int) -> BasePlacement:
    return BasePlacement.of_multi_rows(np.empty((0, 5)), np.empty((0, positions)), np.empty((0, positions)), status)


def _keys(bases: KeyedBases, points: Floats, options: QueryOptions) -> list[Key] | None:
    """The key of every position; None if one of them is out of reach, or if no floor is free."""
    found = [find_key(bases.grid, float(z), options.pitch, options.roll) for z in points[:, 2]]
    keys = [key for key in found if key is not None]
    return None if len(keys) < len(found) or options.space.is_empty else keys


def _find_path(
    bases: KeyedBases, search: _Search, options: QueryOptions, solids: SolidBoxes | None, pivots: Floats
) -> BasePlacement:
    """`_find` at those turns at which gripper and wrist are in no solid box.

    Args:
        bases, search, options: as in `_find`.
        solids: boxes, or None for none.
        pivots: (n, m, 3) about which each position of the search turns with the approach yaw.
    """
    if solids is None:
        return _find(bases, search, options).with_first_yaw()
    n, m = search.points.shape[:2]
    poses = _poses_of(search, options)
    axes = pivots.reshape(-1, 3)[:, :2]
    free = ~solids.block(poses, axes).reshape(n, m).any(axis=1)
    if not free.any():
        half = 0.5 * float(search.turns[1] - search.turns[0]) if n > 1 else 0.0
        blocked = solids.block(poses, axes, half).reshape(n, m).any(axis=1)
        is_no = blocked.all() or _is_out_of_reach(bases, search, options)
        return _nothing(Status.NO if is_no else Status.UNKNOWN, m).with_first_yaw()
    turns = search.turns[free]
    turns.setflags(write=False)  # as all turns, so that kernels are compiled only once
    search = search._replace(turns=turns, points=search.points[free])
    found = _find(bases, search, options).with_first_yaw()
    poses = _poses_of(search, options).reshape(-1, m, 4, 4)
    certain = found.certain.copy()
    for rank in np.flatnonzero(certain):
        turn = _turn_numbers(search, found.approach_yaw[rank : rank + 1])[0]
        certain[rank] = _is_clear(bases, found.poses[rank], poses[turn], solids)
    certain.setflags(write=False)
    status = Status.UNKNOWN if found.status is Status.YES and not certain.any() else found.status
    return replace(found, status=status, certain=certain)


def _is_clear(bases: KeyedBases, base: Floats, T_world_tcp: Floats, solids: SolidBoxes) -> bool:
    """Whether the open fingers are in no box at TCP poses (m, 4, 4), and wrist and forearm in some configuration."""
    chain = bases.reachability_map.chain
    T_base_world = np.eye(4)
    T_base_world[:3, :3] = rotation(-float(base[2]), 0.0, 0.0)
    T_base_world[:2, 3] = -T_base_world[:2, :2] @ base[:2]
    if solids.block_open_fingers(T_world_tcp).any():
        return False
    for T in T_world_tcp[solids.may_block(T_world_tcp)]:
        if chain is None or not chain.has_closed_form:
            return False
        torsos = np.linspace(*bases.grid.torso_range, _TORSOS)
        q = inverse(chain, T_base_world @ T, torsos, np.linspace(-np.pi, np.pi, _ROLLS, endpoint=False))
        if not solids.are_clear(T, q).any():
            return False
    return True


def _poses_of(search: _Search, options: QueryOptions) -> Floats:
    """(n * m, 4, 4) T_world_tcp at each turn and position of a search for a path."""
    T = np.tile(np.eye(4), (*search.points.shape[:2], 1, 1))
    for turn, yaw in enumerate(search.turns + search.keys[search.reference].yaw_shift):
        T[turn, :, :3, :3] = rotation(float(yaw), options.pitch, options.roll)
    T[..., :3, 3] = search.points
    return T.reshape(-1, 4, 4)


def _find(bases: KeyedBases, search: _Search, options: QueryOptions) -> BasePlacement:
    """The best bases common to all positions of a search."""
    found = _common_bases(bases, search, options, options.k)
    if len(found.rows) and bases.is_exact_wanted(options, by_default=search.same_yaw):
        kept = _decided(bases, search, options, found)
        if len(kept.rows) < len(found.rows):
            kept = _decided(bases, search, options, _common_bases(bases, search, options, options.k + SPARE_BASES))
        found = _Found(*(column[: options.k] for column in kept))
    if len(found.rows):
        status = Status.YES if found.rows[:, 4].any() else Status.UNKNOWN
    else:
        status = Status.NO if _is_out_of_reach(bases, search, options) else Status.UNKNOWN
    return BasePlacement.of_multi_rows(*found, status)


def _common_bases(bases: KeyedBases, search: _Search, options: QueryOptions, count: int) -> _Found:
    """At most `count` bases common to all positions of a search, by the map."""
    keys, key, windows = search.keys, search.keys[search.reference], search.windows
    order = np.concatenate([[search.reference], np.delete(np.arange(len(keys)), search.reference)])
    spans = np.column_stack([windows[:, 0] - key.yaw_shift, windows[:, 1] - windows[:, 0]])
    orientations = bases.grid.orientations
    if orientations.is_pole(key.group) and orientations.free_roll:
        spans[:] = -np.pi, 2 * np.pi
    query = MultiTargetQuery(np.ascontiguousarray(search.points[:, order]), search.turns, spans[order], search.same_yaw)
    rows, torsos, yaws = np.empty((count, 5)), np.empty((count, len(keys))), np.empty((count, len(keys)))
    flat, apart = flat_key(bases.grid, key.layer, key.group), max(options.separation, SAME_PLACE)
    kernel = (bases.tiles, flat, query, bases.field(key.group), key.exact, options.space.raster, apart)
    found = wanted = 0
    while found == wanted < count:
        wanted = min(count, wanted + _BASES_AT_A_TIME)
        found = best_common_bases(*kernel, rows, torsos, yaws, found, wanted)
    back = np.argsort(order)
    return _Found(rows[:found], torsos[:found, back], yaws[:found, back] + key.yaw_shift)


def _decided(bases: KeyedBases, search: _Search, options: QueryOptions, found: _Found) -> _Found:
    """Those of the bases that may reach all positions, with exact torso heights and certainty."""
    points = search.points[_turn_numbers(search, found.yaws[:, search.reference])]
    decided = bases.decide(found.rows[:, :3], points, found.yaws, options)
    found.rows[:, 4] = decided.certain
    found.torsos[decided.certain] = decided.torso[decided.certain]
    return _Found(*(column[decided.may_reach] for column in found))


def _turn_numbers(search: _Search, yaws: Floats) -> NDArray[np.int64]:
    """(k,) which of a search's turns belong to the approach yaws (k,) of its reference."""
    turns = yaws - search.keys[search.reference].yaw_shift
    return np.asarray(np.abs(wrap_to_pi(turns[:, None] - search.turns)).argmin(axis=1))


def _is_out_of_reach(bases: KeyedBases, search: _Search, options: QueryOptions) -> bool:
    """Whether one of the positions certainly has no base at all, or two of them are too far apart for one base."""
    discs = [bases.disc(point[2], options.pitch) for point in search.points[0]]
    farthest = np.array([-np.inf if disc is None else disc.farthest for disc in discs])
    apart = np.linalg.norm(search.points[0][:, None, :2] - search.points[0][None, :, :2], axis=2)
    if np.any(apart > farthest[:, None] + farthest):
        return True
    return any(
        is_fixed and not bases.may_exist(point, options.pitch, key, (low, high), options.space)
        for is_fixed, point, key, (low, high) in zip(
            search.fixed, search.points[0], search.keys, search.windows, strict=True
        )
    )
