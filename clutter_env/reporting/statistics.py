"""Means with bootstrap intervals, over scenes and over training seeds."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

__all__ = ["Interval", "bootstrap"]

RESAMPLES = 2000
LEVEL = 0.95


class Interval(NamedTuple):
    """A mean and the ends of its interval."""

    mean: float
    low: float
    high: float

    def __str__(self) -> str:
        return f"{self.mean:.2f} [{self.low:.2f}, {self.high:.2f}]"


def bootstrap(groups: Sequence[Sequence[float]], rng: np.random.Generator) -> Interval:
    """The mean over groups of their means, with a 95% percentile interval.

    Args:
        groups: one per training seed, each with one value per scene; empty groups do not count. Groups are resampled
            first, then the scenes of each, so that the interval covers both kinds of chance.
        rng: for resampling.
    """
    arrays = [np.asarray(group, float) for group in groups if len(group)]
    if not arrays:
        return Interval(float("nan"), float("nan"), float("nan"))
    means = np.empty(RESAMPLES)
    for k in range(RESAMPLES):
        drawn = [arrays[i] for i in rng.integers(len(arrays), size=len(arrays))]
        means[k] = np.mean([group[rng.integers(len(group), size=len(group))].mean() for group in drawn])
    low, high = np.quantile(means, ((1 - LEVEL) / 2, (1 + LEVEL) / 2))
    return Interval(float(np.mean([group.mean() for group in arrays])), float(low), float(high))
