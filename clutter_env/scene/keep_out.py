"""A region that a driving base keeps out of."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_CLEARANCE = 0.05
"""[m] off the rectangle's corners, along x and along y, at which the base goes round them."""
_TOLERANCE = 1e-6
"""[m] by which a line must enter the rectangle to count."""


@dataclass(frozen=True, eq=False)
class KeepOutRegion:
    """A rectangle on the ground, in the world, that the base keeps out of.

    Attributes:
        low, high: (2,) x and y [m] of its sides; infinite where no demonstration goes round.
    """

    low: Array
    high: Array

    def path(self, start: Array, goal: Array) -> Array:
        """Base poses (n, 3) to drive to one after the other, from a base (3,) to a goal (3,); the goal is the last.

        The path is the shortest over corners that keeps out of the rectangle; straight where there is none. Where start
        or goal lies inside, the rectangle ends there: a base that is wanted there fits. Yaw changes evenly.
        """
        region = self._without(start)._without(goal)
        best = np.stack((start[:2], goal[:2]))
        if region._is_entered(*best):
            paths = [np.stack((start[:2], *corners, goal[:2])) for corners in region._corners()]
            free = [path for path in paths if not any(map(region._is_entered, path, path[1:]))] or [best]
            best = min(free, key=lambda path: float(_lengths(path).sum()))
        driven = np.cumsum(_lengths(best))
        turn = np.remainder(goal[2] - start[2] + np.pi, 2 * np.pi) - np.pi
        return np.column_stack((best[1:], start[2] + turn * driven / max(float(driven[-1]), _TOLERANCE)))

    def _without(self, base: Array) -> KeepOutRegion:
        """The rectangle with the nearest side moved so that a base (3,) is not inside."""
        sides = np.stack((self.low, self.high))
        depth = (base[:2] - sides) * ((1.0,), (-1.0,))
        if not (depth > 0).all():
            return self
        side = np.unravel_index(np.argmin(depth), depth.shape)
        sides[side] = base[side[1]]
        return KeepOutRegion(*sides)

    def _corners(self) -> Iterator[tuple[Array, ...]]:
        """The corners that a path may go over: one, or two."""
        sides = (self.low - _CLEARANCE, self.high + _CLEARANCE)
        corners = [np.array((x[0], y[1])) for x, y in product(sides, sides) if np.isfinite((x[0], y[1])).all()]
        yield from ((corner,) for corner in corners)
        yield from ((one, other) for one, other in product(corners, corners) if one is not other)

    def _is_entered(self, start: Array, end: Array) -> bool:
        """Whether a straight line (2,) to (2,) enters the rectangle."""
        first, last = 0.0, 1.0
        for low, high, here, there in zip(self.low + _TOLERANCE, self.high - _TOLERANCE, start, end, strict=True):
            if abs(there - here) < _TOLERANCE:
                if not low < here < high:
                    return False
                continue
            shares = sorted(((low - here) / (there - here), (high - here) / (there - here)))
            first, last = max(first, shares[0]), min(last, shares[1])
        return bool(first < last)


def _lengths(path: Array) -> Array:
    """(n - 1,) [m] of the legs of a path (n, 2)."""
    return np.asarray(np.linalg.norm(np.diff(path, axis=0), axis=1))
