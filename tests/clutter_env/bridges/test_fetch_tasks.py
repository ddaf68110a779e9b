"""Gymnasium-Robotics' FetchPickAndPlace through its four numbers."""

from __future__ import annotations

import pytest

from planners import TampExpert

pytest.importorskip("gymnasium_robotics")


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1], ids=["put down", "held in the air"])
def test_an_episode_ends_with_the_success_of_its_own_check(seed: int) -> None:
    from clutter_env.bridges.fetch_tasks import DOWN, FetchTask

    task = FetchTask(seed)
    expert = TampExpert(task.world, grasps=DOWN)
    expert.reset()
    while not (expert.done or task.world.is_over):
        task.world.step(expert.act())
    assert task.finish()
    assert task.steps == 50


@pytest.mark.slow
def test_the_gripper_reaches_a_point() -> None:
    from clutter_env.bridges.fetch_tasks import reach

    assert reach(seed=0)
