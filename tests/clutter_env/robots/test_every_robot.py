"""What holds for every robot: checkers, determinism, saved states, grasps, random actions.

Fetch is the default robot of most other tests, so that here only its random actions are tried.
"""

from __future__ import annotations

import math
import warnings
from itertools import product
from typing import NamedTuple

import gymnasium as gym
import mujoco
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import clutter_env  # noqa: F401  registers the environments
from assets import PR2, RobotSpec
from clutter_env.envs.retrieve import RetrieveEnv
from tests.clutter_env.envs.side_grasp import SideGrasp, reset_to_free_target
from tests.clutter_env.simulation.test_saved_state import pushing_actions, run

GRASPS, EPISODES = 2, 10


class Stance(NamedTuple):
    """Where the base stops for a side grasp: `standoff` [m] before the target, which is `side` [m] to the left.

    `farthest` [m]: largest x of a target that the arm reaches from there.
    """

    standoff: float
    side: float = 0.0
    farthest: float = math.inf


STANCES = {
    # the square base stays before the table, the right arm reaches straight ahead
    "pr2": Stance(0.72, -0.2, 0.0),
    "panda_mobile": Stance(0.80),
}
OTHERS = pytest.mark.parametrize("robot", STANCES)
MODES = pytest.mark.parametrize("mode", ["joint", "ee"])
EACH_ROBOT_AND_MODE = pytest.mark.parametrize(
    ("robot", "mode"),
    [*product(STANCES, ("joint", "ee")), (PR2.with_all_arms(), "joint")],
    ids=lambda value: getattr(value, "full_name", value),
)


def make(robot: str | RobotSpec, count: int, **keywords):
    return gym.make(f"clutter_env/Retrieve-o{count}-v0", robot=robot, **keywords).unwrapped


@EACH_ROBOT_AND_MODE
def test_gymnasium_checker_is_silent(robot: str | RobotSpec, mode: str) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for env_id in ("clutter_env/Retrieve-o5-v0", "clutter_env/Reach-v0"):
            check_env(gym.make(env_id, robot=robot, control_mode=mode).unwrapped, skip_render_check=True)


@EACH_ROBOT_AND_MODE
def test_a_saved_state_continues_bit_for_bit(robot: str | RobotSpec, mode: str) -> None:
    env, other = (make(robot, 20, control_mode=mode) for _ in range(2))
    env.reset(seed=4)
    for action in pushing_actions(env, 100, 4):
        env.step(action)
    state, actions = env.save_state(), pushing_actions(env, 60, 5)
    expected = run(env, actions)
    other.reset(seed=1)
    other.restore_state(state)
    assert run(other, actions) == expected


@OTHERS
def test_side_grasps_hold(robot: str) -> None:
    stance = STANCES[robot]
    env = RetrieveEnv(num_objects=5, control_mode="ee", robot=robot)
    results, seed = [], -1
    for _ in range(GRASPS):
        seed = reset_to_free_target(env, seed + 1, stance.farthest)
        results.append(SideGrasp(env, stance.standoff, stance.side).run())
    assert all(r.lift >= 0.15 and r.is_held and r.slip < 0.002 and r.warnings == 0 for r in results), results


@pytest.mark.slow
@pytest.mark.parametrize("robot", ["fetch", *STANCES])
@MODES
def test_random_actions_keep_the_state_finite(robot: str, mode: str) -> None:
    """MuJoCo's warnings are counted after every episode: a reset clears its counters."""
    env = make(robot, 20, control_mode=mode)
    rng = np.random.default_rng(0)
    for episode in range(EPISODES):
        env.reset(seed=episode)
        for _ in range(500):
            observation, reward, *_ = env.step(rng.uniform(-1, 1, env.action_space.shape))
            assert env.observation_space.contains(observation)
            assert np.isfinite(reward)
        warned = [mujoco.mjtWarning(kind).name for kind in np.flatnonzero(env.data.warning.number)]
        assert not warned, f"episode {episode}: {warned}"
