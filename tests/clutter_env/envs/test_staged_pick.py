"""The staged reward of ArmPick: below 1 on the way, 1 held at the goal, and that of other goals from the infos."""

from __future__ import annotations

from itertools import pairwise

import gymnasium as gym
import numpy as np
import pytest

from clutter_env.envs.from_above import Nearness
from clutter_env.envs.goal import GOAL_TOLERANCE
from clutter_env.envs.staged_pick import PICK_WEIGHTS, pick_reward, pick_terms
from clutter_env.errors import ActionError
from clutter_env.policies.experts import make_expert

ALONG = [
    (Nearness(0.1, 0.0, 0.0), False, 0.3),
    (Nearness(0.6, 0.2, 0.0), False, 0.3),
    (Nearness(0.9, 0.9, 0.5), False, 0.3),
    (Nearness(1.0, 1.0, 1.0), False, 0.3),
    (Nearness(1.0, 1.0, 1.0), True, 0.3),
    (Nearness(1.0, 1.0, 1.0), True, 0.1),
    (Nearness(1.0, 1.0, 1.0), True, 0.051),
    (Nearness(1.0, 1.0, 1.0), True, 0.05),
]
"""Arguments of `pick_terms` along the task, at the end with the object held at its goal."""


@pytest.fixture
def env():
    return gym.make("clutter_env/ArmPick-v0", reward_mode="staged")


def test_stages_rise_along_the_task_and_stay_below_one_away_from_the_goal() -> None:
    rewards = [pick_reward(pick_terms(*state), state[2], GOAL_TOLERANCE) for state in ALONG]
    assert all(later > earlier for earlier, later in pairwise(rewards))
    assert rewards[-2] < 1 == rewards[-1]
    assert sum(PICK_WEIGHTS.values()) == pytest.approx(1)


def test_an_object_at_its_goal_that_is_not_held_earns_what_it_earns_elsewhere() -> None:
    for nearness in (Nearness(0.0, 0.0, 0.0), Nearness(0.9, 0.9, 0.5)):
        there, elsewhere = (pick_reward(pick_terms(nearness, False, m), m, GOAL_TOLERANCE) for m in (0.0, 0.3))
        assert there == elsewhere < 1


@pytest.mark.parametrize("discount", [0.5, 0.95, 0.99])
def test_finishing_beats_hovering_from_every_stage(discount: float) -> None:
    for state in ALONG[:-1]:
        level = pick_reward(pick_terms(*state), state[2], GOAL_TOLERANCE)
        for steps in (0, 1, 10, 50):
            finishing = (level * (1 - discount**steps) + discount**steps) / (1 - discount)
            assert finishing > level / (1 - discount) or discount**steps < 1e-12


def test_rewards_of_steps_are_those_of_their_goals_and_of_saved_states(env) -> None:
    script = make_expert("armpick")
    observation, info = env.reset(seed=3)
    script.reset(info, env)
    infos, achieved, rewards = [], [], []
    for _ in range(40):
        observation, reward, _, _, info = env.step(script.act(observation))
        distance = float(np.linalg.norm(observation["achieved_goal"] - observation["desired_goal"]))
        is_held = info["reward_terms"]["grasp"] >= PICK_WEIGHTS["grasp"]
        is_finished = info["is_success"] and is_held
        assert reward == pytest.approx(1.0 if is_finished else sum(info["reward_terms"].values()))
        assert info["is_success"] == (distance <= GOAL_TOLERANCE)
        infos.append(info)
        achieved.append(observation["achieved_goal"])
        rewards.append(reward)
    assert is_finished
    assert 0 < min(rewards) < 0.1
    goals = np.repeat(observation["desired_goal"][None], len(infos), 0)
    compute = env.get_wrapper_attr("compute_reward")
    assert np.array_equal(compute(np.array(achieved), goals, infos), rewards)
    is_held = [info["reward_terms"]["grasp"] >= PICK_WEIGHTS["grasp"] for info in infos]
    there = compute(np.array(achieved), np.array(achieved), np.array(infos))
    assert np.array_equal(there == 1, is_held)
    other = gym.make("clutter_env/ArmPick-v0", reward_mode="staged").unwrapped
    _, restored = other.reset(options={"state": env.unwrapped.save_state()})
    assert restored["reward_terms"] == info["reward_terms"]


def test_a_relabelled_goal_needs_the_terms_of_its_step(env) -> None:
    env.reset(seed=0)
    compute = env.get_wrapper_attr("compute_reward")
    with pytest.raises(ActionError, match="copy_info_dict"):
        compute(np.zeros((2, 3)), np.ones((2, 3)), [{}, {}])


def test_the_other_rewards_of_the_same_steps_are_as_before(env) -> None:
    sparse, dense = (gym.make("clutter_env/ArmPick-v0", reward_mode=mode) for mode in ("sparse", "dense"))
    for each in (env, sparse, dense):
        each.reset(seed=1)
    for _ in range(5):
        action = np.array([0.3, -0.2, -0.4, 1.0])
        (seen, *_), (_, one, *_), (_, two, *_, info) = (each.step(action) for each in (env, sparse, dense))
        distance = float(np.linalg.norm(seen["achieved_goal"] - seen["desired_goal"]))
        assert one == -float(distance > GOAL_TOLERANCE)
        assert two == pytest.approx(-distance)
        assert "reward_terms" not in info
