"""The dense reward: from reset on, finishing earns more than anything else, and every clearance shows."""

from __future__ import annotations

import itertools
import math

import gymnasium as gym
import numpy as np
import pytest

import clutter_env
from clutter_env.envs.retrieve import RetrieveEnv
from clutter_env.envs.reward import DISCOUNT, EVENT_SCALES, MOST, Way, dense_reward
from planners import TampExpert
from tests.clutter_env.envs.cheats import cylinder
from tests.clutter_env.envs.side_grasp import SideGrasp, reset_to_free_target
from tests.clutter_env.simulation.test_saved_state import pushing_actions

NOTHING = dict.fromkeys(EVENT_SCALES, 0.0)
LONGEST = gym.spec("clutter_env/Retrieve-o60-v0").max_episode_steps


ROUNDING = 1e-12
"""Of the return of a long episode; 200 γ^2970 is as small."""


def discounted(rewards: np.ndarray | list[float], discount: float) -> float:
    return float(np.sum(np.asarray(rewards) * discount ** np.arange(len(rewards))))


def rewards_of(potentials: np.ndarray, last: str = "") -> np.ndarray:
    """The rewards of a stream of potentials, the last step with an event."""
    rewards = dense_reward(potentials[:-1], potentials[1:], NOTHING)
    rewards[-1] += EVENT_SCALES.get(last, 0.0)
    return rewards


def never_finishing(start: float, limit: int, rng: np.random.Generator) -> list[np.ndarray]:
    """Potentials of hovering, oscillating, dropping, idling, rising ever more, anything, and of the best last step."""
    up, time = np.full(limit, MOST), np.arange(limit)
    kinds = [up, up * (time % 2), up * (time % 40 > 9), np.full(limit, start), np.sort(rng.uniform(0, MOST, limit))]
    kinds += [rng.uniform(0, MOST, limit), up * (time == limit - 1)]
    return [np.concatenate(([start], kind)) for kind in kinds]


@pytest.mark.parametrize("discount", [DISCOUNT, 1.0])
@pytest.mark.parametrize("steps", [15, 1500, LONGEST])
def test_finishing_late_and_near_the_target_all_along_earns_more_than_never_finishing(
    discount: float, steps: int
) -> None:
    rng = np.random.default_rng(steps)
    for start in (0.0, 0.1, MOST):
        finished = discounted(rewards_of(np.array([start, *[MOST] * (steps - 1), 0.0]), "success"), discount)
        for limit in (steps, LONGEST):
            for potentials in never_finishing(start, limit, rng):
                going_on = discounted(rewards_of(potentials), discount)
                assert going_on < finished + ROUNDING * (steps == LONGEST)
                ended = discounted(rewards_of(np.append(potentials[:-1], 0.0), "failure"), discount)
                assert ended < going_on + ROUNDING * (limit == LONGEST)


def test_no_time_limit_is_longer_than_the_proof_allows() -> None:
    limits = [scene.max_steps for name in clutter_env.suite_names() for scene in clutter_env.suite(name)]
    limits += [clutter_env.time_limit(count) for count in range(1, 61)]
    assert (1 - DISCOUNT) * (max(limits) - 1) * MOST + MOST < EVENT_SCALES["success"] == -EVENT_SCALES["failure"]


# What is in the way.


def clearances(env: RetrieveEnv) -> float:
    return Way(env.robot.full_name, env.layout).clearances(env.world, env.measurements)


def test_an_object_before_the_target_counts_and_so_does_one_before_that_object() -> None:
    env = RetrieveEnv(num_objects=8, reward_mode="dense")
    counts = []
    for line in ([], [0.05], [0.05, -0.1]):
        beside = [(0.28, -0.4), (0.28, -0.2), (0.28, 0.0)]
        objects = [cylinder(0.2, -0.3), *(cylinder(x, y) for x, y in [*beside, *((x, -0.3) for x in line)])]
        env.reset(seed=0, options={"objects": objects, "target": "object_00"})
        counts.append(clearances(env))
        assert counts[-1] == env._way.clearances(env.world, env.measurements), "made anew for every scene"
    assert counts[0] < counts[1] < counts[2]


