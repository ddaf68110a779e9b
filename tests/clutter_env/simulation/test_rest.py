"""Objects that have toppled come to rest and sleep; the head camera is in the head and sees the table top."""

from __future__ import annotations

import math

import mujoco
import numpy as np
import pytest

from clutter_env.envs.retrieve import RetrieveEnv
from clutter_env.scene.layout import TABLE_HEIGHT
from clutter_env.simulation.world import Grip
from tests.clutter_env.toppling import topple_objects


def test_toppled_objects_sleep_within_five_seconds() -> None:
    env = RetrieveEnv(num_objects=40)
    back = np.zeros(env.action_size, np.float32)
    back[0] = -1
    num_awake = []
    for seed in range(1):
        env.reset(seed=seed)
        topple_objects(env, np.random.default_rng(seed))
        for _ in range(100):
            info = env.step(back)[4]
        assert info["num_fallen"] > 20
        awake = env.data.body_awake[env.world.index.object_bodies] == int(mujoco.mjtSleepState.mjS_AWAKE)
        num_awake.append(int(awake.sum()))
    assert max(num_awake) <= 2, "without rolling friction 8 to 24 of 40 are awake"


@pytest.mark.parametrize("robot", ["fetch", "pr2"])
def test_the_head_camera_is_in_the_head(robot: str) -> None:
    env = RetrieveEnv(num_objects=1, robot=robot)
    model = env.model
    camera = model.camera("head")
    assert model.jnt_bodyid[model.joint(env.robot.head_joints[1]).id] == camera.bodyid[0]
    assert np.linalg.norm(camera.pos) < 0.15


@pytest.mark.parametrize("distance", [0.6, 0.85, 1.1])
def test_at_home_the_head_camera_sees_the_whole_table_top(distance: float) -> None:
    """From where the base works to the farthest start, facing the table."""
    env = RetrieveEnv(num_objects=1)
    env.reset(seed=0)
    layout, world = env.layout, env.world
    x, y = layout.depth / 2, layout.width / 2
    env.data.qpos[world.index.drive_qpos[:3]] = (-x - distance, 0.0, 0.0)
    mujoco.mj_forward(world.model, world.data)
    model, robot = world.model, world.model.body_rootid[world.index.base_body]
    camera = model.camera("head").id
    eye, axes = world.data.cam_xpos[camera], world.data.cam_xmat[camera].reshape(3, 3)
    half_view = math.tan(math.radians(model.cam_fovy[camera]) / 2)
    grid = [(a, b, TABLE_HEIGHT) for a in np.linspace(-x, x, 15) for b in np.linspace(-y, y, 21)]
    hidden = outside = 0
    for point in np.array(grid):
        right, up, back = (point - eye) @ axes
        outside += max(abs(right), abs(up)) >= -back * half_view
        ray = point - eye
        geom = np.zeros(1, np.int32)
        mujoco.mj_ray(model, world.data, eye, ray, None, 1, -1, geom)
        hidden += model.body_rootid[model.geom_bodyid[geom[0]]] == robot
    assert outside <= 0.02 * len(grid), "all but the nearest corners is inside the image"
    assert not hidden, "the arm is beside the view"


def test_measurements_are_new_only_when_something_has_changed() -> None:
    env = RetrieveEnv(num_objects=3)
    env.reset(seed=0)
    first = env.measurements
    env.step(np.zeros(env.action_size, np.float32))
    assert env.measurements is first, "all objects sleep"
    assert env.world.measure_objects(Grip((1,), (False,), True)).held == 1
    env.data.qpos[env.world.index.object_qpos][2] = TABLE_HEIGHT - 0.1
    moved = env.world.measure()
    assert moved.is_off.tolist() == moved.is_fallen.tolist() == [True, False, False]
    env.world.apply_scene(env.world.scene)
    assert env.world.measure() is not moved, "sizes and masses may be others"
