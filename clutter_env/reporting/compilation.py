"""What a command shows while kernels are compiled."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from clutter_env.reporting.progress import progress_bar

__all__ = ["shown_compilation"]

_LOGGER = "planners.warming"
"""The logger that says which kernel is compiled."""


@contextmanager
def shown_compilation() -> Iterator[None]:
    """While this lasts, a progress line names the kernel that is compiled, how many have been, and the time so far.

    How many there will be depends on what is compiled already, so that nothing is estimated. Where nothing has to be
    compiled, nothing is shown.
    """
    logger, shown = logging.getLogger(_LOGGER), _Shown()
    level = logger.level
    logger.setLevel(logging.INFO)
    logger.addHandler(shown)
    logger.propagate = False
    try:
        yield
    finally:
        logger.propagate = True
        logger.removeHandler(shown)
        logger.setLevel(level)
        shown.close()


class _Shown(logging.Handler):
    """Shows the messages on one line; the bar is made at the first kernel."""

    def __init__(self) -> None:
        super().__init__()
        self._bar: Any = None

    def emit(self, record: logging.LogRecord) -> None:
        """Show a message."""
        if self._bar is None:
            self._bar = progress_bar(bar_format="{desc} ({n} kernels, {elapsed})")
        self._bar.set_description_str(record.getMessage(), refresh=record.levelno > logging.INFO)
        self._bar.update(record.levelno <= logging.INFO)

    def close(self) -> None:
        """End the line."""
        if self._bar is not None:
            self._bar.close()
        super().close()