def test_toppling_is_no_clearance() -> None:
    env = RetrieveEnv(num_objects=15, reward_mode="dense")
    env.reset(seed=4)
    standing, positions = clearances(env), env.data.qpos[env.world.index.object_qpos].copy()
    for slot in range(15):
        poses = positions.reshape(15, 7).copy()
        poses[slot, 2:] = 0.79, math.sqrt(0.5), 0.0, math.sqrt(0.5), 0.0
        env.data.qpos[env.world.index.object_qpos] = poses.ravel()
        env.measurements = env.world.measure()
        assert env.measurements.is_fallen.tolist() == [other == slot for other in range(15)]
        assert clearances(env) >= standing


@pytest.mark.slow
def test_nine_of_ten_clearances_of_the_expert_show() -> None:
    shown = []
    for scene in itertools.islice(clutter_env.suite("side-25-v3"), 12):
        env = scene.make(reward_mode="dense")
        _, info = scene.reset(env)
        expert = TampExpert(env, grasps="side")
        expert.reset()
        counts, is_over = [clearances(env.unwrapped)], False
        while not (is_over or expert.done):
            cleared = info["num_cleared"]
            *_, is_over, _, info = env.step(expert.act())
            if info["num_cleared"] > cleared:
                counts.append(clearances(env.unwrapped))
        shown += [after < before for before, after in itertools.pairwise(counts)]
    assert len(shown) > 15
    assert np.mean(shown) >= 0.9


@pytest.mark.parametrize("terminate_on_fallen", [False, True])
def test_rewards_of_a_restored_state_are_the_same_bit_for_bit(terminate_on_fallen: bool) -> None:
    env, other = (
        RetrieveEnv(num_objects=15, control_mode="ee", reward_mode="dense", terminate_on_fallen=terminate_on_fallen)
        for _ in range(2)
    )
    env.reset(seed=4)
    other.reset(seed=5)
    rewards, again = [], []
    for step, action in enumerate(pushing_actions(env, 240, 4)):
        if step % 30 == 0:
            other.restore_state(env.save_state())
        rewards.append(env.step(action)[1])
        again.append(other.step(action)[1])
    assert env.info["num_disturbed"] > 2, "the scenario must move objects"
    assert rewards == again


def test_in_physics_a_target_held_too_low_earns_less_than_one_that_is_lifted() -> None:
    returns = []
    for lift, least in ((0.155, 0), (0.09, 320)):
        env = RetrieveEnv(num_objects=5, control_mode="ee", reward_mode="dense")
        reset_to_free_target(env)
        start = env._potential
        script = SideGrasp(env, lift=lift, drive=0.0)
        script.run()
        while len(script.record) < least:
            script.step()
        ended = next((i for i, result in enumerate(script.record) if result[2]), len(script.record) - 1)
        record, discounts = script.record[: ended + 1], DISCOUNT ** np.arange(ended + 2)
        rewards = [result[1] for result in record]
        assert record[-1][4]["held"] == record[-1][4]["target"]
        rest = EVENT_SCALES["success"] * discounts[ended] if lift > 0.1 else discounts[ended + 1] * env._potential
        assert discounted(rewards, DISCOUNT) == pytest.approx(rest - start, abs=1e-12)
        returns.append((discounted(rewards, DISCOUNT), sum(rewards)))
    assert returns[0] > returns[1]
    assert returns[0][1] > 190 > 0 > returns[1][1]


def test_rewards_do_without_numpys_functions_whose_last_bits_depend_on_the_processor(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def refuse(*_: object) -> None:
        raise AssertionError

    for name in ("arctan2", "arctan", "arcsin", "arccos", "tan", "tanh", "exp", "log", "power", "dot", "matmul"):
        monkeypatch.setattr(np, name, refuse)
    env = RetrieveEnv(num_objects=6, reward_mode="dense", shapes="mixed", layout="shelf")
    env.reset(seed=0)
    for action in np.random.default_rng(0).uniform(-1, 1, (20, env.action_size)):
        env.step(action)
