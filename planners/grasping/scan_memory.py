"""Memory of a scan for arm configurations, allocated outside compiled code."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from irm.ik.closed_form import MAX_SOLUTIONS

__all__ = ["CAPACITY", "Kept", "Memory", "make_memory"]

Array = NDArray[np.float64]

CAPACITY = np.int64(96)
"""Configurations kept in all. Typed, so that kernels are not compiled once more for the constant."""


class Kept(NamedTuple):
    """Up to `CAPACITY` configurations of n joints; the first `size[0]` rows are in use.

    Attributes:
        q: (c, n) torso [m] and arm [rad].
        pair: (c,) index of gripper pose and base pose.
        hits: (c,) objects hit, as masks.
        quality: (c,) see `_quality`.
        size: (1,) number of rows in use.
    """

    q: Array
    pair: NDArray[np.int64]
    hits: NDArray[np.uint64]
    quality: Array
    size: NDArray[np.int64]


class Memory(NamedTuple):
    """What a scan of configurations of n joints writes to.

    Attributes:
        kept: the configurations found so far.
        found: (MAX_SOLUTIONS, n) inverse kinematics; `nearest` (n,) the configuration nearest to home.
        R, p: (n + 1, 3, 3) and (n + 1, 3) frames of the links; `J` (6, n - 1) the Jacobian, and memory of
            `condition`: `A` (6, 6), `d` and `e` (6,).
    """

    kept: Kept
    found: Array
    nearest: Array
    R: Array
    p: Array
    J: Array
    A: Array
    d: Array
    e: Array


def make_memory(joints: int) -> Memory:
    """Memory for one scan of configurations of so many joints, with nothing found yet."""
    n, rows = joints, int(CAPACITY)
    size = np.zeros(1, np.int64)
    kept = Kept(np.empty((rows, n)), np.empty(rows, np.int64), np.empty(rows, np.uint64), np.empty(rows), size)
    R, p, J = np.empty((n + 1, 3, 3)), np.empty((n + 1, 3)), np.empty((6, n - 1))
    return Memory(kept, np.empty((MAX_SOLUTIONS, n)), np.empty(n), R, p, J, np.empty((6, 6)), np.empty(6), np.empty(6))
