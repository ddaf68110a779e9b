"""Keys of a set of gripper poses at one place: ranges of height, pitch and roll, as in section 3.2.2 of the paper.

Every cell of the map that the ranges meet yields one pose of the set: the cell's middle, or the nearest end of a range.
"""

from __future__ import annotations

from math import floor, pi
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from irm.grid import MapGrid
from irm.query_kernels import KeySet
from irm.query_keys import Key, Range, find_key, yaw_window

Floats = NDArray[np.float64]
_ROUNDING = 1e-9
"""[m], [rad] Least overlap of a cell with a range."""


class PoseSet(NamedTuple):
    """n poses, one per key.

    `keys`: n keys. `angles` (n, 3): height [m], pitch and roll [rad] of each pose. `arrays`: the keys for kernels.
    `windows` (w, 5): windows of turns.
    """

    keys: list[Key]
    angles: Floats
    arrays: KeySet
    windows: Floats


def poses_of_set(
    grid: MapGrid, height: Range, pitch: Range, roll: Range, yaw_range: Range, yaw_step: float
) -> PoseSet | None:
    """Choose poses in ranges of height [m], pitch, roll and yaw [rad]. None if no arm configuration reaches these
    heights.

    Raises:
        QueryError: the map covers none of these pitches or heights.
    """
    orientations = grid.orientations
    rings = np.unique(orientations.pitch).tolist()
    pitches = _met(rings, orientations.step / 2, pitch) or [0.5 * (pitch[0] + pitch[1])]
    if orientations.free_roll:
        rolls = [roll[0]]
    else:
        some = np.unique(orientations.roll)
        turned = np.concatenate([some + turn for turn in (-2 * pi, 0.0, 2 * pi)]).tolist()
        rolls = _met(turned, pi / len(some), roll)
    first, last = (floor((z - grid.bottom) / grid.thickness) for z in height)
    layers = [grid.layer_height(k) for k in range(max(0, first), min(grid.layers - 1, last) + 1)]
    heights = _met(layers, grid.thickness / 2, height) or [height[0]]
    keys: dict[tuple[int, float], tuple[Key, tuple[float, float, float]]] = {}
    for z in heights:
        for beta in pitches:
            for alpha in rolls:
                if (key := find_key(grid, z, beta, alpha)) is not None:
                    keys.setdefault((key.number, key.yaw_shift), (key, (z, beta, alpha)))
    if not keys:
        return None
    found = [key for key, _ in keys.values()]
    windows = [yaw_window(grid, key, yaw_range, yaw_step) for key in found]
    different = list(dict.fromkeys(windows))
    arrays = KeySet(
        np.array([key.number for key in found]),
        np.array([key.height_offset for key in found]),
        np.array([key.exact for key in found]),
        np.array([different.index(window) for window in windows]),
    )
    return PoseSet(found, np.array([angles for _, angles in keys.values()]), arrays, np.array(different, dtype=float))


def _met(middles: list[float], half: float, asked: Range) -> list[float]:
    """Values of a range nearest to the middles of the cells that it meets."""
    met = [k for k in middles if k - half < asked[1] - _ROUNDING and k + half > asked[0] + _ROUNDING]
    if not met:  # a single value, on the border of two cells
        met = [k for k in middles if abs(k - asked[0]) <= half + _ROUNDING][:1]
    return [float(np.clip(k, *asked)) for k in met]
