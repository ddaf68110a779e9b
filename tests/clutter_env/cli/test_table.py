"""The clearance table: its statistics on small cases, its file of trials, and one small run."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import planners.strategies
from assets.robots import FETCH
from clutter_env import time_limit
from clutter_env.cli.main import main
from clutter_env.cli.table import STRATEGIES
from clutter_env.experiments.clearance_table import trials
from clutter_env.experiments.clearance_table.layouts import make_layout_row, summary
from clutter_env.experiments.clearance_table.picture import draw_table
from clutter_env.experiments.clearance_table.records import OtherSettings, Records
from clutter_env.experiments.clearance_table.statistics import CRASH, make_row, make_shared, summarise_scenes
from clutter_env.experiments.clearance_table.table import TableSettings, summarise_table
from clutter_env.experiments.clearance_table.trials import Assessment, Attempt
from clutter_env.experiments.clearance_table.variants import ABLATIONS
from planners.placing.surfaces import Supports, find_supports
from planners.planner import Planner
from tests.planners.scenes import table_scene

ROOT = Path(__file__).resolve().parents[3]


def attempt(seed: int, cleared: int | None, strategy: str = "ngr", cause: str = "motion") -> Attempt:
    """An attempt that cleared so many objects, or failed."""
    if cleared is None:
        return Attempt(15, seed, strategy, cause=cause)
    return Attempt(15, seed, strategy, solved=True, clearances=tuple(f"object_{i:02d}" for i in range(cleared)))


def table(*attempts: Attempt) -> dict[int, Attempt]:
    return {entry.seed: entry for entry in attempts}


def test_rows_pair_by_scene_and_count_unsolved_scenes_at_the_cap() -> None:
    reference = table(attempt(1, 1), attempt(2, 2), attempt(3, None))
    own = table(attempt(1, 4), attempt(2, None), attempt(3, 5))
    row = make_row(own, reference, {1: 2, 3: 5}, cap=10, seed=0)
    assert (row.scenes, row.solved, row.both) == (3, 2, 1)
    assert (row.both_clearances, row.both_reference, row.difference.mean) == (4, 1, 3)
    assert row.censored.mean == pytest.approx((4 + 10 + 5) / 3)
    assert row.ratio.mean == pytest.approx((4 / 2 + 5 / 5) / 2)
    assert row.at_floor == 0.5
    assert row.causes == {"motion": 1}
    assert row.p_success == 1.0


def test_mcnemar_sees_a_strategy_that_fails_where_the_other_does_not() -> None:
    reference = table(*(attempt(seed, 1) for seed in range(10)))
    own = table(*(attempt(seed, None) for seed in range(10)))
    assert make_row(own, reference, {}, cap=10, seed=0).p_success == pytest.approx(2 / 2**10)


def test_a_crash_is_not_a_failure_to_solve() -> None:
    own = table(attempt(1, 1), attempt(2, None, cause=CRASH))
    row = make_row(own, own, {}, cap=10, seed=0)
    assert (row.scenes, row.crashed, row.success.mean) == (1, 1, 1.0)
    assert not row.causes


def test_strategies_and_floor_are_compared_on_the_scenes_that_all_solve() -> None:
    """The picture drew the floor of all scenes over the clearances of the scenes that a strategy solved."""
    attempts = {
        "lookahead": table(attempt(1, 1), attempt(2, 2), attempt(3, 6)),
        "ngr": table(attempt(1, 3), attempt(2, 2), attempt(3, None)),
    }
    first, second = make_shared(attempts, {1: 1, 2: 2, 3: 6}, 15, seed=0)
    assert (first.strategy, first.scenes, first.floor, first.clearances.mean) == ("lookahead", 2, 1.5, 1.5)
    assert (second.strategy, second.scenes, second.floor, second.clearances.mean) == ("ngr", 2, 1.5, 2.5)
    assert make_shared({"ngr": table(attempt(3, None))}, {3: 6}, 15, seed=0) == []


def test_the_picture_marks_the_floor_of_the_scenes_whose_clearances_it_draws(tmp_path: Path) -> None:
    settings = TableSettings(objects=(15,), strategies=("lookahead", "ngr"), scenes=2)
    records = Records(tmp_path / "trials.jsonl", settings.of_trials)
    for seed, floor in ((100_000, 1), (100_001, 5)):
        records.add(Assessment(15, seed, floor=floor, proved=True, side_floor=floor))
        records.add(replace(attempt(seed, floor, "lookahead"), total_s=0.1))
    records.add(replace(attempt(100_000, 3), total_s=0.2))
    records.add(attempt(100_001, None))
    axes = draw_table(summarise_table(settings, records)).axes[1]
    (floor_line,) = [line for line in axes.lines if line.get_gid() == "floor"]
    assert list(floor_line.get_ydata()) == [1.0, 1.0], "5 is the floor of a scene that ngr did not solve"
    assert [list(bars.lines[0].get_ydata()) for bars in axes.containers] == [[1.0], [3.0]]
    assert [label.get_text() for label in axes.get_xticklabels()] == ["15\nscenes: 1"]


def test_scenes_are_told_apart_by_what_the_floor_says() -> None:
    found = [
        Assessment(15, 1, floor=0, proved=True, side_floor=0),
        Assessment(15, 2, floor=3, proved=True, side_floor=3),
        Assessment(15, 3, floor=5, proved=False, side_floor=5),
        Assessment(15, 4, proved=True, cause="no self-clearable set"),
        Assessment(15, 5, proved=True, cause="unreachable"),
        Assessment(15, 6, cause=CRASH),
    ]
    row = summarise_scenes(15, found, seed=0)
    assert (row.seeds, row.free, row.obstructed, row.without_set, row.unreachable) == (6, 1, 2, 1, 1)
    assert (row.crashed, row.unproved, row.floor.mean) == (1, 1, 3)


def test_obstructed_means_that_no_level_grasp_reaches_the_target_whatever_the_grasp_set() -> None:
    found = [Assessment(40, seed, floor=0, proved=True, side_floor=4) for seed in (1, 2)]
    row = summarise_scenes(40, found, seed=0)
    assert (row.obstructed, row.free, row.floor.mean) == (2, 0, 0.0)
    own = table(attempt(1, 0), attempt(2, 1))
    attempts = make_row(own, own, {1: 0, 2: 0}, cap=10, seed=0)
    assert attempts.at_floor == 0.5
    assert np.isnan(attempts.ratio.mean), "nothing is divided by a floor of 0"


def test_layouts_are_counted_against_the_targets_that_are_taken_alone() -> None:
    failed = [replace(attempt(3, None), is_taken_alone=False), attempt(4, None), attempt(5, None, cause=CRASH)]
    row = make_layout_row("shelf", table(attempt(1, 2), attempt(2, 3), *failed), {1: 2, 2: 2, 3: None, 4: 1, 5: 1})
    assert (row.solved, row.alone, row.scenes, row.crashed) == (2, 3, 4, 1)
    assert (row.cleared, row.floor, row.above, row.ratio) == (5, 4, 1, 1.25)
    assert row.causes == {"motion": 1, "motion (alone too)": 1}
    assert "| shelf | 15 | 2 / 3 | 4 | 5 / 4 (1.25) | 1 | 0 |" in summary([row])


@pytest.mark.slow
def test_layouts_are_compared_in_one_table(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["--layouts", "shelf", "cabinet", "--objects", "3", "--scenes", "2", "--strategies", "lookahead"]
    main(["table", *words, "--no-obstructed", "--grasps", "all", "--workers", "1", "--out", str(tmp_path)])
    assert "| cabinet | 3 | 2 / 2 | 2 |" in capsys.readouterr().out
    rows = json.loads((tmp_path / "layouts.json").read_text())["rows"]
    assert [(row["layout"], row["solved"]) for row in rows] == [("shelf", 2), ("cabinet", 2)]


def test_records_survive_a_kill_in_the_middle_of_a_line(tmp_path: Path) -> None:
    path, settings = tmp_path / "trials.jsonl", {"layout": "paper"}
    records = Records(path, settings)
    records.add(attempt(1, 2))
    records.add(Assessment(15, 1, "object_03", floor=2, proved=True))
    with path.open("a") as file:
        file.write('{"objects": 15, "see')
    again = Records(path, settings)
    assert again.get(15, 1, "ngr") == attempt(1, 2)
    assert again.assessments(15)[1].target == "object_03"
    again.add(attempt(2, None))
    assert Records(path, settings).get(15, 2, "ngr") == attempt(2, None)
    with pytest.raises(OtherSettings, match="layout: 'paper' there, 'dense' now"):
        Records(path, {"layout": "dense"})


def test_strategies_that_solve_all_are_not_certain_to() -> None:
    own = table(*(attempt(seed, 1) for seed in range(20)))
    success = make_row(own, own, {}, cap=10, seed=0).success
    assert success.mean == success.high == 1.0
    assert success.low == pytest.approx(0.839, abs=1e-3)


def test_the_command_knows_all_strategies() -> None:
    assert tuple(planners.strategies.STRATEGIES) == STRATEGIES


def test_ablations_differ_from_the_planner_in_one_thing_each() -> None:
    scene = replace(table_scene(), supports=("table_top", "counter_left"))
    whole = Planner(FETCH, grasps="all")
    variants = {name.removeprefix("lookahead - "): variant for name, variant in ABLATIONS.items()}
    assert set(variants) == {"look-ahead", "tilt", "counters", "second moves"}
    made = {name: variant.planner(whole, scene) for name, variant in variants.items()}
    assert made["look-ahead"] == made["second moves"] == whole
    assert (made["tilt"].grasps, made["tilt"].supports) == ("side", "all")
    assert (made["counters"].grasps, made["counters"].supports) == ("all", ("table_top",))
    assert not variants["look-ahead"].strategy.plans_ahead
    assert variants["second moves"].strategy.second_moves == 0
    assert variants["tilt"].strategy == variants["counters"].strategy == planners.strategies.STRATEGIES["lookahead"]


@pytest.mark.parametrize(
    ("words", "supports"),
    [
        ((), None),
        (("all",), "all"),
        (("table",), ("table_top",)),
        (("table", "counter_left"), ("table_top", "counter_left")),
    ],
)
def test_objects_are_put_where_the_table_says(words: tuple[str, ...], supports: Supports) -> None:
    settings = TableSettings(objects=(8,), supports=words)
    planner, scene, _ = trials._scene(settings.trial(8, 0, "lookahead"))
    assert planner.supports == supports
    assert set(find_supports(scene, supports)) <= set(scene.supports)


def test_supports_that_a_layout_lacks_are_named(tmp_path: Path) -> None:
    with pytest.raises(SystemExit, match=r"shelf_board.*'paper'.*all.*table.*counter_left"):
        main(["table", "--supports", "table", "shelf_board", "--out", str(tmp_path)])
    with pytest.raises(SystemExit, match=r"counter_left.*'island'"):
        main(
            [
                "table",
                "--supports",
                "counter_left",
                "--layouts",
                "paper",
                "island",
                "--out",
                str(tmp_path),
                "--report-only",
            ]
        )


def test_trials_with_other_supports_are_not_mixed(tmp_path: Path) -> None:
    settings = TableSettings(supports=("table", "counter_left"))
    Records(tmp_path / "trials.jsonl", settings.of_trials)
    Records(tmp_path / "trials.jsonl", settings.of_trials)
    with pytest.raises(OtherSettings, match="supports: 'table counter_left' there, None now"):
        Records(tmp_path / "trials.jsonl", TableSettings().of_trials)


@pytest.mark.slow
def test_a_small_table_is_made_and_made_again_from_its_trials(tmp_path: Path) -> None:
    command = [sys.executable, "scripts/clearance_table.py", "--objects", "15", "--strategies", "lookahead", "ngr"]
    command += ["--scenes", "2", "--workers", "1", "--out", str(tmp_path)]
    command += ["--markdown", str(tmp_path / "docs" / "t.md")]
    for _ in range(2):
        result = subprocess.run(command, capture_output=True, text=True, cwd=ROOT, timeout=600)
        assert result.returncode == 0, result.stderr
    figures = json.loads((tmp_path / "table.json").read_text())
    assert [row["strategy"] for row in figures["rows"]] == ["lookahead", "ngr"]
    assert figures["rows"][0]["solved"] == 2
    lines = (tmp_path / "trials.jsonl").read_text().splitlines()
    assert len(lines) == 1 + sum('"strategy": "floor"' in line for line in lines) + 2 * 2
    assert (tmp_path / "docs" / "images" / "t.png").stat().st_size > 10_000


@pytest.mark.parametrize(
    "wrong",
    [["--objects", "61"], ["--strategies", "best"], ["--scenes", "0"], ["--workers", "0"]],
)
def test_wrong_arguments_are_named(wrong: list[str], tmp_path: Path) -> None:
    with pytest.raises(SystemExit, match=f"{wrong[0].removeprefix('--')}.*{wrong[1]}|{wrong[1]}.*strateg"):
        main(["table", *wrong, "--out", str(tmp_path)])


def test_a_wrong_layout_is_named(tmp_path: Path) -> None:
    with pytest.raises(SystemExit, match=r"attic.*valid names: 'paper'"):
        main(["table", "--layouts", "shelf", "attic", "--out", str(tmp_path)])


@pytest.mark.parametrize("option", ["--layouts", "--layout"])
def test_more_objects_than_a_layout_holds_are_refused_before_any_trial(option: str, tmp_path: Path) -> None:
    layouts = ["paper", "dense"] if option == "--layouts" else ["dense"]
    with pytest.raises(SystemExit, match=r"num_objects=60 does not fit layout 'dense'.*at most 51 fit"):
        main(["table", option, *layouts, "--objects", "3", "60", "--scenes", "1", "--out", str(tmp_path)])
    assert not list(tmp_path.rglob("trials.jsonl"))


@pytest.mark.parametrize("objects", [8, 15, 40])
def test_a_trial_has_the_time_limit_of_its_number_of_objects(objects: int) -> None:
    env = trials._environment(objects, "paper", "joint", "fetch")
    assert env.spec is not None
    assert env.spec.max_episode_steps == time_limit(objects)
