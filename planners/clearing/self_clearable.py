"""Self-clearable sets: which objects can be taken away one by one, and in which order?

Option j of object o is a way to grasp o; its *blockers* are the objects it hits where they stand now. A set of objects
is *self-clearable* for a target if its objects and then the target can be removed in some order, each through an
option whose blockers were all removed before.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import NamedTuple, TypeAlias

import numpy as np

from planners.clearing.search_kernel import closure
from planners.clock import NO_DEADLINE, Deadline
from planners.scene import MAX_OBJECTS

__all__ = [
    "FloorOptionsError",
    "OptionMasks",
    "OptionTable",
    "Removal",
    "is_self_clearable",
    "removal_orders",
    "usable_options",
]

OptionMasks: TypeAlias = Mapping[int, Sequence[int]] | Callable[[int], Sequence[int]]
"""Blocker masks of every option of an object, by object index; a callable is asked once per object that matters.

Objects are bits 0 … MAX_OBJECTS - 1; an option that hits a higher bit (a static obstacle, the robot) is never usable.
"""


class FloorOptionsError(ValueError):
    """The declared options cannot be read: a negative mask, or an object without any declaration."""


class Removal(NamedTuple):
    """One step of an order of removal: this object, through this one of its options."""

    object: int
    option: int


class OptionTable:
    """Options asked for as they are needed; an object not asked for yet counts as free to take, which is optimistic."""

    def __init__(self, options: OptionMasks, target: int) -> None:
        """Ask for the target's options.

        Raises:
            FloorOptionsError: the target is no object index, or its options cannot be read.
        """
        if not 0 <= target < MAX_OBJECTS:
            raise FloorOptionsError(f"target {target} is not an object index; valid: 0 … {MAX_OBJECTS - 1}")
        self._source = options if callable(options) else options.__getitem__
        self._target = target
        self._declared: dict[int, tuple[int, ...]] = {}
        self._minimal: dict[int, list[int]] = {}
        self._arrays: tuple[np.ndarray, np.ndarray, np.ndarray] | None = None
        self._size = target + 1
        self.declared(target)

    def declared(self, index: int) -> tuple[int, ...]:
        """Blocker masks of object `index` in the order declared, without its own bit."""
        if index not in self._declared:
            self._load(index)
        return self._declared[index]

    def load(self, mask: int, deadline: Deadline = NO_DEADLINE) -> bool:
        """Ask for the options of every object of `mask`, until the deadline; whether any were missing."""
        missing = [index for index in bits(mask) if index not in self._declared]
        for index in missing:
            if deadline.is_over:
                break
            self._load(index)
        return bool(missing)

    def arrays(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """What the compiled search reads.

        Returns:
            Minimal usable masks of all objects (m,), offsets of each object's masks (n + 1,), and the two orders
            (2, n) in which landmarks are grown.
        """
        if self._arrays is None:
            minimal = [self._minimal.get(index, [0]) for index in range(self._size)]
            starts = np.cumsum([0, *map(len, minimal)], dtype=np.int64)
            masks = np.array([mask for masks in minimal for mask in masks], np.int64)
            indices = np.arange(self._size, dtype=np.int64)
            self._arrays = masks, starts, np.stack((indices, indices[::-1]))
        return self._arrays

    def removable(self, allowed: int, removed: int = 0) -> int:
        """`removed` and all objects of `allowed` that can be removed one by one after it."""
        self.load(allowed)
        return self.optimistically_removable(allowed, removed)

    def optimistically_removable(self, allowed: int, removed: int = 0) -> int:
        """As `removable`, with objects whose options were not asked for counted as free to take."""
        masks, starts, _ = self.arrays()
        return int(closure(masks, starts, np.int64(allowed), np.int64(removed)))

    def everything(self) -> int:
        """All objects that occur so far, as a mask."""
        return (1 << self._size) - 1

    def _load(self, index: int) -> None:
        try:
            masks = tuple(int(mask) & ~(1 << index) for mask in self._source(index))
        except LookupError:
            raise FloorOptionsError(f"no options declared for object {index}") from None
        if any(mask < 0 for mask in masks):
            raise FloorOptionsError(f"object {index} has a negative blocker mask")
        self._declared[index] = masks
        self._minimal[index] = _minimal(self._usable(index))
        self._size = max([self._size, *(mask.bit_length() for mask in self._minimal[index])])
        self._arrays = None

    def _usable(self, index: int) -> list[int]:
        """Nothing waits for the target: it is taken last."""
        forbidden = 0 if index == self._target else 1 << self._target
        return [mask for mask in self._declared[index] if mask < 1 << MAX_OBJECTS and not mask & forbidden]


def bits(mask: int) -> Iterator[int]:
    """Indices of the set bits, lowest first."""
    while mask:
        low = mask & -mask
        yield low.bit_length() - 1
        mask ^= low


def usable_options(options: OptionMasks, index: int, removed: int) -> tuple[int, ...]:
    """Options of object `index` whose blockers are all in the mask `removed`, in the order declared."""
    masks = options(index) if callable(options) else options[index]
    return tuple(j for j, mask in enumerate(masks) if int(mask) & ~(1 << index) & ~removed == 0)


def removal_orders(options: OptionMasks | OptionTable, mask: int, target: int) -> Iterator[tuple[Removal, ...]]:
    """Every order in which the objects of `mask` and then the target can be removed, lowest indices first.

    Each step names the first option, in the order declared, that is free by then. Lazy: there may be many.
    """
    table = options if isinstance(options, OptionTable) else OptionTable(options, target)
    yield from _orders(table, mask & ~(1 << target), target, 0, ())


def is_self_clearable(options: OptionMasks, mask: int, target: int) -> bool:
    """Whether all objects of `mask` can be removed one by one, and the target after them."""
    return next(removal_orders(options, mask, target), None) is not None


def _orders(
    table: OptionTable, remaining: int, target: int, removed: int, done: tuple[Removal, ...]
) -> Iterator[tuple[Removal, ...]]:
    everything = remaining | 1 << target
    if table.removable(everything, removed) != everything | removed:
        return
    for index in bits(remaining) if remaining else (target,):
        option = next((j for j, mask in enumerate(table.declared(index)) if mask & ~removed == 0), None)
        if option is None:
            continue
        order = (*done, Removal(index, option))
        if remaining:
            yield from _orders(table, remaining & ~(1 << index), target, removed | 1 << index, order)
        else:
            yield order


def _minimal(masks: Sequence[int]) -> list[int]:
    """The masks of which no other is a subset."""
    kept: list[int] = []
    for mask in sorted(set(masks), key=int.bit_count):
        if not any(other & ~mask == 0 for other in kept):
            kept.append(mask)
    return kept
