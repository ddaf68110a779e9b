"""Comparisons, the tables made of them, and runs as policies."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import gymnasium as gym
import pytest

from clutter_env.cli.leaderboard import Entry, _ranked
from clutter_env.cli.main import main
from clutter_env.errors import LearningError
from clutter_env.evaluation import compare as comparing
from clutter_env.evaluation.compare import CONTROLS, Comparison, compare, run_names
from clutter_env.evaluation.evaluate import Evaluation, evaluate
from clutter_env.evaluation.picture import plot
from clutter_env.evaluation.scenes import SceneSet
from clutter_env.evaluation.score import PolicyCrashed
from clutter_env.evaluation.tables import markdown, markdown_by_floor, results, stratum, summarise
from clutter_env.policies.protocol import PolicyError
from clutter_env.policies.registry import BUILT_IN, policy_families
from clutter_env.reporting.files import json_text, write_json
from clutter_env.reporting.intervals import wilson
from clutter_env.suites import Floor
from clutter_env.task import Task, family
from clutter_env.training.run import Run
from clutter_env.training.settings import Settings
from tests.clutter_env.evaluation.evaluations import evaluation, score

O15 = SceneSet("side-15-v3", count=2)
O5 = SceneSet(env_id="clutter_env/Retrieve-o5-v0", count=1)
REACH = SceneSet(env_id="clutter_env/Reach-v0", count=2)


def test_moved_per_lower_bound_counts_solved_scenes_with_a_proved_one_of_at_least_one() -> None:
    scores = [score(0, 2), score(1, 3), score(2, None), score(3, 5), score(4, 1)]
    floors = [Floor(1, True), Floor(2, True), Floor(1, True), Floor(1, False), Floor(0, True)]
    row = summarise("ngr", [evaluation(scores, floors, O15)])
    assert row.clean.mean == 0.8
    assert row.moved_per_floor.mean == pytest.approx((2 + 1.5) / 2)
    assert dict(row.failures) == {"time limit": 1}


def test_success_is_broken_down_by_lower_bound() -> None:
    floors = [Floor(0, True), Floor(1, True), Floor(1, True), Floor(7, True), Floor(None, True, "why")]
    scores = [score(0, 0), score(1, 1), score(2, None), score(3, 9), score(4, None)]
    row = summarise("random", [evaluation(scores, floors, O15)])
    assert {name: (rate.scenes, rate.clean.mean) for name, rate in row.by_floor.items()} == {
        "0": (1, 1.0),
        "1": (2, 0.5),
        "3 or more": (1, 1.0),
        "none": (1, 0.0),
    }
    assert row.by_floor["1"].clean == wilson(1, 2)
    assert stratum(Floor(2, False)) == "not proved"


def test_the_tables_have_a_line_per_row_and_the_picture_is_drawn(tmp_path: Path) -> None:
    rows = [summarise("random", [evaluation([score(0, None)], [Floor(1, True)], scenes)]) for scenes in (O15, O5)]
    for table in (markdown(rows), markdown_by_floor(rows)):
        lines = table.splitlines()
        assert len(lines) == 4
        assert len({line.count("|") for line in lines}) == 1
    plot(rows, tmp_path / "plot.png")
    assert (tmp_path / "plot.png").stat().st_size > 1000
    reach = summarise("random", [evaluation([score(0, None)], [], REACH)])
    assert markdown_by_floor([reach]) == ""
    assert json.loads(json_text(reach), parse_constant=pytest.fail)["moved_per_floor"]["mean"] is None


def test_controls_play_too_and_runs_that_differ_in_their_seed_form_one_row(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, seed, steps in (("a", 0, 10), ("a", 1, 10), ("b", 0, 20)):
        directory = tmp_path / name / f"seed-{seed}"
        Run(Task("clutter_env/Reach-v0"), "sac", directory, seed, Settings(steps=steps)).write_record()
    one, other, longer = sorted(tmp_path.glob("*/*"))
    assert set(run_names([str(one), str(other)]).values()) == {"sac"}
    assert run_names([str(one), str(longer)])[str(longer)] == "sac, b"
    (tmp_path / "copy").symlink_to(one)
    with pytest.raises(LearningError, match="are one run, not two seeds"):
        run_names([str(one), str(other), str(tmp_path / "copy")])

    def evaluated(_: str, scenes: SceneSet, **__: object) -> Evaluation:
        floors = [scene.floor_side for scene in scenes.scenes] if scenes.suite else []
        return evaluation([score(scene.seed, 1) for scene in scenes.scenes], floors, scenes)

    monkeypatch.setattr(comparing, "evaluate", evaluated)
    rows = compare(Comparison((REACH,), (str(one), str(other))))
    assert [(row.policy, row.runs) for row in rows] == [("sac", 2), ("random", 1)]
    rows = compare(Comparison((O15,), ("ngr",)))
    assert [row.policy for row in rows] == ["ngr", *CONTROLS["retrieve"]]
    assert {row.moved_per_floor.mean for row in rows} == {0.75}
    with pytest.raises(LearningError, match="cannot play any of these scenes: side-15-v3"):
        Comparison((O15,), (str(one),))


def test_policies_that_act_by_skills_are_compared_on_skills() -> None:
    skills = SceneSet(env_id="clutter_env/Skill-o5-v0", count=1)
    (row,) = compare(Comparison((skills,), ("greedy",)))
    assert (row.policy, row.clean.mean) == ("greedy", 1.0)
    with pytest.raises(LearningError, match="lookahead cannot play"):
        Comparison((skills,), ("lookahead",))


@pytest.mark.parametrize("name", ["random", "my_module:MyPolicy"])
def test_a_policy_that_reads_observations_is_compared_on_every_family(name: str) -> None:
    """Searches were left out."""
    ids = [env_id for env_id in gym.registry if env_id.startswith("clutter_env/")]
    assert {family(env_id) for env_id in ids} == set(policy_families(name))


def test_an_unknown_policy_is_refused_and_controls_are_known() -> None:
    assert {name for names in CONTROLS.values() for name in names} <= set(BUILT_IN)
    with pytest.raises(PolicyError, match="lookahead"):
        Comparison((O15,), ("nobody",))


def test_the_command_writes_tables_pictures_and_rows(tmp_path: Path) -> None:
    words = ["compare", "--envs", "clutter_env/Reach-v0", "--policies", "random", "--scenes", "1", "--workers", "1"]
    main([*words, "--out", str(tmp_path), "--json", str(tmp_path / "new" / "rows.json")])
    (found,) = json.loads((tmp_path / "new" / "rows.json").read_text(), parse_constant=pytest.fail)
    assert (found["clean"]["mean"], found["policy"]) == (0.0, "random")
    assert "clutter-env compare --envs clutter_env/Reach-v0" in (tmp_path / "table.md").read_text()
    with pytest.raises(SystemExit, match="name scenes"):
        main(["compare", "--out", str(tmp_path)])


@pytest.fixture(scope="module")
def played() -> dict[str, Any]:
    """A results file's content: two scenes of Reach."""
    return results(evaluate("reach", SceneSet(env_id="clutter_env/Reach-v0", count=2)))


