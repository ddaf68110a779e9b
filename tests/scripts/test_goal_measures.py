"""Measured goals: a scene follows from its seed, every kind can be drawn, and the table counts what came out."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from clutter_env.reporting.files import JsonLines
from scripts.goal_measures import CASES, FIRST_SEED, GROUPS, NOT_DRAWN, OBJECTS, TASKS, Table, drawn, main, measure


def test_every_task_is_drawn_in_every_layout_or_said_not_to_be() -> None:
    layouts = [name for names in GROUPS.values() for name in names]
    assert len(CASES) == (len(TASKS) * len(layouts) - len(NOT_DRAWN)) * len(OBJECTS)
    for number, (task, layout, objects) in enumerate(CASES):
        it = drawn(FIRST_SEED + number)
        assert (it.task.split()[0], it.layout, it.objects) == (task, layout, objects)
        assert not it.goal.holds(it.scene)


def test_a_scene_follows_from_its_seed() -> None:
    for seed in (FIRST_SEED + 5, FIRST_SEED + 38):
        one, other = drawn(seed), drawn(seed)
        assert one.goal == other.goal
        assert one.scene.names == other.scene.names
        for name in one.scene.names:
            assert np.array_equal(one.scene.body(name).position, other.scene.body(name).position)


def test_a_measured_scene_is_a_row_of_the_table(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = JsonLines(tmp_path / "goals.jsonl")
    row = measure(drawn(FIRST_SEED + 2), budget=10.0)
    assert (row["task"], row["status"], row["unmet"]) == ("swap", "planned", [])
    file.append(row)
    file.append({**row, "seed": 7, "status": "given up", "cause": "given up", "detail": "after nothing"})
    main(Table((tmp_path / "goals.jsonl",)))
    lines = capsys.readouterr().out.splitlines()
    assert next(line for line in lines if line.startswith("| swap | tables | 2 | 1 | 0 | 0 | 1 |"))
    assert next(line for line in lines if line.startswith("  7 swap paper standard"))
