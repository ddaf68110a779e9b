"""A refused reset changes nothing, the random generator included."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import pytest

import clutter_env  # noqa: F401 - registers the environments
from clutter_env.errors import ClutterEnvError

RETRIEVE, PICK, SKILL = "clutter_env/Retrieve-o5-v0", "clutter_env/Pick-v0", "clutter_env/Skill-o5-v0"
CYLINDER = {"shape": "cylinder", "radius": 0.03, "height": 0.15, "position": (0.0, 0.0)}
REFUSED: list[dict[str, Any]] = [
    {"options": {"target": "object_99"}},
    {"options": {"objects": [CYLINDER, CYLINDER]}},
    {"options": {"objects": [CYLINDER], "target": "object_03"}},
    {"options": {"state": b"nothing"}},
    {"options": {"goal": 1}},
    {"options": 5},
]


def generator_of(env: Any) -> tuple[object, ...]:
    generator = env._np_random
    return generator, env._np_random_seed, None if generator is None else repr(generator.bit_generator.state)


@pytest.mark.parametrize("name", [RETRIEVE, PICK, SKILL])
@pytest.mark.parametrize("seed", [None, 11])
@pytest.mark.parametrize("arguments", REFUSED, ids=range(len(REFUSED)))
def test_the_generator_is_left_alone(name: str, seed: int | None, arguments: dict[str, Any]) -> None:
    env: Any = gym.make(name).unwrapped
    inner = [env, env.physics_env] if name == SKILL else [env]
    before = [generator_of(one) for one in inner]
    with pytest.raises(ClutterEnvError):
        env.reset(seed=seed, **arguments)
    assert [generator_of(one) for one in inner] == before, "of a new environment"
    env.reset(seed=4)
    before, state = [generator_of(one) for one in inner], inner[-1].save_state()
    with pytest.raises(ClutterEnvError):
        env.reset(seed=seed, **arguments)
    assert [generator_of(one) for one in inner] == before
    assert inner[-1].save_state() == state


@pytest.mark.parametrize("seed", [-1, "three", 1.5])
def test_a_wrong_seed_changes_nothing(seed: object) -> None:
    env: Any = gym.make(RETRIEVE).unwrapped
    env.reset(seed=4)
    before, state = generator_of(env), env.save_state()
    with pytest.raises(gym.error.Error):
        env.reset(seed=seed)
    assert generator_of(env) == before
    assert env.save_state() == state


def test_the_next_episode_is_the_same_with_and_without_a_refusal() -> None:
    first, second = gym.make(RETRIEVE), gym.make(RETRIEVE)
    first.reset(seed=4)
    second.reset(seed=4)
    with pytest.raises(ValueError, match="object_99"):
        second.reset(seed=99, options={"target": "object_99"})
    one, other = first.reset()[0], second.reset()[0]
    assert all((one[name] == other[name]).all() for name in one)
