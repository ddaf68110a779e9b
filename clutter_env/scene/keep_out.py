"""Region that a driving base avoids."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_CLEARANCE = 0.05
"""[m] Distance from the rectangle's corners, along x and along y, at which the base drives around them."""
_TOLERANCE = 1e-6
"""[m] Least depth at which a line is regarded as entering the rectangle."""


@dataclass(frozen=True, eq=False)
class KeepOutRegion:
    """A rectangle on the ground, in the world frame, that the base avoids.

    Attributes:
        low, high: (2,) lowest and highest x and y [m]. A side is infinite if no demonstration drives around it.
    """

    low: Array
    high: Array

    def path(self, start: Array, goal: Array) -> Array:
        """Base poses (n, 3) to drive to in order, from a base pose (3,) to a goal (3,). The last pose is the goal.

        The path is the shortest outside the rectangle over at most two corners, or the straight line if no such path
        exists. If start or goal lies inside, the rectangle is shrunk to exclude it, because the base has to fit at
        these poses. Yaw changes in proportion to the distance driven.
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
        """The rectangle with its nearest side moved so that a base (3,) is outside."""
        sides = np.stack((self.low, self.high))
        depth = (base[:2] - sides) * ((1.0,), (-1.0,))
        if not (depth > 0).all():
            return self
        side = np.unravel_index(np.argmin(depth), depth.shape)
        sides[side] = base[side[1]]
        return KeepOutRegion(*sides)

    def _corners(self) -> Iterator[tuple[Array, ...]]:
        """Sequences of one or two corners that a path may pass."""
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
    """Lengths (n - 1,) [m] of the legs of a path (n, 2)."""
    return np.asarray(np.linalg.norm(np.diff(path, axis=0), axis=1))
