"""What KinDER's own code does with environments, done with ours: run by an interpreter that has KinDER.

python in_kinder.py INTERPRETER_WITH_CLUTTER_ENV
"""

from __future__ import annotations

import os
import sys
import warnings
from pathlib import Path
from typing import Any

import gymnasium as gym
import kinder
import numpy as np
from gymnasium.utils.env_checker import check_env
from kinder.envs.dynamic3d.object_types import MujocoFixtureObjectType, MujocoMovableObjectType, MujocoObjectType
from relational_structs import ObjectCentricState
from relational_structs.spaces import ObjectCentricBoxSpace

from clutter_env.bridges import for_kinder
from clutter_env.bridges.remote import BridgeError, Remote

PYTHON = sys.argv[1]
ID = "kinder/ClutteredRetrieval3D-o5-v0"


def refused(call: Any, *args: Any, **keywords: Any) -> str:
    """The message with which a call is refused."""
    try:
        call(*args, **keywords)
    except (BridgeError, RuntimeError) as problem:
        return str(problem)
    raise AssertionError("it was not refused")


def test_nothing_of_ours_is_needed() -> None:
    assert not {"numba", "scipy", "mink", "planners", "irm"} & set(sys.modules)


def test_ids_are_in_kinder_s_lists() -> None:
    ids = kinder.get_env_variants("ClutteredRetrieval3D")
    assert set(ids) <= kinder.get_all_env_ids()
    assert "ClutteredRetrieval3D" in kinder.get_env_categories()["Dynamic3D"]
    assert gym.spec("kinder/ClutteredRetrieval3D-o15-v0").max_episode_steps == 3700


def test_the_interpreter_is_found_from_every_folder() -> None:
    """KinDER's experiments change theirs."""
    for python in ("sh", os.path.relpath(PYTHON)):
        for_kinder.register(python)
        kept = Path(gym.spec(ID).kwargs["python"])
        assert kept.is_absolute()
        assert kept.exists()


def test_every_variant_passes_gymnasium_s_check() -> None:
    for id in kinder.get_env_variants("ClutteredRetrieval3D"):
        env = kinder.make(id, render_mode="rgb_array")
        assert env.render_mode == "rgb_array"
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of unbounded observations, which all of KinDER's are
            check_env(env.unwrapped, skip_render_check=id != ID)
        env.close()


def test_states_are_object_centric() -> None:
    env: Any = kinder.make(ID)
    vector, info = env.reset(seed=0)
    space = env.observation_space
    assert isinstance(space, ObjectCentricBoxSpace)
    state = space.devectorize(vector)
    assert isinstance(state, ObjectCentricState)
    np.testing.assert_array_equal(space.vectorize(state), vector)
    objects = state.get_objects(MujocoMovableObjectType)
    assert [entry.name for entry in objects] == [f"object_{slot:02d}" for slot in range(5)]
    assert [entry.name for entry in objects if state.get(entry, "is_target")] == [info["target"]]
    table = state.get_object_from_name("table_top")
    assert table in state.get_objects(MujocoFixtureObjectType)
    assert [round(float(state.get(table, f"bb_{axis}")), 6) for axis in "xyz"] == [0.7, 1.0, 0.04]
    top = state.get(table, "z") + state.get(table, "bb_z") / 2
    for entry in objects:
        np.testing.assert_allclose(state.get(entry, "z") - state.get(entry, "bb_z") / 2, top, atol=1e-6)
    robot = state.get_object_from_name("robot")
    assert not robot.is_instance(MujocoObjectType)
    assert {"pos_base_x", "pos_arm_joint7", "pos_gripper", "vel_base_rot"} <= set(
        env.observation_space.type_features[robot.type]
    )
    for key in ("description", "observation_space_description", "action_space_description", "reward_description"):
        assert env.metadata[key].strip()
    env.close()


def test_an_episode_is_that_of_the_worker_to_the_last_bit() -> None:
    """The worker's is that of our own environment, by `test_for_kinder.py`."""
    env: Any = kinder.make(ID)
    inner = env.unwrapped._object_centric_env
    with Remote(PYTHON, "retrieve_worker.py") as remote:
        remote("make", keywords={"num_objects": 5})
        env.reset(seed=3)
        remote("reset", seed=3, options=None)
        env.action_space.seed(3)
        for _ in range(30):
            action = env.action_space.sample()
            _, reward, terminated, truncated, info = env.step(action)
            answer = remote("step", action=action.tolist(), saved=False)
            assert (reward, terminated, truncated, info) == (-1.0, False, False, answer["info"])
            for each in answer["state"].values():
                for name, numbers in each.items():
                    state = inner._state
                    assert state[state.get_object_from_name(name)].tolist() == numbers
    env.close()


