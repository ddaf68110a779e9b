"""Keys of equation 5: the cell [z, β, α] of a TCP pose, and the yaws at which its bases are laid out."""

from __future__ import annotations

from functools import lru_cache
from math import copysign, pi
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from irm.arm.angles import signed
from irm.errors import QueryError
from irm.maps.grid import MapGrid, Orientations
from irm.queries.arguments import approach_yaws

__all__ = [
    "Key",
    "YawWindow",
    "base_turns",
    "evenly",
    "find_key",
    "find_keys",
    "flat_key",
    "nearby_keys",
    "outer_turns",
    "yaw_window",
]

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

_EXACT = 1e-6
"""[rad] within which a TCP orientation counts as that of the map's ring."""

_POLE_STEP = float(np.radians(15))
"""[rad] Largest distance between the turns around a vertical approach."""

_OUTER_STEP = float(np.radians(5))
"""[rad] between the turns at which the outer map is searched."""

_OUTER_STEPS = 1.5
"""Yaw samples by which the outer map extends beyond a reachable one: to the far edge of its neighbour."""


class Key(NamedTuple):
    """A layer and an orientation group of the map, and the TCP's offsets from them.

    `height_offset`: of the TCP above the layer's middle [m]. `exact`: whether pitch and roll are those of the group.
    `yaw_shift`: what to subtract from the approach yaw to get the turn; at a pole, the roll [rad].
    """

    layer: int
    group: int
    height_offset: float
    exact: bool
    yaw_shift: float


class YawWindow(NamedTuple):
    """A range of turns: yaws at which a key's bases are laid out around the TCP. Kernels lay out the turns themselves.

    `low`, `high` and the largest `step` between two turns [rad]; `samples`: for a full turn, the number of turns is a
    multiple of this; `shift`: what to add to a turn to get the approach yaw [rad].
    """

    low: float
    high: float
    step: float
    samples: int
    shift: float


def find_key(grid: MapGrid, z: float, pitch: float, roll: float) -> Key | None:
    """The key of a TCP at height `z` [m]; None if no arm configuration reaches this height.

    Raises:
        QueryError: an angle is not finite, or the map was built without this height or pitch.
    """
    group, exact, shift = _find_group(grid.orientations, pitch, roll)
    layer = grid.layer(z)
    if not 0 <= layer < grid.layers:
        _require_covered(grid, z)
        return None
    return Key(layer, group, z - grid.layer_height(layer), exact, shift)


def find_keys(grid: MapGrid, z: Floats, pitch: float, roll: float) -> tuple[Key, Integers, Floats]:
    """Keys of many TCP heights (n,) at one pitch and roll.

    Returns:
        A key whose layer and height offset have no meaning; key numbers (n,), -1 where the height is out of reach; and
        height offsets (n,) [m].

    Raises:
        QueryError: as `find_key`, for the lowest or the highest of them.
    """
    for height in (float(z.min()), float(z.max())):
        if not 0 <= grid.layer(height) < grid.layers:
            _require_covered(grid, height)
    group, exact, shift = _find_group(grid.orientations, pitch, roll)
    layers = np.floor((z - grid.bottom) / grid.thickness).astype(np.int64)
    keys = layers * len(grid.orientations.pitch) + group
    keys[(layers < 0) | (layers >= grid.layers)] = -1
    return Key(0, group, 0.0, exact, shift), keys, z - (grid.bottom + (layers + 0.5) * grid.thickness)


@lru_cache(maxsize=1024)
def _find_group(orientations: Orientations, pitch: float, roll: float) -> tuple[int, bool, float]:
    """Group of a pitch and a roll, whether they are exactly those of the group, and the yaw shift."""
    group = orientations.nearest(pitch, roll)
    exact = abs(pitch - float(orientations.pitch[group])) < _EXACT
    if orientations.free_roll:
        return group, exact, 0.0
    if orientations.is_pole(group):
        return group, exact, copysign(roll, pitch)
    off_roll = signed(roll - float(orientations.roll[group]))
    return group, exact and abs(off_roll) < _EXACT, 0.0


def _require_covered(grid: MapGrid, z: float) -> None:
    """Raise if a height is outside the grid because of the map's parameters, not because of the arm's reach."""
    if grid.cut_below if z < grid.bottom else grid.cut_above:
        raise QueryError(f"this map covers TCP heights {grid.bottom:.2f} to {grid.top:.2f} m, not {z:.3f} m")


def flat_key(grid: MapGrid, layer: int, group: int) -> int:
    """Number of a key; the groups of one layer have consecutive numbers."""
    return layer * len(grid.orientations.pitch) + group


def yaw_window(grid: MapGrid, key: Key, yaw_range: tuple[float, float], step: float) -> YawWindow:
    """The window of turns for a checked range of approach yaws.

    For a vertical approach of a wrist that rolls freely it is a full turn: the wrist makes up for the yaw.
    """
    orientations, shift = grid.orientations, key.yaw_shift
    samples = int(orientations.count[key.group])
    if orientations.free_roll and orientations.is_pole(key.group):
        return YawWindow(-pi, pi, min(step, _POLE_STEP), samples, shift)
    return YawWindow(yaw_range[0] - shift, yaw_range[1] - shift, step, samples, shift)


def base_turns(grid: MapGrid, key: Key, yaw_range: tuple[float, float], step: float) -> Floats:
    """(n,) turns for a checked range of approach yaws, as kernels lay them out, read-only; see `yaw_window`."""
    window = yaw_window(grid, key, yaw_range, step)
    return _turns(window.low, window.high, window.step, window.samples)


@lru_cache(maxsize=256)
def _turns(low: float, high: float, step: float, samples: int) -> Floats:
    turns = approach_yaws((low, high), step, samples)
    turns.setflags(write=False)
    return turns


def nearby_keys(grid: MapGrid, key: Key) -> Integers | None:
    """Numbers of the keys whose cells touch those of a key; None if the map was built without some of them."""
    orientations = grid.orientations
    if (key.layer == 0 and grid.cut_below) or (key.layer == grid.layers - 1 and grid.cut_above):
        return None
    layers = range(max(0, key.layer - 1), min(grid.layers, key.layer + 2))
    near = np.abs(orientations.pitch - orientations.pitch[key.group]) < 1.01 * orientations.step
    sides = len(np.unique(np.round(orientations.pitch[near] / orientations.step)))
    if not key.exact and sides < (2 if orientations.is_pole(key.group) else 3):
        return None
    return np.array([flat_key(grid, layer, int(group)) for layer in layers for group in np.flatnonzero(near)])


def outer_turns(grid: MapGrid, key: Key, yaw_range: tuple[float, float]) -> tuple[Floats, float]:
    """Turns (n,) for the outer map, and the largest distance of any yaw in the range from the nearest of them [rad]."""
    widening = _OUTER_STEPS * 2 * np.pi / grid.orientations.count[key.group]
    return evenly((yaw_range[0] - key.yaw_shift - widening, yaw_range[1] - key.yaw_shift + widening))


def evenly(span: tuple[float, float]) -> tuple[Floats, float]:
    """Yaws (n,) over a span, a full turn at most, and half their distance [rad]."""
    low, high = span if span[1] - span[0] < 2 * np.pi else (-np.pi, np.pi)
    count = max(1, int(np.ceil((high - low) / _OUTER_STEP)))
    return np.linspace(low, high, count + 1), (high - low) / count / 2
