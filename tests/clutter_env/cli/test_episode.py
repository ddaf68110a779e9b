"""`clutter-env episode`: what is printed, what is written, and whole demonstrations."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from clutter_env.cli.episode_arguments import Arguments
from clutter_env.cli.expert_episodes import (
    episode_text,
    plan_text,
    replanning_text,
    report_rows,
    write_plan,
)
from clutter_env.cli.main import main
from planners import Cause, EpisodeReport, Infeasible, Solution
from planners.tamp.solution import ReplanRecord, SolveStats
from tests.planners.plans import solved

ROOT = Path(__file__).resolve().parents[3]


def test_replanning_marks_what_held_and_what_was_refuted() -> None:
    plan = ("MoveBase(a, b, t)", "PickUp(object_01, g)", "MoveBase(b, c, u)")
    stats = SolveStats(history=(ReplanRecord(plan, 1, plan[1], ("(obstacle object_02)",)),))
    lines = replanning_text(Infeasible(Cause.MOTION, "", stats=stats)).splitlines()
    marked = ["  + MoveBase(a, b, t)", "  x PickUp(object_01, g)", "    MoveBase(b, c, u)"]
    assert lines[1:4] == marked
    assert "    (obstacle object_02)" in lines


def test_the_text_of_an_episode_without_a_plan_names_the_cause() -> None:
    plan = Infeasible(Cause.NO_CLEARANCE_LOCATION, "nowhere for object_02", target="object_01")
    report = EpisodeReport(failure="no clearance location: nowhere for object_02")
    text = episode_text(Arguments(strategy="ngr"), plan, report_rows(report, False, False))
    assert "No plan takes object_01" in text
    assert "Cause: no clearance location" in text
    assert "Replanning of ngr (as in Fig. 11)\n\nnone" in text
    assert "no: no clearance location: nowhere for object_02" in text


def test_the_files_of_an_episode_hold_its_plan(tmp_path: Path) -> None:
    plan = solved()
    files = write_plan(plan, tmp_path)
    assert [path.name for path in files] == ["plan.png", "overview.png", "plan.npz"]
    assert Solution.load(tmp_path / "plan.npz") == plan
    assert all(path.stat().st_size > 10_000 for path in files)
    assert plan_text(plan, "pr2").count("PUTDOWNFORCLEARANCE_PR2") == len(plan.clearances)


def test_the_report_believes_the_environment() -> None:
    report = EpisodeReport(planned=True, executed=True, scored=True, clearances=("object_02",), floor=1)
    assert report_rows(report, is_success=True, lifted=True)["success"] == "yes, by the environment"
    assert report_rows(report, is_success=False, lifted=False)["success"] == "no: the goal was not reached"
    assert "no: an object has fallen" in report_rows(report, is_success=False, lifted=True)["success"]


def test_a_printed_report_has_a_cause_and_readable_numbers() -> None:
    text = str(EpisodeReport(failure="no plan: blocked", planning_s=0.19320000000000004, sim_s=3712.04))
    assert "result: no plan: blocked\n" in text
    assert "planning: 0.19 s" in text
    assert "simulated time: 3712.0 s" in text


@pytest.mark.parametrize(
    "wrong",
    [["--objects", "16"], ["--strategy", "best"], ["--layout", "round"], ["--robot", "r2"], ["--episodes", "0"]],
)
def test_wrong_arguments_are_named(wrong: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["episode", *wrong])
    assert ended.value.code == 2
    assert wrong[1] in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.parametrize("robot", ["fetch", "pr2"])
def test_the_demonstration_takes_the_target_out_of_fifteen_objects(
    tmp_path: Path, robot: str, capsys: pytest.CaptureFixture[str]
) -> None:
    main(["episode", "--objects", "15", "--robot", robot, "--out", str(tmp_path)])
    assert f"PUTDOWNFORCLEARANCE_{robot.upper()}" in capsys.readouterr().out
    figures = json.loads((tmp_path / "report.json").read_text())
    assert figures["is_success"]
    assert all(Path(path).is_file() for path in figures["files"])
    assert (tmp_path / "plan.png").stat().st_size > 20_000


@pytest.mark.slow
def test_many_episodes_are_counted(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    main(["episode", "--objects", "5", "--episodes", "2", "--workers", "1", "--no-obstructed", "--out", str(tmp_path)])
    assert len(json.loads((tmp_path / "report.json").read_text())["episodes"]) == 2
    assert "clean success" in capsys.readouterr().out
