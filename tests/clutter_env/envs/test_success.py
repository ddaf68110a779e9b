"""Side grasps hold; both kinds of success in the environments, and saved states in the middle of an episode."""

from __future__ import annotations

import math

import gymnasium as gym
import numpy as np
import pytest

import clutter_env  # noqa: F401 - registers the environments
from clutter_env.envs.observation import OBSERVATION_LAYOUT
from clutter_env.envs.retrieve import RetrieveEnv
from clutter_env.errors import ConfigError
from clutter_env.scene.layout import TABLE_HEIGHT
from tests.clutter_env.envs.side_grasp import SideGrasp, reset_to_free_target


@pytest.mark.parametrize("name", ["Reach-v0", "Pick-v0"])
@pytest.mark.parametrize("keyword", [{"success": "lifted"}, {"terminate_on_fallen": True}])
def test_goal_environments_refuse_the_kinds_of_success(name: str, keyword: dict) -> None:
    with pytest.raises(ConfigError, match=next(iter(keyword))):
        gym.make(f"clutter_env/{name}", **keyword)


def move(env: RetrieveEnv, slot: int, offset: tuple[float, float, float]) -> None:
    """Displace an object, as if it had been pushed within one step."""
    _poses(env)[slot, :3] += offset


def topple(env: RetrieveEnv, slot: int) -> None:
    """Lay an object on its side, at the height of its radius."""
    height = TABLE_HEIGHT + env.world.scene.half_extents[slot, 0]
    _poses(env)[slot, 2:] = height, math.sqrt(0.5), 0.0, math.sqrt(0.5), 0.0


def _poses(env: RetrieveEnv) -> np.ndarray:
    """The poses (n, 7) of the objects in the simulation, writable."""
    return env.data.qpos[env.world.index.object_qpos].reshape(-1, 7)


def grasping_env(**keywords) -> tuple[RetrieveEnv, int]:
    """An environment whose target is free, and another object's slot."""
    env = RetrieveEnv(num_objects=5, control_mode="ee", **keywords)
    reset_to_free_target(env)
    return env, (env.target_slot + 1) % 5


@pytest.mark.parametrize("spoil", ["push", "topple"])
@pytest.mark.parametrize("success", ["clean", "lifted"])
def test_a_spoilt_lift_is_a_success_of_the_plain_kind_only(spoil: str, success: str) -> None:
    env, other = grasping_env(success=success)
    back = (0.06, 0.0, 0.0) if env.world.scene.positions[other, 0] < 0 else (-0.06, 0.0, 0.0)
    if spoil == "push":
        move(env, other, back)
    else:
        topple(env, other)
    script = SideGrasp(env)
    script.run()
    info, is_over = next((result[4], result[2]) for result in script.record if result[2] or result[4]["lifted"])
    assert info["lifted"]
    assert info["is_success"] == is_over == (success == "lifted")
    assert info["num_disturbed"] + info["num_fallen"] >= 1
    assert info["num_fallen"] == (spoil == "topple")


def test_objects_at_rest_are_never_disturbed() -> None:
    env = RetrieveEnv(num_objects=30)
    env.reset(seed=3)
    env.model.opt.enableflags &= 0  # no body sleeps, so that every contact keeps working
    for _ in range(80):
        *_, info = env.step(np.zeros(12))
    assert (info["num_fallen"], info["num_disturbed"]) == (0, 0)


def test_a_saved_state_keeps_what_the_success_monitor_remembers() -> None:
    env, other = grasping_env()
    move(env, other, (0.03, 0.0, 0.0))
    script, states, infos = SideGrasp(env), [], []
    step = env.step

    def watched(action):
        states.append((env.save_state(), action))
        infos.append(step(action)[4])
        return infos[-1]

    env.step = watched  # type: ignore[method-assign]  # the test watches the steps of the script
    script.run()
    fresh = RetrieveEnv(num_objects=5, control_mode="ee")
    held = next(index for index, info in enumerate(infos) if info["held"])
    for index in (5, held + 1):
        fresh.reset(seed=0, options={"state": states[index][0]})
        assert fresh.save_state() == states[index][0]
        for (state, action), info in zip(states[index:], infos[index:], strict=True):
            assert fresh.save_state() == state
            assert fresh.step(action)[4] == info
    fresh.restore_state(states[5][0])
    move(fresh, other, (0.03, 0.0, 0.0))
    *_, info = fresh.step(states[5][1])
    assert info["num_disturbed"] == 1, "three centimetres before it was saved, three after"


def grasp_free_targets(count: int, **keywords) -> list:
    """Results of the script on random free targets, one per scene."""
    env = RetrieveEnv(num_objects=20, control_mode="ee", **keywords)
    results, seed = [], -1
    for _ in range(count):
        seed = reset_to_free_target(env, seed + 1)
        results.append(SideGrasp(env).run())
    return results


def good(results: list) -> int:
    # A box that is grasped askew turns until its sides lie on the pads, and slides by two millimetres meanwhile.
    return sum(r.lift >= 0.15 and r.is_held and r.slip < 0.003 and r.warnings == 0 for r in results)


@pytest.mark.parametrize("shapes", ["cylinder", "mixed"])
def test_a_grasp_holds(shapes: str) -> None:
    assert good(grasp_free_targets(1, shapes=shapes)) == 1


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
    assert rewards[first] == pytest.approx(200, abs=1)
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
