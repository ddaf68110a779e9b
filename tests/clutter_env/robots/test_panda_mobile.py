"""A robot that no code knows, read from its MJCF file: checkers, determinism, saved states, grasps, random actions."""

from __future__ import annotations

import warnings

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import clutter_env  # noqa: F401  registers the environments
from clutter_env.envs.retrieve import RetrieveEnv
from tests.clutter_env.envs.side_grasp import SideGrasp, free_targets
from tests.clutter_env.envs.test_determinism import digest
from tests.clutter_env.simulation.test_saved_state import pushing_actions, run

STANDOFF = 0.80
"""[m] From the base to the target."""


def make(count: int, **keywords):
    return gym.make(f"clutter_env/Retrieve-o{count}-v0", robot="panda_mobile", **keywords).unwrapped


@pytest.mark.parametrize("mode", ["joint", "ee"])
def test_gymnasium_checker_is_silent(mode: str) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for env_id in ("clutter_env/Retrieve-o5-v0", "clutter_env/Reach-v0", "clutter_env/Pick-v0"):
            check_env(gym.make(env_id, robot="panda_mobile", control_mode=mode).unwrapped, skip_render_check=True)


@pytest.mark.parametrize("mode", ["joint", "ee"])
def test_same_seed_same_bits(mode: str) -> None:
    first, second = make(20, control_mode=mode), make(20, control_mode=mode)
    second.reset(seed=9)
    second.step(second.action_space.sample())
    assert digest(first, steps=200) == digest(second, steps=200)


@pytest.mark.parametrize("mode", ["joint", "ee"])
def test_a_saved_state_continues_bit_for_bit(mode: str) -> None:
    env, other = make(20, control_mode=mode), make(20, control_mode=mode)
    env.reset(seed=4)
    for action in pushing_actions(env, 100, 4):
        env.step(action)
    state, actions = env.save_state(), pushing_actions(env, 60, 5)
    expected = run(env, actions)
    other.reset(seed=1)
    other.restore_state(state)
    assert run(other, actions) == expected


def test_side_grasps_hold() -> None:
    env = RetrieveEnv(num_objects=5, control_mode="ee", robot="panda_mobile")
    results = []
    for seed in range(60):
        env.reset(seed=seed)
        near = free_targets(env)
        if near:
            env.reset(seed=seed, options={"target": near[0]})
            results.append(SideGrasp(env, STANDOFF).run())
        if len(results) == 4:
            break
    assert len(results) == 4
    assert all(r.lift >= 0.15 and r.is_held and r.slip < 0.002 and r.warnings == 0 for r in results), results


@pytest.mark.slow
@pytest.mark.parametrize("mode", ["joint", "ee"])
def test_random_actions_keep_the_state_finite(mode: str) -> None:
    env = make(20, control_mode=mode)
    rng = np.random.default_rng(0)
    for episode in range(10):
        env.reset(seed=episode)
        for _ in range(500):
            observation, reward, *_ = env.step(rng.uniform(-1, 1, env.action_space.shape))
            assert env.observation_space.contains(observation)
            assert np.isfinite(reward)
    assert sum(warning.number for warning in env.data.warning) == 0
