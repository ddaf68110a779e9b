"""Table 1 of Lee & Kim 2019 and more: strategies on scenes whose target is obstructed, planned or in physics.

    python scripts/clearance_table.py --objects 15 40 --strategies lookahead ngr --scenes 100

Scenes are what the environment resets to from --seed on. Every trial is written down as soon as it is made: run the
same command again after an interruption. JSON, a Markdown table and plots are written to the output directory.
"""

from __future__ import annotations

import itertools
import json
import math
import os
import shlex
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, Literal

from tqdm import tqdm

from clutter_env import OBJECT_COUNTS
from clutter_env.cli.command import run_command
from clutter_env.experiments.clearance_table.pages import markdown, plot
from clutter_env.experiments.clearance_table.records import Record, Records
from clutter_env.experiments.clearance_table.statistics import CRASH, Row, Scenes, make_row, summarise_scenes
from clutter_env.experiments.clearance_table.trials import ASSESSMENT, Assessment, Attempt, Trial, run_trial
from clutter_env.parallel.processes import Crash, Killed, run_jobs
from planners.strategies import STRATEGIES, find_strategy

_PATIENCE = 6
"""A trial is killed after so many times the planner's own time limit, an episode in physics after ten times that."""
_CHANGES_NOTHING = ("jobs", "retry_crashes", "report_only", "output", "json")
"""Arguments that a table does not depend on."""
_RESETS_PER_SCENE = 50
"""Resets looked at for each obstructed scene wanted, before saying that there are too few."""


@dataclass(frozen=True)
class Arguments:
    """Make the clearance table."""

    objects: tuple[int, ...] = (15, 20, 25, 30, 35, 40, 50, 60)
    """Objects on the table, the target among them."""
    strategies: tuple[str, ...] = tuple(STRATEGIES)
    """The first is what the others are compared with."""
    scenes: int = 100
    """Obstructed scenes for each number of objects."""
    seed: int = 100_000
    """First seed of the scenes."""
    layout: str = "paper"
    physics: bool = False
    """Let the expert execute its plans in physics; the environment is the judge of success."""
    control_mode: Literal["joint", "ee"] = "joint"
    time_limit: float = 20.0
    """[s] of wall time for one solve."""
    cap: int = 20
    """Clearances that an unsolved scene counts as in the censored mean."""
    jobs: int = os.cpu_count() or 1
    """Processes."""
    retry_crashes: bool = False
    """Try again what crashed in an earlier run."""
    report_only: bool = False
    """Make tables and plots of the trials there are; make no new ones."""
    output: Path = Path("outputs/clearance_table")
    """Directory of trials.jsonl, table.json, table.md and table.png."""
    json: Path | None = None
    """Write the figures to this file too."""
    markdown: Path | None = None
    """Write the page to this file too, and its picture to images/ beside it."""

    def __post_init__(self) -> None:
        for name in self.strategies:
            find_strategy(name)
        for count in self.objects:
            if count not in OBJECT_COUNTS:
                raise ValueError(f"--objects {count} is not valid; valid numbers: {', '.join(map(str, OBJECT_COUNTS))}")
        if min(self.scenes, self.jobs) < 1:
            raise ValueError("--scenes and --jobs must be at least 1")

    def trial(self, objects: int, seed: int, name: str) -> Trial:
        """One trial under these settings."""
        return Trial(objects, seed, name, self.layout, self.control_mode, self.physics, self.time_limit)

    @property
    def settings(self) -> dict[str, str | bool | float]:
        """What all trials of a table have in common."""
        names = ("layout", "physics", "control_mode", "time_limit")
        return {name: getattr(self, name) for name in names}

    @property
    def command(self) -> str:
        """The command that makes this table, without what does not change it."""
        words = ["python", "scripts/clearance_table.py"]
        for entry in fields(self):
            value = getattr(self, entry.name)
            if entry.name not in _CHANGES_NOTHING and value != entry.default:
                flag = f"--{entry.name.replace('_', '-')}"
                values = value if isinstance(value, tuple) else () if value is True else (value,)
                words += [flag, *map(str, values)]
        return shlex.join(words)


def run(arguments: Arguments) -> None:
    """Find the scenes, try the strategies, report."""
    records = Records(arguments.output / "trials.jsonl", arguments.settings)
    if not arguments.report_only:
        print(f"first each of {arguments.jobs} processes loads or compiles the planner's kernels and maps")
        assess_scenes(arguments, records)
        try_strategies(arguments, records)
    report(arguments, records)


def assess_scenes(arguments: Arguments, records: Records) -> None:
    """Compute floors until there are enough obstructed scenes of each kind."""
    for objects in arguments.objects:
        missing = (arguments.trial(objects, seed, ASSESSMENT) for seed in seeds_to_assess(arguments, records, objects))
        with tqdm(desc=f"scenes with {objects} objects", unit="reset") as bar:
            for _ in made(arguments, records, missing):
                bar.update()
                bar.set_postfix(obstructed=len(obstructed_seeds(arguments, records, objects)))


def seeds_to_assess(arguments: Arguments, records: Records, objects: int) -> Iterator[int]:
    """Seeds not looked at yet, in order, while scenes are missing."""
    for seed in itertools.count(arguments.seed):
        if len(obstructed_seeds(arguments, records, objects, before=seed)) >= arguments.scenes:
            return
        if seed - arguments.seed >= arguments.scenes * _RESETS_PER_SCENE:
            print(f"too few obstructed scenes with {objects} objects: stopped at seed {seed}")
            return
        if is_missing(arguments, records.get(objects, seed, ASSESSMENT)):
            yield seed


