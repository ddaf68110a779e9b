"""PR2 in the environments: layouts, control modes, the arm that does not act, grasps, saved states, random actions."""

from __future__ import annotations

import warnings

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import clutter_env  # noqa: F401  registers the environments
from assets.robots import PR2
from clutter_env.envs.retrieve import RetrieveEnv
from clutter_env.simulation.meshes import has_visuals
from tests.clutter_env.envs.side_grasp import SideGrasp, free_targets
from tests.clutter_env.envs.test_determinism import digest
from tests.clutter_env.simulation.test_saved_state import pushing_actions, run

STANDOFF, SIDE = 0.72, -0.2
"""[m] From the base to the target: the square base stays before the table, the right arm reaches straight ahead."""
FARTHEST = 0.0
"""[m] x of a target that the arm reaches from there."""


def make(count: int, **keywords):
    return gym.make(f"clutter_env/Retrieve-o{count}-v0", robot="pr2", **keywords).unwrapped


@pytest.mark.parametrize("mode", ["joint", "ee"])
def test_gymnasium_checker_is_silent(mode: str) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for env_id in ("clutter_env/Retrieve-o5-v0", "clutter_env/Reach-v0", "clutter_env/Pick-v0"):
            check_env(gym.make(env_id, robot="pr2", control_mode=mode).unwrapped, skip_render_check=True)


def test_actions_and_observations_are_those_of_the_active_arm() -> None:
    env = make(5)
    assert env.action_space.shape == (3 + 1 + 7 + 1,)
    names = [column.name for column in env.observation_layout["robot"].columns]
    assert "r_wrist_roll_position" in names
    assert not [name for name in names if name.startswith("l_")]


@pytest.mark.parametrize("mode", ["joint", "ee"])
def test_the_idle_arm_stays_at_home(mode: str) -> None:
    env = make(5, control_mode=mode)
    env.reset(seed=0)
    rng = np.random.default_rng(0)
    for _ in range(200):
        env.step(rng.uniform(-1, 1, env.action_space.shape))
    joints = PR2.still_joints
    positions = np.array([env.data.joint(name).qpos[0] for name in joints])
    assert np.abs(positions - PR2.still_configuration).max() < 0.02


def test_the_left_arm_acts_where_it_is_the_active_one() -> None:
    env = make(1)
    left = gym.make("clutter_env/Retrieve-o1-v0", robot=PR2.using("left")).unwrapped
    for one in (env, left):
        one.reset(seed=0)
        for _ in range(10):
            one.step(np.concatenate((np.zeros(4), [0.3], np.zeros(7))))
    assert abs(env.data.joint("r_shoulder_pan_joint").qpos[0] - PR2.home[1]) > 0.1
    assert abs(left.data.joint("l_shoulder_pan_joint").qpos[0] - PR2.idle_arms[0].home[0]) > 0.1
    assert abs(left.data.joint("r_shoulder_pan_joint").qpos[0] - PR2.home[1]) < 0.02


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


@pytest.mark.skipif(not has_visuals(PR2), reason="robosuite-models is not installed: pip install clutter-env[visuals]")
@pytest.mark.usefixtures("needs_gl")
def test_meshes_do_not_change_the_physics() -> None:
    drawn = make(20, render_mode="rgb_array")
    assert drawn.model.nmesh
    assert digest(drawn, steps=100, draws=True) == digest(make(20), steps=100)
    drawn.close()


def test_side_grasps_hold() -> None:
    env = RetrieveEnv(num_objects=5, control_mode="ee", robot="pr2")
    results = []
    for seed in range(60):
        env.reset(seed=seed)
        near = [n for n in free_targets(env) if env.world.scene.positions[env.world.names.index(n), 0] < FARTHEST]
        if near:
            env.reset(seed=seed, options={"target": near[0]})
            results.append(SideGrasp(env, STANDOFF, SIDE).run())
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
