"""Which objects may be picked next: all that begin a shortest sequence of clearances, by what is in the way."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

_MOST_CLEARANCES = 5
"""Clearances up to which a sequence is looked for: the sets of objects grow by a factor with each."""
_MOST_SETS = 4000
"""Sets of cleared objects that are looked at, at most."""


def right_objects(blockers: Sequence[Iterable[int]], target: int) -> tuple[frozenset[int], int]:
    """Objects that may be picked next, and the number of clearances before the target.

    Args:
        blockers: for each object, masks of what is in the way of its grasps: bit j for object j. No mask: no grasp.
        target: index of the object to take.

    Returns:
        The target alone if it is free. Nothing, and -1, if more than `_MOST_CLEARANCES` are needed.
    """
    masks = [_least(one) for one in blockers]

    def is_free(index: int, cleared: int) -> bool:
        return any(mask & ~cleared == 0 for mask in masks[index])

    if is_free(target, 0):
        return frozenset((target,)), 0
    relevant = _in_the_way(masks, target)
    first = {1 << index: frozenset((index,)) for index in relevant if is_free(index, 0)}
    for count in range(1, _MOST_CLEARANCES + 1):
        found = [begun for cleared, begun in first.items() if is_free(target, cleared)]
        if found:
            return frozenset().union(*found), count
        after: dict[int, frozenset[int]] = {}
        for cleared, begun in first.items():
            for index in relevant:
                if not cleared >> index & 1 and is_free(index, cleared):
                    key = cleared | 1 << index
                    after[key] = after.get(key, frozenset()) | begun
        if not after or len(after) > _MOST_SETS:
            break
        first = after
    return frozenset(), -1


def _least(masks: Iterable[int]) -> list[int]:
    """The masks that contain no other one."""
    found: list[int] = []
    for mask in sorted(set(masks), key=int.bit_count):
        if not any(other & mask == other for other in found):
            found.append(mask)
    return found


def _in_the_way(masks: Sequence[Sequence[int]], target: int) -> list[int]:
    """All objects that may have to be cleared: those in the way of the target, of these, and so on."""
    found, left = {target}, [target]
    while left:
        for mask in masks[left.pop()]:
            new = {index for index in range(mask.bit_length()) if mask >> index & 1} - found
            found |= new
            left += new
    return sorted(found - {target})
