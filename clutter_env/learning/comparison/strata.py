"""Scenes by the minimum number of clearances before the target can be held."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeVar

from clutter_env.suites import Floor

__all__ = ["STRATA", "by_stratum", "stratum"]

STRATA = ("0", "1", "2", "3 or more", "none", "unproved")
"""Minimum numbers of clearances; "none": there is no plan; "unproved": only an upper bound is known."""
T = TypeVar("T")


def stratum(floor: Floor) -> str:
    """The stratum of a scene with that floor."""
    if not floor.is_proved:
        return "unproved"
    return "none" if floor.count is None else STRATA[min(floor.count, 3)]


def by_stratum(entries: Sequence[T], floors: Sequence[Floor]) -> dict[str, list[T]]:
    """The entries of each stratum, in the order of `STRATA`; entry i is of a scene with floor i."""
    names = [stratum(floor) for floor in floors]
    groups = {name: [entry for entry, own in zip(entries, names, strict=True) if own == name] for name in STRATA}
    return {name: group for name, group in groups.items() if group}
