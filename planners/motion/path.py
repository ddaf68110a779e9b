"""Motions of the whole robot before timing, and the two kinds of failure to plan them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planners.scene import HeldObject

Array = NDArray[np.float64]

CLEARANCE = 0.01
"""Distance [m] that motions keep from everything if possible: the arm lags, and held objects sink by some mm."""
SAME_BASE = 1e-6
"""Difference [m, rad] up to which base poses are the same: rounding."""


@dataclass(frozen=True, eq=False)
class WholeBodyPath:
    """A motion of base, torso and arm, straight between configurations. Arrays are read-only.

    Attributes:
        configurations: (n, 11) base x [m], y [m], yaw [rad] (continuous), torso [m] and arm [rad].
        opening: gripper opening [m].
        held: the held object.
        ignore: mask of objects that were no obstacles.
    """

    configurations: Array
    opening: float
    held: HeldObject | None = None
    ignore: int = 0

    def __post_init__(self) -> None:
        array = np.array(self.configurations, dtype=float)
        array.setflags(write=False)
        object.__setattr__(self, "configurations", array)

    @property
    def end_base(self) -> Array:
        """Base pose (3,) at the end."""
        return np.asarray(self.configurations[-1, :3])

    @property
    def end(self) -> Array:
        """Torso and arm (8,) at the end."""
        return np.asarray(self.configurations[-1, 3:])

    def reversed(self) -> WholeBodyPath:
        """The same motion in reverse."""
        return replace(self, configurations=self.configurations[::-1])


@dataclass(frozen=True)
class BlockedBy:
    """No path in the present scene: these objects are in the way, in this phase of the motion."""

    blockers: frozenset[str]
    phase: str


@dataclass(frozen=True)
class NoPath:
    """No path even if objects are cleared. `reason`: limits, static obstacles, self-collision, or search given up."""

    reason: str


NO_WAY = NoPath("drive: no way for the base")
"""No drive between two base poses, although each of them is free."""


def on_base(bases: ArrayLike, waypoints: ArrayLike) -> Array:
    """Join base poses (n, 3) with torso and arm (n, 8) into configurations (n, 11). A single row is repeated."""
    bases, waypoints = np.atleast_2d(bases), np.atleast_2d(waypoints)
    X = np.empty((len(waypoints) if len(bases) == 1 else len(bases), bases.shape[1] + waypoints.shape[1]))
    X[:, : bases.shape[1]], X[:, bases.shape[1] :] = bases, waypoints
    return X


def cut(parts: NDArray[np.int64]) -> Array:
    """Positions (1 + m,) on a polygon whose segments are cut into parts (n,). 1.5: middle of the second segment."""
    segment = np.repeat(np.arange(len(parts)), parts)
    part = np.arange(1, len(segment) + 1) - np.repeat(np.cumsum(parts) - parts, parts)
    return np.append(0.0, segment + part / parts[segment])


def interpolate(at: Array, knots: NDArray[Any], points: Array) -> Array:
    """Interpolate all columns of points (k, d) at knots (k,) in one call, as `np.interp` does: (m, d)."""
    if len(points) == 1:
        return np.tile(points, (len(at), 1))
    left = np.searchsorted(knots[1:-1], at, side="right")
    with np.errstate(invalid="ignore"):  # knots may coincide
        slopes = (points[1:] - points[:-1]) / (knots[1:] - knots[:-1])[:, None]
    found = slopes.take(left, axis=0)
    found *= (at - knots[left])[:, None]
    found += points.take(left, axis=0)
    found[at >= knots[-1]] = points[-1]
    return found
