"""Running the expert: what is printed, what a plan's picture says, and one whole demonstration."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

from clutter_env.experiments.clearance_table.trials import Attempt
from clutter_env.experiments.episodes.episode import (
    EpisodeResult,
    EpisodeSettings,
    draw_episode,
    episode_figures,
    episode_text,
)
from clutter_env.experiments.episodes.many import Episode, counts_text
from clutter_env.experiments.episodes.text import plan_text, replanning_text, report_text
from clutter_env.rendering.film import Film
from planners.cause import Cause
from planners.drawing.page.planned import plan_recording
from planners.drawing.region import ClearancePicture, DrawnSurface, draw_clearance
from planners.expert.report import EpisodeReport
from planners.placing.negative_goal_region import NegativeGoalRegion, SupportGrid
from planners.scene import Body
from planners.tamp.solution import Infeasible, ReplanRecord, Solution
from tests.planners.plans import solved
from tests.planners.scenes import table_scene

ROOT = Path(__file__).resolve().parents[3]


def test_replanning_marks_what_held_and_what_was_refuted() -> None:
    plan = ("MoveBase(a, b, t)", "PickUp(object_01, g)", "MoveBase(b, c, u)")
    text = replanning_text([ReplanRecord(plan, 1, plan[1], ("(obstacle object_02)",))])
    lines = text.splitlines()
    assert lines[1] == "  + MoveBase(a, b, t)"
    assert lines[2] == "  x PickUp(object_01, g)"
    assert lines[3] == "    MoveBase(b, c, u)"
    assert "    (obstacle object_02)" in lines


def test_the_text_of_an_episode_without_a_plan_names_the_cause() -> None:
    plan = Infeasible(Cause.NO_CLEARANCE_LOCATION, "nowhere for object_02", target="object_01")
    settings = EpisodeSettings("clutter_env/Retrieve-o5-v0", strategy="ngr")
    report = EpisodeReport(failure="no clearance location: nowhere for object_02")
    text = episode_text(
        EpisodeResult(settings, 0, table_scene(), plan, report, False, False, None, plan_recording(solved()))
    )
    assert "No plan takes object_01" in text
    assert "Cause: no clearance location" in text
    assert "Evidence: nowhere for object_02" in text
    assert "Replanning of ngr (as in Fig. 11)\n\nnone" in text
    assert "no: no clearance location: nowhere for object_02" in text


def test_the_files_of_an_episode_hold_its_plan(tmp_path: Path) -> None:
    plan = solved()
    settings = EpisodeSettings("clutter_env/Retrieve-o25-v0")
    result = EpisodeResult(
        settings, 3, plan.actions[0].scene, plan, EpisodeReport(), True, True, None, plan_recording(plan)
    )
    files = draw_episode(result, tmp_path)
    assert [path.name for path in files] == ["episode.html", "plan.png", "overview.png", "plan.npz"]
    assert Solution.load(tmp_path / "plan.npz") == plan
    assert all(path.stat().st_size > 10_000 for path in files)
    figures = json.loads(json.dumps(episode_figures(result)))
    assert figures["target"] == plan.target
    assert len(figures["plan"]) == len(plan.actions)
    assert plan_text(plan).count("PUTDOWNFORCLEARANCE_FETCH") == len(plan.clearances)
    assert plan_text(plan, "pr2").count("PUTDOWNFORCLEARANCE_PR2") == len(plan.clearances)


def test_the_report_believes_the_environment() -> None:
    report = EpisodeReport(planned=True, executed=True, scored=True, clearances=("object_02",), floor=1)
    assert "yes, by the environment" in report_text(report, is_success=True, lifted=True)
    assert "no: the target was not held up" in report_text(report, is_success=False, lifted=False)
    assert "no: an object has fallen or been disturbed" in report_text(report, is_success=False, lifted=True)


def test_counts_keep_crashes_apart_from_failures() -> None:
    solved = Attempt(15, 1, "lookahead", solved=True, clearances=("object_02",), deviations=("object_03: toppled",))
    failed = Attempt(15, 2, "lookahead", cause="no clearance location")
    crashed = Attempt(15, 3, "lookahead", cause="crash", detail="Traceback")
    text = counts_text([Episode(1, solved), Episode(2, failed), Episode(None, crashed)])
    assert "1 of 2: 0.50" in text
    assert "1 CRASHED" in text
    assert "1 x no clearance location" in text
    assert "1 x toppled" in text


def test_a_clearance_picture_draws_every_object_and_rank() -> None:
    grid = SupportGrid(-0.35, -0.5, 0.005, (140, 200), 0.75)
    upright = np.array([1.0, 0.0, 0.0, 0.0])
    bodies = [
        Body(f"object_{i:02d}", "cylinder", np.array([0.03, 0.03, 0.08]), np.array([0.0, 0.1 * i, 0.83]), upright)
        for i in range(3)
    ]
    surface = DrawnSurface(grid, NegativeGoalRegion(grid.empty(), grid.empty()))
    spots = np.array([[0.2, 0.2], [0.1, -0.2]])
    picture = ClearancePicture(
        [surface], bodies, "object_00", candidates=spots, ordered=spots[:1], chosen=spots[0], moved="object_01"
    )
    axes = Figure().subplots()
    draw_clearance(axes, picture, "title")
    assert {text.get_text() for text in axes.texts} == {"00", "01", "02", "1"}
    assert [picture.kind(body) for body in bodies] == ["target", "moved", "object"]


def test_a_film_without_ffmpeg_becomes_a_gif(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda _: None)
    film = object.__new__(Film)
    film.frames = [np.full((64, 96, 3), 60 * k, np.uint8) for k in range(4)]
    film.moments = [(f"moment {k}", frame) for k, frame in enumerate(film.frames)]
    assert film.save_film(tmp_path / "film") == tmp_path / "film.gif"
    film.save_strip(tmp_path / "strip.png")
    assert (tmp_path / "strip.png").stat().st_size > 500


@pytest.mark.parametrize(
    "wrong", [["--objects", "16"], ["--strategy", "best"], ["--layout", "round"], ["--robot", "r2"]]
)
def test_wrong_arguments_are_named(wrong: list[str]) -> None:
    command = [sys.executable, "scripts/run_episode.py", *wrong]
    result = subprocess.run(command, capture_output=True, text=True, cwd=ROOT)
    assert result.returncode != 0
    assert "Traceback" not in result.stderr
    assert wrong[1] in result.stderr


@pytest.mark.slow
@pytest.mark.parametrize("robot", ["fetch", "pr2"])
def test_the_demonstration_takes_the_target_out_of_fifteen_objects(tmp_path: Path, robot: str) -> None:
    command = [sys.executable, "scripts/run_episode.py", "--objects", "15", "--robot", robot, "--out", str(tmp_path)]
    result = subprocess.run(command, capture_output=True, text=True, cwd=ROOT, timeout=900)
    assert result.returncode == 0, result.stderr
    assert f"PUTDOWNFORCLEARANCE_{robot.upper()}" in result.stdout
    figures = json.loads((tmp_path / "report.json").read_text())
    assert figures["is_success"]
    assert (tmp_path / "plan.png").stat().st_size > 20_000


@pytest.mark.slow
def test_many_episodes_are_counted(tmp_path: Path) -> None:
    command = [sys.executable, "scripts/run_episode.py", "--objects", "5", "--episodes", "2", "--workers", "1"]
    command += ["--no-obstructed", "--out", str(tmp_path)]
    result = subprocess.run(command, capture_output=True, text=True, cwd=ROOT, timeout=900)
    assert result.returncode == 0, result.stderr
    assert len((tmp_path / "episodes.jsonl").read_text().splitlines()) == 2
    assert "success" in result.stdout


@pytest.mark.slow
def test_the_example_of_the_page_runs(capsys: pytest.CaptureFixture[str]) -> None:
    code = re.search(r"```python\n(.*?)```", (ROOT / "docs" / "planners.md").read_text(), re.DOTALL)
    assert code is not None
    exec(code[1], {})
    assert "scored=True" in capsys.readouterr().out
