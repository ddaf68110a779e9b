"""The console command: `clutter-env COMMAND ...`.

A command is a module of this package with a dataclass `Arguments`, read by tyro, and a function `run(arguments)`. Its
docstring is the help text. Functions import what they need, so that `--help` appears at once.
"""

from __future__ import annotations

import contextlib
import importlib
import io
import os
import re
import sys
from collections.abc import Collection, Sequence
from dataclasses import fields
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any, NoReturn

from clutter_env.errors import INSTALL, missing_extra

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

COMMANDS = {
    "episode": "run the expert in physics: one episode in full, or statistics of many",
    "collect": "collect demonstrations of an expert that replay bit for bit",
    "export": "write demonstrations for LeRobot, Minari, robomimic, or as one HDF5 file",
    "train": "train a policy from rewards",
    "compare": "compare policies, baselines and the expert on the same held-out scenes",
    "evaluate": "play a suite of fixed scenes with a policy and write one results file",
    "verify": "play the recorded actions of a results file again, and confirm its scores",
    "challenge": "measure a policy on fresh scenes that nobody could choose",
    "audit": "say what is won in a suite without looking, and what its scenes can show",
    "leaderboard": "make a page of results files, every score confirmed by replay",
    "questions": "ask about rendered scenes, with proved answers, and score what is answered",
    "play": "play one episode of a policy, in a window or as a film",
    "table": "compare strategies on scenes that need clearing (Table 1 of Lee & Kim 2019)",
    "map": "build the reachability map of a robot",
    "robot": "check the data of a robot, and draw it",
    "benchmark": "measure speed, memory and rendering of the environments",
    "warmup": "compile the planner's kernels, once on a machine",
    "list": "list environments, suites, layouts, robots and policies",
    "doctor": "check this installation, and say what is missing and how to get it",
}
"""The commands, each in the module of its name in this package, and their descriptions."""

MAX_SEED = 2**32 - 1
"""The largest that every generator takes: NumPy's, PyTorch's and Gymnasium's."""

SHELLS = ("bash", "zsh", "tcsh")
PACKAGES = ("assets", "irm", "planners", "clutter_env")


def main(argv: Sequence[str] | None = None) -> None:
    """Run a command.

    Exit codes: 0 success, 1 an error while it ran, 2 wrong arguments, 130 interrupted by Ctrl-C.

    Args:
        argv: the command and its arguments. By default those of the process.
    """
    command, *rest = (sys.argv[1:] if argv is None else argv) or ["--help"]
    if command in ("-h", "--help"):
        print(_overview())
    elif command == "--version":
        from clutter_env.version import version

        print(f"clutter-env {version()}")
    elif command == "--completion":
        _print_completion(*rest)
    elif command in COMMANDS:
        _run(command, rest)
    else:
        print(f"{_overview()}\n", file=sys.stderr)
        hint = _did_you_mean([command], f"{command} {' '.join(COMMANDS)}")
        _end(f"clutter-env: no command {command!r}{hint and f'; {hint}'}", 2)


def _run(command: str, argv: Sequence[str]) -> None:
    import logging

    logging.basicConfig(format="%(message)s")
    # The processes that a command starts would import the current directory's files before Python's and packages'.
    os.environ.setdefault("PYTHONSAFEPATH", "1")
    advice = ""
    try:
        module = importlib.import_module(f"clutter_env.cli.{command}")
        arguments = read(module, f"clutter-env {command}", argv)
        if not 0 <= (seed := getattr(arguments, "seed", 0)) <= MAX_SEED:
            _end(f"clutter-env {command}: --seed {seed} is not valid; it must be from 0 to {MAX_SEED}", 2)
        if (workers := getattr(arguments, "workers", 1)) < 1:
            _end(f"clutter-env {command}: --workers {workers} is not valid; it must be at least 1", 2)
        advice = getattr(module, "WHEN_INTERRUPTED", "")
        code = module.run(arguments)
    except KeyboardInterrupt:
        _end(f"clutter-env {command}: interrupted{advice and f'; {advice}'}", 130)
    except Exception as problem:
        if _is_raised_by_user(problem):
            raise
        if missing := missing_extra(problem):
            _end(f"clutter-env {command}: {missing}", 1)
        # Errors of this project and of the file system say all there is to say in their messages.
        if type(problem).__module__.partition(".")[0] not in PACKAGES and not isinstance(problem, OSError):
            raise
        # Misuse is a ValueError; what went wrong while it ran is (also) a RuntimeError or an OSError; an extra that is
        # not installed is no misuse either, wherever that is found out.
        message = "\n".join((str(problem), *getattr(problem, "__notes__", ())))
        code = 1 if INSTALL in message or isinstance(problem, RuntimeError | OSError) else 2
        hint = _did_you_mean(argv, message) if code == 2 else ""
        _end(f"clutter-env {command}: {_with_hint(message, hint)}", code)
    if code:
        raise SystemExit(code)


