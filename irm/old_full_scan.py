"""x"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from irm.free_space import FreeSpace
from irm.inverse_map import InverseReachabilityMap
from irm.inverse_table import base_turns, find_key, flat_key
from irm.placement import BasePlacement
from irm.query_options import FULL_TURN, YAW_STEP, QueryOptions, as_position, as_yaw_range
from irm.rotations import wrap_to_pi
from irm.status import Status


def full_scan(
    inverse_map: InverseReachabilityMap,
    position: Iterable[float],
    *,
    pitch: float = 0.0,
    roll: float = 0.0,
    yaw_range: tuple[float, float] = FULL_TURN,
    free_space: FreeSpace | None = None,
    yaw_step: float = YAW_STEP,
) -> BasePlacement:
    """The base of highest μ, found by a test of every base of the key at every yaw (section 3.2.2 of the paper).

    Arguments as in `InverseReachabilityMap.query`. The status is never better than UNKNOWN, and NO only where the map
    has no key.
    """
    grid, tiles = inverse_map.reachability_map.grid, inverse_map.tiles
    options = QueryOptions(pitch, roll, free_space, yaw_step=yaw_step)
    point, bounds = as_position(position), as_yaw_range(yaw_range)
    key = find_key(grid, point[2], options.pitch, options.roll)
    if key is None:
        return BasePlacement.nothing(Status.NO)
    turns, flat = base_turns(grid, key, bounds, options.yaw_step), flat_key(grid, key.layer, key.group)
    mine = slice(int(tiles.base_first[flat]), int(tiles.base_first[flat + 1]))
    c, s = np.cos(turns)[:, None], np.sin(turns)[:, None]
    x = point[0] + c * tiles.x[mine] - s * tiles.y[mine]
    y = point[1] + s * tiles.x[mine] + c * tiles.y[mine]
    score = np.where(options.floor.are_free(x, y), tiles.mu[mine], np.float32(0.0))
    if score.size == 0 or not score.max() > 0:
        return BasePlacement.nothing(Status.UNKNOWN)
    turn, base = np.unravel_index(int(score.argmax()), score.shape)
    yaw = wrap_to_pi(float(turns[turn] + tiles.yaw[mine][base]))
    approach_yaw = turns[turn] + key.yaw_shift
    row = [x[turn, base], y[turn, base], yaw, approach_yaw, score[turn, base], tiles.torso[mine][base], 0.0]
    return BasePlacement.of_rows(np.array([row]))
