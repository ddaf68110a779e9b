"""CPU time of calls: of all threads of this process together."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

__all__ = ["Stopwatch", "cpu_time"]


def cpu_time(run: Callable[[], Any]) -> float:
    """CPU time [s] of a call."""
    start = time.process_time()
    run()
    return time.process_time() - start


class Stopwatch:
    """A function that adds up the CPU time spent in it, as `seconds`."""

    def __init__(self, function: Callable[..., Any]) -> None:
        self.function = function
        self.seconds = 0.0

    def __call__(self, *values: Any, **keywords: Any) -> None:
        start = time.process_time()
        self.function(*values, **keywords)
        self.seconds += time.process_time() - start
