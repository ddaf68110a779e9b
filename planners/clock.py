"""Clocks: the deadline that a solve hands down, and CPU time, of child processes too where an engine starts some."""

from __future__ import annotations

import math
import os
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from numbers import Real


class TimeLimitError(ValueError):
    """A time limit that is not a number of seconds, not negative."""


@dataclass(frozen=True)
class Deadline:
    """A point in wall time at which a solve ends. Without one, no clock has an influence on its answer.

    Attributes:
        at: [s] on the clock of `time.monotonic`.
    """

    at: float = math.inf

    @classmethod
    def after(cls, time_limit: float | None) -> Deadline:
        """The deadline `time_limit` [s] from now, None for none; raises `TimeLimitError`."""
        if time_limit is None:
            return NO_DEADLINE
        if not isinstance(time_limit, Real) or isinstance(time_limit, bool) or not time_limit >= 0:
            raise TimeLimitError(
                f"time_limit={time_limit!r} is not valid; give seconds of at least 0, or None for none"
            )
        return cls(time.monotonic() + float(time_limit))

    @property
    def remaining(self) -> float:
        """[s] left; 0 once it is over, infinite for no deadline."""
        return max(0.0, self.at - time.monotonic())

    @property
    def is_over(self) -> bool:
        """Whether the time is up."""
        return time.monotonic() >= self.at


NO_DEADLINE = Deadline()


_of_children = 0.0
"""[s] of CPU time of the child processes that `children_counted` has seen."""


def cpu_seconds() -> float:
    """[s] of CPU time of this process, and of the child processes that `children_counted` has seen."""
    return time.process_time() + _of_children


@contextmanager
def children_counted() -> Iterator[None]:
    """Let `cpu_seconds` count the child processes that end inside; they are counted for the whole process.

    They are not read with every look at the clock: `os.times` is a system call that can take half a millisecond.
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
