"""Reads the entries of a decoded saved state: every one is checked for its type, its shape and its range."""

from __future__ import annotations

import math
from collections.abc import Collection
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clutter_env.errors import StateError

LARGEST = 1e10
"""Largest magnitude of a number in a state: MuJoCo resets a simulation with a larger one (mjMAXVAL)."""
_UNIT_TOLERANCE = 1e-6
"""Of the norm of a saved quaternion; MuJoCo normalises them to 1e-15 in every step."""


class Fields:
    """A dictionary of a decoded state with exactly the given names.

    Args:
        value: what was decoded from JSON.
        place: where it is in the state, for messages.
        names: of the entries that it must have.

    Raises:
        StateError: not a dictionary, or with other names. All methods raise it for an entry that is not valid.
    """

    def __init__(self, value: object, place: str, names: Collection[str]) -> None:
        if not isinstance(value, dict) or set(value) != set(names):
            raise StateError(f"{place} of the state must have exactly the entries {', '.join(names)}")
        self._value: dict[str, Any] = value
        self._place = place

    def __getitem__(self, name: str) -> Any:
        """The entry as it was decoded."""
        return self._value[name]

    def integer(self, name: str, lowest: int, highest: int) -> int:
        """An integer from `lowest` to `highest`, both included."""
        value = self._value[name]
        if type(value) is not int or not lowest <= value <= highest:
            raise self._refuse(name, f"an integer from {lowest} to {highest}")
        return value

    def number(self, name: str, lowest: float = -LARGEST, highest: float = LARGEST) -> float:
        """A finite number from `lowest` to `highest`, both included."""
        value = self._value[name]
        if not _is_number(value) or not lowest <= value <= highest:
            raise self._refuse(name, f"a number from {lowest:g} to {highest:g}")
        return float(value)

    def flag(self, name: str) -> bool:
        """True or false."""
        value = self._value[name]
        if type(value) is not bool:
            raise self._refuse(name, "true or false")
        return value

    def numbers(
        self, name: str, shape: tuple[int, ...], lowest: float = -LARGEST, highest: float = LARGEST
    ) -> NDArray[np.float64]:
        """An array (shape) of finite numbers from `lowest` to `highest`, both included."""
        wanted = f"finite numbers of shape {shape} from {lowest:g} to {highest:g}"
        entries = self._flat(name, shape, wanted)
        if not set(map(type, entries)) <= {int, float}:
            raise self._refuse(name, wanted)
        if not all(lowest <= entry <= highest for entry in entries):  # false for NaN too
            raise self._refuse(name, wanted)
        return np.array(entries, np.float64).reshape(shape)

    def integers(self, name: str, size: int, lowest: int, highest: int) -> NDArray[np.int64]:
        """An array (size,) of integers from `lowest` to `highest`, both included."""
        wanted = f"{size} integers from {lowest} to {highest}"
        entries = self._flat(name, (size,), wanted)
        if not set(map(type, entries)) <= {int} or not all(lowest <= entry <= highest for entry in entries):
            raise self._refuse(name, wanted)
        return np.array(entries, np.int64)

    def flags(self, name: str, size: int) -> NDArray[np.bool_]:
        """An array (size,) of true and false."""
        wanted = f"{size} times true or false"
        entries = self._flat(name, (size,), wanted)
        if not all(type(entry) is bool for entry in entries):
            raise self._refuse(name, wanted)
        return np.array(entries, np.bool_)

    def items(self, name: str) -> dict[str, Any]:
        """The entries of a list as they were decoded, by their numbers as text."""
        value = self._value[name]
        if not isinstance(value, list):
            raise self._refuse(name, "a list")
        return {str(index): entry for index, entry in enumerate(value)}

    def _flat(self, name: str, shape: tuple[int, ...], wanted: str) -> list[Any]:
        """The entries of nested lists of this shape, in order."""
        entries: list[Any] = [self._value[name]]
        for size in shape:
            if not all(isinstance(entry, list) and len(entry) == size for entry in entries):
                raise self._refuse(name, wanted)
            entries = [inner for entry in entries for inner in entry]
        return entries

    def _refuse(self, name: str, wanted: str) -> StateError:
        shown = repr(self._value[name])
        return StateError(f"{self._place}: {name} of the state must be {wanted}, not {shown[:80]}")


def check_quaternions(place: str, quaternions: NDArray[np.float64]) -> None:
    """Raise StateError unless quaternions (..., 4) have the length 1; `place` says where they are in the state."""
    if (np.abs(np.linalg.norm(quaternions, axis=-1) - 1) > _UNIT_TOLERANCE).any():
        raise StateError(f"{place}: a quaternion of the state has not the length 1")


def _is_number(value: object) -> bool:
    return type(value) is int or (type(value) is float and math.isfinite(value))
