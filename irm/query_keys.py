"""Validation of a query's keyword arguments, and the keys and turns of its TCP poses.

The key of a TCP pose is a layer of heights and an orientation group (pitch, roll) of the map. Its bases are laid out
around the TCP at every allowed yaw.
"""

from __future__ import annotations

from collections.abc import Iterable
from functools import lru_cache
from math import copysign, inf, isfinite, pi
from operator import index
from typing import Any, Literal, NamedTuple, TypedDict, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from irm.errors import QueryError
from irm.free_space import EVERYWHERE, FreeSpace
from irm.grid import MapGrid, Orientations
from irm.rotations import as_poses, wrap_to_pi, yaw_pitch_roll

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
FULL_TURN = (-np.pi, np.pi)
"""Every approach yaw."""
YAW_STEP = float(np.radians(15))
"""[rad] between the approach yaws tried."""
SEPARATION = 0.1
"""[m] between the bases of an answer, so that the second base is an alternative to the first."""
SMALLEST_YAW_STEP = 1e-3
"""[rad]: 6,284 yaws per turn."""
_FARTHEST = 1e7
"""[m] Limit of x and y from the world's origin. Beyond it, neighbouring floating-point numbers are more than 1 nm
apart, too coarse for differences between a base and a TCP."""
MOST_BASES = 100_000
"""Largest `k`: more than the bases of one TCP pose on any map of a reasonable size."""
_ROUNDING = 1e-9
"""[rad] by which a range may exceed a full turn."""


Order = Literal["manipulability", "certainty"]
"""Order of bases: by μ alone, or first the bases whose cell is reached over its whole height."""


Range = tuple[float, float]


class BaseYaws(NamedTuple):
    """Allowed yaws of the base in the world: a `span` from `low` on [rad]. An infinite span allows all."""

    low: float
    span: float


ANY_YAW = BaseYaws(-pi, inf)


class QueryKeywords(TypedDict, total=False):
    """Keyword arguments of all queries. `InverseReachabilityMap` explains them."""

    pitch: float | Range
    roll: float | Range
    free_space: FreeSpace | None
    k: int
    separation: float
    yaw_step: float
    exact: bool | None
    order: Order
    height: Range | None
    base_yaw_range: Range | None


class QueryOptions(NamedTuple):
    """Validated keyword arguments of a query."""

    pitch: float = 0.0
    roll: float = 0.0
    free_space: FreeSpace = EVERYWHERE
    k: int = 1
    separation: float = SEPARATION
    yaw_step: float = YAW_STEP
    exact: bool | None = None
    order: Order = "manipulability"
    base_yaws: BaseYaws = ANY_YAW
    ranges: tuple[Range, Range, Range | None] | None = None
    """Ranges of pitch, roll and height, if any of them is a range. Height is None for that of the position."""


def checked_options(keywords: QueryKeywords, *, may_be_set: bool = False) -> QueryOptions:
    """Validate the options of one call. `may_be_set`: whether ranges of pitch, roll and height are allowed.

    Raises:
        QueryError: a value has a wrong type, is not finite or is out of its range.
        TypeError: no such keyword.
    """
    try:
        options = _recent(**keywords)
    except TypeError:  # an unknown keyword, or a value without a hash, such as an array of one number
        known = QueryKeywords.__annotations__
        unknown = [name for name in keywords if name not in known]
        if unknown:
            raise TypeError(f"queries have no keyword argument {unknown[0]!r}; they have {', '.join(known)}") from None
        options = _validated(**keywords)
    if options.ranges is not None and not may_be_set:
        raise QueryError("ranges of pitch, roll and height are for `query` alone")
    return options


