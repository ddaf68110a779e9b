"""Intervals, tables and jobs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from clutter_env.learning.comparison.evaluation import Score, held_out_seeds, play, play_expert
from clutter_env.learning.comparison.jobs import policy_name, scene_set_name
from clutter_env.learning.comparison.tables import markdown, plot, summarise
from clutter_env.learning.demonstrations.experts import make_expert
from clutter_env.learning.task import HELD_OUT, Task
from clutter_env.reporting.statistics import bootstrap


def score(seed: int, moved: int | None) -> Score:
    """A solved scene, or with None an unsolved one."""
    solved = moved is not None
    return Score(seed, solved, moved or 0, 0, 100, 5.0, 1.0, "" if solved else "time limit")


def test_intervals_hold_their_mean_and_shrink_with_data() -> None:
    rng = np.random.default_rng(0)
    few, many = rng.normal(size=10), rng.normal(size=1000)
    one, other = bootstrap([few], np.random.default_rng(1)), bootstrap([many], np.random.default_rng(1))
    assert one.low <= one.mean <= one.high
    assert other.high - other.low < one.high - one.low


def test_intervals_cover_the_spread_over_training_seeds() -> None:
    rng = np.random.default_rng(0)
    alike = bootstrap([[0.5, 0.5]] * 3, rng)
    spread = bootstrap([[0.0, 0.0], [0.5, 0.5], [1.0, 1.0]], rng)
    assert alike.low == alike.high == 0.5
    assert spread.low < 0.3
    assert spread.high > 0.7


def test_the_excess_counts_solved_scenes_with_a_known_floor_only() -> None:
    runs = [[score(0, 2), score(1, 1), score(2, None), score(3, 5)]]
    row = summarise("o5", "lookahead", runs, {0: 1, 1: 1, 2: 0, 3: None}, seed=0)
    assert row.success.mean == 0.75
    assert row.moved.mean == pytest.approx(8 / 3)
    assert row.excess.mean == 0.5
    assert dict(row.failures) == {"time limit": 1}


def test_the_table_has_a_line_per_row_and_the_plot_is_drawn(tmp_path: Path) -> None:
    rows = [summarise(f"o{n}", "random", [[score(0, None)]], {}, 0) for n in (5, 10)]
    lines = markdown(rows).splitlines()
    assert len(lines) == 4
    assert len({line.count("|") for line in lines}) == 1
    plot(rows, tmp_path / "plot.png")
    assert (tmp_path / "plot.png").stat().st_size > 1000


def test_names() -> None:
    assert scene_set_name("clutter_env/Retrieve-o15-v0") == scene_set_name("clutter_env/Skill-o15-v0") == "o15"
    assert scene_set_name("clutter_env/Reach-v0") == "reach"
    assert policy_name("lookahead") == "lookahead"


def test_playing_measures_what_happened() -> None:
    env = Task("clutter_env/Pick-v0").make()
    seed = held_out_seeds(1)[0]
    assert seed == HELD_OUT
    good = play_expert(env, make_expert(env), seed)
    idle = play(env, lambda _: np.zeros(10, np.float32), seed, max_steps=30)
    assert good.is_success
    assert good.failure == ""
    assert idle.steps == 30
    assert idle.moved == 0
    assert idle.failure == "time limit"
    assert idle.sim_s == pytest.approx(1.5)
