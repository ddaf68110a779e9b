"""PR2 with both arms, and with one: the arm that does not act, the left arm, the meshes."""

from __future__ import annotations

import gymnasium as gym
import numpy as np
import pytest

import clutter_env  # noqa: F401  registers the environments
from assets.robots import PR2
from clutter_env.errors import ActionError, ConfigError
from clutter_env.simulation.model import has_visuals
from tests.clutter_env.envs.test_determinism import digest

BOTH = PR2.with_all_arms()
ARMS = slice(4, 11), slice(11, 18)


def make(count: int = 5):
    return gym.make(f"clutter_env/Retrieve-o{count}-v0", robot=BOTH).unwrapped


def test_actions_and_observations_are_those_of_both_arms() -> None:
    env = make()
    assert env.action_space.shape == (3 + 1 + 7 + 7 + 2,)
    names = [column.name for column in env.observation_layout["robot"].columns]
    assert {"r_wrist_roll_position", "l_wrist_roll_position", "l_wrist_roll_velocity"} <= set(names)
    widths = [column.name for column in env.observation_layout["gripper"].columns]
    assert widths == ["width", "left_width", "commanded_width", "left_commanded_width"]
    with pytest.raises(ConfigError, match="valid values: 'joint'"):
        gym.make("clutter_env/Retrieve-o5-v0", robot=BOTH, control_mode="ee")


@pytest.mark.parametrize("arm", [0, 1])
def test_each_arm_follows_its_own_numbers(arm: int) -> None:
    env = make()
    env.reset(seed=0)
    action = np.zeros(20)
    action[ARMS[arm]], action[18 + arm], action[19 - arm] = 0.2, 1.0, -1.0
    before = env.world.controller.state.target.copy()
    for _ in range(40):
        observation, *_ = env.step(action)
    moved = np.abs(env.world.controller.state.target - before)
    assert moved[ARMS[arm]].min() > 0.1
    assert moved[ARMS[1 - arm]].max() == 0.0
    positions = env.data.qpos[env.world.index.drive_qpos]
    assert np.abs(positions - env.world.controller.state.target).max() < 0.05
    widths = observation["gripper"][:2]
    assert widths[arm] > 0.08 > 0.01 > widths[1 - arm]


def test_joint_action_leads_both_arms_to_a_configuration() -> None:
    env = make()
    env.reset(seed=0)
    goal = env.world.controller.state.target.copy()
    goal[[5, 12]] += 0.1
    for _ in range(20):
        env.step(env.joint_action(goal, [0.05, 0.02]))
    assert np.abs(env.world.controller.state.target - goal).max() < 1e-3
    with pytest.raises(ActionError, match=r"shape \(2,\)"):
        env.joint_action(goal, 0.05)
    with pytest.raises(ActionError, match=r"shape \(18,\)"):
        env.joint_action(goal[:11], [0.05, 0.02])


def make_one(count: int, **keywords):
    return gym.make(f"clutter_env/Retrieve-o{count}-v0", robot="pr2", **keywords).unwrapped


@pytest.mark.parametrize("mode", ["joint", "ee"])
def test_the_idle_arm_stays_at_home(mode: str) -> None:
    env = make_one(5, control_mode=mode)
    env.reset(seed=0)
    rng = np.random.default_rng(0)
    for _ in range(200):
        env.step(rng.uniform(-1, 1, env.action_space.shape))
    joints = PR2.still_joints
    positions = np.array([env.data.joint(name).qpos[0] for name in joints])
    assert np.abs(positions - PR2.still_configuration).max() < 0.02


def test_the_left_arm_acts_where_it_is_the_active_one() -> None:
    env = make_one(1)
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
    drawn = make_one(20, render_mode="rgb_array")
    assert drawn.model.nmesh
    assert digest(drawn, steps=100, draws=True) == digest(make_one(20), steps=100)
    drawn.close()