def _validated(
    *,
    pitch: Any = 0.0,
    roll: Any = 0.0,
    height: Range | None = None,
    base_yaw_range: Range | None = None,
    **keywords: Any,
) -> QueryOptions:
    asked = QueryOptions(**keywords)
    ranges = _as_range("pitch", pitch), _as_range("roll", roll), None if height is None else _as_range("height", height)
    is_set = height is not None or any(low < high for low, high in ranges[:2])
    if ranges[0][0] < ranges[0][1] and max(map(abs, ranges[0])) > pi / 2 + _ROUNDING:
        raise QueryError(f"a range of pitches lies in [-π/2, π/2], not {pitch}")
    if ranges[1][1] - ranges[1][0] > 2 * pi + _ROUNDING:
        raise QueryError(f"a range of rolls is at most a full turn, not {roll}")
    base_yaws = ANY_YAW
    if base_yaw_range is not None:
        low, high = as_yaw_range(base_yaw_range)
        base_yaws = BaseYaws(low, high - low) if high - low < 2 * pi - _ROUNDING else ANY_YAW
    separation = _as_number("separation", "[m]", asked.separation)
    yaw_step = min(_as_number("yaw_step", "[rad]", asked.yaw_step), 2 * pi)
    if separation < 0.0:
        raise QueryError(f"separation must be a number ≥ 0 [m], not {separation}")
    if yaw_step < SMALLEST_YAW_STEP:
        raise QueryError(f"yaw_step must be at least {SMALLEST_YAW_STEP} rad, not {yaw_step}")
    if not (asked.free_space is None or isinstance(asked.free_space, FreeSpace)):
        raise QueryError(f"free_space is a FreeSpace or None, not {type(asked.free_space).__name__}")
    if not (asked.exact is None or isinstance(asked.exact, bool | np.bool_)):
        raise QueryError(f"exact is True, False or None, not {asked.exact!r}")
    if asked.order not in get_args(Order):
        raise QueryError(f"order is {' or '.join(map(repr, get_args(Order)))}, not {asked.order!r}")
    try:
        count = 0 if isinstance(asked.k, bool) else index(asked.k)
    except TypeError:
        count = 0
    if not 1 <= count <= MOST_BASES:
        raise QueryError(f"k is a number of bases, at least 1 and at most {MOST_BASES}, not {asked.k!r}")
    about = asked.free_space or EVERYWHERE, count, separation, yaw_step, asked.exact, asked.order, base_yaws
    return QueryOptions(ranges[0][0], ranges[1][0], *about, ranges if is_set else None)


_recent = lru_cache(maxsize=16, typed=True)(_validated)
"""Validation takes a tenth of the time of a query, and most queries repeat the options of the last one. The cache is
typed, because True equals 1 but is not a valid number of bases."""


def _as_number(name: str, unit: str, value: Any) -> float:
    try:
        number = float(value)
    except (TypeError, ValueError, OverflowError):
        number = inf
    if not isfinite(number) or isinstance(value, str | bytes):
        raise QueryError(f"{name} must be a finite number {unit}, not {value!r}")
    return number


def _as_range(name: str, value: Any) -> Range:
    """Convert a number, or a tuple of two numbers, to a range."""
    unit = "[m]" if name == "height" else "[rad]"
    if name != "height" and not isinstance(value, tuple):
        number = _as_number(name, unit, value)
        return number, number
    try:
        low, high = (_as_number(name, unit, end) for end in value)
    except (TypeError, ValueError) as problem:
        if isinstance(problem, QueryError):
            raise
        raise QueryError(f"{name} must be a finite number, or a range: two of them {unit}, not {value!r}") from None
    if low > high:
        raise QueryError(f"the range of {name}, ({low}, {high}), is empty")
    return low, high


_TOO_FAR = f"a TCP is at most {_FARTHEST:g} m from the world's origin; give positions in a frame that is nearer"


def as_position(position: Iterable[float]) -> tuple[float, float, float]:
    """Convert to three finite numbers. Anything else raises a `QueryError`."""
    try:
        x, y, z = map(float, position)
    except (TypeError, ValueError):
        x = y = z = inf
    if not (isfinite(x) and isfinite(y) and isfinite(z)):
        raise QueryError(f"a TCP position is three finite numbers [m], not {position!r}")
    if not (-_FARTHEST <= x <= _FARTHEST and -_FARTHEST <= y <= _FARTHEST):
        raise QueryError(_TOO_FAR)
    return x, y, z


def as_position_and_angles(
    T_world_tcp: Iterable[Any], yaw_range: tuple[float, float], keywords: QueryKeywords
) -> tuple[Floats, tuple[float, float], QueryKeywords]:
    """Convert one TCP pose (4, 4) to position, yaw range and keywords of a query.

    Raises:
        QueryError: not a rotation and a translation, or angles are given in addition.
    """
    given = [name for name in ("pitch", "roll") if name in keywords] + ["yaw_range"] * (yaw_range != FULL_TURN)
    if given:
        raise QueryError(f"a pose (4, 4) has its own angles; it goes without {', '.join(given)}")
    T = as_poses(np.asarray([T_world_tcp]))
    yaw, pitch, roll = yaw_pitch_roll(T[:, :3, :3])[0].tolist()
    return T[0, :3, 3], (yaw, yaw), {**keywords, "pitch": pitch, "roll": roll}


