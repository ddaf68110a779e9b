"""Checks of goals: scenes follow from their seeds, and what a second search says is counted in the tables."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from scripts import goal_bounds, goal_judges, goal_proofs
from scripts.goal_measures import CASES


@pytest.mark.parametrize("script", [goal_bounds, goal_proofs])
def test_a_scene_follows_from_its_seed(script: Any) -> None:
    for seed in range(script.FIRST_SEED, script.FIRST_SEED + 6):
        (*_, scene, goal), (*_, again, same) = script.drawn(seed), script.drawn(seed)
        assert goal == same
        assert not goal.holds(scene)
        for one, other in zip(scene.objects, again.objects, strict=True):
            assert np.array_equal(one.position, other.position)


def test_household_scenes_are_played_but_for_those_that_are_cleared() -> None:
    assert {CASES[k][2] for k in goal_judges.PLAYED} == {"household"}
    assert {CASES[k][0] for k in goal_judges.PLAYED} == {"sort", "set", "swap", "stack", "fetch"}


def test_a_success_has_no_reason_against_it() -> None:
    info = {"num_fallen": 0, "num_disturbed": 1, "total_path": 0.2, "unmet": 0, "lifted": True, "unstable": False}
    info |= {"is_success": False}
    why = "an object slid more than 5 cm, objects slid more than 10 cm together"
    assert goal_judges.why_no_success(info, True) == why
    assert goal_judges.why_no_success({**info, "is_success": True}, True) == ""


def test_proofs_are_confirmed_and_plans_are_not_denied(capsys: pytest.CaptureFixture[str]) -> None:
    """A circle by the order of the goal, objects in a region that is too small, and a pole where one is to go."""
    kinds = [*goal_proofs.KINDS]
    rows = [goal_proofs.measure(goal_proofs.FIRST_SEED + kinds.index(kind)) for kind in ("fixed", "circle", "crowded")]
    assert [(row["proved"], row["no_way"]) for row in rows] == [(True, "room"), (True, "order"), (True, "room")]
    goal_proofs.report(rows)
    assert "| all | 3 | 0 | 0 | 3 | 3 | room 2, order 1 |" in capsys.readouterr().out


@pytest.mark.slow
def test_proofs_of_mugs_and_of_corners_are_confirmed() -> None:
    kinds = ("mugs", "corner")
    rows = [goal_proofs.measure(goal_proofs.FIRST_SEED + number, kinds) for number in (8, 1)]
    assert [(row["proved"], row["no_way"]) for row in rows] == [(True, "order"), (True, "release")]


def test_a_bound_above_a_plan_is_too_high(capsys: pytest.CaptureFixture[str]) -> None:
    row = goal_bounds.measure(goal_bounds.FIRST_SEED + 4, budget=10.0)
    assert (row["goal"], row["picks"], row["best"]) == ("away", 2, 2)
    goal_bounds.report([row, {**row, "least": 3, "picks": 3}, {**row, "picks": None, "least": 0}])
    assert "| all | 3 | 3 | 2 |" in capsys.readouterr().out
