"""Evaluation jobs, their scores, and the tables made of them."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np
import pytest

from clutter_env.cli.main import main
from clutter_env.errors import SuiteError
from clutter_env.learning.comparison.compare import CONTROLS, Comparison, evaluate_all, make_jobs, make_rows
from clutter_env.learning.comparison.evaluation import Score, held_out_seeds, play, play_scene
from clutter_env.learning.comparison.jobs import FLOOR, EvaluationJob, Result, WrongScene, run_job
from clutter_env.learning.comparison.picture import plot
from clutter_env.learning.comparison.records import ResultRecords
from clutter_env.learning.comparison.run_names import run_names
from clutter_env.learning.comparison.scene_sets import SceneSet, SeededScene, find_floor, skill_scene
from clutter_env.learning.comparison.suite_policies import load_policy
from clutter_env.learning.comparison.tables import markdown, markdown_by_floor, summarise
from clutter_env.learning.errors import LearningError
from clutter_env.learning.policies.baselines import Bulldozer
from clutter_env.learning.task import HELD_OUT, Task
from clutter_env.learning.training.run import Run
from clutter_env.parallel import Crash
from clutter_env.reporting.files import json_text
from clutter_env.reporting.intervals import wilson
from clutter_env.suites import Floor, suite

O15 = SceneSet(env_id="clutter_env/Retrieve-o15-v0", obstructed=True, count=2)
REACH = SceneSet(env_id="clutter_env/Reach-v0", count=2)


def score(seed: int, moved: int | None, disturbed: int = 0) -> Score:
    """A solved scene, or with None an unsolved one."""
    solved = moved is not None
    failure = "" if solved else "time limit"
    return Score(seed, solved, solved, 100, 5.0, moved or 0, moved or 0, disturbed, 0, 0, failure, 1.0)


def test_moved_per_floor_counts_solved_scenes_with_a_known_floor_of_at_least_one() -> None:
    runs = [[score(0, 2), score(1, 3), score(2, None), score(3, 5), score(4, 1)]]
    floors = {0: Floor(1, True), 1: Floor(2, True), 2: Floor(1, True), 3: Floor(1, False), 4: Floor(0, True)}
    row = summarise("o5", "lookahead", runs, floors, seed=0)
    assert row.clean.mean == 0.8
    assert row.moved_per_floor.mean == pytest.approx((2 + 1.5) / 2)
    assert dict(row.failures) == {"time limit": 1}


def test_success_is_broken_down_by_floor() -> None:
    floors = {0: Floor(0, True), 1: Floor(1, True), 2: Floor(1, True), 3: Floor(7, True), 4: Floor(None, True, "why")}
    row = summarise(
        "o5", "random", [[score(0, 0), score(1, 1), score(2, None), score(3, 9), score(4, None)]], floors, 0
    )
    assert {name: (rate.scenes, rate.clean.mean) for name, rate in row.by_floor.items()} == {
        "0": (1, 1.0),
        "1": (2, 0.5),
        "3 or more": (1, 1.0),
        "none": (1, 0.0),
    }
    assert row.by_floor["1"].clean == wilson(1, 2)


def test_the_tables_have_a_line_per_row_and_the_picture_is_drawn(tmp_path: Path) -> None:
    floors = {0: Floor(1, True)}
    rows = [summarise(name, "random", [[score(0, None)]], floors, 0) for name in ("o5", "side-15-v1")]
    for table in (markdown(rows), markdown_by_floor(rows)):
        lines = table.splitlines()
        assert len(lines) == 4
        assert len({line.count("|") for line in lines}) == 1
    plot(rows, tmp_path / "plot.png")
    assert (tmp_path / "plot.png").stat().st_size > 1000
    assert markdown_by_floor([summarise("reach", "random", [[score(0, None)]], {}, 0)]) == ""


def test_sets_of_scenes_have_names_and_know_their_kind() -> None:
    assert (O15.name, O15.family, O15.num_objects) == ("o15 obstructed", "retrieve", 15)
    assert SceneSet(env_id="clutter_env/Retrieve-o20-v0", obstructed=2, count=1).name == "o20 obstructed 2"
    assert (REACH.name, REACH.family) == ("reach", "reach")
    shelf = SceneSet("shelf-10-v2", "validation", count=3)
    assert (shelf.name, shelf.num_objects, len(shelf.scenes)) == ("shelf-10-v2 (validation)", 10, 3)
    with pytest.raises(LearningError, match="name one of them"):
        SceneSet()
    with pytest.raises(LearningError, match="from 1 to 100"):
        SceneSet("shelf-10-v2", count=101)


def test_skills_play_the_scenes_of_suites_and_environments() -> None:
    for scene in (suite("shelf-10-v2").test[0], O15.scenes[0]):
        played, plain = skill_scene(scene, "none"), scene.make()
        env = played.make()
        _, info = played.reset(env)
        scene.reset(plain)
        assert info["target"] == plain.unwrapped.world.names[plain.unwrapped.target_slot]
        assert np.array_equal(env.unwrapped.physics_env.data.qpos, plain.unwrapped.data.qpos)
    with pytest.raises(LearningError, match="no skills"):
        skill_scene(REACH.scenes[0], "oracle")


def test_the_floor_of_an_obstructed_scene_is_at_least_one() -> None:
    floor = find_floor(O15.scenes[0], "side")
    assert floor.is_proved
    assert floor.count
    stored = suite("side-15-v1").test[0]
    assert find_floor(stored, "side") == stored.floor_side


def test_playing_measures_what_happened() -> None:
    env = Task("clutter_env/Pick-v0").make()
    seed = held_out_seeds(1)[0]
    assert seed == HELD_OUT
    good = play_scene(SeededScene("clutter_env/Pick-v0", {}, seed), env, load_policy("pick", 0))
    idle = play(env, lambda _: np.zeros(10, np.float32), seed, max_steps=30)
    assert good.clean
    assert good.failure == ""
    assert idle.steps == 30
    assert idle.moved == 0
    assert idle.failure == "time limit"
    assert idle.sim_s == pytest.approx(1.5)


def test_success_of_all_scenes_is_no_certainty() -> None:
    one = summarise("o5", "lookahead", [[score(seed, 0) for seed in range(50)]], {}, seed=0)
    assert one.clean == wilson(50, 50)
    assert one.clean.low < 0.95
    three = summarise("o5", "sac", [[score(seed, 0) for seed in range(50)]] * 3, {}, seed=0)
    assert three.clean.low < 1.0


class Here:
    """Runs jobs in this process: policies succeed with one object moved, the floor is 1; some policies crash."""

    def __init__(self, crashing: str = "", is_final: bool = True) -> None:
        self.crashing, self.is_final, self.done = crashing, is_final, []

    def __call__(
        self, _: object, jobs: Iterable[EvaluationJob]
    ) -> Iterator[tuple[EvaluationJob, Result | WrongScene | Crash]]:
        for job in jobs:
            self.done.append(job.policy)
            if job.policy == self.crashing:
                yield job, Crash("Traceback ...\nValueError: as told", self.is_final)
            else:
                seed = job.scenes.scenes[job.index].seed
                yield job, Floor(1, True) if job.policy.startswith(FLOOR) else score(seed, 1)


def test_a_killed_comparison_goes_on_where_it_was(tmp_path: Path) -> None:
    comparison = Comparison((O15,), ("ngr",))
    jobs = make_jobs(comparison)
    assert {job.policy for job in jobs} == {FLOOR + "side", "ngr", *CONTROLS["retrieve"]}
    path = tmp_path / "results.jsonl"
    with pytest.raises(LearningError, match=r"greedy on scene 0 of o15 obstructed: (.|\n)*as told"):
        evaluate_all(jobs, ResultRecords(path), Here("greedy", is_final=False))
    path.write_text(path.read_text() + '{"key": "cut o')
    again = Here()
    results = evaluate_all(jobs, ResultRecords(path), again)
    assert "ngr" not in again.done
    assert again.done.count("greedy") == 2
    rows = make_rows(comparison, results)
    assert [row.policy for row in rows] == ["ngr", *CONTROLS["retrieve"]]
    assert {row.moved_per_floor.mean for row in rows} == {1.0}
    assert evaluate_all(jobs, ResultRecords(path), Here("ngr")) == results


def test_an_exception_of_a_policy_is_a_failed_episode_that_is_played_again(tmp_path: Path) -> None:
    comparison = Comparison((REACH,))
    jobs, path = make_jobs(comparison), tmp_path / "results.jsonl"
    (row,) = make_rows(comparison, evaluate_all(jobs, ResultRecords(path), Here("random")))
    assert (row.clean.mean, dict(row.failures)) == (0.0, {"ValueError: as told": 2})
    (row,) = make_rows(comparison, evaluate_all(jobs, ResultRecords(path), Here()))
    assert row.clean.mean == 1.0


def test_a_scene_that_is_not_the_suite_s_is_an_error(tmp_path: Path) -> None:
    jobs = make_jobs(Comparison((O15,)))
    wrong = lambda _, jobs: ((job, WrongScene("another scene")) for job in jobs)  # noqa: E731
    with pytest.raises(SuiteError, match="another scene"):
        evaluate_all(jobs, ResultRecords(tmp_path / "results.jsonl"), wrong)


def test_results_of_other_versions_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "results.jsonl"
    ResultRecords(path)
    path.write_text(path.read_text().replace('"mujoco": "', '"mujoco": "0.'))
    with pytest.raises(LearningError, match="mujoco: '0"):
        ResultRecords(path)


def test_runs_have_one_name_if_they_differ_in_their_seed_alone(tmp_path: Path) -> None:
    for name, seed, steps in (("a", 0, 10), ("a", 1, 10), ("b", 0, 20)):
        Run(Task("clutter_env/Reach-v0"), "sac", steps, tmp_path / name / f"seed-{seed}", seed).write_record()
    one, other, longer = sorted(tmp_path.glob("*/*"))
    assert set(run_names([str(one), str(other)]).values()) == {"sac (actions)"}
    assert run_names([str(one), str(longer)])[str(longer)] == "sac (actions), b"
    comparison = Comparison((REACH, O15), runs=(one,))
    assert comparison.contenders(REACH) == [str(one), "random"]
    with pytest.raises(LearningError, match="cannot play any of these scenes: o15 obstructed"):
        make_jobs(Comparison((O15,), runs=(one,)))


def test_greedy_skills_play_a_scene() -> None:
    played = run_job(EvaluationJob(O15, 0, "greedy"))
    assert isinstance(played, Score)
    assert 1 <= played.steps <= 7
    assert played.refused >= 1, "the target is obstructed"


def test_the_bulldozer_lifts_without_success_and_is_counted_apart() -> None:
    env = Task("clutter_env/Retrieve-o15-v0", Bulldozer.env_keywords).make()
    bulldozer = Bulldozer()
    scenes = [SeededScene("clutter_env/Retrieve-o15-v0", {}, seed) for seed in (610_001, 610_002)]
    scores = [play_scene(scene, env, bulldozer) for scene in scenes]
    assert [score.lifted for score in scores] == [True, False]
    assert not any(score.clean for score in scores)
    assert [score.failure for score in scores] == ["not clean", "gave up"]
    assert all(score.disturbed for score in scores)
    assert scores[0].steps < 100, "an episode is over when the target is lifted"
    row = summarise("o15", "bulldozer", [scores], {}, seed=0)
    assert (row.clean.mean, row.lifted.mean) == (0.0, 0.5)
    assert bulldozer.done
    bulldozer.reset(env, {})
    assert not bulldozer.done


def test_the_bulldozer_needs_control_of_the_gripper() -> None:
    with pytest.raises(LearningError, match="ee"):
        Bulldozer().reset(Task("clutter_env/Retrieve-o5-v0").make(), {})


def test_an_unknown_policy_is_refused() -> None:
    with pytest.raises(LearningError, match="lookahead"):
        make_jobs(Comparison((O15,), ("nobody",)))


def test_what_was_never_solved_is_null_in_json(tmp_path: Path) -> None:
    row = summarise("reach", "random", [[score(0, None)]], {}, 0)
    assert json.loads(json_text(row), parse_constant=pytest.fail)["moved_per_floor"]["mean"] is None
    words = ["--envs", "clutter_env/Reach-v0", "--policies", "random", "--scenes", "1", "--workers", "1"]
    main(["compare", *words, "--out", str(tmp_path), "--json", str(tmp_path / "new" / "rows.json")])
    (found,) = json.loads((tmp_path / "new" / "rows.json").read_text(), parse_constant=pytest.fail)
    assert (found["clean"]["mean"], found["policy"]) == (0.0, "random")
    assert "clutter-env compare --envs clutter_env/Reach-v0" in (tmp_path / "table.md").read_text()
    with pytest.raises(SystemExit, match="name scenes"):
        main(["compare", "--out", str(tmp_path)])
