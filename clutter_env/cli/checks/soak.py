"""Random steps through every environment: no warning, no exception, no number out of range, no growing memory."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from clutter_env.experiments.environments.endurance import run_endurance
from clutter_env.reporting.command import run_command
from clutter_env.reporting.files import write_json
from clutter_env.reporting.progress import progress_bar


@dataclass(frozen=True)
class Arguments:
    """Command line."""

    steps: int = 1_000_000
    """Control steps in all, shared among the ids, control modes and layouts."""
    seed: int = 0
    """Random seed of scenes and actions."""
    json: Path | None = None
    """File of machine-readable results."""


def run(arguments: Arguments) -> None:
    """Step, then print the counts."""
    start = time.process_time()
    with progress_bar(total=arguments.steps, desc="stepping", unit="step") as progress:
        result = run_endurance(arguments.steps, arguments.seed, progress.update)
    print(f"{result.summary()}\nCPU time: {time.process_time() - start:.0f} s")
    if arguments.json is not None:
        write_json(arguments.json, result)


def main(words: Sequence[str] | None = None) -> None:
    """Run the command; `words` are its arguments, those of the process if not given."""
    run_command("soak", Arguments, run, __doc__, words)
