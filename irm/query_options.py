"""Keyword arguments of the placement queries: their meaning, and their validation in one place."""

from __future__ import annotations

from collections.abc import Iterable
from functools import lru_cache
from math import ceil, inf, isfinite, pi
from operator import index
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from irm.errors import QueryError
from irm.free_space import EVERYWHERE, FreeSpace

Floats = NDArray[np.float64]

FULL_TURN = (-np.pi, np.pi)
"""Every approach yaw."""

YAW_STEP = float(np.radians(15))
"""[rad] between the approach yaws tried."""

SEPARATION = 0.1
"""[m] between the bases of one answer, so that the second base is an alternative to the first one."""

SMALLEST_YAW_STEP = 1e-3
"""[rad]: 6,284 yaws per turn."""

MOST_BASES = 100_000
"""Largest `k`: more than there are bases for one TCP pose on any map of a reasonable size."""

_ROUNDING = 1e-9
"""[rad] by which a range may exceed a full turn."""


class QueryOptions(NamedTuple):
    """The keyword arguments that all queries share, validated; `InverseReachabilityMap.query` says what they mean.

    `space` is the free floor: `EVERYWHERE` if none was given.
    """

    pitch: float
    roll: float
    space: FreeSpace
    k: int
    separation: float
    yaw_step: float
    exact: bool | None


def checked_options(*values: Any) -> QueryOptions:
    """The options of one call, from the values of its keyword arguments in the order of `QueryOptions`.

    Raises:
        QueryError: a value is not of its kind, not finite or out of its range.
    """
    try:
        return _recent(*values)
    except TypeError:  # a value that has no hash, such as an array of one number
        return _validated(*values)


def _validated(
    pitch: float,
    roll: float,
    free_space: FreeSpace | None,
    k: int,
    separation: float,
    yaw_step: float,
    exact: bool | None,
) -> QueryOptions:
    pitch, roll = _as_number("pitch", "[rad]", pitch), _as_number("roll", "[rad]", roll)
    separation, yaw_step = _as_number("separation", "[m]", separation), _as_number("yaw_step", "[rad]", yaw_step)
    if separation < 0.0:
        raise QueryError(f"separation must be a number ≥ 0 [m], not {separation}")
    if yaw_step < SMALLEST_YAW_STEP:
        raise QueryError(f"yaw_step must be at least {SMALLEST_YAW_STEP} rad, not {yaw_step}")
    if not (free_space is None or isinstance(free_space, FreeSpace)):
        raise QueryError(f"free_space is a FreeSpace or None, not {type(free_space).__name__}")
    if not (exact is None or isinstance(exact, bool | np.bool_)):
        raise QueryError(f"exact is True, False or None, not {exact!r}")
    try:
        count = 0 if isinstance(k, bool) else index(k)
    except TypeError:
        count = 0
    if not 1 <= count <= MOST_BASES:
        raise QueryError(f"k is a number of bases, at least 1 and at most {MOST_BASES}, not {k!r}")
    return QueryOptions(pitch, roll, free_space or EVERYWHERE, count, separation, yaw_step, exact)


_recent = lru_cache(maxsize=16, typed=True)(_validated)
"""Validation takes a tenth of the time of a query, and most queries repeat the options of the last one. Typed, since
True and 1 are equal, and one of them is a wrong number of bases."""


def _as_number(name: str, unit: str, value: Any) -> float:
    """One finite number."""
    try:
        number = float(value)
    except (TypeError, ValueError, OverflowError):
        number = inf
    if not isfinite(number) or isinstance(value, str | bytes):
        raise QueryError(f"{name} must be a finite number {unit}, not {value!r}")
    return number


def as_position(position: Iterable[float]) -> tuple[float, float, float]:
    """Three finite numbers; anything else is a `QueryError`."""
    try:
        x, y, z = map(float, position)
    except (TypeError, ValueError):
        x = y = z = inf
    if not (isfinite(x) and isfinite(y) and isfinite(z)):
        raise QueryError(f"a TCP position is three finite numbers [m], not {position!r}")
    return x, y, z


def as_positions(positions: ArrayLike) -> Floats:
    """(n, 3) finite numbers, n ≥ 1; anything else is a `QueryError`."""
    try:
        points = np.ascontiguousarray(np.atleast_2d(np.asarray(positions, dtype=float)))
    except (TypeError, ValueError):
        raise QueryError(f"TCP positions are an array (n, 3) of finite numbers [m], not {positions!r}") from None
    if points.ndim != 2 or points.shape[1] != 3 or len(points) == 0 or not np.isfinite(points).all():
        raise QueryError(f"TCP positions are an array (n, 3) of finite numbers [m] with n ≥ 1, not {points.shape}")
    return points


def as_yaw_range(yaw_range: Iterable[float]) -> tuple[float, float]:
    """A pair of finite angles, at most a turn apart [rad]; anything else is a `QueryError`."""
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
    """(r, 2) ranges, each as in `as_yaw_range`; one pair (2,) gives r = 1."""
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


def approach_yaws(yaw_range: tuple[float, float], step: float, samples: int = 1) -> Floats:
    """Approach yaws (n,) of a checked range, increasing [rad].

    Args:
        yaw_range: [rad].
        step: largest distance between two of the yaws [rad].
        samples: for a full turn, the number of yaws is a multiple of this.
    """
    low, high = yaw_range
    if high - low >= 2 * pi - _ROUNDING:
        count = samples * ceil(2 * pi / step / samples - _ROUNDING)
        return np.asarray(low + np.arange(count) * (2 * pi / count))
    count = ceil((high - low) / step - _ROUNDING) + 1
    if count == 1:
        return np.array([(low + high) / 2])
    return np.asarray(low + np.arange(count) * ((high - low) / (count - 1)))
