"""Means and success rates with 95% intervals, over scenes and over training seeds, and quantiles of times."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

RESAMPLES = 4000
LEVEL = 0.95
_BLOCK = 1_000_000
"""Most numbers drawn at once, unless there are more scenes. They take about 30 MB with the intermediate results."""


class Interval(NamedTuple):
    """A mean and the ends of its 95% interval. All are NaN without any value."""

    mean: float
    low: float
    high: float

    def __str__(self) -> str:
        return "–" if math.isnan(self.mean) else f"{self.mean:.2f} [{self.low:.2f}, {self.high:.2f}]"


class Times(NamedTuple):
    """Median and 95th percentile of times [s], NaN without any."""

    median: float
    p95: float


NO_INTERVAL = Interval(math.nan, math.nan, math.nan)
"""The interval without any value."""


def bootstrap(groups: Sequence[Sequence[float]], rng: np.random.Generator) -> Interval:
    """The mean over groups of their means, with a percentile bootstrap interval.

    Groups and scenes are resampled, the same scenes for all groups, because a hard scene is hard for all of them. This
    is the bootstrap of crossed effects (Owen 2007, Annals of Applied Statistics 1, pp. 386-411).

    Args:
        groups: one per training seed (or a single one), each with one value per scene. Value k is that of scene k in
            every group. Missing values are NaN, or left out at the end. Groups without any value are ignored.
        rng: for resampling.
    """
    filled = [np.asarray(group, float) for group in groups if len(group)]
    values = np.full((len(filled), max(map(len, filled), default=0)), np.nan)
    for row, group in zip(values, filled, strict=True):
        row[: len(group)] = group
    is_known = ~np.isnan(values)
    values = values[is_known.any(axis=1)][:, is_known.any(axis=0)]
    if not values.size:
        return NO_INTERVAL
    drawn = rng.integers(len(values), size=(RESAMPLES, len(values)))
    means, rows = np.empty((RESAMPLES, len(values))), max(_BLOCK // values.shape[1], 1)
    for start in range(0, RESAMPLES, rows):  # the generator continues as in a single block
        block = slice(start, min(start + rows, RESAMPLES))
        scenes = rng.integers(values.shape[1], size=(block.stop - start, values.shape[1]))
        means[block] = np.stack([_means(row[scenes]) for row in values], axis=1)
    low, high = np.nanquantile(_means(np.take_along_axis(means, drawn, axis=1)), ((1 - LEVEL) / 2, (1 + LEVEL) / 2))
    return Interval(float(_means(values).mean()), float(low), float(high))


def _means(rows: NDArray[np.float64]) -> NDArray[np.float64]:
    """Mean of the numbers of each row, NaN for a row without any."""
    is_known = ~np.isnan(rows)
    counts = is_known.sum(axis=1)
    sums = np.where(is_known, rows, 0.0).sum(axis=1)
    return np.divide(sums, counts, out=np.full(len(rows), np.nan), where=counts > 0)


def wilson(successes: int, trials: int) -> Interval:
    """A success rate with Wilson's score interval (Wilson 1927, JASA 22, pp. 209-212).

    Unlike the bootstrap it does not shrink to a point when all trials succeed or all fail.
    """
    if not trials:
        return NO_INTERVAL
    from scipy.stats import binomtest  # takes a moment to import

    rate, found = successes / trials, binomtest(successes, trials).proportion_ci(LEVEL, method="wilson")
    return Interval(rate, min(float(found.low), rate), max(float(found.high), rate))


def newcombe(one: tuple[int, int], other: tuple[int, int]) -> Interval:
    """Difference of two success rates on different scenes (Newcombe 1998, Stat. Med. 17, method 10).

    Args:
        one, other: successes and trials. The result is the rate of `one` minus that of `other`.
    """
    here, there = wilson(*one), wilson(*other)
    by = here.mean - there.mean
    low = by - math.hypot(here.mean - here.low, there.high - there.mean)
    return Interval(by, low, by + math.hypot(here.high - here.mean, there.mean - there.low))


def success_interval(runs: Sequence[Sequence[bool]], rng: np.random.Generator) -> Interval:
    """The success rate of a policy.

    For one run: Wilson's interval over its scenes. For several runs, one per training seed, on the same scenes in the
    same order: the bootstrap over seeds and scenes. If all episodes succeed, or all fail, this interval is a point.
    Then Wilson's interval is used, with as many trials as scenes, because episodes of different seeds on one scene are
    not independent.
    """
    played = [run for run in runs if len(run)]
    if len(played) == 1:
        return wilson(sum(played[0]), len(played[0]))
    found = bootstrap(played, rng)
    if found.low < found.high or not played:
        return found
    scenes = max(map(len, played))
    if found.mean in (0.0, 1.0):
        return wilson(round(found.mean * scenes), scenes)
    return found


def times(values: Sequence[float]) -> Times:
    """Median and 95th percentile of times [s]."""
    return Times(*map(float, np.quantile(values, (0.5, 0.95)))) if len(values) else Times(math.nan, math.nan)
