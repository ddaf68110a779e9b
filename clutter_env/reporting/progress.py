"""Progress of long work: a bar in a terminal, now and then a line in a log file."""

from __future__ import annotations

import sys
from typing import Any, TextIO

from tqdm import tqdm

__all__ = ["SECONDS_BETWEEN_LINES", "progress_bar"]

SECONDS_BETWEEN_LINES = 30.0
"""Least time [s] between two lines in a log file."""


def progress_bar(*arguments: Any, **options: Any) -> tqdm:
    """`tqdm.tqdm`, which takes the arguments; where the error stream is no terminal, it writes whole lines, and few."""
    if sys.stderr.isatty():
        return tqdm(*arguments, **options)
    return _Lines(*arguments, **{"mininterval": SECONDS_BETWEEN_LINES, "maxinterval": SECONDS_BETWEEN_LINES, **options})


class _Lines(tqdm):  # type: ignore[misc]  # tqdm has no type hints
    """A progress bar whose every state is a line of its own."""

    disable: bool

    @staticmethod
    def status_printer(file: TextIO) -> Any:
        """A function that writes a state."""

        def write(state: str) -> None:
            """Write it as a line, if it is not empty."""
            if state.strip():
                file.write(state.strip() + "\n")
                file.flush()

        return write

    def close(self) -> None:
        """Write the last state, unless nothing has changed since the last line."""
        if not self.disable:
            if self.n != self.last_print_n:
                self.display()
            self.disable = True
            self._decr_instances(self)