def obstructed_seeds(arguments: Arguments, records: Records, objects: int, before: int | None = None) -> list[int]:
    """The scenes of the table: the first obstructed ones, as far as they are known."""
    found = records.assessments(objects)
    seeds = [s for s, scene in found.items() if scene.is_obstructed and arguments.seed <= s < (before or s + 1)]
    return seeds[: arguments.scenes]


def try_strategies(arguments: Arguments, records: Records) -> None:
    """Every strategy on every scene of the table."""
    trials = [
        arguments.trial(objects, seed, name)
        for objects in arguments.objects
        for seed in obstructed_seeds(arguments, records, objects)
        for name in arguments.strategies
    ]
    missing = [trial for trial in trials if is_missing(arguments, records.get(*trial.key))]
    tally: Counter[str] = Counter()
    with tqdm(desc="strategies", total=len(trials), initial=len(trials) - len(missing), unit="trial") as bar:
        for record in made(arguments, records, iter(missing)):
            tally[record.cause or "solved"] += 1
            bar.update()
            bar.set_postfix_str(", ".join(f"{cause} {count}" for cause, count in tally.most_common(3)))


def is_missing(arguments: Arguments, record: Record | None) -> bool:
    """Whether a trial is to be made."""
    return record is None or (arguments.retry_crashes and record.cause == CRASH)


def made(arguments: Arguments, records: Records, trials: Iterator[Trial]) -> Iterator[Record]:
    """Make trials in parallel; each is written down before the next is looked at."""
    limit_s = arguments.time_limit * _PATIENCE * (10 if arguments.physics else 1)
    for trial, result in run_jobs(run_trial, trials, arguments.jobs, limit_s):
        record = named(trial, result) if isinstance(result, Crash | Killed) else result
        records.add(record)
        yield record


def named(trial: Trial, result: Crash | Killed) -> Record:
    """The record of a trial that returned none."""
    cause = CRASH if isinstance(result, Crash) else "killed"
    detail = result.detail if isinstance(result, Crash) else f"did not end within {result.seconds:.0f} s"
    kind = Assessment if trial.strategy == ASSESSMENT else Attempt
    return kind(objects=trial.objects, seed=trial.seed, strategy=trial.strategy, cause=cause, detail=detail)


def report(arguments: Arguments, records: Records) -> None:
    """Print and write what the trials say."""
    scenes, rows = summary(arguments, records)
    if not rows:
        print(f"no trials of these strategies and numbers of objects in {arguments.output}")
        return
    tables = markdown(scenes, rows, arguments.cap, arguments.physics)
    print(f"\n{tables}")
    figures = json_values({"settings": arguments.settings, "scenes": scenes, "rows": rows})
    for path in filter(None, (arguments.output / "table.json", arguments.json)):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(figures, indent=1, allow_nan=False))
    write_page(arguments, tables, scenes, rows, arguments.output / "table.md", arguments.output / "table.png")
    if arguments.markdown is not None:
        picture = arguments.markdown.parent / "images" / f"{arguments.markdown.stem}.png"
        write_page(arguments, tables, scenes, rows, arguments.markdown, picture)
    print(f"tables, figures and plots: {arguments.output}")
    if crashed := sum(row.crashed for row in rows) + sum(scene.crashed for scene in scenes):
        print(f"{crashed} trials CRASHED; their tracebacks are in {arguments.output / 'trials.jsonl'}")


def summary(arguments: Arguments, records: Records) -> tuple[list[Scenes], list[Row]]:
    """Rows for what has been tried so far."""
    scenes, rows = [], []
    for objects in arguments.objects:
        seeds = obstructed_seeds(arguments, records, objects)
        if not seeds:
            continue
        found = {
            seed: scene for seed, scene in records.assessments(objects).items() if arguments.seed <= seed <= seeds[-1]
        }
        floors = {seed: scene.floor for seed, scene in found.items() if scene.proved and scene.floor}
        scenes.append(summarise_scenes(objects, list(found.values()), arguments.seed))
        reference = records.attempts(objects, arguments.strategies[0], seeds)
        for name in arguments.strategies:
            own = reference if name == arguments.strategies[0] else records.attempts(objects, name, seeds)
            if own:
                rows.append(make_row(own, reference, floors, arguments.cap, arguments.seed))
    return scenes, rows


def json_values(value: Any) -> Any:
    """Dataclasses and named tuples as objects; what is not a number becomes null, as JSON knows no NaN."""
    if isinstance(value, Scenes | Row):
        return json_values(vars(value))
    if hasattr(value, "_asdict"):
        return json_values(value._asdict())
    if isinstance(value, Mapping):
        return {name: json_values(entry) for name, entry in value.items()}
    if isinstance(value, list | tuple):
        return [json_values(entry) for entry in value]
    return None if isinstance(value, float) and math.isnan(value) else value


def write_page(
    arguments: Arguments, tables: str, scenes: list[Scenes], rows: list[Row], page: Path, picture: Path
) -> None:
    """The Markdown page and its picture."""
    plot(scenes, rows, picture)
    page.parent.mkdir(parents=True, exist_ok=True)
    kind = f'in physics, "{arguments.control_mode}" mode' if arguments.physics else "plans only"
    page.write_text(
        f"# Clearance table ({kind})\n\n```sh\n{arguments.command}\n```\n\n"
        f"Layout {arguments.layout!r}; each strategy on the same scenes: the environment's own resets from seed "
        f"{arguments.seed} on whose target is obstructed. How to read the columns: "
        "[planners.md](planners.md#reading-the-clearance-table).\n\n"
        f"![Clearance table]({picture.relative_to(page.parent)})\n\n{tables}"
    )


def main(words: Sequence[str] | None = None) -> None:
    """Run the command; `words` are its arguments, those of the process if not given."""
    run_command("table", Arguments, run, __doc__, words)
