"""Robots whose shapes have no names, as in most files."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import gymnasium as gym

import clutter_env
from assets import FETCH
from planners import Scene

assert clutter_env  # registers the environments


def test_shapes_without_names_are_the_robot_s_own(tmp_path: Path) -> None:
    """Where some shapes of two bodies count and others do not, those that do get names: the planner refused them."""
    text = re.sub(r'(<geom) name="(?!.*finger)[^"]*"', r"\1", FETCH.mjcf_path.read_text())
    (tmp_path / "fetch.xml").write_text(text)
    env = gym.make("clutter_env/Retrieve-o1-v0", robot=replace(FETCH, mjcf=str(tmp_path / "fetch.xml")))
    env.reset(seed=0)
    model, data = env.unwrapped.model, env.unwrapped.data
    assert any(model.geom(geom).name.startswith("robot_geom_") for geom in range(model.ngeom))
    assert Scene.from_mujoco(model, data, env.unwrapped.robot).names == ("object_00",)
