"""Environments with a base that does not move: where it stands, and that it stays there."""

from __future__ import annotations

from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import clutter_env  # noqa: F401  registers the environments
from assets import FETCH
from clutter_env.errors import ConfigError, OptionError
from planners import TampExpert

ID = "clutter_env/Retrieve-o5-v0"
PANDA = {"robot": "panda_mobile", "base": "fixed"}


def base_of(env: gym.Env) -> np.ndarray:
    """Where the base is, and how it is turned."""
    inner = env.unwrapped
    return inner.data.qpos[inner.world.index.drive_qpos[:3]].copy()


@pytest.mark.parametrize("mode", ["joint", "ee"])
def test_actions_have_no_base_and_none_moves_it(mode: str) -> None:
    env = gym.make(ID, **PANDA, control_mode=mode)
    assert env.action_space.shape[0] == gym.make(ID, robot="panda_mobile", control_mode=mode).action_space.shape[0] - 3
    env.reset(seed=0, options={"base": (-0.7, 0.1, 0.2)})
    np.testing.assert_array_equal(base_of(env), (-0.7, 0.1, 0.2))
    for action in np.random.default_rng(0).uniform(-1, 1, (40, *env.action_space.shape)):
        env.step(action)
    assert np.abs(base_of(env) - (-0.7, 0.1, 0.2)).max() < 1e-5
    np.testing.assert_array_equal(env.unwrapped.world.controller.state.target[:3], (-0.7, 0.1, 0.2))


def test_the_expert_takes_the_target_from_where_the_base_was_put() -> None:
    env = gym.make(ID, **PANDA)
    _, info = env.reset(seed=1)
    start, again = base_of(env), gym.make(ID, **PANDA)
    again.reset(seed=1)
    np.testing.assert_array_equal(base_of(again), start)
    expert, is_over = TampExpert(env), False
    expert.reset()
    while not (is_over or expert.done):
        *_, terminated, truncated, info = env.step(expert.act())
        is_over = terminated or truncated
    assert info["is_success"], expert.report
    assert np.abs(base_of(env) - start).max() < 1e-5


@pytest.mark.slow
def test_checkers_saved_states_and_other_tasks_accept_it() -> None:
    env = gym.make(ID, **PANDA)
    check_env(env.unwrapped, skip_render_check=True)
    env.reset(seed=3)
    state = env.unwrapped.save_state()
    other = gym.make(ID, **PANDA)
    other.reset(options={"state": state})
    np.testing.assert_array_equal(base_of(other), base_of(env))
    sort = gym.make("clutter_env/Rearrange-o4-v0", **PANDA)
    sort.reset(seed=0)
    assert sort.action_space.shape == env.action_space.shape


def test_a_robot_that_is_fixed_says_so_itself_and_misuse_is_named() -> None:
    assert gym.make(ID, robot=FETCH.fixed()).unwrapped.config.base == "fixed"
    with pytest.raises(ConfigError, match="'holonomic', 'differential', 'fixed'"):
        gym.make(ID, base="floating")
    env = gym.make(ID, **PANDA)
    for base, message in (((0.0, 0.0), "x, y"), ((0.0, 0.0, 0.0), "inside"), ((9.0, 0.0, 0.0), "9")):
        with pytest.raises(OptionError, match=message):
            env.reset(options={"base": base})
    with pytest.raises(OptionError, match="cannot move"):
        gym.make(ID).reset(options={"base": (-1.0, 0.0, 0.0)})


def test_the_fixed_arm_of_the_goal_tasks_may_be_said_to_be_fixed() -> None:
    env = gym.make("clutter_env/ArmReach-v0", base="fixed")
    plain = gym.make("clutter_env/ArmReach-v0")
    np.testing.assert_array_equal(env.reset(seed=0)[0]["observation"], plain.reset(seed=0)[0]["observation"])
    assert replace(env.unwrapped.robot, name="other").base_drive == "fixed"
