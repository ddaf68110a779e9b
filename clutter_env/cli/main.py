"""The console command: `clutter-env COMMAND ...`."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Sequence

__all__ = ["COMMANDS", "main"]

COMMANDS = {
    "episode": "one episode of the expert in physics, shown in full, or many counted",
    "collect": "expert demonstrations that replay",
    "train": "a policy, from rewards or from demonstrations",
    "compare": "policies, baselines and the expert on the same held-out scenes",
    "table": "strategies compared on scenes that need clearing (Table 1 of Lee & Kim 2019)",
    "map": "the reachability map of a robot",
    "benchmark": "speed, memory and rendering of the environments",
}
"""Commands and what they make or show; each is the module of that name in this package."""


def main(words: Sequence[str] | None = None) -> None:
    """Run a command; `words` are the command and its arguments, those of the process if not given."""
    command, *rest = (sys.argv[1:] if words is None else words) or ["--help"]
    if command in ("-h", "--help"):
        print(_overview())
    elif command in COMMANDS:
        importlib.import_module(f"clutter_env.cli.{command}").main(rest)
    else:
        sys.exit(f"clutter-env: no command {command!r}\n\n{_overview()}")


def _overview() -> str:
    lines = "\n".join(f"  {name:<11}{text}" for name, text in COMMANDS.items())
    return f"usage: clutter-env COMMAND [arguments]\n\n{lines}\n\nclutter-env COMMAND --help lists the arguments."
