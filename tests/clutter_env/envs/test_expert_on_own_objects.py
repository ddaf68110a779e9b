"""The expert on a layout and a robot of the user's own: from `gym.make` to the lifted target."""

from __future__ import annotations

from dataclasses import replace

import gymnasium as gym
import pytest

import clutter_env  # noqa: F401 - registers the environments
from assets.robots import FETCH
from clutter_env.scene.layout import Box, Layout
from planners.expert.expert import TampExpert

BENCH = Layout("bench", depth=0.5, width=0.9, is_front_only=False)
CRATE = Box("crate", (0.0, 1.1, 0.3), (0.2, 0.2, 0.3))
OBJECTS = [{"radius": 0.03, "height": 0.16, "position": (x, y)} for x, y in ((-0.1, 0.0), (0.1, 0.2), (0.15, -0.2))]


@pytest.mark.parametrize(
    "keywords",
    [
        {"layout": BENCH},
        pytest.param(
            {"layout": replace(BENCH, boxes=(CRATE,)), "robot": replace(FETCH, name="mine")}, marks=pytest.mark.slow
        ),
    ],
)
def test_the_expert_lifts_a_free_target(keywords: dict) -> None:
    env = gym.make("clutter_env/Retrieve-o5-v0", **keywords)
    _, info = env.reset(seed=0, options={"objects": OBJECTS, "target": "object_00"})
    expert = TampExpert(env)
    expert.reset(info["target"])
    while not (expert.done or info["is_success"]):
        *_, info = env.step(expert.act())
    assert info["is_success"], expert.report
    assert info["num_fallen"] == 0
