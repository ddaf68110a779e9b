"""One strategy over several layouts: scenes solved, targets that are taken when they stand alone, clearances."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from clutter_env.experiments.clearance_table.records import Records
from clutter_env.experiments.clearance_table.statistics import CRASH
from clutter_env.experiments.clearance_table.table import TableSettings, run_trials, table_seeds
from clutter_env.experiments.clearance_table.trials import Attempt
from clutter_env.reporting.intervals import Times, times
from clutter_env.reporting.tables import NOTHING, markdown_table, number_text

__all__ = ["LayoutRow", "make_layout_row", "run_layouts", "summary"]


@dataclass(frozen=True)
class LayoutRow:
    """One strategy on the scenes of one layout with one number of objects.

    Attributes:
        layout: its name.
        objects: number of objects, the target among them.
        scenes: number of attempts without those that crashed.
        crashed: number of attempts that crashed; they are counted nowhere else.
        alone: number of scenes whose target can be taken when it stands there alone.
        solved: number of scenes solved.
        cleared: number of clearances over the solved scenes with a proved floor.
        floor: the sum of their floors, the minimum numbers of clearances.
        above: number of solved scenes with more clearances than the floor.
        twice: number of objects cleared twice or more.
        total: CPU time of a whole solve.
        causes: of failures, with counts; those of targets that cannot be taken alone say so.
    """

    layout: str
    objects: int
    scenes: int
    crashed: int
    alone: int
    solved: int
    cleared: int
    floor: int
    above: int
    twice: int
    total: Times
    causes: Mapping[str, int]

    @property
    def ratio(self) -> float | None:
        """Clearances divided by floors; None where nothing has to be cleared."""
        return self.cleared / self.floor if self.floor else None


def run_layouts(
    settings: TableSettings, layouts: Sequence[str], out: Path, workers: int, retry_crashes: bool, report_only: bool
) -> list[LayoutRow]:
    """Make the trials that are missing, layout by layout, and summarise the first strategy's.

    Args:
        settings: of the tables; their layout is replaced.
        layouts: names of the layouts; the trials of each are kept in a directory of its name in `out`.
        out: directory of the trials.
        workers: number of processes.
        retry_crashes: make the trials again that crashed.
        report_only: make no trials.

    Raises:
        ConfigError: an unknown layout, or one that does not hold the objects; before any trial is made.
    """
    rows = []
    for own in [replace(settings, layout=layout) for layout in layouts]:
        records = Records(out / own.layout / "trials.jsonl", own.of_trials)
        if not report_only:
            run_trials(own, records, workers, retry_crashes)
        for objects in own.objects:
            seeds = table_seeds(own, records, objects)
            found = records.assessments(objects)
            floors = {seed: found[seed].floor for seed in seeds if found[seed].proved}
            attempts = records.attempts(objects, own.strategies[0], seeds)
            if attempts:
                rows.append(make_layout_row(own.layout, attempts, floors))
    return rows


def make_layout_row(layout: str, attempts: Mapping[int, Attempt], floors: Mapping[int, int | None]) -> LayoutRow:
    """The row of one layout.

    Args:
        layout: its name.
        attempts: by seed of the scene, at least one.
        floors: proved minimum numbers of clearances by seed of the scene; None where it is proved that there is none.
    """
    first = next(iter(attempts.values()))
    ended = {seed: attempt for seed, attempt in attempts.items() if attempt.cause != CRASH}
    solved = {seed: attempt for seed, attempt in ended.items() if attempt.solved}
    floored = [(len(attempt.clearances), floors.get(seed)) for seed, attempt in solved.items()]
    pairs = [(count, floor) for count, floor in floored if floor is not None]
    failed = [attempt for attempt in ended.values() if not attempt.solved]
    return LayoutRow(
        layout=layout,
        objects=first.objects,
        scenes=len(ended),
        crashed=len(attempts) - len(ended),
        alone=len(solved) + sum(attempt.is_taken_alone for attempt in failed),
        solved=len(solved),
        cleared=sum(count for count, _ in pairs),
        floor=sum(floor for _, floor in pairs),
        above=sum(count > floor for count, floor in pairs),
        twice=sum(attempt.duplicated for attempt in solved.values()),
        total=times([attempt.total_s for attempt in ended.values()]),
        causes=Counter(f"{a.cause}{'' if a.is_taken_alone else ' (alone too)'}" for a in failed),
    )


def summary(rows: Sequence[LayoutRow]) -> str:
    """All rows as a Markdown table."""
    head = ["layout", "N", "solved / taken alone", "scenes", "cleared / floor", "above the floor", "twice"]
    head += ["whole solve [CPU s]: median (95%)", "causes", "crashed"]
    return markdown_table(
        head,
        [
            [
                row.layout,
                str(row.objects),
                f"{row.solved} / {row.alone}",
                str(row.scenes),
                f"{row.cleared} / {row.floor} ({number_text(row.ratio)})",
                str(row.above),
                str(row.twice),
                f"{row.total.median:.2f} ({row.total.p95:.2f})",
                ", ".join(f"{cause}: {count}" for cause, count in sorted(row.causes.items())) or NOTHING,
                str(row.crashed),
            ]
            for row in rows
        ],
    )
