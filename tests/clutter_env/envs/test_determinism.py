"""Same seed, same bits: across instances, processes, histories, with and without pictures and meshes."""

from __future__ import annotations

import hashlib
import subprocess
import sys
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

import clutter_env  # noqa: F401 - registers the environments

STEPS = 500
IDS = ["clutter_env/Retrieve-o20-v0", "clutter_env/Reach-v0", "clutter_env/Pick-v0"]


def digest(env, steps: int = STEPS, seed: int = 5, draws: bool = False) -> str:
    """A hash over everything that an episode of pushing actions returns."""
    rng = np.random.default_rng(seed)
    sum_ = hashlib.sha256()
    observation, info = env.reset(seed=seed)
    for step in range(steps):
        sum_.update(b"".join(value.tobytes() for value in observation.values()) + repr(info).encode())
        action = rng.uniform(-1, 1, env.action_space.shape)
        action[0], action[5] = 0.2, 0.1
        observation, *_, info = env.step(action)
        if draws and step % 100 == 0:
            env.render()
    return sum_.hexdigest()


@pytest.mark.parametrize("env_id", IDS)
@pytest.mark.parametrize("mode", ["joint", "ee"])
def test_instances_and_histories_do_not_matter(env_id: str, mode: str) -> None:
    first, second = (gym.make(env_id, control_mode=mode).unwrapped for _ in range(2))
    expected = digest(first)
    assert digest(first) == expected, "an episode before it changed this one"
    for seed in range(3):
        second.reset(seed=seed)
        second.step(second.action_space.sample())
    second.reset(seed=9)
    assert digest(second) == expected


@pytest.mark.parametrize(
    "keywords",
    [
        {"object_set": "lying", "shapes": "mixed"},
        {"object_set": "low", "shapes": "box", "success": "lifted"},
        {"object_set": "tall", "terminate_on_fallen": True, "reward_mode": "dense"},
        {"object_set": "heavy", "shapes": "mixed", "layout": "island"},
        {"obstructed": 2, "layout": "dense"},
    ],
    ids=str,
)
def test_instances_and_histories_do_not_matter_whatever_the_objects(keywords: dict[str, Any]) -> None:
    first, second = (gym.make("clutter_env/Retrieve-o10-v0", **keywords).unwrapped for _ in range(2))
    expected = digest(first)
    assert digest(first) == expected, "an episode before it changed this one"
    second.reset(seed=9)
    second.step(second.action_space.sample())
    assert digest(second) == expected


def test_processes_do_not_matter() -> None:
    script = (
        f"import sys; sys.path.insert(0, {__file__.rsplit('/', 1)[0]!r})\n"
        "from test_determinism import *\n"
        "sys.stdout.write(digest(gym.make(IDS[0]).unwrapped))"
    )
    result = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert result.stdout == digest(gym.make(IDS[0]).unwrapped)


@pytest.mark.usefixtures("needs_gl")
def test_meshes_and_pictures_do_not_matter() -> None:
    env = gym.make(IDS[0], render_mode="rgb_array").unwrapped
    assert digest(env, draws=True) == digest(gym.make(IDS[0]).unwrapped)
    env.close()


def test_explicit_scenes_leave_no_trace() -> None:
    env, fresh = (gym.make("clutter_env/Retrieve-o5-v0").unwrapped for _ in range(2))
    boxes = [{"shape": "box", "depth": 0.05, "width": 0.05, "height": 0.1, "position": (0, y)} for y in (-0.2, 0.2)]
    env.reset(seed=1, options={"objects": boxes})
    for _ in range(20):
        env.step(env.action_space.sample())
    assert digest(env, steps=50) == digest(fresh, steps=50)


def test_model_constants_are_those_of_a_fresh_model() -> None:
    env, fresh = (gym.make("clutter_env/Retrieve-o20-v0", shapes="mixed").unwrapped for _ in range(2))
    for seed in range(4):
        env.reset(seed=seed)
        for _ in range(10):
            env.step(env.action_space.sample())
    env.reset(seed=8)
    fresh.reset(seed=8)
    for name in dir(env.model):
        mine = getattr(env.model, name)
        if isinstance(mine, np.ndarray):
            assert np.array_equal(mine, getattr(fresh.model, name), equal_nan=True), name
