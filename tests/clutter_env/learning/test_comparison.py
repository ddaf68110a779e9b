"""Evaluation jobs, their scores, and the table made of them."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np
import pytest

from clutter_env.cli.compare import main
from clutter_env.learning.comparison.compare import Comparison, evaluate_all, make_jobs, make_rows
from clutter_env.learning.comparison.evaluation import Score, held_out_seeds, play, play_expert
from clutter_env.learning.comparison.jobs import FLOOR, EvaluationJob, policy_name, scene_set_name
from clutter_env.learning.comparison.tables import markdown, plot, summarise
from clutter_env.learning.demonstrations.experts import MAX_SCRIPT_STEPS, make_expert
from clutter_env.learning.errors import LearningError
from clutter_env.learning.policies.baselines import Bulldozer
from clutter_env.learning.task import HELD_OUT, Task
from clutter_env.parallel.jobs import Crash
from clutter_env.reporting.json_file import json_text
from clutter_env.reporting.statistics import wilson


def score(seed: int, moved: int | None) -> Score:
    """A solved scene, or with None an unsolved one."""
    solved = moved is not None
    return Score(seed, solved, moved or 0, 0, 100, 5.0, 1.0, "" if solved else "time limit")


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


def test_success_of_all_scenes_is_no_certainty() -> None:
    one = summarise("o5", "lookahead", [[score(seed, 0) for seed in range(50)]], {}, seed=0)
    assert one.success == wilson(50, 50)
    assert one.success.low < 0.95
    three = summarise("o5", "sac", [[score(seed, 0) for seed in range(50)]] * 3, {}, seed=0)
    assert three.success.low < 1.0


class Here:
    """Runs jobs in this process: policies succeed with one object moved, the floor is 1; `crashing` crashes."""

    def __init__(self, crashing: str = "") -> None:
        self.crashing, self.done = crashing, []

    def __call__(
        self, _: object, jobs: Iterable[EvaluationJob]
    ) -> Iterator[tuple[EvaluationJob, Score | int | Crash | None]]:
        for job in jobs:
            self.done.append(job)
            if job.policy == self.crashing:
                yield job, Crash("Traceback ...\nValueError: as told", is_final=True)
            else:
                yield job, 1 if job.policy == FLOOR else score(job.seed, 1)


def test_scores_survive_a_crash_and_are_not_made_again(tmp_path: Path) -> None:
    comparison = Comparison(("clutter_env/Retrieve-o5-v0",), ("ngr", "random"), scenes=2)
    jobs = make_jobs(comparison)
    assert len(jobs) == 6
    with pytest.raises(LearningError, match=r"random on clutter_env/Retrieve-o5-v0, seed 1000000(.|\n)*as told"):
        evaluate_all(jobs, tmp_path / "scores.json", Here("random"))
    again = Here()
    results = evaluate_all(jobs, tmp_path / "scores.json", again)
    assert [job.policy for job in again.done] == ["random", "random"]
    assert [(row.policy, row.excess.mean) for row in make_rows(comparison, results)] == [("ngr", 0.0), ("random", 0.0)]


def test_the_bulldozer_lifts_without_success_and_is_counted_apart() -> None:
    env = Task("clutter_env/Retrieve-o15-v0", Bulldozer.env_keywords).make()
    bulldozer = Bulldozer()
    bulldozer.reset(env, {})
    scores = [play(env, bulldozer.act, seed, MAX_SCRIPT_STEPS) for seed in (610_001, 610_002)]
    assert [score.lifted for score in scores] == [True, False]
    assert not any(score.is_success for score in scores)
    assert [score.failure for score in scores] == ["not clean", "time limit"]
    assert all(score.disturbed for score in scores)
    assert scores[0].steps < 100, "an episode is over when the target is lifted"
    row = summarise("o15", "bulldozer", [scores], {}, seed=0)
    assert (row.success.mean, row.lifted.mean) == (0.0, 0.5)
    assert bulldozer.done
    bulldozer.reset(env, {})
    assert not bulldozer.done


def test_the_bulldozer_needs_control_of_the_gripper() -> None:
    with pytest.raises(LearningError, match="ee"):
        Bulldozer().reset(Task("clutter_env/Retrieve-o5-v0").make(), {})


def test_an_unknown_policy_is_refused() -> None:
    with pytest.raises(LearningError, match="lookahead"):
        make_jobs(Comparison(("clutter_env/Retrieve-o5-v0",), ("nobody",)))


def test_what_was_never_solved_is_null_in_json(tmp_path: Path) -> None:
    row = summarise("reach", "random", [[score(0, None)]], {}, 0)
    assert json.loads(json_text(row), parse_constant=pytest.fail)["moved"]["mean"] is None
    main(
        ["--envs", "clutter_env/Reach-v0", "--policies", "random", "--scenes", "1", "--max-steps", "2"]
        + ["--workers", "1", "--out", str(tmp_path), "--json", str(tmp_path / "new" / "rows.json")]
    )
    (found,) = json.loads((tmp_path / "new" / "rows.json").read_text(), parse_constant=pytest.fail)
    assert (found["success"]["mean"], found["excess"]) == (0.0, {"mean": None, "low": None, "high": None})
    assert "clutter-env compare --envs clutter_env/Reach-v0" in (tmp_path / "table.md").read_text()
