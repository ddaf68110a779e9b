"""Depth-first search for small self-clearable sets, on bit masks, compiled.

Objects are removed one by one, each once the blockers of one of its options are gone. This is planning without delete
effects. A *landmark* is a set of objects of which every self-clearable set must contain one. Landmarks that share no
object add up to a lower bound. Branching on a landmark visits every self-clearable set exactly once.
"""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from irm.compilation import njit
from planners.scene.masks import Mask

EXHAUSTED, FOUND, PAUSED = 0, 1, 2
"""Status: no further set within the budget, one found, or node limit of this call reached. The search can be
resumed."""

Array: TypeAlias = NDArray[np.int64]

_BITS = 62
_ONE = np.int64(1)
_NONE = np.int64(0)


class SearchStack:
    """The state of a search between two calls of `search`: committed, excluded and untried objects per depth.

    Attributes:
        frames: (depth, 3) int64 masks: committed, excluded, still to branch on.
        registers: (3,) int64: current depth, nodes visited, smallest size known to exceed the budget.
    """

    def __init__(self, target: int) -> None:
        """Start at the set of the target alone."""
        self.frames = np.zeros((_BITS + 2, 3), np.int64)
        self.frames[0, 2] = 1 << target
        self.registers = np.array([0, 0, _BITS + 1], np.int64)

    @property
    def nodes(self) -> int:
        """Number of sets visited so far."""
        return int(self.registers[1])

    @property
    def next_budget(self) -> int:
        """Smallest size of a set beyond the budget, 0 if none exists. Known once the search is exhausted."""
        return int(self.registers[2]) if self.registers[2] <= _BITS else 0


@njit(cache=True)
def bit_count(mask: Mask) -> int:
    """Number of set bits of a non-negative int64."""
    count = 0
    while mask:
        mask &= mask - 1
        count += 1
    return count


@njit(cache=True)
def _has_usable_option(masks: Array, starts: Array, index: int, removed: Mask) -> bool:
    for k in range(starts[index], starts[index + 1]):  # noqa: SIM110  a generator does not compile
        if masks[k] & ~removed == 0:
            return True
    return False


@njit(cache=True)
def closure(masks: Array, starts: Array, allowed: Mask, removed: Mask) -> Mask:
    """All objects of `allowed` that can be removed one by one once the objects of `removed` are gone (int64 mask).

    `masks[starts[i]:starts[i + 1]]` are the blockers of object i's options.
    """
    count = starts.shape[0] - 1
    grown = True
    while grown:
        grown = False
        for index in range(count):
            bit = _ONE << index
            if allowed & bit and not removed & bit and _has_usable_option(masks, starts, index, removed):
                removed |= bit
                grown = True
    return removed


@njit(cache=True)
def _landmark(
    masks: Array, starts: Array, order: Array, target_bit: Mask, allowed: Mask, excluded: Mask, removed: Mask
) -> Mask:
    """An inclusion-minimal landmark disjoint from `allowed` and `excluded`. Empty if the target can never be removed.

    `allowed` grows object by object while the target stays out of reach. The objects left over form the landmark.
    """
    missing: Mask = _NONE
    for position in range(order.shape[0]):
        bit = _ONE << order[position]
        if (allowed | excluded) & bit:
            continue
        if not _has_usable_option(masks, starts, order[position], removed):
            allowed |= bit
            continue
        reached = closure(masks, starts, allowed | bit, removed | bit)
        if reached & target_bit:
            missing |= bit
        else:
            allowed |= bit
            removed = reached
    return missing


@njit(cache=True)
def disjoint_landmarks(
    masks: Array, starts: Array, orders: Array, target_bit: Mask, committed: Mask, excluded: Mask, most: int
) -> tuple[int, Mask]:
    """Lower bound on the objects to add to `committed`, and the smallest landmark to branch on.

    It stops once the bound exceeds `most`. It is (-1, 0) if the target cannot be reached without `excluded`. The bound
    is 0 when `committed` is self-clearable.
    """
    removed = closure(masks, starts, committed, _NONE)
    if removed & target_bit:
        return 0, _NONE
    best_bound = 0
    best: Mask = _NONE
    for k in range(orders.shape[0]):
        allowed = committed
        reached = removed
        bound = 0
        while not reached & target_bit:
            landmark = _landmark(masks, starts, orders[k], target_bit, allowed, excluded, reached)
            if landmark == 0:
                return -1, _NONE
            if best == 0 or bit_count(landmark) < bit_count(best):
                best = landmark
            bound += 1
            if bound > most:
                return bound, best
            allowed |= landmark
            reached = closure(masks, starts, allowed, reached)
        best_bound = max(best_bound, bound)
    return best_bound, best


@njit(cache=True)
def search(
    masks: Array,
    starts: Array,
    orders: Array,
    target: int,
    budget: int,
    frames: Array,
    registers: Array,
    node_limit: int,
) -> tuple[int, Mask]:
    """Next self-clearable set with exactly `budget` objects, the target included.

    The search is depth-first over sets. Siblings exclude the objects tried before them, so no set is visited twice. A
    set that is self-clearable before the budget is used up is not extended. `frames` and `registers` belong to a
    `SearchStack`.

    Returns:
        status (FOUND, EXHAUSTED or PAUSED) and the found set (int64 mask).
    """
    target_bit = _ONE << target
    stop_at = registers[1] + node_limit
    depth = registers[0]
    while depth >= 0:
        if frames[depth, 2] == 0:
            depth -= 1
            continue
        if registers[1] >= stop_at:
            registers[0] = depth
            return PAUSED, _NONE
        registers[1] += 1
        bit: Mask = frames[depth, 2] & -frames[depth, 2]
        frames[depth, 2] ^= bit
        committed: Mask = frames[depth, 0] | bit
        excluded = frames[depth, 1]
        frames[depth, 1] |= bit
        size = bit_count(committed)
        bound, landmark = disjoint_landmarks(masks, starts, orders, target_bit, committed, excluded, budget - size)
        if bound < 0:
            continue
        if bound == 0:
            if size == budget:
                registers[0] = depth
                return FOUND, committed
            continue
        if size + bound > budget:
            registers[2] = min(registers[2], size + bound)
            continue
        depth += 1
        frames[depth, 0] = committed
        frames[depth, 1] = excluded
        frames[depth, 2] = landmark
    registers[0] = depth
    return EXHAUSTED, _NONE
