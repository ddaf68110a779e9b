"""Intervals: what they cover, and that they do not shrink to a point where all trials succeed."""

from __future__ import annotations

import math
import tracemalloc

import numpy as np
import pytest

from clutter_env.reporting import intervals
from clutter_env.reporting.intervals import bootstrap, newcombe, success_interval, times, wilson


def test_bootstrap_intervals_enclose_their_mean_and_shrink_with_data() -> None:
    rng = np.random.default_rng(0)
    few, many = (bootstrap([rng.normal(5.0, 1.0, size).tolist()], rng) for size in (20, 2000))
    assert few.low < few.mean < few.high
    assert many.high - many.low < 0.3 * (few.high - few.low)
    assert bootstrap([[3, 3, 3]], rng) == (3, 3, 3)
    assert math.isnan(bootstrap([], rng).mean)
    assert str(bootstrap([[]], rng)) == "–"


def test_resamples_in_blocks_are_those_of_one_block(monkeypatch: pytest.MonkeyPatch) -> None:
    groups = np.random.default_rng(0).random((3, 47))
    found = []
    for block in (10**9, 1, 47 * 1000 + 5):
        monkeypatch.setattr(intervals, "_BLOCK", block)
        rng = np.random.default_rng(1)
        found.append((bootstrap(groups.tolist(), rng), rng.random()))
    assert found[0] == found[1] == found[2]


def test_many_episodes_do_not_take_the_memory_of_all_resamples_at_once() -> None:
    """A results file with 300,000 crashed episodes was a MemoryError."""
    values = np.random.default_rng(0).random(10_000).tolist()
    tracemalloc.start()
    bootstrap([values], np.random.default_rng(0))
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert most < 100e6


def test_bootstrap_intervals_cover_the_spread_over_training_seeds() -> None:
    rng = np.random.default_rng(0)
    alike = bootstrap([[0.5, 0.5]] * 3, rng)
    spread = bootstrap([[0.0, 0.0], [0.5, 0.5], [1.0, 1.0]], rng)
    assert alike.low == alike.high == 0.5
    assert spread.low < 0.3
    assert spread.high > 0.7


def test_seeds_on_the_same_scenes_are_not_more_scenes() -> None:
    rng = np.random.default_rng(0)
    one = rng.normal(0.0, 1.0, 20).tolist()
    alone, together = bootstrap([one], rng), bootstrap([one] * 30, rng)
    assert together.mean == pytest.approx(alone.mean)
    assert together.high - together.low == pytest.approx(alone.high - alone.low, rel=0.1)


def test_scenes_without_a_value_do_not_count() -> None:
    rng = np.random.default_rng(0)
    nan = math.nan
    assert bootstrap([[2.0, nan, 2.0], [nan, nan, 4.0]], rng).mean == 3.0
    assert bootstrap([[1.0, nan, 1.0], [nan, nan, nan], []], rng) == (1.0, 1.0, 1.0)
    assert math.isnan(bootstrap([[nan]], rng).mean)
    with_gaps, without = (
        bootstrap([row], np.random.default_rng(1)) for row in ([nan, 1.0, 2.0, nan, 5.0], [1.0, 2.0, 5.0])
    )
    assert with_gaps == without


def test_success_of_all_is_no_certainty() -> None:
    rng = np.random.default_rng(0)
    assert success_interval([[True] * 50], rng).low == pytest.approx(0.929, abs=1e-3)
    assert success_interval([[True] * 50] * 3, rng) == wilson(50, 50)
    assert success_interval([[False] * 50] * 3, rng).high == pytest.approx(0.071, abs=1e-3)
    assert math.isnan(success_interval([], rng).mean)
    assert 0.0 == wilson(0, 3).low < wilson(0, 3).high < 1.0
    # Several seeds are resampled as well as scenes.
    apart = success_interval([[True] * 20, [False] * 20], rng)
    assert (apart.low, apart.mean, apart.high) == (0.0, 0.5, 1.0)


def test_times_of_nothing_are_not_numbers() -> None:
    assert times([1.0, 2.0, 3.0]).median == 2.0
    assert math.isnan(times([]).p95)


def test_the_interval_of_a_difference_of_two_rates() -> None:
    """Newcombe's own example: 56 of 70 against 48 of 80, 0.20 [0.0524, 0.3339]."""
    assert newcombe((56, 70), (48, 80)) == pytest.approx((0.2, 0.0524, 0.3339), abs=1e-4)
    assert newcombe((10, 10), (0, 10)).low > 0.5
    both = newcombe((5, 5), (5, 5))
    assert both.low < both.mean == 0.0 < both.high
