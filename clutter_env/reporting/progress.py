"""Progress of long work and of compilation: a bar in a terminal, or occasional lines in a log file."""

from __future__ import annotations

import logging
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Self, TextIO

from tqdm import tqdm

_WORTH_SAYING, _MINUTES_FROM = 10.0, 100.0
"""[s] Estimates above the first are printed, those above the second in minutes."""
SECONDS_BETWEEN_LINES = 30.0
"""[s] Least time between two lines in a log file."""


def progress_bar(*arguments: Any, seconds: float = 0.0, **options: Any) -> tqdm:
    """`tqdm.tqdm` with these arguments. Without a terminal, print occasional whole lines.

    An estimate of the total time [s] is printed first if it exceeds ten seconds.
    """
    if seconds > _WORTH_SAYING:
        about = f"{seconds:.0f} s" if seconds < _MINUTES_FROM else f"{seconds / 60:.0f} min"
        sys.stderr.write(f"this takes about {about} where nothing else runs\n")
    if sys.stderr.isatty():
        return tqdm(*arguments, **options)
    return _Lines(*arguments, **{"mininterval": SECONDS_BETWEEN_LINES, "maxinterval": SECONDS_BETWEEN_LINES, **options})


class LateBar:
    """A progress bar of `progress_bar` that appears only at `begin`, after the arguments have proved valid.

    A context manager, which closes the bar.
    """

    def __init__(self, **options: Any) -> None:
        self._options = options
        self._bar: tqdm | None = None

    def begin(self) -> None:
        """Show the bar."""
        self._bar = self._bar or progress_bar(**self._options)

    def update(self) -> None:
        """Add one."""
        self.begin()
        assert self._bar is not None
        self._bar.update()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        if self._bar is not None:
            self._bar.close()


class _Lines(tqdm):  # type: ignore[misc]  # tqdm has no type hints
    """A progress bar that prints every state on a line of its own."""

    disable: bool = True  # until the work has begun, because Ctrl-C may come before

    @staticmethod
    def status_printer(file: TextIO) -> Any:
        """Return a function that writes a state."""

        def write(state: str) -> None:
            """Write the state as a line, if it is not empty."""
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
"""The logger that names the kernel being compiled."""


@contextmanager
def shown_compilation() -> Iterator[None]:
    """Show a progress line with the kernel being compiled, the number compiled so far, and the time so far.

    The total depends on the kernels compiled before, so it is not estimated. If nothing has to be compiled, nothing is
    shown.
    """
    logger, bars = logging.getLogger(_LOGGER), list[Any]()  # a single bar, from the first kernel on

    def show(record: logging.LogRecord) -> bool:
        """Show a message, and stop it from going anywhere else."""
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
