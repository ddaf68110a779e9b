"""What many configurations, straight motions and whole paths hit, compiled: loops around `configuration_hits`."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from irm.compilation import njit
from planners.collision.compilation import leaf_kernel
from planners.collision.configuration_kernel import CollisionQuery, configuration_hits
from planners.collision.references import by_reference

Array = NDArray[np.float64]

_NONE = np.uint64(0)


@njit(cache=True)
def many_hits(query: CollisionQuery, base: Array, Q: Array) -> NDArray[np.uint64]:
    """`configuration_hits` of each row of `Q` (k, n) at one base pose (3,): (k,)."""
    checks, hits = by_reference(query), np.empty(Q.shape[0], np.uint64)
    for row in range(Q.shape[0]):
        hits[row] = configuration_hits(checks, query.active, base, Q[row])
    return hits


@leaf_kernel
def edge_samples(reach: Array, start: Array, end: Array, step: float) -> int:
    """Into how many parts a straight motion must be cut so that no point moves more than `step` [m] in one.

    `reach` (3 + n,) is that of `Attached`; `start` and `end` (3 + n,) are whole-body configurations.
    """
    length = math.hypot(end[0] - start[0], end[1] - start[1])
    for joint in range(2, start.shape[0]):
        length += abs(end[joint] - start[joint]) * reach[joint]
    return max(1, math.ceil(length / step))


@leaf_kernel
def edge_hits(query: CollisionQuery, start: Array, end: Array, step: float) -> np.uint64:
    """What a straight motion between two whole-body configurations (3 + n,) hits; `start` itself is not checked.

    The query comes by reference. No point of the robot moves more than `step` [m] between two checks, so nothing deeper
    than `step / 2 - padding` is missed. The end comes first, then ever finer subdivisions: a blocked edge is refused
    early.
    """
    parts = edge_samples(query.attached.reach, start, end, step)
    x = query.scratch.x
    for joint in range(x.shape[0]):
        x[joint] = end[joint]
    hits = configuration_hits(query, query.active, x[:3], x[3:])
    stride = 1
    while 2 * stride < parts:
        stride *= 2
    while stride >= 1 and not (query.first_only and hits != _NONE):
        for i in range(stride, parts, 2 * stride):
            for joint in range(x.shape[0]):
                x[joint] = start[joint] + (end[joint] - start[joint]) * i / parts
            hits |= configuration_hits(query, query.active, x[:3], x[3:])
            if query.first_only and hits != _NONE:
                return np.uint64(hits)
        stride //= 2
    return np.uint64(hits)


@njit(cache=True)
def path_hits(query: CollisionQuery, X: Array, step: float) -> np.uint64:
    """What a piecewise straight motion through whole-body configurations `X` (k, 3 + n) hits, both ends included."""
    checks = by_reference(query)
    hits = configuration_hits(checks, query.active, X[0, :3], X[0, 3:])
    for row in range(1, X.shape[0]):
        if query.first_only and hits != _NONE:
            break
        hits |= edge_hits(checks, X[row - 1], X[row], step)
    return np.uint64(hits)
