"""Same seed, same bits: across instances and histories, with and without pictures and meshes."""

from __future__ import annotations

import hashlib
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

import clutter_env  # noqa: F401 - registers the environments

STEPS = 120
RETRIEVE = "clutter_env/Retrieve-o20-v0"


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


CASES = [
    ("Retrieve-o20-v0", {}),
    ("Retrieve-o20-v0", {"control_mode": "ee", "reward_mode": "dense"}),
    ("Reach-v0", {"control_mode": "joint"}),
    ("Pick-v0", {}),
    ("Retrieve-o10-v0", {"object_set": "lying", "shapes": "mixed"}),
    ("Retrieve-o10-v0", {"object_set": "low", "shapes": "box", "success": "lifted"}),
    ("Retrieve-o10-v0", {"object_set": "heavy", "shapes": "mixed", "layout": "island"}),
    ("Retrieve-o10-v0", {"obstructed": 2, "layout": "dense", "object_set": "tall", "terminate_on_fallen": True}),
]


@pytest.mark.parametrize(("name", "keywords"), CASES, ids=str)
def test_instances_and_histories_do_not_matter(name: str, keywords: dict[str, Any]) -> None:
    first, second = (gym.make(f"clutter_env/{name}", **keywords).unwrapped for _ in range(2))
    expected = digest(first)
    assert digest(first) == expected, "an episode before it changed this one"
    for seed in range(3):
        second.reset(seed=seed)
        second.step(second.action_space.sample())
    second.reset(seed=9)
    assert digest(second) == expected


@pytest.mark.usefixtures("needs_gl")
def test_meshes_and_pictures_do_not_matter() -> None:
    env = gym.make(RETRIEVE, render_mode="rgb_array").unwrapped
    assert digest(env, draws=True) == digest(gym.make(RETRIEVE).unwrapped)
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
