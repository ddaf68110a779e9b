"""Clearances that are left, from what the network predicts about candidates: value iteration over the objects.

The cost of taking an object is that of its best candidate. At a candidate every object that may be in the way costs
the lesser of two: the risk of touching it, or clearing it first, one clearance and what it takes to take that object.
Costs start at `MAX_COST` and fall until they no longer change, as in Bellman-Ford. An object that stands in the way of
two others that are both cleared is counted twice: the values are upper bounds of the clearances.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

MAX_COST = 12.0
"""[clearances] Cost of an object that cannot be taken."""
RISK = 10.0
"""[clearances] Cost of a candidate that certainly fails."""
_ROUNDS = 12
"""Rounds at most: a chain of clearances is hardly ever longer."""


@dataclass(frozen=True, eq=False)
class Costs:
    """Costs [clearances] in k variants of one scene.

    Attributes:
        objects: (k, n) of taking each object.
        candidates: (k, m) of each candidate.
        is_cleared: (k, m, n) whether an object that may be in the way of a candidate had better be cleared first.
    """

    objects: Array
    candidates: Array
    is_cleared: NDArray[np.bool_]


def clearing_costs(own: NDArray[np.int64], fixed: Array, blocks: Array, known: Array | None = None) -> Costs:
    """Costs of m candidates of n objects.

    Args:
        own: (m,) index of the object of each candidate.
        fixed: (m,) cost of a candidate whatever stands in its way.
        blocks: (k, m, n) probabilities that an object is in the way, 0 for its own.
        known: (n,) costs of objects that are known already, NaN for others.
    """
    variants, candidates, count = blocks.shape
    objects = np.full((variants, count), MAX_COST)
    order = np.argsort(own, kind="stable")
    present, first = np.unique(own[order], return_index=True)
    risk = RISK * blocks
    total = np.full((variants, candidates), MAX_COST)
    is_known = np.zeros(count, np.bool_) if known is None else ~np.isnan(known)
    for _ in range(_ROUNDS):
        if known is not None:
            objects[:, is_known] = known[is_known]
        total = fixed + np.minimum(risk, 1.0 + objects[:, None]).sum(axis=2)
        found = objects.copy()
        if candidates:
            found[:, present] = np.minimum(np.minimum.reduceat(total[:, order], first, axis=1), MAX_COST)
        if np.allclose(found, objects):
            break
        objects = found
    return Costs(objects, total, risk > 1.0 + objects[:, None])
