"""The clearance table: its statistics on small cases, its file of trials, and one small run."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import planners
from assets import FETCH
from clutter_env.cli.main import main
from clutter_env.cli.table import STRATEGIES
from clutter_env.evaluation.clearance_page import draw, row, scene_row, shared_rows, summarise
from clutter_env.evaluation.clearance_table import CRASH, Assessment, Attempt, OtherSettings, Table, Trial, Variant
from planners import Planner
from scripts.ablations import ABLATIONS

LOOKAHEAD = planners.STRATEGIES["lookahead"]


def attempt(seed: int, cleared: int | None, strategy: str = "ngr", cause: str = "motion") -> Attempt:
    """An attempt that cleared so many objects, or failed."""
    if cleared is None:
        return Attempt(15, seed, strategy, cause=cause)
    return Attempt(15, seed, strategy, solved=True, clearances=tuple(f"object_{i:02d}" for i in range(cleared)))


def by_seed(*attempts: Attempt) -> dict[int, Attempt]:
    return {entry.seed: entry for entry in attempts}


def table_at(folder: Path, names: tuple[str, ...] = ("lookahead", "ngr"), scenes: int = 2, **common: Any) -> Table:
    trial = replace(Trial(0, 100_000, ""), **common)
    variants: Mapping[str, Variant] = {name: Variant(planners.STRATEGIES[name]) for name in names}
    return Table(trial, (15,), variants, scenes, True, folder / "trials.jsonl")


def test_rows_pair_by_scene_and_count_unsolved_scenes_at_the_cap() -> None:
    reference = by_seed(attempt(1, 1), attempt(2, 2), attempt(3, None))
    own = by_seed(attempt(1, 4), attempt(2, None), attempt(3, 5))
    found = row(own, reference, {1: 2, 3: 5}, cap=10, seed=0)
    assert (found["scenes"], found["solved"], found["both"]) == (3, 2, 1)
    assert (found["both_clearances"], found["both_reference"], found["difference"].mean) == (4, 1, 3)
    assert found["censored"].mean == pytest.approx((4 + 10 + 5) / 3)
    assert found["ratio"].mean == pytest.approx((4 / 2 + 5 / 5) / 2)
    assert found["at_floor"] == 0.5
    assert found["causes"] == {"motion": 1}
    assert found["p_success"] == 1.0


def test_mcnemar_sees_a_strategy_that_fails_where_the_other_does_not() -> None:
    reference = by_seed(*(attempt(seed, 1) for seed in range(10)))
    own = by_seed(*(attempt(seed, None) for seed in range(10)))
    assert row(own, reference, {}, cap=10, seed=0)["p_success"] == pytest.approx(2 / 2**10)


def test_a_crash_is_not_a_failure_to_solve() -> None:
    own = by_seed(attempt(1, 1), attempt(2, None, cause=CRASH))
    found = row(own, own, {}, cap=10, seed=0)
    assert (found["scenes"], found["crashed"], found["success"].mean) == (1, 1, 1.0)
    assert not found["causes"]


def test_strategies_and_floor_are_compared_on_the_scenes_that_all_solve() -> None:
    """The picture drew the floor of all scenes over the clearances of the scenes that a strategy solved."""
    attempts = {
        "lookahead": by_seed(attempt(1, 1), attempt(2, 2), attempt(3, 6)),
        "ngr": by_seed(attempt(1, 3), attempt(2, 2), attempt(3, None)),
    }
    first, second = shared_rows(attempts, {1: 1, 2: 2, 3: 6}, 15, seed=0)
    assert (first["strategy"], first["scenes"], first["floor"], first["clearances"].mean) == ("lookahead", 2, 1.5, 1.5)
    assert (second["scenes"], second["floor"], second["clearances"].mean) == (2, 1.5, 2.5)
    assert shared_rows({"ngr": by_seed(attempt(3, None))}, {3: 6}, 15, seed=0) == []


def test_the_picture_marks_the_floor_of_the_scenes_whose_clearances_it_draws(tmp_path: Path) -> None:
    table = table_at(tmp_path)
    for seed, floor in ((100_000, 1), (100_001, 5)):
        table.add(Assessment(15, seed, floor=floor, proved=True, side_floor=floor))
        table.add(replace(attempt(seed, floor, "lookahead"), total_s=0.1))
    table.add(replace(attempt(100_000, 3), total_s=0.2))
    table.add(attempt(100_001, None))
    axes = draw(summarise(table)).axes[1]
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
    counts = scene_row(15, found, seed=0)
    names = ("seeds", "free", "obstructed", "without_set", "unreachable", "crashed", "unproved")
    assert [counts[name] for name in names] == [6, 1, 2, 1, 1, 1, 1]
    assert counts["floor"].mean == 3


def test_obstructed_means_that_no_level_grasp_reaches_the_target_whatever_the_grasp_set() -> None:
    counts = scene_row(40, [Assessment(40, seed, floor=0, proved=True, side_floor=4) for seed in (1, 2)], seed=0)
    assert (counts["obstructed"], counts["free"], counts["floor"].mean) == (2, 0, 0.0)
    own = by_seed(attempt(1, 0), attempt(2, 1))
    found = row(own, own, {1: 0, 2: 0}, cap=10, seed=0)
    assert found["at_floor"] == 0.5
    assert np.isnan(found["ratio"].mean), "nothing is divided by a floor of 0"


def test_trials_survive_a_kill_in_the_middle_of_a_line_and_are_not_mixed_with_others(tmp_path: Path) -> None:
    table = table_at(tmp_path)
    table.add(attempt(100_000, 2))
    table.add(Assessment(15, 100_000, "object_03", floor=2, proved=True, side_floor=2))
    with (tmp_path / "trials.jsonl").open("a") as file:
        file.write('{"objects": 15, "see')
    again = table_at(tmp_path)
    assert again.attempts(15, "ngr") == {100_000: attempt(100_000, 2)}
    assert again.assessments(15)[100_000].target == "object_03"
    with pytest.raises(OtherSettings, match="layout: 'paper' there, 'wide' now"):
        table_at(tmp_path, layout="wide")
    with pytest.raises(OtherSettings, match="supports: None there, 'table counter_left' now"):
        table_at(tmp_path, supports=("table", "counter_left"))


def test_the_command_knows_all_strategies() -> None:
    assert tuple(planners.STRATEGIES) == STRATEGIES


def test_ablations_differ_from_lookahead_in_one_thing_each() -> None:
    differing = [
        (variant.planner != {}) + (variant.strategy != LOOKAHEAD) + variant.all_arms for variant in ABLATIONS.values()
    ]
    assert differing == [1, 1, 1, 1]
    assert all(replace(Planner(FETCH), **variant.planner) for variant in ABLATIONS.values())


@pytest.mark.parametrize(
    ("names", "supports"),
    [((), None), (("all",), "all"), (("table", "counter_left"), ("table_top", "counter_left"))],
)
def test_objects_are_put_where_the_table_says(names: tuple[str, ...], supports: object) -> None:
    assert Trial(8, 0, "lookahead", supports=names).support_names == supports


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (["--objects", "61"], "objects=61"),
        (["--strategies", "best"], "best.*lookahead"),
        (["--scenes", "0"], "scenes=0"),
        (["--workers", "0"], "workers=0"),
        (["--layout", "attic"], r"attic.*valid names: 'paper'"),
        (["--supports", "table", "shelf_board"], r"shelf_board.*'paper'.*all.*table.*counter_left"),
        (["--layout", "dense", "--objects", "60"], r"num_objects=60 does not fit layout 'dense'.*at most 51 fit"),
    ],
)
def test_wrong_arguments_are_named_before_any_trial(wrong: list[str], message: str, tmp_path: Path) -> None:
    with pytest.raises(SystemExit, match=message):
        main(["table", *wrong, "--out", str(tmp_path)])
    assert not [line for file in tmp_path.rglob("trials.jsonl") for line in file.read_text().splitlines()[1:]]


@pytest.mark.slow
def test_a_small_table_is_made_and_made_again_from_its_trials(tmp_path: Path) -> None:
    words = ["table", "--objects", "15", "--strategies", "lookahead", "ngr", "--scenes", "2", "--workers", "1"]
    for _ in range(2):
        main([*words, "--out", str(tmp_path), "--markdown", str(tmp_path / "docs" / "t.md")])
    figures = json.loads((tmp_path / "table.json").read_text())
    assert [entry["strategy"] for entry in figures["rows"]] == ["lookahead", "ngr"]
    assert figures["rows"][0]["solved"] == 2
    lines = (tmp_path / "trials.jsonl").read_text().splitlines()
    assert len(lines) == 1 + sum('"strategy": "floor"' in line for line in lines) + 2 * 2
    assert (tmp_path / "docs" / "images" / "t.png").stat().st_size > 10_000
