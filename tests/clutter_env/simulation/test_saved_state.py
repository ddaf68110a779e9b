"""A saved state continues bit for bit: here, in another process, with and without meshes."""

from __future__ import annotations

import subprocess
import sys

import gymnasium as gym
import numpy as np
import pytest

import clutter_env  # noqa: F401 - registers the environments
from clutter_env.errors import ActionError, StateError

STEPS = 50


def in_clutter(mode: str, seed: int = 4, **keywords):
    """An environment whose robot has pushed objects about for a while."""
    env = gym.make("clutter_env/Retrieve-o15-v0", control_mode=mode, **keywords).unwrapped
    env.reset(seed=seed)
    for action in pushing_actions(env, 160, seed):
        env.step(action)
    return env


def pushing_actions(env, count: int, seed: int) -> np.ndarray:
    """Random actions that drive to the table with a lowering gripper, and to the right: the gripper starts left."""
    actions = np.random.default_rng(seed).uniform(-1, 1, (count, env.action_space.shape[0]))
    actions[:, 0] = 0.25
    actions[:, 1:3] *= 0.2
    actions[:, 1] -= 0.06
    actions[:, 5] = 0.1 if env.config.control_mode == "joint" else -0.3
    return actions


def moved_objects(env) -> int:
    """How many objects are not where they started."""
    return int((np.abs(env.measurements.poses[:, :2] - env.world.scene.positions).max(axis=1) > 1e-3).sum())


def run(env, actions: np.ndarray) -> list[bytes]:
    """All that the steps return, as bytes."""
    record = []
    for action in actions:
        observation, reward, *ended, info = env.step(action)
        record.append(
            b"".join(value.tobytes() for value in observation.values()) + repr((reward, ended, info)).encode()
        )
    record.append(env.data.qpos.tobytes() + env.data.qvel.tobytes())
    return record


@pytest.mark.parametrize(("mode", "keywords"), [("joint", {}), ("ee", {"shapes": "mixed"})])
def test_round_trip_changes_nothing(mode: str, keywords: dict) -> None:
    env = in_clutter(mode, **keywords)
    assert moved_objects(env) > 2, "the scenario must move objects"
    actions = pushing_actions(env, STEPS, seed=9)
    state = env.save_state()
    untouched = run(env, actions)
    env.restore_state(state)
    assert run(env, actions) == untouched
    other = gym.make("clutter_env/Retrieve-o15-v0", control_mode=mode, **keywords).unwrapped
    other.reset(seed=77, options={"state": state})
    assert other.save_state() == state
    assert run(other, actions) == untouched


def test_fresh_process_continues_alike(tmp_path) -> None:
    env = in_clutter("joint")
    actions = pushing_actions(env, STEPS, seed=9)
    (tmp_path / "state").write_bytes(env.save_state())
    np.save(tmp_path / "actions.npy", actions)
    run(env, actions)
    script = (
        "import sys, numpy as np, gymnasium as gym, clutter_env\n"
        "env = gym.make('clutter_env/Retrieve-o15-v0').unwrapped\n"
        "env.restore_state(open(sys.argv[1] + '/state', 'rb').read())\n"
        "for action in np.load(sys.argv[1] + '/actions.npy'): env.step(action)\n"
        "sys.stdout.write((env.data.qpos.tobytes() + env.data.qvel.tobytes()).hex())"
    )
    result = subprocess.run([sys.executable, "-c", script, str(tmp_path)], capture_output=True, text=True, check=True)
    assert result.stdout == (env.data.qpos.tobytes() + env.data.qvel.tobytes()).hex()


def test_explicit_scenes_are_restored_into_any_environment() -> None:
    env = gym.make("clutter_env/Retrieve-o5-v0").unwrapped
    box = {"shape": "box", "depth": 0.05, "width": 0.04, "height": 0.15, "position": (0.1, 0.2), "yaw": 0.3}
    env.reset(seed=0, options={"objects": [box]})
    state = env.save_state()
    actions = pushing_actions(env, 20, seed=1)
    expected = run(env, actions)
    other = gym.make("clutter_env/Retrieve-o5-v0").unwrapped
    other.restore_state(state)
    assert run(other, actions) == expected


def test_random_generator_is_part_of_the_state() -> None:
    env = gym.make("clutter_env/Retrieve-o5-v0").unwrapped
    env.reset(seed=4)
    state = env.save_state()
    first, _ = env.reset()
    env.restore_state(state)
    second, _ = env.reset()
    assert all(np.array_equal(first[name], second[name]) for name in first)


def test_wrong_states_are_refused() -> None:
    env = gym.make("clutter_env/Retrieve-o5-v0").unwrapped
    with pytest.raises(ActionError, match="reset"):
        env.save_state()
    env.reset(seed=0)
    state = env.save_state()
    damaged = state[:-1] + bytes([state[-1] ^ 1])
    for wrong, message in ((None, "bytes"), (b"", "no saved state"), (damaged, "damaged"), (state[:40], "damaged")):
        with pytest.raises(StateError, match=message):
            env.restore_state(wrong)
    with pytest.raises(StateError, match="num_objects"):
        gym.make("clutter_env/Retrieve-o10-v0").unwrapped.restore_state(state)
    with pytest.raises(StateError, match="task"):
        gym.make("clutter_env/Pick-v0").unwrapped.restore_state(state)
