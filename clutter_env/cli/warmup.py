"""Compile the planner's kernels, once on a machine, so that later commands start fast.

    clutter-env warmup

They are kept on the disk. Without this command the first solve does the same work and takes about a minute longer.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Arguments:
    """Compile the planner's kernels."""

    json: Path | None = None
    """Write the time that it took to this file."""


def run(arguments: Arguments) -> None:
    """Compile, and print the time."""
    import time

    import planners
    from clutter_env.reporting.files import write_json
    from clutter_env.reporting.progress import shown_compilation

    started, before = time.perf_counter(), time.process_time()
    with shown_compilation():
        planners.warmup()
    wall_s, cpu_s = time.perf_counter() - started, time.process_time() - before
    print(f"ready after {wall_s:.0f} s ({cpu_s:.0f} s of CPU time)")
    if arguments.json is not None:
        write_json(arguments.json, {"wall_s": wall_s, "cpu_s": cpu_s})
