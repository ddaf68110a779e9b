"""The clearance table: find obstructed scenes, try every strategy on each of them, and summarise."""

from __future__ import annotations

import itertools
import logging
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any, Literal

from assets.robots import robot as find_robot
from clutter_env.config import EnvConfig
from clutter_env.errors import ConfigError
from clutter_env.experiments.clearance_table.records import Record, Records
from clutter_env.experiments.clearance_table.statistics import (
    CRASH,
    Row,
    Scenes,
    Shared,
    make_row,
    make_shared,
    summarise_scenes,
)
from clutter_env.experiments.clearance_table.supports import chosen_supports
from clutter_env.experiments.clearance_table.trials import ASSESSMENT, Assessment, Attempt, Trial, run_trial
from clutter_env.experiments.clearance_table.variants import ARMS, VARIANTS
from clutter_env.parallel import Crash, Killed, run_jobs
from clutter_env.reporting.progress import progress_bar
from clutter_env.scene.object_sets import MAX_OBJECTS
from planners.grasping.families import GRASP_SETS
from planners.strategies import STRATEGIES

__all__ = ["Summary", "TableSettings", "failure_record", "run_trials", "summarise_table", "table_seeds"]

logger = logging.getLogger(__name__)

_SOLVE_LIMITS = 6
"""A trial is killed after so many times the planner's own time limit."""
_EPISODE_LIMITS = 60
"""An episode in physics is killed after so many times the planner's own time limit."""
_DEFAULT_ROBOT = "fetch"
"""That of tables that do not name one."""
_RESETS_PER_SCENE = 50
"""Resets that are assessed for each obstructed scene wanted, before giving up."""


@dataclass(frozen=True)
class TableSettings:
    """What the table shows.

    Attributes:
        objects: numbers of objects on the table, the target among them.
        strategies: names of strategies or ablations; the others are compared with the first one.
        scenes: number of scenes for each number of objects.
        seed: first seed of the scenes.
        layout: its name.
        physics: whether the expert executes its plans in physics, where the environment decides about success.
        control_mode: "joint" or "ee".
        time_limit: [s] of one solve.
        cap: number of clearances that an unsolved scene counts as in the censored mean.
        grasps: name of the planner's grasp set; minimum numbers of clearances are for this set too.
        only_obstructed: leave out scenes in which nothing has to be cleared, or no clearance frees the target.
        supports: where objects may be put, as for `chosen_supports`; () leaves it to the grasp set.
        robot: its name.

    Raises:
        ConfigError: a number that is not valid or more than the layout holds, or an unknown strategy, grasp set,
            layout, robot or support; the message lists the valid ones.
    """

    objects: tuple[int, ...] = (15, 20, 25, 30, 35, 40, 50, 60)
    strategies: tuple[str, ...] = field(default_factory=lambda: tuple(STRATEGIES))
    scenes: int = 100
    seed: int = 100_000
    layout: str = "paper"
    physics: bool = False
    control_mode: Literal["joint", "ee"] = "joint"
    time_limit: float = 20.0
    cap: int = 20
    grasps: str = "side"
    only_obstructed: bool = True
    supports: tuple[str, ...] = ()
    robot: str = _DEFAULT_ROBOT

    def __post_init__(self) -> None:
        if self.grasps not in GRASP_SETS:
            raise ConfigError(f"grasps={self.grasps!r} is not valid; valid grasp sets: {', '.join(GRASP_SETS)}")
        for name in self.strategies:
            if name not in VARIANTS:
                raise ConfigError(f"no strategy {name!r}; known strategies: {', '.join(VARIANTS)}")
        for count in self.objects:
            if not 1 <= count <= MAX_OBJECTS:
                raise ConfigError(f"objects={count} is not valid; it must be from 1 to {MAX_OBJECTS}")
            EnvConfig(num_objects=count, layout=self.layout, robot=self.robot)
        if self.compares_arms and not find_robot(self.robot).idle_arms:
            raise ConfigError(f"robot={self.robot!r} has one arm; to compare one arm with two take robot='pr2'")
        chosen_supports(self.layout, self.supports)
        if self.scenes < 1:
            raise ConfigError(f"scenes={self.scenes} is not valid; it must be at least 1")

    def trial(self, objects: int, seed: int, name: str) -> Trial:
        """One trial under these settings."""
        same = {key: value for key, value in self.of_trials.items() if key not in ("supports", "robot")}
        return Trial(objects, seed, name, **same, supports=self.supports, robot=self.robot)

    @property
    def compares_arms(self) -> bool:
        """Whether some rows are about several arms."""
        return any(name in ARMS for name in self.strategies)

    @property
    def of_trials(self) -> dict[str, Any]:
        """The settings that all trials in one file have in common."""
        names = ("layout", "physics", "control_mode", "time_limit", "grasps")
        common: dict[str, Any] = {name: getattr(self, name) for name in names}
        common["supports"] = " ".join(self.supports) or None
        common["robot"] = None if self.robot == _DEFAULT_ROBOT else self.robot
        return common


