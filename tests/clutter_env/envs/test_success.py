"""Both kinds of success in the environments, their infos, and saved states in the middle of an episode."""

from __future__ import annotations

import math

import gymnasium as gym
import numpy as np
import pytest

import clutter_env  # noqa: F401 - registers the environments
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
    for _ in range(200):
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
    for index in (5, held, held + 1, held + 15):
        fresh.reset(seed=0, options={"state": states[index][0]})
        assert fresh.save_state() == states[index][0]
        for (state, action), info in zip(states[index:], infos[index:], strict=True):
            assert fresh.save_state() == state
            assert fresh.step(action)[4] == info
    fresh.restore_state(states[5][0])
    move(fresh, other, (0.03, 0.0, 0.0))
    *_, info = fresh.step(states[5][1])
    assert info["num_disturbed"] == 1, "three centimetres before it was saved, three after"