def _with_hint(message: str, hint: str) -> str:
    """A message with a hint before the list of valid names, which may be long."""
    said, semicolon, rest = message.partition(";")
    return message if not hint else f"{said}; {hint}{rest or semicolon}"


def _did_you_mean(argv: Sequence[str], message: str) -> str:
    """A hint at the name in a message that is closest to one of the typed words. "" if none is close.

    Messages list the valid names next to the wrong name. This is a rule of this project, and tyro does so too.
    """
    import difflib

    typed = [part for word in argv for part in word.split("=")]
    named = dict.fromkeys(re.findall(r"[\w./:-]*\w", message))
    valid = [name for name in named if name not in typed and not name.isdigit()]
    wrong = [word for word in typed if word in named]
    close = [name for word in wrong for name in difflib.get_close_matches(word, valid, n=1, cutoff=0.7)]
    return f"did you mean {close[0]!r}?" if close else ""


def _end(message: str, code: int) -> NoReturn:
    """End the process with a message on the error stream. The exception has it too, for callers of `main`."""
    print(message, file=sys.stderr)
    end = SystemExit(message)
    end.code = code
    raise end


def read(module: ModuleType, prog: str, argv: Sequence[str]) -> Any:
    """The arguments of a command. Wrong arguments end the process with a message and exit code 2."""
    import tyro

    said, stderr = io.StringIO(), sys.stderr
    try:
        with contextlib.redirect_stderr(said):
            return tyro.cli(module.Arguments, prog=prog, description=module.__doc__, args=argv)
    finally:
        stderr.write(said.getvalue())
        if hint := _did_you_mean(argv, said.getvalue()):
            print(f"{prog}: {hint}", file=stderr)


def command_line(name: str, arguments: DataclassInstance, leave_out: Collection[str] = ()) -> str:
    """The command that was given, to be shown beside its results: the arguments that are not the default.

    Args:
        name: "clutter-env" and the name of the command.
        arguments: its arguments.
        leave_out: names of arguments that the results do not depend on.
    """
    import shlex

    argv = name.split()
    for entry in fields(arguments):
        value: Any = getattr(arguments, entry.name)
        flag = entry.name.replace("_", "-")
        if entry.name in leave_out or value == entry.default:
            continue
        if isinstance(value, bool):
            argv.append(f"--{flag}" if value else f"--no-{flag}")
        else:
            argv += [f"--{flag}", *map(str, value if isinstance(value, tuple) else (value,))]
    return shlex.join(argv)


def _is_raised_by_user(problem: BaseException) -> bool:
    """Whether an error was raised in a module that is neither ours, nor Python's, nor an installed package."""
    import traceback

    known = (*PACKAGES, *sys.stdlib_module_names, "__main__")
    modules = [frame.f_globals for frame, _ in traceback.walk_tb(problem.__traceback__)]
    others = [module for module in modules if str(module.get("__name__", "")).partition(".")[0] not in known]
    return any("site-packages" not in Path(str(module.get("__file__", ""))).parts for module in others)


def _overview() -> str:
    lines = "\n".join(f"  {name:<12}{text}" for name, text in COMMANDS.items())
    return (
        "usage: clutter-env COMMAND [arguments]\n       clutter-env --version\n"
        f"       clutter-env --completion {{{','.join(SHELLS)}}}\n\n{lines}\n\n"
        "clutter-env COMMAND --help lists the arguments."
    )


def _print_completion(shell: str = "", *_: str) -> None:
    if shell not in SHELLS:
        _end(f"clutter-env: --completion {shell}: valid shells: {', '.join(SHELLS)}", 2)
    import tyro

    modules = {name: importlib.import_module(f"clutter_env.cli.{name}") for name in COMMANDS}
    commands = {name: module.Arguments for name, module in modules.items()}
    tyro.extras.subcommand_cli_from_dict(commands, prog="clutter-env", args=["--tyro-print-completion", shell])


if __name__ == "__main__":
    main()
