"""Saved states that someone has changed and sealed again: refused without any change, or valid."""

from __future__ import annotations

import copy
import hashlib
import json
import zlib
from collections.abc import Iterator
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

import clutter_env  # noqa: F401 - registers the environments
from clutter_env.envs.base import BaseEnv
from clutter_env.errors import StateError

MAGIC = b"clutter-env state 4\n"
BAD_VALUES = (float("nan"), 1e999, -1e300, 10**30, 77, -5, True, None, "0", [], [[]], {}, {"a": 1})
MANY = 20
"""Lists longer than this are changed at their first, middle and last entries alone."""

Path = tuple[str | int, ...]


def opened(state: bytes) -> Any:
    """The JSON values in the bytes of a state."""
    return json.loads(zlib.decompress(state[len(MAGIC) + 32 :]))


def seal(content: Any) -> bytes:
    """Bytes with the right checksum."""
    body = zlib.compress(json.dumps(content).encode(), level=1)
    return MAGIC + hashlib.sha256(body).digest() + body


def paths(value: Any, path: Path = ()) -> Iterator[Path]:
    """All places in nested dictionaries and lists, the inner nodes too."""
    if path:
        yield path
    if isinstance(value, dict):
        for name, entry in value.items():
            yield from paths(entry, (*path, name))
    if isinstance(value, list):
        size = len(value)
        for index in range(size) if size <= MANY else (0, size // 2, size - 1):
            yield from paths(value[index], (*path, index))


def changed(content: Any, path: Path, value: Any) -> Any:
    result = copy.deepcopy(content)
    at(result, path[:-1])[path[-1]] = value
    return result


def at(content: Any, path: Path) -> Any:
    for step in path:
        content = content[step]
    return content


def made(name: str, **keywords: Any) -> BaseEnv:
    """An environment in which something has happened."""
    env = gym.make(name, **keywords).unwrapped
    assert isinstance(env, BaseEnv)
    env.reset(seed=3)
    actions = np.random.default_rng(0).uniform(-1, 1, (8, env.action_size))
    for action in actions:
        env.step(action)
    return env


def snapshot(env: BaseEnv) -> tuple[bytes, ...]:
    """All that a refusal must leave alone, the model's sizes and the generator included."""
    model = env.model
    sizes = (model.geom_size, model.body_mass, model.geom_rgba, model.qpos0, env.data.qacc, env.data.xpos)
    return (env.save_state(), repr(env.world.shapes).encode(), *(array.tobytes() for array in sizes))


CASES = [
    ("clutter_env/Retrieve-o5-v0", {}),
    ("clutter_env/Pick-v0", {}),
    ("clutter_env/ArmPick-v0", {}),
    ("clutter_env/Reach-v0", {"control_mode": "joint"}),
]


@pytest.mark.parametrize("every", [5, pytest.param(1, marks=pytest.mark.slow)])
@pytest.mark.parametrize(("name", "keywords"), CASES)
def test_bad_values_of_every_field_are_refused(name: str, keywords: dict[str, Any], every: int) -> None:
    """Bad values in place of every value, `every` so many of them, in turn."""
    env = made(name, **keywords)
    state = env.save_state()
    env.restore_state(state)
    content, before = opened(state), snapshot(env)
    refused = 0
    for number, path in enumerate(paths(content)):
        original = at(content, path)
        for value in BAD_VALUES[number % every :: every]:
            if value == original and type(value) is type(original):
                continue
            hostile = changed(content, path, value)
            try:
                env.restore_state(seal(hostile))
            except StateError:
                refused += 1
            else:
                assert is_plausible(path, original, value), f"{path}: {value!r} in place of {original!r}"
                env.step(np.zeros(env.action_size))
                env.restore_state(state)
    assert refused > 200
    assert snapshot(env) == before


def is_plausible(path: Path, original: object, value: object) -> bool:
    """Whether a value is of the same type as the valid one, or a whole number in place of any number."""
    if path[-1] in ("counts", "lists", "rng", "kind") or isinstance(original, dict | list):
        return False
    return type(value) is type(original) or (type(original) is float and type(value) is int)


@pytest.mark.parametrize("name", [case[0] for case in CASES])
def test_missing_and_additional_entries_are_refused(name: str) -> None:
    env = made(name)
    content, before = opened(env.save_state()), snapshot(env)
    for path in [path for path in paths(content) if len(path) < 3 or path[-1] == 0]:
        holder = at(content, path[:-1])
        for hostile in removed_and_added(content, path, holder):
            with pytest.raises(StateError):
                env.restore_state(seal(hostile))
    assert snapshot(env) == before


def removed_and_added(content: Any, path: Path, holder: Any) -> Iterator[Any]:
    without = copy.deepcopy(content)
    del at(without, path[:-1])[path[-1]]
    yield without
    more = copy.deepcopy(content)
    if isinstance(holder, dict):
        at(more, path[:-1])["more"] = 0
    else:
        at(more, path[:-1]).append(holder[-1])
    yield more


CONTRADICTIONS = {
    "a sleep index outside the lists": (("physics", "lists", "dof_awake_ind", 0), 40_000_000),
    "a negative sleep index": (("physics", "lists", "body_awake_ind", 1), -40_000_000),
    "a tree that sleeps in no cycle": (("physics", "lists", "tree_asleep", 1), 2),
    "a robot that sleeps": (("physics", "lists", "tree_asleep", 0), 0),
    "more awake dofs than dofs": (("physics", "counts", "nv_awake"), 40_000_000),
    "a negative mass": (("scene", "masses", 0), -0.2),
    "no mass": (("scene", "masses", 0), 0.0),
    "an oval cylinder": (("scene", "half_extents", 0, 0), 0.031),
    "a negative size": (("scene", "half_extents", 0, 2), -0.05),
    "a target that is not there": (("scene", "target"), 77),
    "no target": (("scene", "target"), -1),
    "a box that lies on its side": (("scene",), {"is_box": [True] * 5, "is_lying": [True] * 5}),
    "an object in hand that is not there": (("memory", "grip", "held", 0), 77),
    "nothing that is carried": (("memory", "grip"), {"held": [-1], "is_carried": [True]}),
    "a negative path": (("memory", "monitor", "paths", 0), -1.0),
    "half an object in a hand": (("memory", "monitor", "hands", 0, 0), 0.5),
    "held again before it was not": (("memory", "monitor", "hands", 0, 1), -3.0),
    "a window of forces above the largest mean": (("memory", "pressing", 0, -1), 4000.0),
    "an open impulse above the largest": (("memory", "pressing", 1, 3), 0.5),
    "a slide without an impulse": (("memory", "pressing", 1, 2), 0.5),
    "an impulse without a slide": (("memory", "pressing", 1, 1), 0.5),
    "no time": (("physics", "integration", 0), float("nan")),
}


@pytest.mark.parametrize("case", CONTRADICTIONS)
def test_contradictions_are_refused(case: str) -> None:
    path, value = CONTRADICTIONS[case]
    env = made("clutter_env/Retrieve-o5-v0")
    content, before = opened(env.save_state()), snapshot(env)
    state = seal(changed(content, path, {**at(content, path), **value} if isinstance(value, dict) else value))
    with pytest.raises(StateError):
        env.restore_state(state)
    with pytest.raises(StateError):
        env.reset(seed=8, options={"state": state})
    assert snapshot(env) == before


@pytest.mark.parametrize("version", [1, 2])
def test_states_of_an_older_version_are_refused_by_name(version: int) -> None:
    env = made("clutter_env/Retrieve-o5-v0")
    with pytest.raises(StateError, match=rf"version 0\.{version}"):
        env.restore_state(env.save_state().replace(MAGIC, f"clutter-env state {version}\n".encode()))


def test_a_refused_scene_of_other_shapes_does_not_switch_the_world() -> None:
    env = made("clutter_env/Retrieve-o5-v0")
    content, before, world = opened(env.save_state()), snapshot(env), env.world
    content["scene"]["is_box"] = [True] * 5
    content["physics"]["integration"][3] = "far"
    with pytest.raises(StateError, match="integration"):
        env.restore_state(seal(content))
    assert env.world is world
    assert snapshot(env) == before


def test_a_sleeping_body_does_not_move_and_quaternions_are_of_unit_length() -> None:
    env = made("clutter_env/Retrieve-o5-v0")
    content, before = opened(env.save_state()), snapshot(env)
    velocity = int(env.model.nq + env.model.nv)
    quaternion = int(env.model.nq) - 3
    for place, value in ((velocity, 0.5), (quaternion, 0.0), (quaternion, 3.0)):
        with pytest.raises(StateError):
            env.restore_state(seal(changed(content, ("physics", "integration", place), value)))
    assert snapshot(env) == before


@pytest.mark.parametrize("place", ["object", "object turning", "joint", "base", "force", "controller", "fingers"])
def test_motion_that_cannot_occur_is_refused(place: str) -> None:
    """Such a state diverged in the next step, or its forces carried the target up."""
    env = made("clutter_env/Retrieve-o5-v0")
    content, before = opened(env.save_state()), snapshot(env)
    wake(env, content["physics"])
    velocities, drive = 1 + int(env.model.nq), env.world.index.drive_dof
    parts, numbers = content["memory"], content["physics"]["integration"]
    entry, value = {
        "object": (velocities + env.world.index.object_dof.start, 30.0),
        "object turning": (velocities + env.world.index.object_dof.start + 5, -3e3),
        "joint": (velocities + int(drive[-1]), 300.0),
        "base": (velocities + int(drive[0]), -30.0),
        "force": (len(numbers) - env.model.neq - 4, 5.0),  # up, on the last object
        "controller": (0, 40.0),
        "fingers": (0, 0.3),
    }[place]
    {"controller": parts["velocity"], "fingers": parts["fingers"]}.get(place, numbers)[entry] = value
    with pytest.raises(StateError, match=r"velocit|forces|fingers"):
        env.restore_state(seal(content))
    assert snapshot(env) == before


def test_bytes_that_cannot_be_decoded_are_refused() -> None:
    env = made("clutter_env/Retrieve-o5-v0")
    before = snapshot(env)
    bombs = [zlib.compress(b"0" * 2**26), zlib.compress(b"[" * 100_000), b"no zlib", zlib.compress(b'{"a": }')]
    bombs += [zlib.compress(b"\xff\xfe"), zlib.compress(b"{}")[:-3], zlib.compress(b"{}") + b"more", b""]
    bombs += [zlib.compress(b"1" * 6000)]
    for body in bombs:
        with pytest.raises(StateError):
            env.restore_state(MAGIC + hashlib.sha256(body).digest() + body)
    assert snapshot(env) == before


@pytest.mark.parametrize("bit_generator", [np.random.MT19937, np.random.PCG64DXSM])
def test_a_generator_of_another_kind_is_refused(bit_generator: type) -> None:
    env = made("clutter_env/Retrieve-o5-v0")
    content, before = opened(env.save_state()), snapshot(env)
    other = bit_generator(3).state
    content["memory"]["rng"] = json.loads(json.dumps(other, default=lambda array: array.tolist()))
    with pytest.raises(StateError, match="PCG64"):
        env.restore_state(seal(content))
    assert snapshot(env) == before


def test_sleeping_objects_that_overlap_are_refused() -> None:
    """MuJoCo stops with a fatal error when one of them is touched."""
    env = made("clutter_env/Retrieve-o5-v0")
    content, before = opened(env.save_state()), snapshot(env)
    content["scene"]["half_extents"][0] = [0.5, 0.5, 0.2]
    with pytest.raises(StateError, match="overlap"):
        env.restore_state(seal(content))
    assert snapshot(env) == before


def test_awake_objects_in_one_place_are_restored_without_a_crash() -> None:
    """A state that is valid, though no simulation reaches it: 60 objects inside one another."""
    env = made("clutter_env/Retrieve-o60-v0")
    content = opened(env.save_state())
    first = 1 + int(env.model.nq) - 7 * 60
    place = content["physics"]["integration"][first : first + 7]
    content["physics"]["integration"][first : first + 7 * 60] = place * 60
    wake(env, content["physics"])
    env.restore_state(seal(content))
    for _ in range(5):
        env.step(np.zeros(env.action_size))


def wake(env: BaseEnv, physics: dict[str, Any]) -> None:
    """Wake every body of a state."""
    trees, bodies, dofs = env.model.ntree, env.model.nbody, env.model.nv
    physics["lists"] = {
        "tree_asleep": [-1] * trees,
        "tree_awake": [1] * trees,
        "body_awake": [-1 if tree < 0 else 1 for tree in env.model.body_treeid],
        "body_awake_ind": list(range(bodies)),
        "parent_awake_ind": [*range(1, bodies), 0],
        "dof_awake_ind": list(range(dofs)),
    }
    physics["counts"] = {"ntree_awake": trees, "nbody_awake": bodies, "nparent_awake": bodies - 1, "nv_awake": dofs}
