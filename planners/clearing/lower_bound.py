"""The exact minimum number of objects that any plan must clear, for a declared set of grasp options.

Option j of object o is a grasp of o. Its *blockers* are the objects that it hits where they stand now. A set of objects
is *self-clearable* for a target if its objects, then the target, can be removed in some order. Each removal needs an
option whose blockers were all removed before. Take the objects that any plan has moved when it holds the target,
monotone or not. They form a self-clearable set. The smallest such set is therefore a lower bound of the number of
objects to clear.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from planners.cause import Cause
from planners.clearing.search_kernel import PAUSED, SearchStack, closure, disjoint_landmarks, search
from planners.clock import NO_DEADLINE, Deadline
from planners.scene import MAX_OBJECTS

Blockers: TypeAlias = Callable[[str], Sequence[int]]
"""Blocker masks of an object's options, by preference, evaluated once for each object that matters.

Bit i is object i. An option that hits a bit of at least MAX_OBJECTS (a static obstacle, the robot) is never usable.
"""

_NODES_PER_CALL = 256
"""Search nodes between two checks of the deadline. A node takes 20-300 µs."""
MAX_EXPANSIONS = 20_000
"""Search nodes before a proof is given up, 0.4 to 6 s. The limit is on work, not time: every machine answers the
same."""


@dataclass(frozen=True)
class ClearanceFloor:
    """The fewest objects that any plan must clear before it can hold the target, for the declared options.

    It holds for plans that move objects twice too: each object's first move begins where it stands now. To reach the
    bound, a plan also needs a location for every object. Locations are not considered here.

    Attributes:
        count: number of objects. None if planning is impossible (see `cause`).
        objects: their names, in an order in which they can be removed.
        proved: whether `count` is exact for the declared options. Otherwise `count` is an upper bound. Options are a
            sample of directions, base poses and arm configurations: with more of them the count can be lower.
        lower_bound: no plan clears fewer.
        options: index of the option of each of `objects`, and last of the target: the first option that is free by
            then.
        cause: "" or why no plan exists: "unreachable", "too wide", "no self-clearable set", or "time limit" if the
            search was aborted.
        expansions: search nodes visited.
        grasps: the grasps that the bound holds for, in words: "with the grasps of 'side'".
    """

    count: int | None
    objects: tuple[str, ...]
    proved: bool
    lower_bound: int
    options: tuple[int, ...] = ()
    cause: str = ""
    expansions: int = 0
    grasps: str = ""

    @property
    def is_infeasible(self) -> bool:
        """Whether it is proved that no plan exists for this robot and these options, even with objects moved twice."""
        return self.count is None and self.proved


def self_clearable_sets(
    blockers: Blockers,
    target: str,
    names: Sequence[str],
    *,
    slack: int = 0,
    fewer_than: float = math.inf,
    at_least: Blockers | None = None,
    expansions: int = MAX_EXPANSIONS,
    deadline: Deadline = NO_DEADLINE,
) -> Iterator[ClearanceFloor]:
    """Yield every self-clearable set that needs all its objects, up to `slack` more than the fewest, fewest first.

    The search is iterative deepening over disjoint landmarks. An object is regarded as free until its options are
    needed for a set that would be smallest. So the answer is exact for all declared options.

    It always yields at least one result. If no set exists, the result says why. If the limit is reached before the
    first set is proved smallest, the result has `proved=False` and both bounds. The iterator ends early at the limit
    and at the deadline. If no set is known by the deadline, the cause of its one result is TIME_LIMIT.

    With `fewer_than`, sets with that many objects or more count as none. `at_least` are masks that are sooner computed:
    each option hits at least one of them. The options of an object are computed only if it is needed with these masks.
    """
    enumeration = _Enumeration(_Options(blockers, at_least, target, names), expansions, deadline)
    fewest: int | None = None
    while 0 < enumeration.size <= fewer_than and (fewest is None or enumeration.size - 1 <= fewest + slack):
        for found in enumeration.sets_of_size():
            fewest = found.bit_count() - 1 if fewest is None else fewest
            yield enumeration.result(found, proved=True, lower_bound=fewest)
        if enumeration.is_out_of_limits:
            break
    if fewest is None:
        found = enumeration.greedy() if 0 < enumeration.size <= fewer_than else 0
        if deadline.is_over:
            lower_bound, expansions = max(enumeration.size - 1, 0), enumeration.expansions
            yield ClearanceFloor(None, (), False, lower_bound, (), Cause.TIME_LIMIT, expansions)
        elif enumeration.size > fewer_than:
            cause, lower_bound = Cause.NO_SELF_CLEARABLE_SET, enumeration.size - 1
            yield ClearanceFloor(None, (), True, lower_bound, (), cause, enumeration.expansions)
        elif found:
            yield enumeration.result(found, proved=False, lower_bound=enumeration.size - 1)
        else:
            cause = Cause.NO_SELF_CLEARABLE_SET if enumeration.options.is_movable else Cause.UNREACHABLE
            yield ClearanceFloor(None, (), True, 0, (), cause, enumeration.expansions)


class _Enumeration:
    """The loop around the compiled search: sizes tried, options loaded on demand, limits."""

    def __init__(self, options: _Options, most: int, deadline: Deadline) -> None:
        self.options, self.target = options, options.target
        self.expansions, self._most, self._deadline = 0, most, deadline
        bit = np.int64(1 << self.target)
        bound, _ = disjoint_landmarks(*options.arrays(), bit, bit, np.int64(0), MAX_OBJECTS)
        # Number of objects in the sets to find, the target included. 0 if no set of any size exists.
        self.size = 1 + int(bound)

    @property
    def is_out_of_limits(self) -> bool:
        return self.expansions >= self._most or self._deadline.is_over

    def sets_of_size(self) -> Iterator[int]:
        """Yield the sets with `self.size` objects. Then `self.size` becomes the next size to try, 0 for none."""
        seen: set[int] = set()
        stack = SearchStack(self.target)
        while found := self._next(stack):
            if self.options.load(found, self._deadline):
                stack = SearchStack(self.target)
            elif found not in seen and self._needs_all(found):
                seen.add(found)
                yield found
        if not self.is_out_of_limits:
            self.size = stack.next_budget

    def _next(self, stack: SearchStack) -> int:
        """The next set by the options known so far. 0 if none is left or the limits are reached."""
        while not self.is_out_of_limits:
            before = stack.nodes
            status, found = search(
                *self.options.arrays(), self.target, self.size, stack.frames, stack.registers, _NODES_PER_CALL
            )
            self.expansions += stack.nodes - before
            if status != PAUSED:
                return int(found)
        return 0

    def _needs_all(self, found: int) -> bool:
        """Whether no object can be left out. Only sets above the fewest can fail this."""
        clearances = found & ~(1 << self.target)
        return not any(self.options.removable(found & ~(1 << i)) >> self.target & 1 for i in bits(clearances))

    def greedy(self) -> int:
        """A self-clearable set in which every single object is needed. 0 if none exists, or no time is left."""
        while not self._deadline.is_over:
            kept = self.options.removable((1 << self.options.size) - 1)
            if not kept >> self.target & 1:
                return 0
            for index in bits(kept & ~(1 << self.target)):
                reached = self.options.removable(kept & ~(1 << index))
                kept = reached if reached >> self.target & 1 else kept
            if not self.options.load(kept, self._deadline):
                return kept
        return 0

    def result(self, found: int, proved: bool, lower_bound: int) -> ClearanceFloor:
        """The set as names, in an order in which its objects can be removed."""
        *objects, _ = order = self.options.order(found)
        names = tuple(self.options.names[index] for index, _ in objects)
        taken = tuple(option for _, option in order)
        return ClearanceFloor(len(names), names, proved, lower_bound, taken, expansions=self.expansions)


class _Options:
    """Options loaded on demand. Until an object is loaded, it is regarded as free to take, which is optimistic.

    With masks that each option hits `at_least`, an object has these first. They are optimistic, too.
    """

    def __init__(self, blockers: Blockers, at_least: Blockers | None, target: str, names: Sequence[str]) -> None:
        self.names, self.target = names, names.index(target)
        self._stages = (blockers,) if at_least is None else (at_least, blockers)
        self._loaded: dict[int, int] = {}
        self._declared: dict[int, tuple[int, ...]] = {}
        self._minimal: dict[int, list[int]] = {}
        self._arrays: tuple[np.ndarray, np.ndarray, np.ndarray] | None = None
        self.size = self.target + 1
        self.load(1 << self.target)

    @property
    def is_movable(self) -> bool:
        """Whether the target has an option without static obstacles in the way."""
        return any(mask < 1 << MAX_OBJECTS for mask in self._declared[self.target])

    def load(self, mask: int, deadline: Deadline = NO_DEADLINE) -> bool:
        """Load the next stage of options of every object of `mask`, until the deadline. Return whether any were
        missing."""
        missing = [index for index in bits(mask) if self._loaded.get(index, 0) < len(self._stages)]
        for index in missing:
            if deadline.is_over:
                break
            stage = self._loaded.get(index, 0)
            masks = tuple(int(mask) & ~(1 << index) for mask in self._stages[stage](self.names[index]))
            self._loaded[index] = stage + 1
            self._declared[index] = masks
            # Nothing waits for the target, which is taken last. Masks that contain another usable mask are redundant.
            forbidden = 0 if index == self.target else 1 << self.target
            usable = {mask for mask in masks if mask < 1 << MAX_OBJECTS and not mask & forbidden}
            minimal = self._minimal[index] = []
            for mask in sorted(usable, key=int.bit_count):
                if not any(other & ~mask == 0 for other in minimal):
                    minimal.append(mask)
            self.size = max([self.size, *(mask.bit_length() for mask in minimal)])
            self._arrays = None
        return bool(missing)

    def arrays(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Arrays that the compiled search reads.

        Returns:
            Minimal usable masks of all objects (m,), offsets of each object's masks (n + 1,), and two orders (2, n) for
            growing landmarks.
        """
        if self._arrays is None:
            minimal = [self._minimal.get(index, [0]) for index in range(self.size)]
            starts = np.cumsum([0, *map(len, minimal)], dtype=np.int64)
            masks = np.array([mask for masks in minimal for mask in masks], np.int64)
            indices = np.arange(self.size, dtype=np.int64)
            self._arrays = masks, starts, np.stack((indices, indices[::-1]))
        return self._arrays

    def removable(self, allowed: int) -> int:
        """All objects of `allowed` that can be removed one by one, by the options known so far."""
        masks, starts, _ = self.arrays()
        return int(closure(masks, starts, np.int64(allowed), np.int64(0)))

    def order(self, found: int) -> list[tuple[int, int]]:
        """Objects of a self-clearable set, each with its option, in an order in which they can be removed.

        Removing an object never blocks another one, so any free object may be next. The lowest index is taken, with its
        first free option. The target is last.
        """
        order: list[tuple[int, int]] = []
        removed, waiting = 0, [*bits(found & ~(1 << self.target)), self.target]
        while waiting:
            index, option = next(
                (index, option)
                for index in (waiting[:-1] or waiting)
                for option, mask in enumerate(self._declared[index])
                if mask & ~removed == 0
            )
            order.append((index, option))
            removed |= 1 << index
            waiting.remove(index)
        return order


def bits(mask: int) -> Iterator[int]:
    """Indices of the set bits, lowest first."""
    while mask:
        low = mask & -mask
        yield low.bit_length() - 1
        mask ^= low