def run_trials(settings: TableSettings, records: Records, workers: int, retry_crashes: bool = False) -> None:
    """Make all trials that are not in the records yet; each is added to them as soon as it ends.

    Args:
        settings: of the table.
        records: of earlier trials.
        workers: number of processes.
        retry_crashes: make the trials again that crashed.
    """
    trials = _Trials(settings, records, workers, retry_crashes)
    for objects in settings.objects:
        missing = (settings.trial(objects, seed, ASSESSMENT) for seed in trials.seeds_to_assess(objects))
        with progress_bar(desc=f"scenes with {objects} objects", unit="reset") as bar:
            for _ in trials.make(missing):
                bar.update()
                bar.set_postfix(obstructed=len(table_seeds(settings, records, objects)))
    trials.try_strategies()


@dataclass(frozen=True)
class _Trials:
    """The trials of one table, made in parallel."""

    settings: TableSettings
    records: Records
    workers: int
    retry_crashes: bool

    def seeds_to_assess(self, objects: int) -> Iterator[int]:
        """Seeds that have not been assessed, in ascending order, until there are enough obstructed scenes."""
        settings = self.settings
        for seed in itertools.count(settings.seed):
            if len(table_seeds(settings, self.records, objects, before=seed)) >= settings.scenes:
                return
            if seed - settings.seed >= settings.scenes * _RESETS_PER_SCENE:
                logger.warning("too few obstructed scenes with %d objects: stopped at seed %d", objects, seed)
                return
            if self._is_missing(self.records.get(objects, seed, ASSESSMENT)):
                yield seed

    def try_strategies(self) -> None:
        """Try every strategy on every scene of the table."""
        trials = [
            self.settings.trial(objects, seed, name)
            for objects in self.settings.objects
            for seed in table_seeds(self.settings, self.records, objects)
            for name in self.settings.strategies
        ]
        missing = [trial for trial in trials if self._is_missing(self.records.get(*trial.key))]
        causes: Counter[str] = Counter()
        with progress_bar(
            desc="strategies", total=len(trials), initial=len(trials) - len(missing), unit="trial"
        ) as bar:
            for record in self.make(iter(missing)):
                causes[record.cause or "solved"] += 1
                bar.update()
                bar.set_postfix_str(", ".join(f"{cause} {count}" for cause, count in causes.most_common(3)))

    def make(self, trials: Iterator[Trial]) -> Iterator[Record]:
        """Make trials in parallel; each record is stored before the next trial is taken."""
        limit_s = self.settings.time_limit * (_EPISODE_LIMITS if self.settings.physics else _SOLVE_LIMITS)
        for trial, result in run_jobs(run_trial, trials, self.workers, limit_s):
            record = failure_record(trial, result) if isinstance(result, Crash | Killed) else result
            self.records.add(record)
            yield record

    def _is_missing(self, record: Record | None) -> bool:
        return record is None or (self.retry_crashes and record.cause == CRASH)


def failure_record(trial: Trial, result: Crash | Killed) -> Record:
    """The record of a trial that crashed or was killed."""
    cause = CRASH if isinstance(result, Crash) else "killed"
    detail = result.detail if isinstance(result, Crash) else f"did not end within {result.seconds:.0f} s"
    kind = Assessment if trial.strategy == ASSESSMENT else Attempt
    return kind(objects=trial.objects, seed=trial.seed, strategy=trial.strategy, cause=cause, detail=detail)


@dataclass(frozen=True)
class Summary:
    """What the trials say: the scenes, every strategy on its own, and all of them on the scenes that all solved."""

    scenes: tuple[Scenes, ...]
    rows: tuple[Row, ...]
    shared: tuple[Shared, ...]


def summarise_table(settings: TableSettings, records: Records) -> Summary:
    """Summarise the trials there are."""
    scenes: list[Scenes] = []
    rows: list[Row] = []
    shared: list[Shared] = []
    for objects in settings.objects:
        seeds = table_seeds(settings, records, objects)
        if not seeds:
            continue
        found = {
            seed: scene for seed, scene in records.assessments(objects).items() if settings.seed <= seed <= seeds[-1]
        }
        floors = {seed: scene.floor for seed, scene in found.items() if scene.proved and scene.floor is not None}
        scenes.append(summarise_scenes(objects, list(found.values()), settings.seed))
        attempts = {name: records.attempts(objects, name, seeds) for name in settings.strategies}
        tried = {name: own for name, own in attempts.items() if own}
        reference = attempts[settings.strategies[0]]
        rows += [make_row(own, reference, floors, settings.cap, settings.seed) for own in tried.values()]
        shared += make_shared(tried, floors, objects, settings.seed)
    return Summary(tuple(scenes), tuple(rows), tuple(shared))


def table_seeds(settings: TableSettings, records: Records, objects: int, before: int | None = None) -> list[int]:
    """The seeds of the table's scenes: the first among those assessed that count, all below `before` if it is given."""
    found = records.assessments(objects)
    last = max(found, default=settings.seed) if before is None else before - 1
    counts = [seed for seed, scene in found.items() if scene.is_obstructed or not settings.only_obstructed]
    seeds = [seed for seed in counts if settings.seed <= seed <= last]
    return seeds[: settings.scenes]
