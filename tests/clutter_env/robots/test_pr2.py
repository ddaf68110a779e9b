"""PR2 alone: the arm that does not act, the left arm, the meshes. `test_every_robot.py` has what holds for all."""

from __future__ import annotations

import gymnasium as gym
import numpy as np
import pytest

import clutter_env  # noqa: F401  registers the environments
from assets.robots import PR2
from clutter_env.simulation.model import has_visuals
from tests.clutter_env.envs.test_determinism import digest


def make(count: int, **keywords):
    return gym.make(f"clutter_env/Retrieve-o{count}-v0", robot="pr2", **keywords).unwrapped


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


@pytest.mark.skipif(not has_visuals(PR2), reason="robosuite-models is not installed: pip install clutter-env[visuals]")
@pytest.mark.usefixtures("needs_gl")
def test_meshes_do_not_change_the_physics() -> None:
    drawn = make(20, render_mode="rgb_array")
    assert drawn.model.nmesh
    assert digest(drawn, steps=100, draws=True) == digest(make(20), steps=100)
    drawn.close()
