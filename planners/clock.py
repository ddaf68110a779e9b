"""Clocks: the deadline of a solve, and CPU time, with that of child processes if an engine starts some."""

from __future__ import annotations

import math
import os
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from numbers import Real


class TimeLimitError(ValueError):
    """A time limit that is no number of seconds of at least 0."""


@dataclass(frozen=True)
class Deadline:
    """A point in wall time at which a solve ends. Without a deadline, the answer depends on no clock.

    Attributes:
        at: time [s] on the clock of `time.monotonic`.
    """

    at: float = math.inf

    @classmethod
    def after(cls, time_limit: float | None) -> Deadline:
        """Deadline `time_limit` [s] from now. None means without end. Raises `TimeLimitError`."""
        if time_limit is None:
            return NO_DEADLINE
        if not isinstance(time_limit, Real) or isinstance(time_limit, bool) or not time_limit >= 0:
            raise TimeLimitError(
                f"time_limit={time_limit!r} is not valid; give seconds of at least 0, or None for none"
            )
        return cls(time.monotonic() + float(time_limit))

    @property
    def remaining(self) -> float:
        """Time left [s]: 0 once the deadline is over, infinite without one."""
        return max(0.0, self.at - time.monotonic())

    @property
    def is_over(self) -> bool:
        """Whether the time is up."""
        return time.monotonic() >= self.at


NO_DEADLINE = Deadline()


_of_children = 0.0
"""CPU time [s] of the child processes measured by `children_counted`."""


def cpu_seconds() -> float:
    """CPU time [s] of this process, and of the child processes measured by `children_counted`."""
    return time.process_time() + _of_children


@contextmanager
def children_counted() -> Iterator[None]:
    """Add the child processes that end inside this context to `cpu_seconds`, for the whole process.

    They are read once, at the end: `os.times` is a system call that can take half a millisecond.
    """
    global _of_children
    before = _children_seconds()
    try:
        yield
    finally:
        _of_children += _children_seconds() - before


def _children_seconds() -> float:
    times = os.times()
    return times.children_user + times.children_system
