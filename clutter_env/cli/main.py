"""The console command: `clutter-env COMMAND ...`."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Sequence

__all__ = ["COMMANDS", "main"]

COMMANDS = {
    "episode": "run the expert in physics: one episode in full, or statistics of many",
    "collect": "collect demonstrations of an expert that replay bit for bit",
    "decisions": "collect decisions of canonical plans, without physics",
    "export": "write demonstrations for LeRobot, Minari, robomimic, or as one HDF5 file",
    "train": "train a policy, from rewards or from demonstrations",
    "curve": "success of learned motions against the number of demonstrations",
    "compare": "compare policies, baselines and the expert on the same held-out scenes",
    "evaluate": "play a suite of fixed scenes with a policy and write one results file",
    "play": "play one episode of a policy, in a window or as a film",
    "table": "compare strategies on scenes that need clearing (Table 1 of Lee & Kim 2019)",
    "map": "build the reachability map of a robot",
    "robot": "check the data of a robot, and draw it",
    "benchmark": "measure speed, memory and rendering of the environments",
    "warmup": "compile the planner's kernels, once on a machine",
}
"""The commands, each in the module of its name in this package, and what they do."""


def main(words: Sequence[str] | None = None) -> None:
    """Run a command; `words` are the command and its arguments, those of the process if not given."""
    command, *rest = (sys.argv[1:] if words is None else words) or ["--help"]
    if command in ("-h", "--help"):
        print(_overview())
    elif command == "--version":
        print(_version())
    elif command in COMMANDS:
        importlib.import_module(f"clutter_env.cli.{command}").main(rest)
    else:
        sys.exit(f"clutter-env: no command {command!r}\n\n{_overview()}")


def _overview() -> str:
    lines = "\n".join(f"  {name:<11}{text}" for name, text in COMMANDS.items())
    return (
        f"usage: clutter-env COMMAND [arguments]\n       clutter-env --version\n\n{lines}\n\n"
        "clutter-env COMMAND --help lists the arguments."
    )


def _version() -> str:
    from importlib import metadata

    return f"clutter-env {metadata.version('clutter-env')}"


if __name__ == "__main__":
    main()
