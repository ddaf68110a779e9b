"""Physical side grasps hold."""

from __future__ import annotations

import numpy as np
import pytest

from clutter_env.envs.observation import OBSERVATION_LAYOUT
from clutter_env.envs.retrieve import RetrieveEnv
from tests.clutter_env.envs.side_grasp import SideGrasp, reset_to_free_target


def grasp_free_targets(count: int, **keywords) -> list:
    """Results of the script on random free targets, one per scene."""
    env = RetrieveEnv(num_objects=20, control_mode="ee", **keywords)
    results, seed = [], -1
    for _ in range(count):
        seed = reset_to_free_target(env, seed + 1)
        results.append(SideGrasp(env).run())
    return results


def good(results: list) -> int:
    return sum(r.lift >= 0.15 and r.is_held and r.slip < 0.002 and r.warnings == 0 for r in results)


@pytest.mark.parametrize("shapes", ["cylinder", "mixed"])
def test_a_few_grasps_hold(shapes: str) -> None:
    assert good(grasp_free_targets(2, shapes=shapes)) == 2


@pytest.mark.slow
def test_thirty_grasps_hold() -> None:
    assert good(grasp_free_targets(30)) >= 29


def test_a_lift_is_a_success() -> None:
    env = RetrieveEnv(num_objects=5, control_mode="ee", reward_mode="dense")
    reset_to_free_target(env)
    script = SideGrasp(env)
    script.run()
    record = script.record
    first = next(index for index, result in enumerate(record) if result[2])
    assert record[first][4]["is_success"]
    assert record[first][4]["held"] == env.target
    is_high = [result[0]["goal"][OBSERVATION_LAYOUT["goal"]["lift_left"]].item() <= 0.0 for result in record]
    assert all(is_high[first - 9 : first + 1])
    assert not is_high[first - 10], "after exactly 0.5 s"
    rewards = [result[1] for result in record]
    assert rewards[first] == pytest.approx(10, abs=0.1)
    assert sum(rewards[: first + 1]) < 11
    assert max(rewards[:first]) < 1
    assert not any(result[4]["is_success"] for result in record[:first])


def test_a_lost_target_ends_the_episode() -> None:
    env = RetrieveEnv(num_objects=1)
    env.reset(seed=0)
    env.data.qpos[env.world.index.object_qpos][:3] = (-0.6, 0.0, 0.9)
    for _ in range(30):
        *_, reward, terminated, _, info = env.step(np.zeros(12))
        if terminated:
            break
    assert terminated
    assert not info["is_success"]
    assert info["num_fallen"] == 1
    assert reward == 0.0
