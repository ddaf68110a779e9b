"""The exact minimum number of objects that any plan must clear, for a declared set of grasp options.

Option j of object o is a way to grasp o; its *blockers* are the objects it hits where they stand now. A set of objects
is *self-clearable* for a target if its objects and then the target can be removed in some order, each through an
option whose blockers were all removed before. Whatever a plan does, monotone or not, the objects it has moved by the
time it holds the target form a self-clearable set. The smallest such set is therefore a lower bound of the number of
objects to clear.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple, TypeAlias

import numpy as np

from planners.cause import Cause
from planners.clearing.search_kernel import EXHAUSTED, FOUND, SearchStack, closure, disjoint_landmarks, search
from planners.clock import NO_DEADLINE, Deadline
from planners.scene import MAX_OBJECTS, Scene

OptionMasks: TypeAlias = Mapping[int, Sequence[int]] | Callable[[int], Sequence[int]]
"""Blocker masks of every option of an object, by object index; a callable is asked once per object that matters.

Objects are bits 0 … MAX_OBJECTS - 1; an option that hits a higher bit (a static obstacle, the robot) is never usable.
"""

_NODES_PER_CALL = 256
"""Search nodes between two looks at the deadline; a node takes 20-300 µs."""


class FloorOptionsError(ValueError):
    """The declared options cannot be read: a negative mask, or an object without any declaration."""


@dataclass(frozen=True)
class FloorLimits:
    """Limits of the search for a proof. It is work that is counted, not time: a slow machine finds the same plan.

    Attributes:
        expansions: search nodes visited; 20,000 take 0.4 to 6 s.
    """

    expansions: int = 20_000


@dataclass(frozen=True)
class ClearanceFloor:
    """The fewest objects any plan must clear before it can hold the target, for the declared options.

    It holds for plans that move objects twice too: each object's first move begins where it stands now. A plan that
    moves each object once, and reaches it, needs a location for every object; whether there is one is not looked at.

    Attributes:
        count: how many; None if no plan exists (see `cause`).
        objects: their names, in an order in which they can be removed.
        proved: `count` is exact; otherwise it is an upper bound and `lower_bound` the other one.
        lower_bound: no plan clears fewer.
        options: which option each of `objects`, and last the target, is taken through.
        cause: "" or why there is none: "unreachable" or "no self-clearable set".
        expansions: search nodes visited.
    """

    count: int | None
    objects: tuple[str, ...]
    proved: bool
    lower_bound: int
    options: tuple[int, ...] = ()
    cause: str = ""
    expansions: int = 0

    @property
    def is_infeasible(self) -> bool:
        """Whether it is proved that no plan exists for this robot and these options, even if objects move twice."""
        return self.count is None and self.proved


def clearance_floor(
    scene: Scene, target: str, blockers: Callable[[str], Sequence[int]], limits: FloorLimits | None = None
) -> ClearanceFloor:
    """The exact minimum number of clearances before `target` can be held, for the declared options.

    Args:
        scene: names of the objects, and what is held.
        target: name of the object wanted.
        blockers: blocker mask of every option of an object, by preference; bit i is object i of the scene.
        limits: when to give up the proof.

    Raises:
        UnknownObject: no object of that name in the scene.
        FloorOptionsError: the options cannot be read.
    """
    index, names = scene.index(target), scene.names
    if target in scene.held_names:
        return ClearanceFloor(0, (), True, 0)
    result = minimum_clearances(lambda i: blockers(names[i]), index, limits)
    return ClearanceFloor(
        count=result.count,
        objects=tuple(names[i] for i in result.objects),
        proved=result.proved,
        lower_bound=result.lower_bound,
        options=tuple(step.option for step in result.order),
        cause=result.cause,
        expansions=result.expansions,
    )


class Removal(NamedTuple):
    """One step of an order of removal: this object, through this one of its options."""

    object: int
    option: int


@dataclass(frozen=True)
class FloorResult:
    """A self-clearable set, or why there is none.

    Attributes:
        count: objects to clear, the target not counted; None if there is no self-clearable set.
        mask: those objects as bits.
        order: an order of removal of them, the target last, each with the first of its options that is free by then.
        proved: no smaller set exists (or, with `cause`, none at all).
        lower_bound: no self-clearable set has fewer clearances.
        cause: "" or why there is no set: UNREACHABLE, NO_SELF_CLEARABLE_SET, or TIME_LIMIT if it was aborted.
        expansions: search nodes visited.
    """

    count: int | None
    mask: int
    order: tuple[Removal, ...]
    proved: bool
    lower_bound: int
    cause: str = ""
    expansions: int = 0

    @property
    def objects(self) -> tuple[int, ...]:
        """Indices of the objects to clear, in the order of removal."""
        return tuple(step.object for step in self.order[:-1])


def minimum_clearances(options: OptionMasks, target: int, limits: FloorLimits | None = None) -> FloorResult:
    """The smallest self-clearable set for the target.

    Iterative deepening over disjoint landmarks; objects whose options have not been asked for count as free, and are
    asked for once a set that would be smallest relies on them. So the answer is exact for all declared options.

    Args:
        options: blocker masks per object; see `OptionMasks`.
        target: index of the target.
        limits: when to give up the proof; the result then says `proved=False` and carries both bounds.

    Raises:
        FloorOptionsError: an object without declared options (declare an empty sequence), or a negative mask.
    """
    return next(self_clearable_sets(options, target, limits=limits))


def self_clearable_sets(
    options: OptionMasks,
    target: int,
    *,
    slack: int = 0,
    limits: FloorLimits | None = None,
    deadline: Deadline = NO_DEADLINE,
) -> Iterator[FloorResult]:
    """Every self-clearable set that needs all its objects, up to `slack` more than the fewest, fewest first.

    Always yields at least one result: if there is no set, the one that says why; if the limits are reached before the
    first set is proved smallest, one with `proved=False`. The iterator ends early at the limits and at the deadline; if
    there is no set by then, it yields one result whose cause is TIME_LIMIT.

    Raises:
        FloorOptionsError: as `minimum_clearances`.
    """
    return _Enumeration(options, target, slack, limits or FloorLimits(), deadline).run()


class _Enumeration:
    """The loop around the compiled search: sizes tried, options asked for on demand, and limits."""

    def __init__(self, options: OptionMasks, target: int, slack: int, limits: FloorLimits, deadline: Deadline) -> None:
        self.table = OptionTable(options, target)
        self.target = target
        self.slack = slack
        self.limits = limits
        self.deadline = deadline
        self.expansions = 0
        self.size = self._first_size()

    def run(self) -> Iterator[FloorResult]:
        """The sets, fewest objects first, or the one result that says why there is none."""
        fewest: int | None = None
        while self.size and (fewest is None or self.size - 1 <= fewest + self.slack):
            for found in self._sets_of_size():
                fewest = found.bit_count() - 1 if fewest is None else fewest
                yield self._result(found, proved=True, lower_bound=fewest)
            if self._out_of_limits():
                break
        if fewest is None:
            found = self._greedy() if self.size else 0
            if self.deadline.is_over:
                yield FloorResult(None, 0, (), False, max(self.size - 1, 0), Cause.TIME_LIMIT, self.expansions)
            else:
                yield self._result(found, proved=False, lower_bound=self.size - 1) if found else self._infeasible()

    def _first_size(self) -> int:
        """Lower bound on the size of a set, the target included; 0 if there is none."""
        masks, starts, orders = self.table.arrays()
        bit = np.int64(1 << self.target)
        bound, _ = disjoint_landmarks(masks, starts, orders, bit, bit, np.int64(0), MAX_OBJECTS)
        return 1 + int(bound)

    def _sets_of_size(self) -> Iterator[int]:
        """The sets with `self.size` objects; when all are found, `self.size` is the next to try, 0 for none."""
        seen: set[int] = set()
        stack = SearchStack(self.target)
        while found := self._next(stack):
            if self.table.load(found, self.deadline):
                stack = SearchStack(self.target)
            elif found not in seen and self._needs_all(found):
                seen.add(found)
                yield found
        if not self._out_of_limits():
            self.size = stack.next_budget

    def _next(self, stack: SearchStack) -> int:
        """The next set, by what is known so far; 0 if there is none or the limits are reached."""
        while not self._out_of_limits():
            status, found = self._advance(stack, _NODES_PER_CALL)
            if status == FOUND:
                return found
            if status == EXHAUSTED:
                return 0
        return 0

    def _advance(self, stack: SearchStack, nodes: int) -> tuple[int, int]:
        """Search on for at most so many nodes: status and the set found."""
        masks, starts, orders = self.table.arrays()
        before = stack.nodes
        status, found = search(masks, starts, orders, self.target, self.size, stack.frames, stack.registers, nodes)
        self.expansions += stack.nodes - before
        return int(status), int(found)

    def _out_of_limits(self) -> bool:
        return self.expansions >= self.limits.expansions or self.deadline.is_over

    def _needs_all(self, found: int) -> bool:
        """Whether no object can be left out; only sets above the fewest can fail this."""
        clearances = found & ~(1 << self.target)
        return not any(self.table.removable(found & ~(1 << i)) >> self.target & 1 for i in bits(clearances))

    def _greedy(self) -> int:
        """A self-clearable set from which no single object can be left out; 0 if there is none, or no time."""
        while not self.deadline.is_over:
            kept = self.table.optimistically_removable((1 << self.table.size) - 1)
            if not kept >> self.target & 1:
                return 0
            for index in bits(kept & ~(1 << self.target)):
                reached = self.table.optimistically_removable(kept & ~(1 << index))
                kept = reached if reached >> self.target & 1 else kept
            if not self.table.load(kept, self.deadline):
                return kept
        return 0

    def _result(self, found: int, proved: bool, lower_bound: int) -> FloorResult:
        mask = found & ~(1 << self.target)
        order = self.table.order(found)
        return FloorResult(mask.bit_count(), mask, order, proved, lower_bound, expansions=self.expansions)

    def _infeasible(self) -> FloorResult:
        movable = any(mask < 1 << MAX_OBJECTS for mask in self.table.declared(self.target))
        cause = Cause.NO_SELF_CLEARABLE_SET if movable else Cause.UNREACHABLE
        return FloorResult(None, 0, (), True, 0, cause, self.expansions)


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
        self.size = target + 1
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
        """Arrays that the compiled search reads.

        Returns:
            Minimal usable masks of all objects (m,), offsets of each object's masks (n + 1,), and the two orders
            (2, n) in which landmarks are grown.
        """
        if self._arrays is None:
            minimal = [self._minimal.get(index, [0]) for index in range(self.size)]
            starts = np.cumsum([0, *map(len, minimal)], dtype=np.int64)
            masks = np.array([mask for masks in minimal for mask in masks], np.int64)
            indices = np.arange(self.size, dtype=np.int64)
            self._arrays = masks, starts, np.stack((indices, indices[::-1]))
        return self._arrays

    def removable(self, allowed: int, removed: int = 0) -> int:
        """`removed` and all objects of `allowed` that can be removed one by one after it."""
        self.load(allowed)
        return self.optimistically_removable(allowed, removed)

    def optimistically_removable(self, allowed: int, removed: int = 0) -> int:
        """The same as `removable`, with objects whose options were not asked for counted as free to take."""
        masks, starts, _ = self.arrays()
        return int(closure(masks, starts, np.int64(allowed), np.int64(removed)))

    def order(self, found: int) -> tuple[Removal, ...]:
        """An order in which the objects of a self-clearable set can be removed, the target last.

        Removing one more object makes no other one harder to remove, so that whichever is free may be next: the lowest
        index, through its first option that is free.
        """
        order: list[Removal] = []
        removed, waiting = 0, [*bits(found & ~(1 << self._target)), self._target]
        while waiting:
            ready = (
                Removal(index, option)
                for index in (waiting[:-1] or waiting)
                for option, mask in enumerate(self.declared(index))
                if mask & ~removed == 0
            )
            order.append(next(ready))
            removed |= 1 << order[-1].object
            waiting.remove(order[-1].object)
        return tuple(order)

    def _load(self, index: int) -> None:
        try:
            masks = tuple(int(mask) & ~(1 << index) for mask in self._source(index))
        except LookupError:
            raise FloorOptionsError(f"no options declared for object {index}") from None
        if any(mask < 0 for mask in masks):
            raise FloorOptionsError(f"object {index} has a negative blocker mask")
        self._declared[index] = masks
        # Nothing waits for the target, which is taken last; of the usable masks those count that contain no other one.
        forbidden = 0 if index == self._target else 1 << self._target
        usable = {mask for mask in masks if mask < 1 << MAX_OBJECTS and not mask & forbidden}
        minimal: list[int] = []
        for mask in sorted(usable, key=int.bit_count):
            if not any(other & ~mask == 0 for other in minimal):
                minimal.append(mask)
        self._minimal[index] = minimal
        self.size = max([self.size, *(mask.bit_length() for mask in minimal)])
        self._arrays = None


def bits(mask: int) -> Iterator[int]:
    """Indices of the set bits, lowest first."""
    while mask:
        low = mask & -mask
        yield low.bit_length() - 1
        mask ^= low
