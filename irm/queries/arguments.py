"""Arguments of the placement queries: defaults, meaning, and one place that checks them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields
from functools import lru_cache
from math import ceil, inf, isfinite, pi
from operator import index
from typing import Any, TypedDict

import numpy as np
from numpy.typing import ArrayLike, NDArray

from irm.errors import QueryError
from irm.floor.free_space import EVERYWHERE, FreeSpace
from irm.visibility.map import VisibilityMap
from irm.visibility.tie_break import COMPARED_BASES

__all__ = [
    "FULL_TURN",
    "SEPARATION",
    "YAW_STEP",
    "QueryKeywords",
    "QueryOptions",
    "approach_yaws",
    "as_position",
    "as_positions",
    "as_yaw_range",
    "as_yaw_ranges",
    "is_full_turn",
]

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


class QueryKeywords(TypedDict, total=False):
    """The keyword arguments that all queries share, for type checkers; `QueryOptions` gives meaning and defaults."""

    pitch: float
    roll: float
    free_space: FreeSpace | None
    k: int
    separation: float
    yaw_step: float
    exact: bool | None
    prefer: VisibilityMap | None


@dataclass(frozen=True, slots=True)
class QueryOptions:
    """The keyword arguments that all queries share, checked.

    Attributes:
        pitch: of the TCP [rad]; a positive pitch points the approach down.
        roll: about the approach [rad]; ignored by maps of robots whose wrist rolls freely.
        free_space: where the base may stand; None for everywhere.
        k: number of bases to return at most, 1 to 100,000.
        separation: smallest distance between two of them [m].
        yaw_step: largest distance between two approach yaws that are tried, at least 0.001 [rad].
        exact: whether the bases are decided by exact inverse kinematics. Those that certainly do not reach are dropped,
            and `certain` is exact. None: for paths of arms with a closed form only, where it takes little time.
        prefer: of bases with about the same μ, those come first from which this map's camera sees more of the target;
            None to order them by μ alone. Only `query` and `query_batch` take it.

    Raises:
        QueryError: a value is not of its kind, not finite or out of its range.
    """

    pitch: float = 0.0
    roll: float = 0.0
    free_space: FreeSpace | None = None
    k: int = 1
    separation: float = SEPARATION
    yaw_step: float = YAW_STEP
    exact: bool | None = None
    prefer: VisibilityMap | None = None

    def __post_init__(self) -> None:
        for name, unit in (("pitch", "[rad]"), ("roll", "[rad]"), ("separation", "[m]"), ("yaw_step", "[rad]")):
            object.__setattr__(self, name, _as_number(name, unit, getattr(self, name)))
        if self.separation < 0.0:
            raise QueryError(f"separation must be a number ≥ 0 [m], not {self.separation}")
        if self.yaw_step < SMALLEST_YAW_STEP:
            raise QueryError(f"yaw_step must be at least {SMALLEST_YAW_STEP} rad, not {self.yaw_step}")
        if not (self.free_space is None or isinstance(self.free_space, FreeSpace)):
            raise QueryError(f"free_space is a FreeSpace or None, not {type(self.free_space).__name__}")
        if not (self.exact is None or isinstance(self.exact, bool | np.bool_)):
            raise QueryError(f"exact is True, False or None, not {self.exact!r}")
        if not (self.prefer is None or isinstance(self.prefer, VisibilityMap)):
            raise QueryError(f"prefer is a VisibilityMap or None, not {type(self.prefer).__name__}")
        object.__setattr__(self, "k", _as_count(self.k))

    @staticmethod
    def of(keywords: Mapping[str, Any], *own: str) -> QueryOptions:
        """The options of one call.

        Args:
            keywords: those of the call that are not among its `own`.
            own: keyword arguments of this query alone, for the error message.

        Raises:
            QueryError: a keyword is unknown; the message lists the valid ones.
        """
        try:
            return _recent_options(**keywords)
        except TypeError:
            unknown = [name for name in keywords if name not in _NAMES]
            if unknown:
                listed = ", ".join((*own, *_NAMES))
                raise QueryError(f"unknown keyword {', '.join(unknown)}; this query takes {listed}") from None
            return QueryOptions(**keywords)

    @property
    def floor(self) -> FreeSpace:
        """`free_space`, or all of the floor if that is None."""
        return self.free_space or EVERYWHERE

    @property
    def compared(self) -> int:
        """Number of bases to compare: `k`, and some more if the most visible ones are preferred."""
        return self.k if self.prefer is None else self.k + COMPARED_BASES

    def without_preference(self, query: str) -> QueryOptions:
        """The options themselves.

        Raises:
            QueryError: `prefer` is given to a query that does not take it.
        """
        if self.prefer is not None:
            raise QueryError(f"{query} takes no prefer; query and query_batch of InverseReachabilityMap do")
        return self


_NAMES = tuple(field.name for field in fields(QueryOptions))

_recent_options = lru_cache(maxsize=16)(QueryOptions)
"""To make and check options takes a tenth of the time of a query, and most queries repeat those of the last one."""


def _as_number(name: str, unit: str, value: Any) -> float:
    """One finite number."""
    try:
        number = float(value)
    except (TypeError, ValueError, OverflowError):
        number = inf
    if not isfinite(number) or isinstance(value, str | bytes):
        raise QueryError(f"{name} must be a finite number {unit}, not {value!r}")
    return number


def _as_count(k: Any) -> int:
    """A number of bases."""
    try:
        count = index(k)
    except TypeError:
        count = 0
    if isinstance(k, bool) or not 1 <= count <= MOST_BASES:
        raise QueryError(f"k is a number of bases, at least 1 and at most {MOST_BASES}, not {k!r}")
    return count


def as_position(position: Iterable[float]) -> tuple[float, float, float]:
    """Three finite numbers.

    Raises:
        QueryError: they are not.
    """
    try:
        x, y, z = map(float, position)
    except (TypeError, ValueError):
        raise QueryError(f"a TCP position is three finite numbers [m], not {position!r}") from None
    if not (isfinite(x) and isfinite(y) and isfinite(z)):
        raise QueryError(f"a TCP position is three finite numbers [m], not {position!r}")
    return x, y, z


def as_positions(positions: ArrayLike) -> Floats:
    """(n, 3) finite numbers, n ≥ 1.

    Raises:
        QueryError: they are not.
    """
    try:
        points = np.ascontiguousarray(np.atleast_2d(np.asarray(positions, dtype=float)))
    except (TypeError, ValueError):
        raise QueryError(f"TCP positions are an array (n, 3) of finite numbers [m], not {positions!r}") from None
    if points.ndim != 2 or points.shape[1] != 3 or len(points) == 0 or not np.isfinite(points).all():
        raise QueryError(f"TCP positions are an array (n, 3) of finite numbers [m] with n ≥ 1, not {points.shape}")
    return points


def as_yaw_range(yaw_range: Iterable[float]) -> tuple[float, float]:
    """A pair of finite angles, at most a turn apart [rad].

    Raises:
        QueryError: the range is empty, longer than a turn, or not finite.
    """
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
    """(r, 2) ranges, each as in `as_yaw_range`; one pair (2,) gives r = 1.

    Raises:
        QueryError: they are not pairs, or one of them is no valid range.
    """
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


def is_full_turn(yaw_range: tuple[float, float]) -> bool:
    """Whether a range contains every yaw."""
    return yaw_range[1] - yaw_range[0] >= 2 * pi - _ROUNDING


def approach_yaws(yaw_range: tuple[float, float], step: float, samples: int = 1) -> Floats:
    """Approach yaws of a checked range.

    Args:
        yaw_range: [rad].
        step: largest distance between two of the yaws [rad].
        samples: for a full turn, the number of yaws is a multiple of this.

    Returns:
        (n,) increasing yaws [rad].
    """
    low, high = yaw_range
    if is_full_turn(yaw_range):
        count = samples * ceil(2 * pi / step / samples - _ROUNDING)
        return np.asarray(low + np.arange(count) * (2 * pi / count))
    count = ceil((high - low) / step - _ROUNDING) + 1
    if count == 1:
        return np.array([(low + high) / 2])
    return np.asarray(low + np.arange(count) * ((high - low) / (count - 1)))
