"""The proof that no base exists: the outer map and the arm's reach against the free floor, compiled."""

from __future__ import annotations

from math import cos, hypot, sin, sqrt

import numpy as np
from numpy.typing import NDArray

from irm.compilation import WITHOUT_REFERENCE_COUNTS, njit
from irm.floor.raster import Raster, floor_distance, floor_gap
from irm.queries.search_kernel import ROUNDING, SHORT
from irm.queries.tiles import Tiles

__all__ = ["any_base_near", "disc_meets_floor"]

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]


@njit(cache=True)
def disc_meets_floor(
    px: float, py: float, level: float, radius: float, turns: Floats, half_turn: float, raster: Raster
) -> bool:
    """Whether any free floor lies within `radius` of the wrist centre at any approach yaw.

    The wrist centre is `level` behind the TCP [m]. `turns` (n,) are approach yaws, `2 half_turn` apart [rad].
    """
    if raster.cells.size == 0:
        return True
    slack = radius + level * half_turn + ROUNDING
    nearest = np.inf
    for turn in turns:
        nearest = min(nearest, floor_gap(raster, px - level * cos(turn), py - level * sin(turn)))
    return nearest <= slack


@njit(cache=True, **WITHOUT_REFERENCE_COUNTS)
def any_base_near(
    tiles: Tiles, keys: Integers, px: float, py: float, turns: Floats, half_turn: float, raster: Raster, slack: float
) -> bool:
    """Whether any base of any of the `keys` lies within `slack` of free floor at one of the `turns` (n, 2).

    Turns are `2 half_turn` apart [rad]; the arc between them is added to the slack.
    """
    bounded = raster.cells.size > 0
    gap = floor_gap(raster, px, py) if bounded else 0.0
    for key in keys:
        for tile in range(tiles.key_first[key], tiles.key_first[key + 1]):
            if not bounded:
                return True
            tx, ty = tiles.tile_x[tile], tiles.tile_y[tile]
            distance = sqrt(tx * tx + ty * ty)
            reach = slack + distance * half_turn + tiles.tile_radius[tile] * (1.0 + half_turn) + ROUNDING
            if distance + reach < gap:
                continue
            turn = 0
            while turn < turns.shape[0]:
                c, s = turns[turn, 0], turns[turn, 1]
                away = floor_distance(raster, px + c * tx - s * ty, py + s * tx + c * ty) - reach
                if away > 0.0:
                    turn += 1 + int(SHORT * away / (distance * 2.0 * half_turn + ROUNDING))
                    continue
                for base in range(tiles.tile_first[tile], tiles.tile_last[tile]):
                    x = px + c * tiles.x[base] - s * tiles.y[base]
                    y = py + s * tiles.x[base] + c * tiles.y[base]
                    if floor_distance(raster, x, y) <= slack + hypot(tiles.x[base], tiles.y[base]) * half_turn:
                        return True
                turn += 1
    return False
