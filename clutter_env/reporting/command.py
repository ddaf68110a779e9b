"""What all commands share: reading their arguments, a clear message instead of a traceback for misuse.

The modules of the commands import what they run inside their functions, so that `--help` appears at once.
"""

from __future__ import annotations

import logging
import shlex
import sys
from collections.abc import Callable, Collection, Sequence
from dataclasses import fields
from typing import TYPE_CHECKING, Any, TypeVar

import tyro

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

__all__ = ["command_line", "run_command"]

A = TypeVar("A")


def run_command(
    name: str, arguments: type[A], function: Callable[[A], None], text: str | None, words: Sequence[str] | None = None
) -> None:
    """Read the arguments of a command and run it.

    Args:
        name: of the command, for messages.
        arguments: dataclass of its arguments.
        function: called with them. A ValueError or an OSError of it (such as a full disk) becomes the message
            with which the process ends.
        text: description of the command, shown by `--help`.
        words: the command line without the command, that of the process if not given.
    """
    logging.basicConfig(format="%(message)s")
    try:
        function(tyro.cli(arguments, prog=f"clutter-env {name}", description=text, args=words))
    except (ValueError, OSError) as problem:
        sys.exit(f"clutter-env {name}: {problem}")
    except KeyboardInterrupt:
        sys.exit(f"clutter-env {name}: interrupted; run the same command again to go on")


def command_line(name: str, arguments: DataclassInstance, leave_out: Collection[str] = ()) -> str:
    """The command that was given, to be shown beside its results: the arguments that are not the default.

    Args:
        name: of the command.
        arguments: its arguments.
        leave_out: names of arguments that the results do not depend on.
    """
    words = ["clutter-env", name]
    for entry in fields(arguments):
        value: Any = getattr(arguments, entry.name)
        if entry.name in leave_out or value == entry.default:
            continue
        flag = entry.name.replace("_", "-")
        if isinstance(value, bool):
            words.append(f"--{flag}" if value else f"--no-{flag}")
        else:
            words += [f"--{flag}", *map(str, value if isinstance(value, tuple) else (value,))]
    return shlex.join(words)
