"""Options of a reset with values of every wrong kind: refused with an error of the package, or carried out."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from decimal import Decimal
from fractions import Fraction
from types import MappingProxyType
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

import clutter_env  # noqa: F401  registers the environments
from clutter_env.errors import ClutterEnvError

KINDS: dict[str, dict[str, Any]] = {
    "Retrieve": {"id": "clutter_env/Retrieve-o5-v0"},
    "household": {"id": "clutter_env/Retrieve-o5-v0", "object_set": "household"},
    "standing": {"id": "clutter_env/Retrieve-o5-v0", "base": "fixed"},
    "Rearrange": {"id": "clutter_env/Rearrange-o4-v0"},
    "Search": {"id": "clutter_env/Search-o5-v0", "image_size": 16, "visible_fraction": 1.0},
    "Skill": {"id": "clutter_env/Skill-o5-v0", "simulation": "kinematic"},
    "Reach": {"id": "clutter_env/Reach-v0"},
    "Pick": {"id": "clutter_env/Pick-v0"},
    "ArmPick": {"id": "clutter_env/ArmPick-v0"},
}
HOSTILE: tuple[Any, ...] = (
    None,
    True,
    np.True_,
    0,
    5,
    -1,
    10**400,
    0.5,
    float("nan"),
    float("inf"),
    1j,
    Fraction(1, 3),
    Decimal("0.1"),
    "",
    "object_00",
    "(and",
    "(on object_00 object_00)",
    "\x00",
    "(" * 5000,
    b"",
    b"{}",
    np.str_("object_00"),
    *(np.array(value) for value in (5, np.nan, [], [1.0, 2.0], [1.0, 2.0, 3.0], np.eye(3), "text", ["a", "b"])),
    np.array([None, None], object),
    np.array([1, "a", None], object),
    np.array([{}, {}], object),
    np.ma.masked_array([1.0, 2.0], mask=[True, False]),
    np.datetime64("nat"),
    (),
    [],
    [1],
    [None],
    ["object_00"],
    ["on", "object_00", "table"],
    [["on"]],
    [["on", 1, 2]],
    [["on", ["a"], {}]],
    [[]],
    [[[]]],
    [np.array(5)],
    [np.array([1, 2])],
    [[np.array(["on", "a"])]],
    (1, 2),
    (1, 2, 3),
    ("a", "b"),
    (np.array([1.0]), np.array([2.0])),
    ([1.0], [2.0], [3.0]),
    {},
    {"a": 1},
    {1: 2},
    [{}],
    [{1: 2}],
    [{None: None}],
    {"x": 0.0, "y": 0.0},
    MappingProxyType({"position": 1}),
    set(),
    {1.0, 2.0},
    range(2),
    range(3),
    iter([1.0, 2.0]),
    (value for value in (1.0, 2.0, 3.0)),
    memoryview(b"ab"),
    bytearray(b"{}"),
    object(),
    object,
    int,
    len,
    ...,
    NotImplemented,
)
OBJECT = {"shape": "cylinder", "radius": 0.03, "height": 0.15, "position": (0.0, 0.0)}
BOX = {"shape": "box", "depth": 0.05, "width": 0.05, "height": 0.15, "position": (0.1, 0.1)}
REGION = {"name": "place", "support": "table", "centre": (0.0, 0.0), "half_extents": (0.1, 0.1)}
FACTS = ("holding", "on", "inside", "at", "clear", "before", "open", "closed", "turned")


def options() -> Iterator[Any]:
    """Every hostile value as the options, as each option, and in each place within one."""
    yield from HOSTILE
    for value in HOSTILE:
        for name in ("target", "objects", "state", "obstructed", "base", "task", "goal", "regions", "text"):
            yield {name: value}
            yield {name: [value]}
            yield {name: [value, value, value]}
            yield {name: {"a": value}}
        if is_hashable(value):
            yield {value: 1}
            yield {"objects": [{**OBJECT, value: 1}]}
        for thing in (OBJECT, BOX):
            for key in (*thing, "yaw", "mass", "row", "lying", "color"):
                yield {"objects": [{**thing, key: value}]}
            yield {"objects": [{**thing, "position": (0.0, value)}]}
            yield {"objects": [thing, value]}
        for fact in FACTS:
            yield {"goal": [[fact, value]]}
            yield {"goal": [[fact, "object_00", value]]}
            yield {"goal": [[fact, "object_00", "table", value]]}
        for key in (*REGION, "yaw", "drop", "colour"):
            region = {**REGION, key: value}
            yield {"regions": [region]}
            yield {"regions": [region], "goal": "(inside object_00 place)"}
        yield {"regions": [{**REGION, "centre": (0.0, value)}]}
        yield {"base": (0.0, 0.0, value)}
        for name, other in itertools.product(("target", "obstructed", "task", "state"), ("objects", "base", "goal")):
            yield {name: value, other: [value]}


def is_hashable(value: Any) -> bool:
    """Whether it can be a key: a tuple of arrays says it is hashable, and is not."""
    try:
        hash(value)
    except (TypeError, ValueError):
        return False
    return True


@pytest.fixture(
    scope="module", params=[pytest.param(kind, marks=[pytest.mark.slow] * (kind == "standing")) for kind in KINDS]
)
def env(request: pytest.FixtureRequest) -> gym.Env:
    made = gym.make(**KINDS[request.param], disable_env_checker=True)
    made.reset(seed=0)
    return made.unwrapped


def test_wrong_values_end_in_an_error_of_the_package_or_in_an_episode(env: gym.Env) -> None:
    refused = 0
    raw: dict[str, str] = {}
    before = repr(env.np_random.bit_generator.state)
    for given in options():
        try:
            env.reset(options=given)
        except ClutterEnvError:
            refused += 1
            assert repr(env.np_random.bit_generator.state) == before, "a refused reset changes nothing"
        except Exception as problem:
            raw.setdefault(f"{type(problem).__name__}: {problem}"[:100], repr(given)[-150:])
        before = repr(env.np_random.bit_generator.state)
    assert not raw
    assert refused > 1000
