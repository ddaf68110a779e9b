"""What a placement query is given and what it answers."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from math import ceil, isfinite, pi

import numpy as np
from numpy.typing import ArrayLike, NDArray

from irm.errors import QueryError
from irm.queries.status import Status

__all__ = [
    "FULL_TURN",
    "SEPARATION",
    "YAW_STEP",
    "BasePlacement",
    "PlacementBatch",
    "approach_yaws",
    "as_count",
    "as_position",
    "as_positions",
    "as_yaw_range",
    "is_full_turn",
]

Floats = NDArray[np.float64]

FULL_TURN = (-np.pi, np.pi)
"""Every approach yaw."""

YAW_STEP = float(np.radians(15))
"""[rad] between the approach yaws tried."""

SEPARATION = 0.1
"""[m] between the bases of one answer, so that the next best is a second choice and not the first one again."""

_ROUNDING = 1e-9
"""[rad] by which a range may exceed a full turn."""


@dataclass(frozen=True)
class BasePlacement:
    """Where the base may stand, best first. Arrays are read-only; k = 0 when nothing was found.

    Attributes:
        status: YES if one of the bases is certain, NO if there is certainly none, UNKNOWN otherwise.
        poses: (k, 3) base x, y [m] and yaw [rad] in [-π, π).
        manipulability: (k,) μ at the map's cell, for paths and several targets the smallest one.
        torso: (k,) torso height that goes with it [m], for paths and several targets (k, m).
        approach_yaw: (k,) yaw of the hand in the world [rad], for several targets (k, m).
        certain: (k,) whether the hand certainly reaches from there.
    """

    status: Status
    poses: Floats
    manipulability: Floats
    torso: Floats
    approach_yaw: Floats
    certain: NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.poses)

    def __bool__(self) -> bool:
        return len(self.poses) > 0

    @staticmethod
    def nothing(status: Status) -> BasePlacement:
        """No base at all."""
        none = np.empty(0)
        return BasePlacement(status, np.empty((0, 3)), none, none, none, np.empty(0, dtype=bool))

    @staticmethod
    def of_rows(rows: Floats) -> BasePlacement:
        """From kernel rows (k, 7), k ≥ 1: x, y, yaw, approach yaw, μ, torso, certain."""
        rows.setflags(write=False)
        certain = rows[:, 6] > 0.5
        certain.setflags(write=False)
        status = Status.YES if True in certain.tolist() else Status.UNKNOWN
        return BasePlacement(status, rows[:, :3], rows[:, 4], rows[:, 5], rows[:, 3], certain)

    @staticmethod
    def of_service(rows: Floats, torsos: Floats, yaws: Floats, status: Status) -> BasePlacement:
        """From kernel rows (k, 5): x, y, yaw, smallest μ, certain; torsos and yaws (k, m)."""
        certain = rows[:, 4] > 0.5
        for array in (rows, torsos, yaws, certain):
            array.setflags(write=False)
        return BasePlacement(status, rows[:, :3], rows[:, 3], torsos, yaws, certain)

    def with_first_yaw(self) -> BasePlacement:
        """The same answer with one approach yaw (k,) for all positions."""
        return replace(self, approach_yaw=self.approach_yaw[:, 0])


@dataclass(frozen=True)
class PlacementBatch:
    """Answers to n queries with up to k bases each; row i is best first and filled with NaN beyond `count[i]`.

    Attributes:
        count: (n,) bases found.
        poses: (n, k, 3) base x, y [m] and yaw [rad].
        manipulability: (n, k).
        torso: (n, k) [m].
        approach_yaw: (n, k) [rad].
        certain: (n, k) whether the hand certainly reaches; False where nothing was found.
    """

    count: NDArray[np.int64]
    poses: Floats
    manipulability: Floats
    torso: Floats
    approach_yaw: Floats
    certain: NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.count)

    @staticmethod
    def of_rows(rows: Floats, count: NDArray[np.int64]) -> PlacementBatch:
        """From kernel rows (n, k, 7), see `BasePlacement.of_rows`."""
        certain = rows[..., 6] > 0.5
        for array in (rows, count, certain):
            array.setflags(write=False)
        return PlacementBatch(count, rows[..., :3], rows[..., 4], rows[..., 5], rows[..., 3], certain)


def as_position(position: Iterable[float]) -> tuple[float, float, float]:
    """Three finite numbers.

    Raises:
        QueryError: they are not.
    """
    try:
        x, y, z = map(float, position)
    except (TypeError, ValueError):
        raise QueryError(f"a hand position is three finite numbers [m], not {position!r}") from None
    if not (isfinite(x) and isfinite(y) and isfinite(z)):
        raise QueryError(f"a hand position is three finite numbers [m], not {position!r}")
    return x, y, z


def as_positions(positions: ArrayLike) -> Floats:
    """(n, 3) finite numbers, n ≥ 1."""
    points = np.ascontiguousarray(np.atleast_2d(np.asarray(positions, dtype=float)))
    if points.ndim != 2 or points.shape[1] != 3 or len(points) == 0 or not np.isfinite(points).all():
        raise QueryError(f"hand positions are an array (n, 3) of finite numbers [m] with n ≥ 1, not {points.shape}")
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


def is_full_turn(yaw_range: tuple[float, float]) -> bool:
    """Whether a range leaves the yaw open."""
    return yaw_range[1] - yaw_range[0] >= 2 * pi - _ROUNDING


def approach_yaws(yaw_range: tuple[float, float], step: float, samples: int = 1) -> Floats:
    """(n,) increasing yaws of a checked range, at most `step` apart; n for a full turn is a multiple of `samples`."""
    if not (isfinite(step) and step > 0):
        raise QueryError(f"yaw_step must be a positive number, not {step}")
    low, high = yaw_range
    if is_full_turn(yaw_range):
        count = samples * ceil(2 * pi / step / samples - _ROUNDING)
        return np.asarray(low + np.arange(count) * (2 * pi / count))
    count = ceil((high - low) / step - _ROUNDING) + 1
    if count == 1:
        return np.array([(low + high) / 2])
    return np.asarray(low + np.arange(count) * ((high - low) / (count - 1)))


def as_count(k: int) -> int:
    """A number of bases, at least 1."""
    if k != int(k) or k < 1:
        raise QueryError(f"k is a number of bases, at least 1, not {k!r}")
    return int(k)
