"""A fourth robot as a user adds it: the example builds its file, and the expert solves an episode with it."""

from __future__ import annotations

import runpy
from pathlib import Path

import gymnasium as gym
import pytest

from planners import TampExpert

EXAMPLE = Path(__file__).resolve().parents[1] / "examples" / "own_robot" / "ur5e_mobile.py"


def test_the_example_is_short() -> None:
    assert len(EXAMPLE.read_text().splitlines()) < 80


@pytest.mark.slow
def test_a_robot_of_the_users_own_solves_an_episode(tmp_path: Path) -> None:
    user = runpy.run_path(str(EXAMPLE))
    user["build"](tmp_path / "robot.xml")
    env = gym.make("clutter_env/Retrieve-o5-v0", robot=user["read"](tmp_path / "robot.xml"))
    _, info = env.reset(seed=0)
    expert, is_over = TampExpert(env), False
    expert.reset()
    while not (is_over or expert.done):
        *_, terminated, truncated, info = env.step(expert.act())
        is_over = terminated or truncated
    assert info["is_success"], expert.report
