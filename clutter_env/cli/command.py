"""How every command starts: arguments from the command line, a clear message instead of a traceback for misuse."""

from __future__ import annotations

import logging
import sys
from collections.abc import Callable, Sequence
from typing import TypeVar

import tyro

__all__ = ["run_command"]

A = TypeVar("A")


def run_command(
    name: str, arguments: type[A], function: Callable[[A], None], text: str | None, words: Sequence[str] | None = None
) -> None:
    """Read the arguments of a command and run it.

    Args:
        name: of the command, for messages.
        arguments: dataclass of its arguments.
        function: what it does.
        text: its description, shown by `--help`.
        words: the command line without the command, that of the process if not given.
    """
    logging.basicConfig(format="%(message)s")
    try:
        function(tyro.cli(arguments, prog=f"clutter-env {name}", description=text, args=words))
    except ValueError as problem:
        sys.exit(f"clutter-env {name}: {problem}")
    except KeyboardInterrupt:
        sys.exit(f"clutter-env {name}: interrupted; run the same command again to go on")
