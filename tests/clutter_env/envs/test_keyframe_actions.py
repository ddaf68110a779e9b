"""Keyframes as actions: those of a demonstration do its task; each ends where it is reached, or where nothing moves."""

from __future__ import annotations

import math

import gymnasium as gym
import numpy as np
import pytest

from clutter_env.data.episode import record
from clutter_env.data.keyframes import keyframe_steps
from clutter_env.envs.keyframe_actions import ARRIVED, MOST_STEPS, KeyframeActions
from clutter_env.errors import ActionError, ConfigError, DatasetError
from clutter_env.policies.experts import find_expert, make_expert
from clutter_env.task import Task

TASK = Task("clutter_env/Retrieve-o5-v0")


def test_the_keyframes_of_a_demonstration_do_its_task_in_ten_decisions() -> None:
    env = TASK.make()
    episode = record(TASK, env, make_expert(find_expert(TASK.env_id)), 0)
    rows, keyframes = keyframe_steps(episode)
    assert (np.diff(rows) > 0).all()
    assert 3 <= len(keyframes) <= 10 < len(episode)
    by_keyframes = KeyframeActions(env)
    by_keyframes.reset(seed=0)
    for keyframe in [*keyframes, keyframes[-1]]:  # the last one is held
        assert by_keyframes.action_space.contains(keyframe)
        _, reward, terminated, _, info = by_keyframes.step(keyframe)
        if terminated:
            break
    assert info["is_success"]
    assert reward > 0


def test_a_keyframe_ends_where_it_is_reached_and_the_base_turns_the_short_way() -> None:
    env = KeyframeActions(gym.make("clutter_env/Retrieve-o1-v0"))
    env.reset(seed=0)
    keyframe = env.present_keyframe
    yaw = keyframe[2]
    keyframe[0] -= 0.2
    keyframe[3] += 0.05
    keyframe[2] = yaw + 0.3 - math.tau
    _, _, terminated, truncated, info = env.step(keyframe)
    assert info["reached"]
    assert not terminated
    assert not truncated
    assert info["control_steps"] < 40
    reached = env.present_keyframe
    assert reached[2] == pytest.approx(yaw + 0.3, abs=ARRIVED)
    assert np.allclose(np.delete(reached, 2), np.delete(keyframe, 2), atol=ARRIVED)
    *_, info = env.step(reached)
    assert info["reached"]
    assert info["control_steps"] <= 5


def test_a_robot_that_is_stuck_gets_the_next_decision() -> None:
    """Driving into the table: it stops there, before the time for a keyframe is up."""
    env = KeyframeActions(gym.make("clutter_env/Retrieve-o1-v0"))
    env.reset(seed=0)
    keyframe = env.present_keyframe
    keyframe[0] += 1.5
    *_, info = env.step(keyframe)
    assert not info["reached"]
    assert info["control_steps"] < MOST_STEPS / 2


def test_what_is_no_keyframe_is_refused() -> None:
    env = KeyframeActions(gym.make("clutter_env/Retrieve-o1-v0"))
    with pytest.raises(ActionError, match="reset"):
        env.step(np.zeros(12))
    env.reset(seed=0)
    with pytest.raises(ActionError, match="shape"):
        env.step(np.zeros(11))
    with pytest.raises(ConfigError, match="joint"):
        KeyframeActions(gym.make("clutter_env/Retrieve-o1-v0", control_mode="ee"))
    arm = Task("clutter_env/ArmRetrieve-o1-v0")
    with pytest.raises(DatasetError, match="no plan"):
        keyframe_steps(record(arm, arm.make(), make_expert("armretrieve"), 0))
