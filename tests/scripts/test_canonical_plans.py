"""How much plans differ from scene to scene."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from assets.robots import FETCH
from clutter_env.envs.retrieve import RetrieveEnv
from planners.contact import Contact
from planners.placing.locations import rotated
from planners.planner import Planner
from scripts.canonical_plans import (
    PlannedContact,
    PlannedScene,
    clusters,
    entropy,
    plan_scene,
    plot_spread,
    relative_yaws,
    spread_table,
)


def planned(base_yaw: float, yaw: float, q: np.ndarray) -> PlannedContact:
    return PlannedContact(Contact("pick", "object_00", np.array([0.0, 0.0, base_yaw]), rotated(yaw, 0.0)), q)


def test_the_entropy_of_equal_classes_is_the_logarithm_of_their_number() -> None:
    assert entropy(np.zeros(5, np.int64)) == 0.0
    assert entropy(np.repeat(np.arange(8), 3)) == pytest.approx(3.0)


@pytest.mark.parametrize(
    ("base", "gripper", "number"), [(0.0, 0.0, 0), (3.1, -3.1, 0), (1.0, 0.74, 1), (0.0, 3.14159, -12)]
)
def test_relative_yaws_do_not_depend_on_whole_turns(base: float, gripper: float, number: int) -> None:
    for turns in (0, 2 * np.pi):
        assert relative_yaws([planned(base + turns, gripper, np.zeros(8))]).tolist() == [number]


def test_configurations_a_whole_turn_apart_are_one_cluster_and_the_torso_does_not_count() -> None:
    home = np.array(FETCH.home)
    turned, raised, other = home.copy(), home.copy(), home.copy()
    turned[7] += 2 * np.pi
    raised[0] += 0.1
    other[4] += 0.6
    assert clusters([planned(0.0, 0.0, q) for q in (other, home, turned, raised)]) == [3, 1]


def test_plans_of_both_kinds_are_compared_on_the_scenes_that_both_solve(tmp_path: Path) -> None:
    env = RetrieveEnv(num_objects=3)
    plans = {
        name: [plan_scene(env, Planner(env.robot, grasps="side", canonical=canonical), 900_000)]
        for name, canonical in (("ordinary", False), ("canonical", True))
    }
    unsolved = PlannedScene(900_001, 0, None, float("nan"), 0.1, ())
    table = spread_table({"ordinary": plans["ordinary"], "canonical": [*plans["canonical"], unsolved]})
    assert "| ordinary | 1 of 1 |" in table
    assert "| canonical | 1 of 2 |" in table
    plot_spread(plans, tmp_path / "figure.png")
    assert (tmp_path / "figure.png").stat().st_size > 10_000
