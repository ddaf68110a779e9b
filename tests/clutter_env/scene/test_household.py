"""Household objects: they stand where they are put, are measured as they are, and other object sets are as before."""

from __future__ import annotations

import math
from typing import Any

import gymnasium as gym
import mujoco
import numpy as np
import pytest

import clutter_env
from clutter_env.envs.observation import OBJECT_FIELDS, OBJECT_KINDS
from clutter_env.policies.protocol import PolicyError, begin_episode
from clutter_env.policies.registry import load_policy
from clutter_env.scene.household import KINDS, HouseholdScene, slot_kinds
from clutter_env.scene.layout import LAYOUTS, OBJECT_GAP
from clutter_env.scene.object_sets import OBJECT_SETS, capacity
from clutter_env.scene.random_scene import sample_scene
from planners import Scene, Solution, generate_grasps, solve
from planners.grasping.families import GRASP_SETS

ID = "clutter_env/Retrieve-o15-v0"
BOX = {"shape": "box", "depth": 0.06, "width": 0.06, "height": 0.1, "position": [0.0, 0.0]}


@pytest.fixture(scope="module")
def env() -> gym.Env:
    return gym.make(ID, object_set="household")


def test_there_are_twelve_kinds_of_real_size_and_mass() -> None:
    assert len(KINDS) == 12
    assert not KINDS.keys() & {"cylinder", "box"}, "these are shapes of other sets"
    for kind in KINDS.values():
        assert 0.02 < 2 * kind.half_extents.min() <= 2 * kind.half_extents.max() < 0.3, kind.name
        assert 0.1 <= kind.mass <= 0.8, kind.name
        for sign in (-1, 1):
            points, radii = kind.cloud
            assert (sign * points + radii[:, None]).max(axis=0) == pytest.approx(kind.half_extents, abs=1e-4)


def test_the_observation_has_the_kind_of_each_object_in_a_last_column(env: gym.Env) -> None:
    observation, _ = env.reset(seed=0)
    inner = env.unwrapped
    layout = inner.observation_layout["objects"]  # type: ignore[attr-defined]  # of this package
    assert tuple(column.name for column in layout.columns) == (*OBJECT_FIELDS, "kind")
    rows = observation["objects"].reshape(15, layout.size)
    assert [OBJECT_KINDS[int(number)] for number in rows[:, layout.index("kind")]] == list(slot_kinds(15))
    assert observation in env.observation_space
    observation, _ = env.reset(options={"objects": [BOX]})
    assert observation["objects"].reshape(15, -1)[:, -1].tolist() == [-1.0] + [0.0] * 14
    plain = gym.make(ID)
    assert plain.reset(seed=0)[0]["objects"].size == 15 * len(OBJECT_FIELDS)
    with pytest.raises(PolicyError, match="household"):
        begin_episode(load_policy("keyframes", 0), {}, env)


@pytest.mark.parametrize("layout", ["paper", "shelf", "two_boards"])
def test_household_scenes_fit_the_table_and_keep_apart(layout: str) -> None:
    place, objects = LAYOUTS[layout], OBJECT_SETS["household"]
    count = capacity(place, "cylinder", objects)
    for seed in range(5):
        scene = sample_scene(np.random.default_rng(seed), place, count, objects=objects)
        radii = np.hypot(scene.half_extents[:, 0], scene.half_extents[:, 1])
        away = np.linalg.norm(scene.positions[:, None] - scene.positions, axis=2) - radii[:, None] - radii
        beside = (scene.levels[:, None] == scene.levels) & ~np.eye(count, dtype=bool)
        assert (away[beside] > OBJECT_GAP - 1e-9).all()
        assert (np.abs(scene.positions) + radii[:, None] <= np.array((place.depth, place.width)) / 2 + 1e-9).all()


def test_every_kind_is_at_rest_where_a_reset_puts_it(env: gym.Env) -> None:
    env.reset(seed=0)
    world = env.unwrapped.world  # type: ignore[attr-defined]  # of this package
    assert world.shapes == slot_kinds(15)
    model, start = world.model, world.data.qpos[world.index.object_qpos].copy()
    data = mujoco.MjData(model)
    data.qpos[:], data.ctrl[:] = world.data.qpos, world.data.ctrl
    sleeps = int(mujoco.mjtEnableBit.mjENBL_SLEEP)
    model.opt.enableflags &= ~sleeps
    mujoco.mj_step(model, data, nstep=500)
    model.opt.enableflags |= sleeps
    moved = np.abs(data.qpos[world.index.object_qpos] - start).reshape(-1, 7)
    assert moved[:, :3].max() < 0.001
    assert moved[:, 3:].max() < 0.005


