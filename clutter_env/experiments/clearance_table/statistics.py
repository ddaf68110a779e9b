"""From trials to the rows of the clearance table: paired by scene, with bootstrap intervals."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.stats import binomtest

from clutter_env.experiments.clearance_table.trials import Assessment, Attempt

__all__ = ["CRASH", "Interval", "Row", "Scenes", "Times", "bootstrap", "make_row", "summarise_scenes"]

CRASH = "crash"
"""Cause of an attempt that ended in an exception or a dead process: no verdict about the strategy."""
_RESAMPLES = 4000
_LEVEL = 0.95


class Interval(NamedTuple):
    """A mean and the ends of its 95% bootstrap interval; NaN where there is nothing to average."""

    mean: float
    low: float
    high: float


class Times(NamedTuple):
    """Median and 95th percentile of CPU times [s]."""

    median: float
    p95: float


@dataclass(frozen=True)
class Scenes:
    """The scenes with one number of objects.

    Attributes:
        objects: on the table.
        seeds: resets looked at.
        obstructed: those where something must be cleared, and can be: what the strategies are tried on.
        free: targets that nothing obstructs.
        without_set: scenes for which the floor proves that there is no self-clearable set.
        unreachable: scenes whose target no grasp reaches.
        crashed: scenes that could not be assessed.
        unproved: obstructed scenes whose floor is an upper bound only.
        floor: over the obstructed scenes with a proved floor.
        floor_time: to compute it.
    """

    objects: int
    seeds: int
    obstructed: int
    free: int
    without_set: int
    unreachable: int
    crashed: int
    unproved: int
    floor: Interval
    floor_time: Times


@dataclass(frozen=True)
class Row:
    """One strategy on the obstructed scenes with one number of objects.

    Attributes:
        objects, strategy: which.
        scenes: attempts that ended by themselves.
        crashed: attempts that did not; they count nowhere else.
        solved: how many.
        success: share of `scenes`.
        clearances: over the solved scenes, as `duplicated` (objects cleared twice or more), `ratio` (clearances by
            floor, where that is proved) and `at_floor` (share with exactly the floor).
        both: scenes that the reference strategy solved too; on them, `both_clearances` and `both_reference`.
        difference: clearances beyond the reference's, on those.
        censored: clearances over all scenes, each counted as at most the cap, an unsolved one as the cap.
        p_success: of McNemar's exact test for a difference in success from the reference, NaN for the reference.
        replans: over all scenes.
        total, task, motion: CPU time of a solve; `task_call`: of one call of the task planner.
        causes: of failures, with counts.
    """

    objects: int
    strategy: str
    scenes: int
    crashed: int
    solved: int
    success: Interval
    clearances: Interval
    duplicated: Interval
    ratio: Interval
    at_floor: float
    both: int
    both_clearances: float
    both_reference: float
    difference: Interval
    censored: Interval
    p_success: float
    replans: Interval
    total: Times
    task: Times
    motion: Times
    task_call: Times
    causes: Mapping[str, int]


def bootstrap(values: Sequence[float], rng: np.random.Generator) -> Interval:
    """The mean, and its interval by resampling the scenes."""
    array = np.asarray(values, dtype=float)
    if not len(array):
        return Interval(np.nan, np.nan, np.nan)
    means = array[rng.integers(len(array), size=(_RESAMPLES, len(array)))].mean(axis=1)
    low, high = np.quantile(means, ((1 - _LEVEL) / 2, (1 + _LEVEL) / 2))
    return Interval(float(array.mean()), float(low), float(high))


def times(values: Sequence[float]) -> Times:
    """Median and 95th percentile."""
    return Times(*map(float, np.quantile(values, (0.5, 0.95)))) if len(values) else Times(np.nan, np.nan)


def summarise_scenes(objects: int, found: Sequence[Assessment], seed: int) -> Scenes:
    """Count the scenes by what the floor says about them."""
    obstructed = [scene for scene in found if scene.is_obstructed]
    proved = [scene.floor for scene in obstructed if scene.proved and scene.floor is not None]
    causes = Counter(scene.cause for scene in found if scene.floor is None)
    crashed = causes.pop(CRASH, 0)
    unreachable = causes.pop("unreachable", 0)
    return Scenes(
        objects=objects,
        seeds=len(found),
        obstructed=len(obstructed),
        free=sum(scene.floor == 0 for scene in found),
        without_set=causes.total(),
        unreachable=unreachable,
        crashed=crashed,
        unproved=len(obstructed) - len(proved),
        floor=bootstrap(proved, np.random.default_rng(seed)),
        floor_time=times([scene.floor_s for scene in found]),
    )


def make_row(
    own: Mapping[int, Attempt],
    reference: Mapping[int, Attempt],
    floors: Mapping[int, int],
    cap: int,
    seed: int,
) -> Row:
    """The row of one strategy.

    Args:
        own: its attempts by seed, at least one.
        reference: those of the strategy to compare with; may be `own` itself.
        floors: proved floors by seed.
        cap: clearances that an unsolved scene counts as.
        seed: of the resampling.
    """
    rng = np.random.default_rng(seed)
    first = next(iter(own.values()))
    ended = {k: attempt for k, attempt in own.items() if attempt.cause != CRASH}
    solved = {k: attempt for k, attempt in ended.items() if attempt.solved}
    both = [k for k in solved if k in reference and reference[k].solved]
    floored = [len(solved[k].clearances) / floors[k] for k in solved if k in floors]
    return Row(
        objects=first.objects,
        strategy=first.strategy,
        scenes=len(ended),
        crashed=len(own) - len(ended),
        solved=len(solved),
        success=bootstrap([attempt.solved for attempt in ended.values()], rng),
        clearances=bootstrap([len(attempt.clearances) for attempt in solved.values()], rng),
        duplicated=bootstrap([attempt.duplicated for attempt in solved.values()], rng),
        ratio=bootstrap(floored, rng),
        at_floor=float(np.mean([ratio <= 1 for ratio in floored])) if floored else np.nan,
        both=len(both),
        both_clearances=_mean([len(own[k].clearances) for k in both]),
        both_reference=_mean([len(reference[k].clearances) for k in both]),
        difference=bootstrap([len(own[k].clearances) - len(reference[k].clearances) for k in both], rng),
        censored=bootstrap([min(len(a.clearances), cap) if a.solved else cap for a in ended.values()], rng),
        p_success=np.nan if own is reference else mcnemar(ended, reference),
        replans=bootstrap([attempt.replans for attempt in ended.values()], rng),
        total=times([attempt.total_s for attempt in ended.values()]),
        task=times([attempt.task_planning_s for attempt in ended.values()]),
        motion=times([attempt.motion_planning_s for attempt in ended.values()]),
        task_call=times([a.task_planning_s / a.task_plans for a in ended.values() if a.task_plans]),
        causes=Counter(attempt.cause for attempt in ended.values() if not attempt.solved),
    )


def mcnemar(own: Mapping[int, Attempt], reference: Mapping[int, Attempt]) -> float:
    """Exact two-sided p value that both solve equally many, from the scenes that only one of them solves."""
    shared = [(own[k].solved, reference[k].solved) for k in own if k in reference and reference[k].cause != CRASH]
    only_own = sum(mine and not theirs for mine, theirs in shared)
    only_reference = sum(theirs and not mine for mine, theirs in shared)
    if not only_own + only_reference:
        return 1.0 if shared else np.nan
    return float(binomtest(only_own, only_own + only_reference).pvalue)


def _mean(values: Sequence[float]) -> float:
    return float(np.mean(values)) if values else np.nan