def as_positions_and_angles(
    T_world_tcp: ArrayLike, yaw_ranges: Any, keywords: QueryKeywords
) -> tuple[Floats, Floats, Floats, Floats]:
    """Convert TCP poses (n, 4, 4) to positions (n, 3), ranges of yaws (n, 2), pitches and rolls (n,).

    Raises:
        QueryError: not an array of poses, or angles are given in addition.
    """
    given = [name for name in ("pitch", "roll") if name in keywords] + ["yaw_ranges"] * (yaw_ranges is not FULL_TURN)
    if given:
        raise QueryError(f"poses (n, 4, 4) have their own angles; they go without {', '.join(given)}")
    T = as_poses(T_world_tcp)
    if not len(T):
        raise QueryError("TCP poses are an array (n, 4, 4) with n ≥ 1")
    yaw, pitch, roll = yaw_pitch_roll(T[:, :3, :3]).T
    return as_positions(T[:, :3, 3]), np.column_stack([yaw, yaw]), pitch, roll


def as_positions(positions: ArrayLike) -> Floats:
    """Convert to (n, 3) finite numbers, n ≥ 1. Anything else raises a `QueryError`."""
    try:
        points = np.ascontiguousarray(np.atleast_2d(np.asarray(positions, dtype=float)))
    except (TypeError, ValueError):
        raise QueryError(f"TCP positions are an array (n, 3) of finite numbers [m], not {positions!r}") from None
    if points.ndim != 2 or points.shape[1] != 3 or len(points) == 0 or not np.isfinite(points).all():
        raise QueryError(f"TCP positions are an array (n, 3) of finite numbers [m] with n ≥ 1, not {points.shape}")
    if np.abs(points[:, :2]).max() > _FARTHEST:
        raise QueryError(_TOO_FAR)
    return points


def as_yaw_range(yaw_range: Iterable[float]) -> tuple[float, float]:
    """Convert to a pair of finite angles, at most a turn apart [rad]. Anything else raises a `QueryError`."""
    try:
        low, high = map(float, yaw_range)
    except (TypeError, ValueError):
        raise QueryError(f"yaw_range is a pair of numbers [rad], not {yaw_range!r}") from None
    if not (isfinite(low) and isfinite(high)):
        raise QueryError(f"yaw_range must be finite, not ({low}, {high})")
    if low > high:
        raise QueryError(f"yaw_range ({low}, {high}) is empty; a range across ±π is written like (3.0, 3.4)")
    if high - low > 2 * pi + _ROUNDING:
        raise QueryError(f"yaw_range ({low}, {high}) is longer than a full turn")
    return low, high


def as_yaw_ranges(yaw_ranges: ArrayLike) -> Floats:
    """Convert to (r, 2) ranges, each as in `as_yaw_range`. One pair (2,) gives r = 1."""
    try:
        ranges = np.atleast_2d(np.asarray(yaw_ranges, dtype=float))
    except (TypeError, ValueError):
        raise QueryError(f"yaw_ranges are pairs of numbers [rad], not {yaw_ranges!r}") from None
    if ranges.ndim != 2 or ranges.shape[1] != 2:
        raise QueryError(f"yaw_ranges are pairs of numbers [rad], of shape (2,) or (n, 2), not {ranges.shape}")
    low, high = ranges.T
    valid = (low <= high) & (high - low <= 2 * pi + _ROUNDING) & np.isfinite(ranges).all(axis=1)
    if not valid.all():
        as_yaw_range(ranges[int(valid.argmin())])
    return ranges


_EXACT = 1e-6
"""[rad] Largest deviation of a TCP orientation on a ring of the map."""
_POLE_STEP = float(np.radians(15))
"""[rad] Largest step between the turns around a vertical approach."""
_OUTER_STEP = float(np.radians(5))
"""[rad] Step between the turns of the search in the outer map."""
_OUTER_STEPS = 1.5
"""Yaw samples by which the outer map extends beyond a reachable sample: to the far edge of its neighbour."""


class Key(NamedTuple):
    """A layer and an orientation group of the map, and the TCP's offsets from them.

    `number`: number of the key. The groups of one layer have consecutive numbers. `height_offset`: height of the TCP
    above the layer's middle [m]. `exact`: whether pitch and roll are those of the group. `yaw_shift`: approach yaw
    minus turn, at a pole the roll [rad].
    """

    layer: int
    group: int
    number: int
    height_offset: float
    exact: bool
    yaw_shift: float


class YawWindow(NamedTuple):
    """Range of turns: yaws at which a key's bases are laid out around the TCP. Kernels lay out the turns themselves.

    `low`, `high`: ends of the range [rad]. `step`: largest step between two turns [rad]. `samples`: divisor of the
    number of turns, for a full turn. `shift`: approach yaw minus turn [rad].
    """

    low: float
    high: float
    step: float
    samples: int
    shift: float


def find_key(grid: MapGrid, z: float, pitch: float, roll: float) -> Key | None:
    """Find the key of a TCP at height `z` [m]. None if no arm configuration reaches this height.

    Raises:
        QueryError: an angle is not finite, or the map was built without this height or pitch.
    """
    group, exact, shift = _find_group(grid.orientations, pitch, roll)
    layer = grid.layer(z)
    if not 0 <= layer < grid.layers:
        _require_covered(grid, z)
        return None
    return Key(layer, group, _number(grid, layer, group), z - grid.layer_height(layer), exact, shift)