def test_the_planner_reads_the_parts_and_grasps_every_kind(env: gym.Env) -> None:
    env.reset(seed=1)
    inner = env.unwrapped
    scene = Scene.from_mujoco(inner.model, inner.data, inner.robot)  # type: ignore[attr-defined]  # of this package
    world = inner.world  # type: ignore[attr-defined]  # of this package
    measured, seen = world.measure(), set[str]()
    for slot, (body, name) in enumerate(zip(scene.objects, world.shapes, strict=True)):
        assert body.half_extents == pytest.approx(KINDS[name].half_extents, abs=1e-4), name
        assert body.position == pytest.approx(measured.poses[slot, :3])
        assert body.bottom == pytest.approx(world.lowest_point(measured, slot), abs=1e-4)
        assert model_mass(inner.model, body.name) == pytest.approx(KINDS[name].mass)  # type: ignore[attr-defined]  # of this package
        if name not in seen:
            seen.add(name)
            assert any(generate_grasps(body, scene.robot, GRASP_SETS[grasps]) for grasps in ("side", "top")), name


def model_mass(model: mujoco.MjModel, name: str) -> float:
    return float(model.body(name).mass[0])


def test_the_lowest_point_of_a_leaning_object_is_that_of_its_geoms(env: gym.Env) -> None:
    env.reset(seed=2)
    inner, rng = env.unwrapped, np.random.default_rng(0)
    world = inner.world  # type: ignore[attr-defined]  # of this package
    q = world.data.qpos[world.index.object_qpos].reshape(-1, 7)
    q[:, 3:] = rng.normal(size=(15, 4))
    q[:, 3:] /= np.linalg.norm(q[:, 3:], axis=1, keepdims=True)
    scene = Scene.from_mujoco(inner.model, world.data, inner.robot)  # type: ignore[attr-defined]  # of this package
    measured = world.measure()
    for slot, body in enumerate(scene.objects):
        assert world.lowest_point(measured, slot) == pytest.approx(body.bottom, abs=0.0003)


def test_a_saved_state_goes_on_alike_in_another_environment(env: gym.Env) -> None:
    env.reset(seed=3)
    state, ends = env.unwrapped.save_state(), []  # type: ignore[attr-defined]  # of this package
    for seed in (4, 5):
        other = gym.make(ID, object_set="household")
        other.reset(seed=seed)
        other.unwrapped.restore_state(state)  # type: ignore[attr-defined]  # of this package
        assert isinstance(other.unwrapped.world.scene, HouseholdScene)  # type: ignore[attr-defined]  # of this package
        other.action_space.seed(0)
        for _ in range(10):
            observation = other.step(other.action_space.sample())[0]
        ends.append(np.concatenate([np.ravel(value) for value in observation.values()]))
    assert np.array_equal(*ends)


def test_explicit_objects_stay_cylinders_and_boxes(env: gym.Env) -> None:
    entry = {"shape": "cylinder", "position": (0.0, 0.0), "radius": 0.03, "height": 0.15}
    env.reset(seed=0, options={"objects": [entry]})
    assert env.unwrapped.world.shapes == ("cylinder",)  # type: ignore[attr-defined]  # of this package
    assert math.isclose(env.unwrapped.model.geom("object_00").size[0], 0.03)  # type: ignore[attr-defined]  # of this package


@pytest.mark.slow
def test_a_bowl_under_a_board_is_taken_by_its_rim() -> None:
    place = clutter_env.suite("household-shelf-10-v2").test[46]
    env = place.make()
    _, info = place.reset(env)
    inner: Any = env.unwrapped
    scene = Scene.from_mujoco(inner.model, inner.data, inner.robot)
    assert inner.world.shapes[scene.names.index(info["target"])] == "bowl"
    assert isinstance(solve(scene, info["target"]), Solution)
