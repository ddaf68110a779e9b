"""Misuse of the expert."""

from __future__ import annotations

import math
from numbers import Real

__all__ = ["ExpertError", "check_number"]


class ExpertError(ValueError):
    """The expert is used wrongly: on an environment or with a value that it cannot use, or before `reset`."""


def check_number(name: str, value: object, allow_infinity: bool = False) -> None:
    """Raise ExpertError unless `value` is a number of at least 0, finite unless infinity is allowed."""
    if isinstance(value, Real) and not isinstance(value, bool):
        number = float(value)
        if number >= 0 and (allow_infinity or not math.isinf(number)):
            return
    kind = "number" if allow_infinity else "finite number"
    raise ExpertError(f"{name}={value!r} is not valid; it must be a {kind} of at least 0")
