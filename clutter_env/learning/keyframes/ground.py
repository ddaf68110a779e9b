"""Which ground the base keeps out of: the largest rectangle that no demonstrated drive enters; and the way round."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from clutter_env.learning.keyframes.motions import Motion

__all__ = ["NO_GROUND", "Ground", "closed_ground"]

Array = NDArray[np.float64]

_APART = 0.02
"""[m] between the points by which a demonstrated drive is compared with a rectangle, and between its possible sides."""
_ROOM = 0.05
"""[m] off the rectangle's corners, along x and along y, at which the base goes round them."""
_LEAST = 1e-6
"""[m] by which a line must enter the rectangle to count."""


@dataclass(frozen=True, eq=False)
class Ground:
    """A rectangle on the floor, in the world, that the base keeps out of.

    Attributes:
        low, high: (2,) x and y [m] of its sides; infinite where no demonstration goes round.
    """

    low: Array
    high: Array

    def way(self, start: Array, goal: Array) -> Array:
        """Where the base (3,) goes one after the other, (n, 3), to come to a goal (3,); the goal is the last.

        It is the shortest way over corners that keeps out of the rectangle; straight where there is none. Where start
        or goal lies inside, the rectangle ends there: a base that is wanted there has room. Yaw changes evenly.
        """
        sides = self._without(start)._without(goal)
        ways = [np.stack((start[:2], *corners, goal[:2])) for corners in sides._corners()]
        open_ways = [way for way in ways if not any(map(sides._is_entered, way, way[1:]))] or ways[:1]
        best = min(open_ways, key=lambda way: float(_lengths(way).sum()))
        gone = np.cumsum(_lengths(best))
        turn = np.remainder(goal[2] - start[2] + np.pi, 2 * np.pi) - np.pi
        return np.column_stack((best[1:], start[2] + turn * gone / max(float(gone[-1]), _LEAST)))

    def _without(self, base: Array) -> Ground:
        """The rectangle with the nearest side moved so that a base (3,) is not inside."""
        sides = np.stack((self.low, self.high))
        depth = (base[:2] - sides) * ((1.0,), (-1.0,))
        if not (depth > 0).all():
            return self
        side = np.unravel_index(np.argmin(depth), depth.shape)
        sides[side] = base[side[1]]
        return Ground(*sides)

    def _corners(self) -> Iterator[tuple[Array, ...]]:
        """What a way may go over: nothing, a corner, or two."""
        yield ()
        sides = (self.low - _ROOM, self.high + _ROOM)
        corners = [np.array((x[0], y[1])) for x, y in product(sides, sides) if np.isfinite((x[0], y[1])).all()]
        yield from ((corner,) for corner in corners)
        yield from ((one, other) for one, other in product(corners, corners) if one is not other)

    def _is_entered(self, start: Array, end: Array) -> bool:
        """Whether a straight line (2,) to (2,) enters the rectangle."""
        first, last = 0.0, 1.0
        for low, high, here, there in zip(self.low + _LEAST, self.high - _LEAST, start, end, strict=True):
            if abs(there - here) < _LEAST:
                if not low < here < high:
                    return False
                continue
            shares = sorted(((low - here) / (there - here), (high - here) / (there - here)))
            first, last = max(first, shares[0]), min(last, shares[1])
        return bool(first < last)


NO_GROUND = Ground(np.zeros(2), np.zeros(2))
"""No ground is closed."""


def closed_ground(motions: Iterable[Motion]) -> Ground:
    """The largest rectangle about the middle of the table that no drive of these motions enters.

    Sides beyond which nothing drives are infinitely far away.
    """
    drives = [
        motion.reading.base[steps.start : steps.stop + 1, :2]
        for motion in motions
        for phase, steps in motion.runs()
        if phase == "drive"
    ]
    return _largest_empty(np.concatenate([_filled(drive) for drive in drives])) if drives else NO_GROUND


def _filled(path: Array) -> Array:
    """Points (n, 2) on a path at most `_APART` from one another."""
    counts = np.ceil(_lengths(path) / _APART).astype(int)
    parts = [np.linspace(one, other, count, False) for one, other, count in zip(path, path[1:], counts, strict=False)]
    return np.concatenate((*parts, path[-1:]))


def _largest_empty(points: Array) -> Ground:
    """The largest rectangle about the origin with none of these points (n, 2) inside; measured as far as they reach."""
    if not len(points):
        return NO_GROUND
    nearest, farthest = np.minimum(points.min(axis=0), 0.0), np.maximum(points.max(axis=0), 0.0)
    y = _APART * np.unique(np.round(points[:, 1] / _APART))
    # Infinity comes first: of rectangles that are equally large the one without a side there is taken.
    lows, highs = np.append(-np.inf, y[y < 0]), np.append(np.inf, y[y > 0])
    best, largest = NO_GROUND, 0.0
    for low, high in product(lows, highs):
        x = points[(points[:, 1] > low) & (points[:, 1] < high), 0]
        left, right = x[x < 0].max(initial=-np.inf), x[x >= 0].min(initial=np.inf)
        found = Ground(np.array((left, low)), np.array((right, high)))
        area = float(np.prod(np.minimum(found.high, farthest) - np.maximum(found.low, nearest)))
        if area > largest:
            best, largest = found, area
    return best


def _lengths(path: Array) -> Array:
    """(n - 1,) [m] of the legs of a path (n, 2)."""
    return np.asarray(np.linalg.norm(np.diff(path, axis=0), axis=1))