def test_planners_return_to_states() -> None:
    """As KinDER's bilevel planner: the observation of one environment, simulated in another one."""
    env: Any = kinder.make(ID)
    sim = for_kinder.ObjectCentricClutteredRetrieval3DEnv(PYTHON, num_objects=5, allow_state_access=True)
    sim.reset(seed=8)
    first, _ = env.reset(seed=1)
    env.action_space.seed(1)
    actions = [env.action_space.sample() for _ in range(12)]
    real = [env.step(action)[0] for action in actions]
    for _ in range(2):
        state, seen = env.observation_space.devectorize(first), []
        for action in actions:
            sim.set_state(state.copy())
            state, *_ = sim.step(action)
            seen.append(env.observation_space.vectorize(state))
        np.testing.assert_array_equal(seen, real)
    np.testing.assert_array_equal(env.reset(options={"init_state": first})[0], first)
    np.testing.assert_array_equal(env.step(actions[0])[0], real[0])
    assert "no environment of this process has shown" in refused(env.reset, options={"init_state": real[5] + 0.01})
    assert "allow_state_access=True" in refused(env.unwrapped.get_state)
    sim.close()
    env.close()
    env = kinder.make(ID, allow_state_access=True)
    env.reset(seed=2)
    here = env.unwrapped.get_state()
    one, reward, terminated = env.unwrapped.get_transition(here, actions[0])
    assert (reward, terminated) == (-1.0, False)
    env.unwrapped.set_state(here)
    np.testing.assert_array_equal(env.step(actions[0])[0], one)
    np.testing.assert_array_equal(env.unwrapped.get_next_state(here, actions[0]), one)
    env.close()


def test_a_state_that_is_returned_to_is_kept() -> None:
    """The root of a long search was forgotten: only what a reset or a step showed was kept."""
    sim = for_kinder.ObjectCentricClutteredRetrieval3DEnv(PYTHON, num_objects=1, allow_state_access=True)
    kept, for_kinder._KEPT = for_kinder._KEPT, 12
    try:
        root, _ = sim.reset(seed=0)
        for _ in range(4):
            sim.set_state(root)
            for _ in range(8):
                sim.step(sim.action_space.sample())
    finally:
        for_kinder._KEPT = kept
        sim.close()


def test_a_demonstration_replays() -> None:
    """As KinDER's own are tested: the same seed, the same actions, the same observations."""
    env: Any = kinder.make("kinder/ClutteredRetrieval3D-o1-v0")
    observations, actions, terminated, truncated = [env.reset(seed=4)[0]], [], False, False
    while not (terminated or truncated):
        actions.append(env.unwrapped.expert_action())
        observation, _, terminated, truncated, info = env.step(actions[-1])
        observations.append(observation)
    assert terminated
    assert info["is_success"]
    np.testing.assert_array_equal(env.reset(seed=4)[0], observations[0])
    again = [env.step(action) for action in actions]
    np.testing.assert_array_equal([step[0] for step in again], observations[1:])
    assert [step[2] for step in again] == [False] * (len(actions) - 1) + [True]
    env.close()


def test_options_and_keywords_are_those_of_retrieve() -> None:
    env: Any = kinder.make(ID, control_mode="ee", reward_mode="dense")
    assert env.action_space.shape == (10,)
    _, info = env.reset(seed=0, options={"target": "object_03"})
    assert info["target"] == "object_03"
    assert env.step(np.zeros(10, np.float32))[1] != -1.0
    one = [{"shape": "cylinder", "radius": 0.03, "height": 0.15, "position": (0.0, 0.0)}]
    assert "1 objects do not fill an observation of 5" in refused(env.reset, options={"objects": one})
    assert "object_05" in refused(env.reset, options={"target": "object_05"})
    env.reset(seed=0)  # a refused reset has changed nothing
    env.close()
    assert "unknown keyword argument 'shade'" in refused(kinder.make, ID, shade="red")


def test_wrong_interpreters_are_told() -> None:
    assert "cannot be started" in refused(kinder.make, ID, python="/nowhere/python")
    assert "No module named" in refused(kinder.make, ID, python=sys.executable)


if __name__ == "__main__":
    kinder.register_all_environments()
    for_kinder.register(PYTHON)
    for test in [value for name, value in globals().items() if name.startswith("test_")]:
        test()
        print(test.__name__, "passed", flush=True)
