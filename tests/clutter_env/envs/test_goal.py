"""Goal environments: rewards agree bit for bit, goals can be reached, relabelling is possible."""

from __future__ import annotations

import warnings

import gymnasium as gym
import numpy as np
import pytest

import clutter_env  # noqa: F401 - registers the environments
from clutter_env.envs.goal import GOAL_TOLERANCE, GoalInterface

IDS = [f"clutter_env/{name}-v0" for name in ("Reach", "Pick", "ArmReach", "ArmPick")]


@pytest.mark.parametrize("env_id", IDS)
@pytest.mark.parametrize("mode", ["sparse", "dense"])
def test_rewards_of_batches_are_those_of_the_steps(env_id: str, mode: str) -> None:
    env = gym.make(env_id, reward_mode=mode)
    achieved, desired, rewards = [], [], []
    for seed in range(3):
        env.reset(seed=seed)
        env.action_space.seed(seed)
        for _ in range(30):
            observation, reward, *_, info = env.step(env.action_space.sample())
            achieved.append(observation["achieved_goal"])
            desired.append(observation["desired_goal"])
            rewards.append(reward)
            assert type(reward) is float
            assert reward == env.unwrapped.compute_reward(achieved[-1], desired[-1], info)
    batch = env.unwrapped.compute_reward(np.array(achieved), np.array(desired), {})
    assert batch.shape == (90,)
    assert np.array_equal(batch, rewards)
    square = env.unwrapped.compute_reward(np.array(achieved).reshape(9, 10, 3), np.array(desired).reshape(9, 10, 3), {})
    assert np.array_equal(square.ravel(), rewards)


def test_reach_goals_are_reached_by_driving_at_them() -> None:
    env = gym.make("clutter_env/Reach-v0").unwrapped
    solved = 0
    for seed in range(8):
        observation, info = env.reset(seed=seed)
        for _ in range(100):
            base = env.world.controller.state.target[:3].copy()
            pose = np.eye(4)
            pose[:3, :3] = env.data.site_xmat[env.world.index.tcp_site].reshape(3, 3)
            pose[:3, 3] = observation["desired_goal"]
            observation, _, _, _, info = env.step(env.ee_action(base, pose, 0.1))
            if info["is_success"]:
                break
        solved += info["is_success"]
    assert solved >= 7


def test_pick_starts_within_reach_and_has_both_kinds_of_goals() -> None:
    env = gym.make("clutter_env/Pick-v0").unwrapped
    lifts, distances = [], []
    for seed in range(40):
        observation, info = env.reset(seed=seed)
        assert env.data.ncon == 0
        assert info["target"] == "object_00"
        lifts.append(observation["desired_goal"][2] - observation["achieved_goal"][2])
        distances.append(np.linalg.norm(observation["achieved_goal"][:2] - env.data.qpos[:2]))
    assert 10 < sum(lift > 0 for lift in lifts) < 30
    assert min(lifts) == 0
    assert max(distances) < 1.0
    assert GOAL_TOLERANCE == 0.05


@pytest.mark.parametrize("env_id", IDS)
def test_wrapped_environments_pass_the_checker_of_stable_baselines3(env_id: str) -> None:
    pytest.importorskip("stable_baselines3")
    from stable_baselines3.common.env_checker import check_env

    limited = GoalInterface(gym.wrappers.TimeLimit(gym.make(env_id).unwrapped, 50))
    for env in (gym.make(env_id, max_episode_steps=30, reward_mode="dense"), limited):
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            check_env(env)


def test_the_made_environment_can_be_made_again_from_its_description() -> None:
    env = gym.make("clutter_env/Pick-v0", reward_mode="dense")
    assert env.spec is not None
    again = gym.make(gym.envs.registration.EnvSpec.from_json(env.spec.to_json()))
    assert str(again) == str(env)
    observation, _ = again.reset(seed=0)
    goal, achieved = observation["desired_goal"], observation["achieved_goal"]
    assert again.compute_reward(achieved, goal, {}) == again.unwrapped.compute_reward(achieved, goal, {})
    assert again.spec == env.spec
