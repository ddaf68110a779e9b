"""`ArmReach` and `ArmPick`: within reach of everything in 50 steps, nothing hidden, the base fixed."""

from __future__ import annotations

import gymnasium as gym
import numpy as np
import pytest

import clutter_env  # noqa: F401 - registers the environments
from clutter_env.envs.arm import GOAL_LIFT, GOAL_RANGE, LOWEST, START_HEIGHT
from clutter_env.errors import ActionError, ConfigError
from clutter_env.policies.experts import find_expert, make_expert

IDS = ["clutter_env/ArmReach-v0", "clutter_env/ArmPick-v0"]


@pytest.mark.parametrize("env_id", IDS)
def test_scripts_reach_every_goal_with_time_to_spare(env_id: str) -> None:
    env, script = gym.make(env_id), make_expert(find_expert(env_id))
    solved = []
    for seed in range(12):
        observation, info = env.reset(seed=seed)
        script.reset(info, env)
        for _ in range(40):
            observation, *_, info = env.step(script.act(observation))
        solved.append(info["is_success"])
    assert all(solved)


@pytest.mark.parametrize("env_id", IDS)
def test_the_base_stands_still_and_the_fingers_stay_above_the_table(env_id: str) -> None:
    env = gym.make(env_id).unwrapped
    env.action_space.seed(0)
    env.reset(seed=0)
    start, heights = env.data.qpos[env.world.index.drive_qpos[:3]].copy(), []
    for step in range(200):
        action = env.action_space.sample()
        action[2] = -1.0 if step % 100 < 50 else action[2]
        *_, info = env.step(action)
        heights.append(env.tcp[2] + START_HEIGHT)
    assert min(heights) > LOWEST - 0.01
    assert np.median(heights) < 2 * LOWEST
    assert info["furniture_force"] < 50
    assert np.abs(env.data.qpos[env.world.index.drive_qpos[:3]] - start).max() < 0.01


@pytest.mark.parametrize("env_id", IDS)
def test_an_action_is_forgotten_after_its_step(env_id: str) -> None:
    """The state that can be observed decides: the pose to follow does not run ahead of the arm."""
    env = gym.make(env_id).unwrapped
    env.reset(seed=1)
    for _ in range(10):
        env.step([0.5, -0.5, -0.1, 1.0])
    moved = []
    for _ in range(10):
        before = env.tcp.copy()
        env.step([0.0, 0.0, 0.0, 1.0])
        moved.append(np.abs(env.tcp - before).max())
    assert max(moved[4:]) < 0.004  # as the arm slowly turns its elbow home


def test_observations_are_those_of_the_layout_and_relative_to_the_start() -> None:
    env = gym.make("clutter_env/ArmPick-v0").unwrapped
    layout = env.observation_layout["observation"]
    in_the_air = []
    for seed in range(30):
        observation, info = env.reset(seed=seed)
        vector, goal = observation["observation"], observation["desired_goal"]
        assert np.abs(vector[layout["tcp_position"]]).max() < 1e-3
        position = observation["achieved_goal"]
        assert np.allclose(vector[layout["object_position"]], position, atol=1e-6)
        assert np.allclose(vector[layout["tcp_to_object"]], position - vector[layout["tcp_position"]], atol=1e-6)
        assert np.allclose(vector[layout["object_quaternion"]], (1, 0, 0, 0), atol=1e-6)
        assert np.abs(vector[layout["object_velocity"]]).max() < 1e-6
        assert (np.abs(position[:2]) <= GOAL_RANGE[:2]).all()
        assert (np.abs(goal[:2]) <= GOAL_RANGE[:2]).all()
        assert 0 <= goal[2] - position[2] <= GOAL_LIFT
        in_the_air.append(goal[2] > position[2])
        assert not info["is_success"] or not in_the_air[-1] or goal[2] - position[2] <= 0.05
    assert 8 < sum(in_the_air) < 22
    assert layout.size == len(vector) == 27


def test_an_object_of_the_users_stands_in_reach() -> None:
    env = gym.make("clutter_env/ArmPick-v0").unwrapped
    box = {"shape": "box", "depth": 0.04, "width": 0.05, "height": 0.06, "position": (-0.1, 0.2)}
    observation, _ = env.reset(seed=0, options={"objects": [box]})
    assert np.allclose(env.measurements.poses[0, :2], (-0.1, 0.2), atol=1e-3)
    assert (np.abs(observation["achieved_goal"][:2]) <= np.add(GOAL_RANGE[:2], 1e-3)).all()


@pytest.mark.usefixtures("needs_gl")
def test_images_hide_the_object() -> None:
    env = gym.make("clutter_env/ArmPick-v0", obs_mode="rgbd", image_size=32)
    observation, _ = env.reset(seed=0)
    assert env.observation_space.contains(observation)
    assert len(observation["observation"]) == 8
    assert any(name.endswith("_rgb") for name in observation)


@pytest.mark.parametrize(
    ("keywords", "message"),
    [
        ({"num_objects": 3}, "num_objects"),
        ({"control_mode": "joint"}, "control_mode"),
        ({"layout": "shelf"}, "shelves"),
        ({"robot": "pr2"}, "behind the front edge"),
        ({"robot": "panda_mobile"}, "misses goals"),
    ],
)
def test_what_these_environments_cannot_be_is_refused(keywords: dict[str, object], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        gym.make("clutter_env/ArmPick-v0", **keywords)
    env = gym.make("clutter_env/ArmReach-v0").unwrapped
    with pytest.raises(ActionError, match="reset"):
        env.arm_action((0, 0, 0), 0.1)
    env.reset(seed=0)
    with pytest.raises(ActionError, match="arm_action"):
        env.ee_action((0, 0, 0), np.eye(4), 0.1)
