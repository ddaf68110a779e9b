"""Scenes: what they read from MuJoCo, their masks, and how they refuse nonsense."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np
import pytest

from assets.robots import FETCH
from clutter_env.scene.layout import LAYOUTS, supports_of
from clutter_env.scene.object_sets import capacity
from clutter_env.scene.random_scene import sample_scene
from clutter_env.simulation.model import ModelIndex, compile_model
from planners.scene import Body, HeldObject, Scene, SceneError, UnknownObject
from tests.planners.motion_scenes import mixed_scene
from tests.planners.scenes import cylinder, table_scene


def test_masks_and_names_are_inverse() -> None:
    scene = mixed_scene(20, 0)
    rng = np.random.default_rng(0)
    for _ in range(20):
        names = tuple(name for name in scene.names if rng.random() < 0.3)
        assert scene.names_of(scene.mask(names)) == names
    assert scene.names_of(1 << 63 | 1 << 62) == ()


@pytest.mark.parametrize("seed", range(3))
def test_extents_contain_every_point_of_a_body_and_touch_one(seed: int) -> None:
    rng = np.random.default_rng(seed)
    for body in mixed_scene(15, seed).objects:
        local = rng.uniform(-1, 1, (4000, 3))
        if body.shape == "box":
            local /= np.abs(local).max(axis=1, keepdims=True)
        else:
            local[:, :2] /= np.linalg.norm(local[:, :2], axis=1, keepdims=True)
            local[:, 2] = np.where(rng.random(4000) < 0.5, 1.0, -1.0)
        points = body.position + (local * body.half_extents) @ body.rotation.T
        assert body.bottom <= points[:, 2].min() + 1e-12
        assert points[:, 2].max() <= body.top + 1e-12
        assert body.top - points[:, 2].max() < 0.01
        reach = np.hypot(*(points - body.position)[:, :2].T).max()
        assert reach <= body.radius + 1e-12
        assert body.radius - reach < 0.02


def test_arrays_cannot_be_written() -> None:
    scene = mixed_scene(3, 0)
    for array in (
        scene.objects[0].position,
        scene.objects[0].rotation,
        scene.state.q,
        scene.static_obstacles[0].half_extents,
    ):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1.0


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda scene: scene.body("cup"), "known objects: object_00, object_01"),
        (lambda scene: scene.with_held(HeldObject("cup", np.eye(4))), "known objects"),
        (lambda scene: Scene(FETCH, scene.state, (scene.objects[0],) * 2, scene.static_obstacles), "duplicate"),
        (lambda scene: Scene(FETCH, scene.state, scene.objects, ()).support, "table_top"),
        (lambda _: table_scene(*(cylinder(f"object_{i:02d}", 0.1 * i, 0.0) for i in range(61))), "at most 60"),
    ],
)
def test_nonsense_is_refused_with_the_valid_names(change: Callable[[Scene], object], message: str) -> None:
    with pytest.raises(SceneError, match=message):
        change(mixed_scene(2, 0))
    assert issubclass(UnknownObject, SceneError)


@pytest.mark.parametrize(
    ("shape", "half_extents", "position", "message"),
    [
        ("cone", [1, 1, 1], [0, 0, 0], "known shapes"),
        ("box", [1, 0, 1], [0, 0, 0], "positive"),
        ("box", [1, 1, 1], [0, np.nan, 0], "finite"),
        ("box", [1, 1], [0, 0, 0], "shape"),
    ],
)
def test_impossible_bodies_are_refused(shape: Any, half_extents: Any, position: Any, message: str) -> None:
    with pytest.raises(SceneError, match=message):
        Body("a", shape, half_extents, position, np.array([1.0, 0, 0, 0]))


@pytest.mark.parametrize("layout", sorted(LAYOUTS))
def test_from_mujoco_reads_what_the_simulation_holds(layout: str) -> None:
    count = min(10, capacity(LAYOUTS[layout], "mixed"))
    contents = sample_scene(np.random.default_rng(0), LAYOUTS[layout], count, "mixed")
    model = compile_model(FETCH, LAYOUTS[layout], contents.shapes)
    data = mujoco.MjData(model)
    index = ModelIndex.of(model, FETCH, count)
    rng = np.random.default_rng(1)
    for i in range(count):
        quaternion = rng.normal(size=4)
        data.joint(f"object_{i:02d}_joint").qpos[:] = [
            *rng.uniform(-1, 1, 3),
            *(quaternion / np.linalg.norm(quaternion)),
        ]
    data.qpos[index.drive_qpos] = [-1.0, 0.2, 0.3, *FETCH.home]
    data.qpos[index.finger_qpos] = 0.02
    mujoco.mj_forward(model, data)
    before = data.qpos.copy()
    first = supports_of(LAYOUTS[layout])[0]
    scene = Scene.from_mujoco(model, data, FETCH, held="object_04", support=first)
    assert np.array_equal(before, data.qpos)
    assert np.allclose(scene.state.base, [-1.0, 0.2, 0.3])
    assert np.allclose(scene.state.q, FETCH.home)
    assert scene.state.finger_position == 0.0, "commanded to close on what is held"
    for body in scene.objects:
        assert np.allclose(body.position, data.geom(body.name).xpos)
        assert np.allclose(body.rotation, data.geom(body.name).xmat.reshape(3, 3))
    for box in scene.static_obstacles:
        assert np.allclose(box.half_extents, model.geom(box.name).size)
        assert np.allclose(box.position, data.geom(box.name).xpos)
    assert scene.support.top == pytest.approx(0.78 if LAYOUTS[layout].has_drawers else 0.75)