def find_keys(grid: MapGrid, z: Floats, pitch: float, roll: float) -> tuple[Key, Integers, Floats]:
    """Find the keys of many TCP heights (n,) at one pitch and roll.

    Returns:
        A key without meaningful layer, number and height offset. Key numbers (n,), -1 where the height is out of reach.
        Height offsets (n,) [m].

    Raises:
        QueryError: as `find_key`, for the lowest or the highest height.
    """
    for height in (float(z.min()), float(z.max())):
        if not 0 <= grid.layer(height) < grid.layers:
            _require_covered(grid, height)
    group, exact, shift = _find_group(grid.orientations, pitch, roll)
    layers = np.floor((z - grid.bottom) / grid.thickness).astype(np.int64)
    keys = _number(grid, layers, group)
    keys[(layers < 0) | (layers >= grid.layers)] = -1
    return Key(0, group, 0, 0.0, exact, shift), keys, z - (grid.bottom + (layers + 0.5) * grid.thickness)


@lru_cache(maxsize=1024)
def _find_group(orientations: Orientations, pitch: float, roll: float) -> tuple[int, bool, float]:
    """Group of a pitch and a roll, whether they are exactly those of the group, and the yaw shift."""
    group = orientations.nearest(pitch, roll)
    exact = abs(pitch - float(orientations.pitch[group])) < _EXACT
    if orientations.free_roll:
        return group, exact, 0.0
    if orientations.is_pole(group):
        return group, exact, copysign(roll, pitch)
    off_roll = wrap_to_pi(roll - float(orientations.roll[group]))
    return group, exact and abs(off_roll) < _EXACT, 0.0


def _require_covered(grid: MapGrid, z: float) -> None:
    """Raise if a height is outside the grid because of the map's parameters, not because of the arm's reach."""
    if grid.cut_below if z < grid.bottom else grid.cut_above:
        raise QueryError(f"this map covers TCP heights {grid.bottom:.2f} to {grid.top:.2f} m, not {z:.3f} m")


def _number(grid: MapGrid, layer: Any, group: int) -> Any:
    """Number of a key, or numbers of the keys of many layers."""
    return layer * len(grid.orientations.pitch) + group


def yaw_window(grid: MapGrid, key: Key, yaw_range: tuple[float, float], step: float) -> YawWindow:
    """The window of turns for a checked range of approach yaws.

    For an exactly vertical approach of a wrist that rolls freely it is a full turn, because the wrist compensates the
    yaw.
    """
    orientations, shift = grid.orientations, key.yaw_shift
    samples = int(orientations.count[key.group])
    if orientations.free_roll and key.exact and orientations.is_pole(key.group):
        return YawWindow(-pi, pi, min(step, _POLE_STEP), samples, shift)
    return YawWindow(yaw_range[0] - shift, yaw_range[1] - shift, step, samples, shift)


def nearby_keys(grid: MapGrid, key: Key) -> Integers | None:
    """Numbers of the keys whose cells touch those of a key. None if the map lacks some of them."""
    orientations = grid.orientations
    if (key.layer == 0 and grid.cut_below) or (key.layer == grid.layers - 1 and grid.cut_above):
        return None
    layers = range(max(0, key.layer - 1), min(grid.layers, key.layer + 2))
    near = np.abs(orientations.pitch - orientations.pitch[key.group]) < 1.01 * orientations.step
    sides = len(np.unique(np.round(orientations.pitch[near] / orientations.step)))
    if not key.exact and sides < (2 if orientations.is_pole(key.group) else 3):
        return None
    return np.array([_number(grid, layer, int(group)) for layer in layers for group in np.flatnonzero(near)])


def outer_turns(grid: MapGrid, key: Key, yaw_range: tuple[float, float]) -> tuple[Floats, float]:
    """Turns (n,) for the outer map, and the largest distance of any yaw in the range from the nearest turn [rad]."""
    widening = _OUTER_STEPS * 2 * np.pi / grid.orientations.count[key.group]
    return linspace_angles((yaw_range[0] - key.yaw_shift - widening, yaw_range[1] - key.yaw_shift + widening))


def linspace_angles(span: tuple[float, float]) -> tuple[Floats, float]:
    """Yaws (n,) over a span, a full turn at most, `_OUTER_STEP` apart, and half their distance [rad]."""
    low, high = span if span[1] - span[0] < 2 * np.pi else (-np.pi, np.pi)
    count = max(1, int(np.ceil((high - low) / _OUTER_STEP)))
    return np.linspace(low, high, count + 1), (high - low) / count / 2
