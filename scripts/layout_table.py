"""One strategy over several layouts: scenes solved, targets that are taken when they stand alone, clearances.

    python scripts/layout_table.py --layouts shelf two_boards cabinet --objects 10 16 25 --grasps all --no-obstructed

All arguments of `clutter-env table` are known; the first strategy is taken.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import tyro

from clutter_env.cli import table_arguments
from clutter_env.cli.clearance_trials import CRASH, Record, Trials
from clutter_env.reporting.intervals import times
from clutter_env.reporting.tables import NOTHING, markdown_table

HEAD = ["layout", "N", "solved / taken alone", "scenes", "cleared / lower bound", "above it", "twice"]
HEAD += ["whole solve [CPU s]: median (95%)", "causes", "crashed"]


@dataclass(frozen=True)
class Arguments(table_arguments.Arguments):
    """Those of `clutter-env table`, and the layouts."""

    layouts: tuple[str, ...] = ("shelf", "two_boards", "cabinet")
    """Names of the layouts; the trials of each are kept in a directory of its name in --out."""
    strategies: tuple[str, ...] = ("lookahead",)
    """The strategy."""
    out: Path = Path("outputs/layout_table")
    """Directory of the trials."""


def main(arguments: tyro.conf.OmitArgPrefixes[Arguments]) -> None:
    """Make the trials that are missing, layout by layout, and print one table."""
    name, rows = arguments.strategies[0], []
    for layout in arguments.layouts:
        made = Trials(replace(arguments, strategies=(name,), layout=layout, out=arguments.out / layout))
        made.run()
        for objects in arguments.objects:
            if attempts := made.attempts(objects, name):
                rows.append([layout, str(objects), *layout_cells(attempts, made.floors(objects))])
    print(markdown_table(HEAD, rows))


def layout_cells(attempts: Mapping[int, Record], floors: Mapping[int, int]) -> list[str]:
    """The cells of one layout: attempts by seed of the scene, and proved lower bounds by seed."""
    ended = {seed: attempt for seed, attempt in attempts.items() if attempt.cause != CRASH}
    solved = {seed: attempt for seed, attempt in ended.items() if attempt.solved}
    failed = [attempt for attempt in ended.values() if not attempt.solved]
    pairs = [(len(attempt.clearances), floors[seed]) for seed, attempt in solved.items() if seed in floors]
    cleared, floor = sum(count for count, _ in pairs), sum(floor for _, floor in pairs)
    spent = times([attempt.total_s for attempt in ended.values()])
    causes = Counter(f"{attempt.cause}{'' if attempt.is_taken_alone else ' (alone too)'}" for attempt in failed)
    return [
        f"{len(solved)} / {len(solved) + sum(attempt.is_taken_alone for attempt in failed)}",
        str(len(ended)),
        f"{cleared} / {floor} ({f'{cleared / floor:.2f}' if floor else NOTHING})",
        str(sum(count > floor for count, floor in pairs)),
        str(sum(attempt.duplicated for attempt in solved.values())),
        f"{spent.median:.2f} ({spent.p95:.2f})",
        ", ".join(f"{cause}: {count}" for cause, count in sorted(causes.items())) or NOTHING,
        str(len(attempts) - len(ended)),
    ]


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
