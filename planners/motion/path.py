"""Motions of the whole robot, not timed yet, and the two kinds of failure to plan them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planners.scene import HeldObject

Array = NDArray[np.float64]

CLEARANCE = 0.01
"""[m] that free motions keep from everything where they can: the arm lags, and what is held sinks by some mm."""
SAME_BASE = 1e-6
"""[m, rad] by which base poses may differ that count as the same: rounding."""


@dataclass(frozen=True, eq=False)
class WholeBodyPath:
    """A motion of base, torso and arm, straight between configurations. Arrays are read-only.

    Attributes:
        configurations: (n, 11) base x [m], y [m], yaw [rad] (continuous), torso [m] and arm [rad].
        opening: of the gripper [m].
        held: the held object.
        ignore: mask of objects that did not count as obstacles.
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
        """(3,) base pose at the end."""
        return np.asarray(self.configurations[-1, :3])

    @property
    def end(self) -> Array:
        """(8,) torso and arm at the end."""
        return np.asarray(self.configurations[-1, 3:])

    def reversed(self) -> WholeBodyPath:
        """The same motion backwards."""
        return replace(self, configurations=self.configurations[::-1])


@dataclass(frozen=True)
class BlockedBy:
    """No path as the scene is: these objects are in the way, in this phase of the motion."""

    blockers: frozenset[str]
    phase: str


@dataclass(frozen=True)
class NoPath:
    """No path, whatever is cleared, and why: limits, static obstacles, self-collision, or the search gave up."""

    reason: str


NO_WAY = NoPath("drive: no way for the base")
"""No drive between two base poses, each of which is free."""


def on_base(bases: ArrayLike, waypoints: ArrayLike) -> Array:
    """Whole-body configurations (n, 11): base poses (n, 3) with torso and arm (n, 8); one of either is that of all."""
    bases, waypoints = np.atleast_2d(bases), np.atleast_2d(waypoints)
    X = np.empty((len(waypoints) if len(bases) == 1 else len(bases), bases.shape[1] + waypoints.shape[1]))
    X[:, : bases.shape[1]], X[:, bases.shape[1] :] = bases, waypoints
    return X


def cut(parts: NDArray[np.int64]) -> Array:
    """Places (1 + m,) on a polygon whose segments are cut into so many parts (n,): 1.5 is the middle of the second."""
    segment = np.repeat(np.arange(len(parts)), parts)
    part = np.arange(1, len(segment) + 1) - np.repeat(np.cumsum(parts) - parts, parts)
    return np.append(0.0, segment + part / parts[segment])


def interpolate(at: Array, knots: NDArray[Any], points: Array) -> Array:
    """`np.interp` of all columns of points (k, d), which belong to knots (k,), in one call: (m, d)."""
    if len(points) == 1:
        return np.tile(points, (len(at), 1))
    left = np.searchsorted(knots[1:-1], at, side="right")
    with np.errstate(invalid="ignore"):  # knots may be the same
        slopes = (points[1:] - points[:-1]) / (knots[1:] - knots[:-1])[:, None]
    found = slopes.take(left, axis=0)
    found *= (at - knots[left])[:, None]
    found += points.take(left, axis=0)
    found[at >= knots[-1]] = points[-1]
    return found
