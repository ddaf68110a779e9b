"""The Gymnasium surface: checkers, vector environments, pickling, every registered id."""

from __future__ import annotations

import copy
import importlib.util
import pickle
import warnings
from collections.abc import Callable
from dataclasses import replace
from itertools import product
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AsyncVectorEnv, AutoresetMode, SyncVectorEnv

import clutter_env
from assets import FETCH, robot as find_robot
from clutter_env.config import CONTROL_MODES, OBS_MODES
from clutter_env.errors import ConfigError
from clutter_env.scene.layout import Layout

IDS = [
    *(f"clutter_env/Retrieve-o{n}-v0" for n in clutter_env.OBJECT_COUNTS),
    *(f"clutter_env/Rearrange-o{n}-v0" for n in clutter_env.REARRANGE_COUNTS),
    "clutter_env/Reach-v0",
    "clutter_env/Pick-v0",
    "clutter_env/ArmReach-v0",
    "clutter_env/ArmPick-v0",
]
INFO_TYPES = {
    "is_success": bool,
    "lifted": bool,
    "target": str,
    "held": str,
    "num_fallen": int,
    "num_disturbed": int,
    "num_cleared": int,
    "furniture_force": float,
    "furniture_impulse": float,
    "self_force": float,
    "self_impulse": float,
    "total_slide": float,
    "total_path": float,
    "unstable": bool,
    "ik_failures": int,
}


FEW = ["clutter_env/Retrieve-o1-v0", "clutter_env/Retrieve-o60-v0", "clutter_env/Rearrange-o4-v0", *IDS[-4:]]
SEARCH: dict[str, Any] = {"id": "clutter_env/Search-o5-v0", "image_size": 32}


@pytest.mark.parametrize("env_id", FEW)
def test_gymnasium_checker_is_silent(env_id: str) -> None:
    """Gymnasium's checker, and that of Stable-Baselines3 where it is installed."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(gym.make(env_id).unwrapped, skip_render_check=True)
        if importlib.util.find_spec("stable_baselines3"):
            from stable_baselines3.common.env_checker import check_env as check_for_sb3

            check_for_sb3(gym.make(env_id).unwrapped)


def _every_environment() -> list[dict[str, Any]]:
    """Arguments of `gym.make` for every registered id with every robot, control mode and observation mode."""
    robots, environments = [*("fetch", "pr2", "panda_mobile"), find_robot("pr2").with_all_arms()], []
    for env_id, robot, obs_mode, mode in product(gym.registry, robots, OBS_MODES, CONTROL_MODES):
        keywords = {"robot": robot, "control_mode": mode, "obs_mode": obs_mode}
        if not env_id.startswith("clutter_env/"):
            continue
        if "/Skill-" in env_id:  # skills have their own observations, and end in joint control
            del keywords["control_mode"], keywords["obs_mode"]
        try:
            env = gym.make(env_id, **keywords)
        except ConfigError:  # no cameras, or two arms in "ee" mode
            continue
        env.close()
        environments.append({"id": env_id, **keywords})
    worlds: list[dict[str, Any]] = [
        {"object_set": "household"},
        {"reality": 1.0},
        {"base": "differential"},
        {"base": "fixed"},
    ]
    for world, robot, obs_mode, mode in product(worlds, robots[:3], OBS_MODES, CONTROL_MODES):
        if "differential" not in world.values() or robot == "fetch":
            keywords = {"robot": robot, "control_mode": mode, "obs_mode": obs_mode}
            environments.append({"id": "clutter_env/Retrieve-o15-v0", **keywords, **world})
    return [entry for index, entry in enumerate(environments) if entry not in environments[:index]]


@pytest.mark.slow
@pytest.mark.usefixtures("needs_gl")
def test_checkers_are_silent_for_every_id_robot_control_mode_and_observation_mode() -> None:
    """Gymnasium's, and that of Stable-Baselines3."""
    from stable_baselines3.common.env_checker import check_env as check_for_sb3

    complaints = []
    for keywords in _every_environment():
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            # Advice of Stable-Baselines3 about observations other than 8-bit images and vectors: depth and points.
            warnings.filterwarnings("ignore", r"It seems that your observation( space)? \w+_depth is an image")
            warnings.filterwarnings("ignore", r"Your observation point\w+ has an unconventional shape")
            env = gym.make(**keywords)
            check_env(env.unwrapped, skip_render_check=True)
            check_for_sb3(env.unwrapped)
            env.close()
        complaints += [f"{keywords}: {entry.message}" for entry in caught]
    assert not complaints


