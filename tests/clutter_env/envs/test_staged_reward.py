"""The staged reward: between 0 and 1 on the way, and finishing beats hovering at every discount up to its own."""

from __future__ import annotations

from itertools import pairwise

import gymnasium as gym
import numpy as np
import pytest

from clutter_env.envs.staged_reward import (
    DISCOUNT,
    STAGE_WEIGHTS,
    SUCCESS,
    WAY_WEIGHT,
    stage_terms,
    staged_reward,
)
from clutter_env.policies.experts import find_expert, make_expert

IDS = [f"clutter_env/ArmRetrieve-o{count}-v0" for count in (1, 3, 5)]
ALONG = [
    (0.2, 0.5, 0.0, 0.0, 0.0, 0.0),
    (1.0, 0.1, 0.0, 0.0, 0.0, 0.0),
    (1.0, 0.6, 0.0, 0.0, 0.0, 0.0),
    (1.0, 1.0, 0.5, 0.0, 0.0, 0.0),
    (1.0, 1.0, 0.9, 0.4, 0.0, 0.0),
    (1.0, 1.0, 1.0, 1.0, 0.0, 0.0),
    (1.0, 1.0, 1.0, 1.0, 0.5, 0.0),
    (1.0, 1.0, 1.0, 1.0, 1.0, 0.0),
    (1.0, 1.0, 1.0, 1.0, 1.0, 0.9),
]
"""Arguments of `stage_terms` along the task."""


@pytest.mark.parametrize("count", [1, 5])
def test_stages_rise_along_the_task_and_stay_below_one(count: int) -> None:
    rewards = [staged_reward(stage_terms(*state, count), is_success=False) for state in ALONG]
    assert all(later > earlier for earlier, later in pairwise(rewards[0 if count > 1 else 1 :]))
    assert min(rewards) >= 0
    assert max(rewards) < 1
    assert sum(STAGE_WEIGHTS.values()) == pytest.approx(1)


@pytest.mark.parametrize("discount", [0.5, 0.9, 0.95, DISCOUNT])
def test_finishing_beats_hovering_from_every_stage(discount: float) -> None:
    """However long the rest takes, if the reward does not fall on it; hovering goes on for ever."""
    for state in ALONG:
        level = staged_reward(stage_terms(*state, 5), is_success=False)
        hovering = level / (1 - discount)
        for steps in (0, 1, 10, 100, 1000):
            finishing = level * (1 - discount**steps) / (1 - discount) + discount**steps * SUCCESS
            assert finishing > hovering or discount**steps < 1e-12


@pytest.mark.parametrize("env_id", IDS)
def test_the_script_earns_more_than_any_hovering_or_idling(env_id: str) -> None:
    """From every step on, at the documented discount; rewards are those of `step`, the terms in the info add up."""
    env, script = gym.make(env_id), make_expert(find_expert(env_id))
    for seed in range(4):
        observation, info = env.reset(seed=seed)
        script.reset(info, env)
        rewards, is_over = [], False
        while not is_over:
            observation, reward, terminated, truncated, info = env.step(script.act(observation))
            rewards.append(reward)
            is_over = terminated or truncated
            expected = SUCCESS if info["is_success"] else sum(info["reward_terms"].values())
            assert reward == pytest.approx(expected)
        assert info["is_success"]
        assert min(rewards) >= 0
        assert max(rewards[:-1]) < 1
        returns = [float(np.polyval(rewards[step:][::-1], DISCOUNT)) for step in range(len(rewards))]
        assert returns[0] > rewards[0] / (1 - DISCOUNT)
        for step, level in enumerate(rewards[:-1]):
            assert returns[step + 1] > level / (1 - DISCOUNT)


def test_terms_are_of_the_object_in_the_way_until_it_is_put_aside() -> None:
    """Clearing pays at every step: reaching, taking, carrying away and putting down the object in the way."""
    env_id = IDS[1]
    env, script = gym.make(env_id), make_expert(find_expert(env_id))
    inner = env.unwrapped
    seed = next(seed for seed in range(20) if env.reset(seed=seed) and inner.in_the_way)
    observation, info = env.reset(seed=seed)
    script.reset(info, env)
    ways = [info["reward_terms"]["way"]]
    while inner.in_the_way:
        assert sum(info["reward_terms"].values()) == info["reward_terms"]["way"]
        observation, *_, info = env.step(script.act(observation))
        ways.append(info["reward_terms"]["way"])
    assert ways[-1] == pytest.approx(WAY_WEIGHT)
    assert min(np.diff(ways)) > -0.05
    assert info["reward_terms"]["reach"] > 0


def test_the_mobile_robot_has_the_stages_too() -> None:
    env = gym.make("clutter_env/Retrieve-o5-v0", object_order="relevance", reward_mode="staged").unwrapped
    _, info = env.reset(seed=0)
    _, reward, *_, info = env.step(np.zeros(12))
    assert reward == pytest.approx(sum(info["reward_terms"].values()))
    assert 0 < reward < 1
