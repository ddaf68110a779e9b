"""The dense reward: staying below the mark never pays, nor does disturbing."""

from __future__ import annotations

import itertools

import gymnasium as gym
import numpy as np
import pytest

from clutter_env.envs.retrieve import RetrieveEnv
from clutter_env.envs.reward import DENSE_SCALES, POTENTIAL_TERMS, dense_reward, potential
from clutter_env.envs.success import HOLD_STEPS
from clutter_env.policies.scripted import direct_approach
from tests.clutter_env.envs.side_grasp import SideGrasp, reset_to_free_target

DISCOUNTS = (0.95, 0.99, 1.0)
LIMIT = gym.spec("clutter_env/Retrieve-o60-v0").max_episode_steps
NOTHING = {"success": 0.0, "disturbed": 0.0, "lost": 0.0}
FULL = {"reach": 1.0, "grasp": 1.0, "lift": 1.0}


def discounted(rewards: list[float] | np.ndarray, discount: float) -> float:
    return float(np.sum(np.asarray(rewards) * discount ** np.arange(len(rewards))))


def approach(steps: int) -> list[float]:
    """Potentials while the gripper comes near and takes the target."""
    reach = [potential({"reach": share, "grasp": 0.0, "lift": 0.0}) for share in np.linspace(0, 1, steps)]
    lift = [potential({"reach": 1.0, "grasp": 1.0, "lift": share}) for share in np.linspace(0, 0.98, 10)]
    return reach + lift


def rewards_of(potentials: list[float], events: dict[int, dict[str, float]]) -> list[float]:
    """The rewards of a stream of potentials, with events at some of its steps."""
    return [
        dense_reward(before, after, {**NOTHING, **events.get(step, {})})
        for step, (before, after) in enumerate(itertools.pairwise(potentials))
    ]


def finishing(steps: int) -> list[float]:
    """The rewards of an episode that takes the target after an approach of so many steps, and holds it."""
    potentials = approach(steps) + [potential(FULL)] * HOLD_STEPS
    return rewards_of(potentials, {len(potentials) - 2: {"success": 1.0}})


def hovering(steps: int, horizon: int, rng: np.random.Generator) -> list[list[float]]:
    """Episodes that take the target as `finishing` does and then never finish: the streams of their rewards."""
    arrive = approach(steps)
    rest = max(horizon - len(arrive) + 1, 1)
    high = np.full(rest, potential({**FULL, "lift": 0.999}))
    low = potential({"reach": 1.0, "grasp": 0.0, "lift": 0.0})
    period = np.arange(rest)
    kinds = [high, np.where(period % 2, high, low), np.where(period % 10 == 9, low, potential(FULL))]
    kinds += [rng.uniform(0.0, potential(FULL), rest), np.maximum.accumulate(rng.uniform(arrive[-1], 1.0, rest))]
    return [rewards_of([*arrive, *kind], {}) for kind in kinds]


@pytest.mark.parametrize("discount", DISCOUNTS)
@pytest.mark.parametrize("steps", [5, 100, 800])
def test_no_policy_that_stays_below_the_mark_earns_more_than_finishing(discount: float, steps: int) -> None:
    rng = np.random.default_rng(0)
    finished = discounted(finishing(steps), discount)
    for horizon in (steps + 20, 1000, LIMIT):
        for stream in hovering(steps, horizon, rng):
            assert discounted(stream, discount) < finished + 1e-12


@pytest.mark.parametrize("discount", DISCOUNTS)
@pytest.mark.parametrize("reach", [0.0, 0.5, 1.0])
@pytest.mark.parametrize("clearing", [50, 300, LIMIT // 2])
def test_bulldozing_earns_less_than_clearing_first(discount: float, reach: float, clearing: int) -> None:
    """From the same state on: the clean episode moves away from the target, clears, and takes the target much later."""
    start = potential({"reach": reach, "grasp": 0.0, "lift": 0.0})
    away = [start] + [0.0] * clearing + approach(40) + [potential(FULL)] * HOLD_STEPS
    clean = discounted(rewards_of(away, {len(away) - 2: {"success": 1.0}}), discount)
    for steps in (1, 5, 20):
        potentials = [start, *(value for value in approach(steps) if value > start)] + [potential(FULL)] * HOLD_STEPS
        for disturbed_at in range(len(potentials) - 1):
            for objects in (1, 3):
                rewards = rewards_of(potentials, {disturbed_at: {"disturbed": objects}})
                assert discounted(rewards, discount) < clean


def test_the_potential_is_at_most_one_and_less_than_a_disturbance_costs() -> None:
    assert potential(FULL) == pytest.approx(1.0)
    assert -DENSE_SCALES["disturbed"] * min(DISCOUNTS) ** (HOLD_STEPS + 1) > potential(FULL)
    assert set(DENSE_SCALES) == {*POTENTIAL_TERMS, *NOTHING}


# In the environment.


def grasp(lift: float, steps: int) -> tuple[list[float], dict]:
    """Rewards of a scripted grasp that lifts so far [m] and stays for so many steps, and the last info."""
    env = RetrieveEnv(num_objects=5, control_mode="ee", reward_mode="dense")
    reset_to_free_target(env)
    script = SideGrasp(env, lift=lift, drive=0.0)
    script.run()
    while len(script.record) < steps:
        script.step()
    ended = next((index for index, result in enumerate(script.record) if result[2]), len(script.record) - 1)
    return [result[1] for result in script.record[: ended + 1]], script.record[ended][4]


def test_hovering_in_physics_earns_less_than_finishing() -> None:
    finished, info = grasp(0.155, 0)
    assert info["is_success"]
    below, info = grasp(0.09, 1000)
    assert not info["is_success"]
    assert info["held"] == info["target"]
    assert len(below) == 1000
    for discount in DISCOUNTS:
        assert discounted(below, discount) < discounted(finished, discount)
    assert sum(below) < 1.0 < 10.0 < sum(finished)


def test_the_rewards_of_a_bulldozer_add_up_to_its_last_potential_and_its_penalties() -> None:
    env = RetrieveEnv(num_objects=15, control_mode="ee", reward_mode="dense")
    disturbed = 0
    for seed in range(3):
        env.reset(seed=seed)
        before, total, is_over, steps = env._measure_potential(), 0.0, False, 0
        while not is_over and steps < 120:
            _, reward, is_over, _, info = env.step(direct_approach(env)[1])
            total += reward
            steps += 1
        judge = env._monitor
        events = 10.0 * info["is_success"] - 10.0 * judge.is_target_lost + DENSE_SCALES["disturbed"] * judge._num_spoilt
        assert total == pytest.approx(env._measure_potential() - before + events, abs=1e-9)
        disturbed += judge._num_spoilt
    assert disturbed > 3
