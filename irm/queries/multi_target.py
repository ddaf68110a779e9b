"""Placement queries for a path and for several targets."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from irm.errors import QueryError
from irm.floor.free_space import FreeSpace
from irm.queries.keys import Key, base_turns, find_key, flat_key
from irm.queries.multi_target_kernel import MultiTargetQuery, best_serving
from irm.queries.placement import BasePlacement, as_yaw_range
from irm.queries.placement_kernel import SAME_PLACE
from irm.queries.status import Status

if TYPE_CHECKING:
    from irm.queries.inverse import InverseReachabilityMap

__all__ = ["Limits", "path_at_target", "path_in_world", "several_targets"]

Floats = NDArray[np.float64]


class Limits(NamedTuple):
    """What the queries of several positions have in common; see `InverseReachabilityMap.query`."""

    pitch: float
    roll: float
    space: FreeSpace
    k: int
    separation: float
    yaw_step: float


def path_in_world(
    inverse_map: InverseReachabilityMap, waypoints: Floats, yaw_range: tuple[float, float], limits: Limits
) -> BasePlacement:
    """`InverseReachabilityMap.query_path` for waypoints (m, 3) in the world."""
    keys = _keys(inverse_map, waypoints, limits)
    if keys is None:
        return _nothing(Status.NO, len(waypoints)).with_first_yaw()
    rarest_key = _rarest(inverse_map, keys)
    turns = base_turns(inverse_map.reachability_map.grid, keys[rarest_key], yaw_range, limits.yaw_step).yaws
    points = np.repeat(waypoints[None], len(turns), axis=0)
    windows = np.tile(np.array([yaw_range]), (len(waypoints), 1))
    fixed = np.ones(len(waypoints), dtype=bool)
    return _serve(inverse_map, keys, rarest_key, points, turns, windows, True, fixed, limits).with_first_yaw()


def path_at_target(
    inverse_map: InverseReachabilityMap,
    target: Floats,
    offsets: Floats,
    yaw_range: tuple[float, float],
    limits: Limits,
) -> BasePlacement:
    """`InverseReachabilityMap.query_path` for offsets (m, 3) in the approach frame at a target (3,)."""
    grid = inverse_map.reachability_map.grid
    keys = _keys(inverse_map, target + offsets * (0, 0, 1), limits)
    if keys is None:
        return _nothing(Status.NO, len(offsets)).with_first_yaw()
    vertical = np.logical_not(offsets[:, :2].any(axis=1))
    if grid.orientations.is_pole(keys[0].group) and grid.orientations.free_roll and not vertical.all():
        raise QueryError(
            "a vertical approach has no horizontal direction: give offsets along z only, or the waypoints in the world"
        )
    rarest_key = _rarest(inverse_map, keys)
    turns = base_turns(grid, keys[rarest_key], yaw_range, limits.yaw_step).yaws
    c, s = np.cos(turns + keys[rarest_key].yaw_shift)[:, None], np.sin(turns + keys[rarest_key].yaw_shift)[:, None]
    x, y, z = offsets.T
    points = target + np.stack([c * x - s * y, s * x + c * y, np.broadcast_to(z, (len(turns), len(z)))], axis=2)
    windows = np.tile(np.array([yaw_range]), (len(offsets), 1))
    return _serve(inverse_map, keys, rarest_key, points, turns, windows, True, vertical, limits).with_first_yaw()


def several_targets(
    inverse_map: InverseReachabilityMap, targets: Floats, yaw_ranges: ArrayLike, limits: Limits
) -> BasePlacement:
    """`InverseReachabilityMap.query_multi` for targets (m, 3)."""
    ranges = np.atleast_2d(np.asarray(yaw_ranges, dtype=float))
    if len(ranges) not in (1, len(targets)):
        raise QueryError(f"{len(targets)} targets do not go with {len(ranges)} yaw ranges")
    windows = np.array(np.broadcast_to(ranges, (len(targets), ranges.shape[1])))
    bounds = [as_yaw_range(window) for window in windows]
    keys = _keys(inverse_map, targets, limits)
    if keys is None:
        return _nothing(Status.NO, len(targets))
    rarest_key = _rarest(inverse_map, keys)
    turns = base_turns(inverse_map.reachability_map.grid, keys[rarest_key], bounds[rarest_key], limits.yaw_step).yaws
    points = np.repeat(targets[None], len(turns), axis=0)
    fixed = np.ones(len(targets), dtype=bool)
    return _serve(inverse_map, keys, rarest_key, points, turns, windows, False, fixed, limits)


def _nothing(status: Status, positions: int) -> BasePlacement:
    return BasePlacement.of_service(np.empty((0, 5)), np.empty((0, positions)), np.empty((0, positions)), status)


def _keys(inverse_map: InverseReachabilityMap, points: Floats, limits: Limits) -> list[Key] | None:
    """The key of every position; None if nothing can be found for one of them, or anywhere on this floor."""
    found = [find_key(inverse_map.reachability_map.grid, float(z), limits.pitch, limits.roll) for z in points[:, 2]]
    keys = [key for key in found if key is not None]
    return None if len(keys) < len(found) or limits.space.is_empty else keys


def _rarest(inverse_map: InverseReachabilityMap, keys: list[Key]) -> int:
    """The position with the fewest bases: the shortest list to search."""
    grid, first = inverse_map.reachability_map.grid, inverse_map.tiles.base_first
    flat = np.array([flat_key(grid, key.layer, key.group) for key in keys])
    return int((first[flat + 1] - first[flat]).argmin())


def _serve(
    inverse_map: InverseReachabilityMap,
    keys: list[Key],
    rarest_key: int,
    points: Floats,
    turns: Floats,
    windows: Floats,
    same_yaw: bool,
    fixed: NDArray[np.bool_],
    limits: Limits,
) -> BasePlacement:
    """Bases for `points` (n, m, 3) at the n lead `turns`; `fixed` (m,) says which points do not depend on the turn."""
    grid, key = inverse_map.reachability_map.grid, keys[rarest_key]
    order = np.concatenate([[rarest_key], np.delete(np.arange(len(keys)), rarest_key)])
    free_yaw = grid.orientations.is_pole(key.group) and grid.orientations.free_roll
    spans = np.column_stack([windows[:, 0] - key.yaw_shift, windows[:, 1] - windows[:, 0]])
    if free_yaw:
        spans[:] = -np.pi, 2 * np.pi
    query = MultiTargetQuery(np.ascontiguousarray(points[:, order]), turns, spans[order], same_yaw)
    rows, torsos, yaws = np.empty((limits.k, 5)), np.empty((limits.k, len(keys))), np.empty((limits.k, len(keys)))
    found = best_serving(
        inverse_map.tiles,
        flat_key(grid, key.layer, key.group),
        query,
        inverse_map.field(key.group),
        limits.space.raster,
        max(limits.separation, SAME_PLACE),
        key.exact,
        *grid.torso_range,
        rows,
        torsos,
        yaws,
    )
    back = np.argsort(order)
    torsos, yaws = torsos[:found, back], yaws[:found, back] + key.yaw_shift
    if found:
        status = Status.YES if rows[:found, 4].any() else Status.UNKNOWN
        return BasePlacement.of_service(rows[:found], torsos, yaws, status)
    certain_no = any(
        fixed[m] and not inverse_map.may_exist(points[0, m], keys[m], (windows[m, 0], windows[m, 1]), limits.space)
        for m in range(len(keys))
    )
    return BasePlacement.of_service(rows[:0], torsos, yaws, Status.NO if certain_no else Status.UNKNOWN)