def test_results_files_are_tabled_as_they_stand(
    played: dict[str, Any], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "reach.json"
    write_json(file, played)
    main(["compare", "--files", str(file), str(file), "--out", str(tmp_path / "out")])
    lines = [line for line in capsys.readouterr().out.splitlines() if line.startswith("| reach | reach ")]
    assert len(lines) == 2
    assert lines[0].split("|")[4:7] == [" 1 × 2 ", " 1.00 [0.34, 1.00] ", " – "]
    assert (tmp_path / "out" / "plot.png").exists()
    file.write_text(file.read_text().replace('"sim_s"', '"seconds"'))
    with pytest.raises(SystemExit, match="an episode lacks 'sim_s'"):
        main(["compare", "--files", str(file)])


def test_a_leaderboard_shows_what_a_replay_confirms(
    played: dict[str, Any], tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    good, forged = tmp_path / "reach.json", tmp_path / "forged.json"
    write_json(good, played)
    episodes = [{**episode, "clean": not episode["clean"]} for episode in played["episodes"]]
    write_json(forged, {**played, "policy": "greedy", "episodes": episodes})
    with pytest.raises(SystemExit) as end:
        main(["leaderboard", str(good), str(forged), "--out", str(tmp_path / "board")])
    assert end.value.code == 1
    page = (tmp_path / "board" / "leaderboard.html").read_text()
    assert "| reach | privileged | 1.00 [0.34, 1.00] |" in capsys.readouterr().out
    assert '<a href="../reach.json"' in page
    assert "http" not in page
    for text in (page, (tmp_path / "board" / "leaderboard.md").read_text()):
        assert f"clutter-env verify {good}" in text or f"`{good}`" in text
        assert "forged.json" in text[text.index("Not confirmed") :]
    # What has been found is kept: nothing is played again.
    monkeypatch.setattr("clutter_env.evaluation.verify.run_jobs", pytest.fail)
    main(["leaderboard", str(good), "--out", str(tmp_path / "board")])
    with pytest.raises(SystemExit, match="of one policy on the same scenes"):
        main(["leaderboard", str(good), str(good), "--out", str(tmp_path / "board")])


def test_one_scene_that_is_won_ranks_below_most_of_a_hundred() -> None:
    entries = [
        Entry(Path(f"{policy}.json"), policy, "observations", "side-15-v3", wilson(clean, of), (), "")
        for policy, clean, of in (("lucky", 1, 1), ("good", 95, 100), ("poor", 10, 100))
    ]
    assert [row[0] for row in _ranked(entries)[1]] == ["good", "lucky", "poor"]


def test_a_comparison_runs_no_code_of_a_policy_in_its_own_process(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The module could overwrite how scores are made."""
    (tmp_path / "at_import.py").write_text("open('imported', 'w').close()\nraise ZeroDivisionError\n")
    monkeypatch.chdir(tmp_path)
    with pytest.raises(PolicyCrashed, match="ZeroDivisionError"):
        Comparison((O15,), ("at_import:Policy",))
    assert (tmp_path / "imported").exists()
    assert "at_import" not in sys.modules


@pytest.mark.slow
@pytest.mark.usefixtures("needs_gl")
@pytest.mark.parametrize("policy", ["lookahead", "greedy"])
def test_a_film_is_made_of_a_played_episode(policy: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    film = tmp_path / "film"
    main(["play", "--objects", "1", "--no-obstructed", "--film", str(film), "--policy", policy])
    assert "fallen: clean success" in capsys.readouterr().out
    (file,) = tmp_path.glob("film*")
    assert file.stat().st_size > 50_000, "the motions can be seen"