@pytest.mark.usefixtures("needs_gl")
@pytest.mark.parametrize(
    "keywords",
    [{"id": FEW[0]}, {"id": FEW[-1]}, {"id": FEW[0], "obs_mode": "rgbd", "image_size": 32}, SEARCH],
)
def test_pictures_and_camera_observations_pass_the_checker_too(keywords: dict) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(gym.make(**keywords).unwrapped, skip_render_check="image_size" in keywords)


@pytest.mark.parametrize("env_id", [*FEW, SEARCH["id"], "clutter_env/Skill-o5-v0"])
def test_all_environments_have_the_same_info_of_plain_types(env_id: str) -> None:
    env = gym.make(env_id)
    _, first = env.reset(seed=0)
    for info in (first, *(env.step(env.action_space.sample())[-1] for _ in range(3))):
        assert {name: type(info[name]) for name in INFO_TYPES} == INFO_TYPES
    assert not first["is_success"]
    assert (first["num_fallen"], first["num_disturbed"], first["num_cleared"]) == (0, 0, 0)


@pytest.mark.parametrize("vector", [SyncVectorEnv, AsyncVectorEnv])
@pytest.mark.parametrize("mode", list(AutoresetMode))
def test_vector_environments_reset_themselves(vector, mode: AutoresetMode) -> None:
    makers = [lambda: gym.make("clutter_env/Retrieve-o5-v0", max_episode_steps=4)] * 2
    envs = vector(makers, autoreset_mode=mode)
    observations, _ = envs.reset(seed=[1, 2])
    assert observations in envs.observation_space
    envs.action_space.seed(0)
    for _ in range(10):
        observations, _, terminated, truncated, _ = envs.step(envs.action_space.sample())
        assert observations in envs.observation_space
        ended = terminated | truncated
        if mode == AutoresetMode.DISABLED and ended.any():
            envs.reset(options={"reset_mask": ended})
    envs.close()


OWN = {"layout": Layout("bench", depth=0.5, width=0.9), "robot": replace(FETCH, name="my_fetch")}


@pytest.mark.parametrize(("env_id", "keywords"), [(FEW[0], {}), (FEW[0], OWN), *((env_id, {}) for env_id in IDS[-2:])])
def test_pickled_environments_go_on(env_id: str, keywords: dict) -> None:
    env = pickle.loads(pickle.dumps(gym.make(env_id, **keywords)))  # taken before the first reset
    env.reset(seed=0)
    env.action_space.seed(1)
    for _ in range(30):
        env.step(env.action_space.sample())
    other = pickle.loads(pickle.dumps(env))
    assert np.array_equal(other.action_space.sample(), env.action_space.sample())
    actions = [env.action_space.sample() for _ in range(10)]
    for action in actions:
        mine, theirs = env.step(action), other.step(action)
        assert all(np.array_equal(mine[0][name], theirs[0][name]) for name in mine[0])
        assert mine[1:] == theirs[1:]


@pytest.mark.parametrize(
    "keywords",
    [
        *({"id": env_id} for env_id in (FEW[0], FEW[2], "clutter_env/Pick-v0", "clutter_env/ArmPick-v0")),
        SEARCH,
        *({"id": "clutter_env/Skill-o5-v0", "simulation": simulation} for simulation in ("physics", "kinematic")),
    ],
    ids=lambda keywords: f"{keywords['id']} {keywords.get('simulation', '')}",
)
@pytest.mark.parametrize("of", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))], ids=["copied", "pickled"])
def test_every_kind_of_environment_goes_on_in_a_copy_of_it(keywords: dict[str, Any], of: Callable[[Any], Any]) -> None:
    """Before the first step and after it: those of Skill then had a planner, which cannot be pickled."""
    env = gym.make(**keywords)
    env.reset(seed=0)
    env.action_space.seed(0)
    for _ in range(3):
        action = env.action_space.sample()
        theirs, mine = of(env).step(action), env.step(action)
        np.testing.assert_equal(theirs, mine)
        if mine[2]:
            break


def test_module_prefix_works() -> None:
    env = gym.make("clutter_env:clutter_env/Retrieve-o15-v0")
    assert env.unwrapped.config.num_objects == 15
