"""`clutter-env table`: its statistics on small cases, its file of trials, and one small run."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

import planners
from assets import FETCH
from clutter_env.cli.clearance_picture import draw
from clutter_env.cli.clearance_tables import scene_row, strategy_rows, summarise
from clutter_env.cli.clearance_trials import ASSESSMENT, CRASH, Record, Trial, Trials, Variant, _environment, run_trial
from clutter_env.cli.main import main
from clutter_env.cli.table_arguments import STRATEGIES, Arguments
from clutter_env.errors import UsageError
from clutter_env.evaluation.suite_making import STEPS_PER_PICK
from planners import Planner
from scripts.ablations import ABLATIONS
from scripts.clearance_page import write_page

LOOKAHEAD = planners.STRATEGIES["lookahead"]


def attempt(seed: int, cleared: int | None, strategy: str = "ngr", cause: str = "motion", **more: Any) -> Record:
    """An attempt that cleared so many objects, or failed."""
    if cleared is None:
        return Record(15, seed, strategy, cause=cause, **more)
    names = tuple(f"object_{i:02d}" for i in range(cleared))
    return Record(15, seed, strategy, solved=True, clearances=names, **more)


def scene(seed: int, floor: int | None, cause: str = "", proved: bool = True) -> Record:
    return Record(15, seed, ASSESSMENT, cause=cause, floor=floor, proved=proved, side_floor=floor)


def by_seed(*attempts: Record) -> dict[int, Record]:
    return {entry.seed: entry for entry in attempts}


def trials_at(folder: Path, **more: Any) -> Trials:
    return Trials(Arguments(objects=(15,), strategies=("lookahead", "ngr"), scenes=2, out=folder, **more))


def test_rows_pair_by_scene_and_lower_bounds_are_divided_by_where_they_are_at_least_one() -> None:
    reference = by_seed(attempt(1, 1), attempt(2, 2), attempt(3, None), attempt(4, 1))
    own = by_seed(attempt(1, 4), attempt(2, None), attempt(3, 5), attempt(4, 0))
    _, found = strategy_rows({"lookahead": reference, "ngr": own}, {1: 2, 3: 5, 4: 0}, seed=0)
    assert (found["scenes"], found["solved"], found["both"]) == (4, 3, 2)
    assert found["difference"].mean == (3 - 1) / 2
    assert found["ratio"].mean == pytest.approx((4 / 2 + 5 / 5) / 2)
    assert found["at_floor"].mean == pytest.approx(2 / 3)
    assert found["causes"] == {"motion": 1}
    assert found["p_success"] == 1.0


def test_a_layout_that_takes_few_objects_is_warmed_up_with_as_few(tmp_path: Path) -> None:
    arguments = Arguments(objects=(3,), scenes=1, out=tmp_path, layout="drawer", grasps="all")
    record = run_trial(Trial(arguments, 3, seed=0, strategy="lookahead", variant=Variant(LOOKAHEAD)))
    assert record.solved, record.detail


def test_mcnemar_sees_a_strategy_that_fails_where_the_other_does_not() -> None:
    reference = by_seed(*(attempt(seed, 1) for seed in range(10)))
    own = by_seed(*(attempt(seed, None) for seed in range(10)))
    assert strategy_rows({"a": reference, "b": own}, {}, seed=0)[1]["p_success"] == pytest.approx(2 / 2**10)


def test_a_crash_is_not_a_failure_to_solve() -> None:
    own = by_seed(attempt(1, 1), attempt(2, None, cause=CRASH))
    (found,) = strategy_rows({"ngr": own}, {}, seed=0)
    assert (found["scenes"], found["crashed"], found["success"].mean) == (1, 1, 1.0)
    assert not found["causes"]


def test_the_picture_marks_the_lower_bound_of_the_scenes_whose_clearances_it_draws(tmp_path: Path) -> None:
    """It drew the lower bound of all scenes over the clearances of the scenes that a strategy solved."""
    trials = trials_at(tmp_path)
    for seed, floor in ((100_000, 1), (100_001, 5)):
        trials.add(scene(seed, floor))
        trials.add(attempt(seed, floor, "lookahead", total_s=0.1))
    trials.add(attempt(100_000, 3, total_s=0.2))
    trials.add(attempt(100_001, None))
    axes = draw(summarise(trials)).axes[1]
    (floor_line,) = [line for line in axes.lines if line.get_gid() == "floor"]
    assert list(floor_line.get_ydata()) == [1.0, 1.0], "5 is the lower bound of a scene that ngr did not solve"
    assert [list(bars.lines[0].get_ydata()) for bars in axes.containers] == [[1.0], [3.0]]
    assert [label.get_text() for label in axes.get_xticklabels()] == ["15\nscenes: 1"]


def test_scenes_are_told_apart_by_what_the_lower_bound_says() -> None:
    found = [
        scene(1, 0),
        scene(2, 3),
        scene(3, 5, proved=False),
        scene(4, None, "no self-clearable set"),
        scene(5, None, "unreachable"),
        scene(6, None, CRASH),
        # Obstructed means that no level grasp reaches the target, whatever the grasp set.
        replace(scene(7, 0), side_floor=4),
    ]
    counts = scene_row(15, found, seed=0)
    names = ("seeds", "free", "obstructed", "without_set", "unreachable", "crashed", "unproved")
    assert [counts[name] for name in names] == [7, 1, 3, 1, 1, 1, 1]
    assert counts["floor"].mean == 1.5


def test_trials_survive_a_kill_in_the_middle_of_a_line_and_are_not_mixed_with_others(tmp_path: Path) -> None:
    trials = trials_at(tmp_path)
    trials.add(attempt(100_000, 2))
    trials.add(scene(100_000, 2))
    with (tmp_path / "trials.jsonl").open("a") as file:
        file.write('{"objects": 15, "see')
    again = trials_at(tmp_path)
    assert again.attempts(15, "ngr") == {100_000: attempt(100_000, 2)}
    assert again.floors(15) == {100_000: 2}
    with pytest.raises(UsageError, match="layout: 'paper' there, 'wide' now"):
        trials_at(tmp_path, layout="wide")
    with pytest.raises(UsageError, match="supports: '' there, 'table counter_left' now"):
        trials_at(tmp_path, supports=("table", "counter_left"))


def test_the_command_knows_all_strategies() -> None:
    assert tuple(planners.STRATEGIES) == STRATEGIES


def test_ablations_differ_from_lookahead_in_one_thing_each() -> None:
    differing = [
        (variant.planner != {}) + (variant.strategy != LOOKAHEAD) + variant.all_arms for variant in ABLATIONS.values()
    ]
    assert differing == [1, 1, 1]
    assert all(replace(Planner(FETCH), **variant.planner) for variant in ABLATIONS.values())


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (["--objects", "61"], "--objects 61"),
        (["--strategies", "best"], "best.*lookahead"),
        (["--scenes", "0"], "--scenes 0"),
        (["--seed", "-1"], "--seed -1 is not valid; it must be from 0"),
        (["--strategies"], "need at least one value"),
        (["--time-limit", "nan"], "--time-limit nan"),
        (["--workers", "0"], "--workers 0"),
        (["--layout", "attic"], r"attic.*valid names: 'paper'"),
        (["--supports", "table", "shelf_board"], r"shelf_board.*'paper'.*all.*table.*counter_left"),
        (["--layout", "dense", "--objects", "60"], r"num_objects=60 does not fit layout 'dense'.*at most 51 fit"),
    ],
)
def test_wrong_arguments_are_named_before_any_trial(wrong: list[str], message: str, tmp_path: Path) -> None:
    with pytest.raises(SystemExit, match=message) as ended:
        main(["table", *wrong, "--out", str(tmp_path)])
    assert ended.value.code == 2
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_a_small_table_is_made_and_made_again_from_its_trials(tmp_path: Path) -> None:
    words = ["table", "--objects", "15", "--strategies", "lookahead", "ngr", "--scenes", "2", "--workers", "1"]
    for _ in range(2):
        main([*words, "--out", str(tmp_path)])
    figures = json.loads((tmp_path / "table.json").read_text())
    assert [entry["strategy"] for entry in figures["rows"]] == ["lookahead", "ngr"]
    assert figures["rows"][0]["solved"] == 2
    lines = (tmp_path / "trials.jsonl").read_text().splitlines()
    assert len(lines) == 1 + sum('"strategy": "floor"' in line for line in lines) + 2 * 2
    assert "### Scenes" in (tmp_path / "table.md").read_text()
    assert (tmp_path / "table.png").stat().st_size > 10_000


def test_a_page_has_the_tables_and_their_picture(tmp_path: Path) -> None:
    trials = trials_at(tmp_path)
    for record in (scene(100_000, 1), attempt(100_000, 1, "lookahead", total_s=0.1), attempt(100_000, 1, total_s=0.1)):
        trials.add(record)
    write_page(trials, "command", summarise(trials), tmp_path / "docs" / "t.md")
    assert "![Clearance table](images/t.png)" in (tmp_path / "docs" / "t.md").read_text()
    assert (tmp_path / "docs" / "images" / "t.png").stat().st_size > 10_000


def test_an_episode_in_physics_has_time_to_clear_all_objects_as_in_the_suites() -> None:
    """Before a cabinet eight clearances took longer than the environment's own limit for sixteen objects."""
    spec = _environment(16, "cabinet", "joint", FETCH).spec
    assert spec is not None
    assert spec.max_episode_steps == 16 * STEPS_PER_PICK
