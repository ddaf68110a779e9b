"""Compare the geometric test for obstructed targets with the planner's minimum number of clearances.

    python scripts/obstruction.py

Prints the confusion table of docs/suites.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from clutter_env.experiments.suites.agreement import SCENE_SETS, agreement, agreement_table
from clutter_env.reporting.command import run_command
from clutter_env.reporting.progress import progress_bar


@dataclass(frozen=True)
class Arguments:
    """Command line."""

    seed: int = 600_000
    """First seed of every set of scenes."""
    workers: int = 2
    """Number of processes."""


def run(arguments: Arguments) -> None:
    """Compare and print."""
    with progress_bar(total=sum(one.scenes for one in SCENE_SETS), unit="scene") as bar:
        found = agreement(arguments.seed, arguments.workers, tick=bar.update)
    print(agreement_table(found), end="")


def main(words: Sequence[str] | None = None) -> None:
    """Run the command; `words` are its arguments, those of the process if not given."""
    run_command("obstruction", Arguments, run, __doc__, words)
