"""Progress of long work and of compilation: a bar in a terminal, now and then a line in a log file."""

from __future__ import annotations

import logging
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, TextIO

from tqdm import tqdm

_WORTH_SAYING, _MINUTES_FROM = 10.0, 100.0
"""[s] Estimates above the first are said, those from the second on in minutes."""
SECONDS_BETWEEN_LINES = 30.0
"""Least time [s] between two lines in a log file."""


def progress_bar(*arguments: Any, seconds: float = 0.0, **options: Any) -> tqdm:
    """`tqdm.tqdm`, which takes the arguments; where the error stream is no terminal, it writes whole lines, and few.

    An estimate of all the time [s] that the work will take is said first, if it is above ten seconds.
    """
    if seconds > _WORTH_SAYING:
        about = f"{seconds:.0f} s" if seconds < _MINUTES_FROM else f"{seconds / 60:.0f} min"
        sys.stderr.write(f"this takes about {about} where nothing else runs\n")
    if sys.stderr.isatty():
        return tqdm(*arguments, **options)
    return _Lines(*arguments, **{"mininterval": SECONDS_BETWEEN_LINES, "maxinterval": SECONDS_BETWEEN_LINES, **options})


class _Lines(tqdm):  # type: ignore[misc]  # tqdm has no type hints
    """A progress bar whose every state is a line of its own."""

    disable: bool = True  # until it has begun: Ctrl-C may come before

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


_LOGGER = "planners.warming"
"""The logger that says which kernel is compiled."""


@contextmanager
def shown_compilation() -> Iterator[None]:
    """While this lasts, a progress line names the kernel that is compiled, how many have been, and the time so far.

    How many there will be depends on what is compiled already, so that nothing is estimated. Where nothing has to be
    compiled, nothing is shown.
    """
    logger, bars = logging.getLogger(_LOGGER), list[Any]()  # one, from the first kernel on

    def show(record: logging.LogRecord) -> bool:
        """Show a message, which goes nowhere else."""
        if not bars:
            bars.append(progress_bar(bar_format="{desc} ({n} kernels, {elapsed})"))
        bars[0].set_description_str(record.getMessage(), refresh=record.levelno > logging.INFO)
        bars[0].update(record.levelno <= logging.INFO)
        return False

    level = logger.level
    logger.setLevel(logging.INFO)
    logger.addFilter(show)
    try:
        yield
    finally:
        logger.removeFilter(show)
        logger.setLevel(level)
        for bar in bars:
            bar.close()
