"""Physical side grasps hold."""

from __future__ import annotations

import numpy as np
import pytest

from clutter_env.envs.retrieve import RetrieveEnv
from clutter_env.envs.reward import LIFT_HEIGHT
from tests.clutter_env.envs.side_grasp import SideGrasp, free_targets


def grasp_free_targets(count: int, **keywords) -> list:
    """Results of the script on random free targets, one per scene."""
    env = RetrieveEnv(num_objects=20, control_mode="ee", **keywords)
    results = []
    for seed in range(10 * count):
        env.reset(seed=seed)
        free = free_targets(env)
        if free:
            target = free[np.random.default_rng(seed).integers(len(free))]
            env.reset(seed=seed, options={"target": target})
            results.append(SideGrasp(env).run())
        if len(results) == count:
            return results
    raise AssertionError("too few scenes have a free target")


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
    for seed in range(50):
        env.reset(seed=seed)
        free = free_targets(env)
        if free:
            break
    env.reset(seed=seed, options={"target": free[0]})
    script, record = SideGrasp(env), []
    step = env.step

    def watched(action):
        result = step(action)
        record.append((env.world.lowest_point(env.measurements, env.target_slot) - 0.75, result))
        return result

    env.step = watched
    script.run()
    ended = [index for index, (_, result) in enumerate(record) if result[2]]
    assert ended, "the episode ends"
    first = ended[0]
    assert record[first][1][4]["is_success"]
    assert record[first][1][4]["held"] == free[0]
    high = [lift >= LIFT_HEIGHT for lift, _ in record]
    assert all(high[first - 9 : first + 1])
    assert not high[first - 10], "after exactly 0.5 s"
    rewards = [result[1] for _, result in record]
    assert rewards[first] == pytest.approx(10, abs=0.1)
    assert sum(rewards[: first + 1]) < 11
    assert max(rewards[:first]) < 1
    assert not any(result[4]["is_success"] for _, result in record[:first])


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
