"""Lying cylinders: how they are placed, that they stay at rest, when they have toppled."""

from __future__ import annotations

import math
from typing import Any

import gymnasium as gym
import mujoco
import numpy as np

import clutter_env  # noqa: F401  registers the environments
from assets.robots import FETCH
from clutter_env.scene.layout import LAYOUTS, TABLE_HEIGHT
from clutter_env.scene.obstruction import count_blockers, side_approaches
from tests.clutter_env.toppling import wake

LYING = {"shape": "cylinder", "lying": True, "radius": 0.025, "height": 0.14}
BOX = {"shape": "box", "depth": 0.14, "width": 0.05, "height": 0.05}


def lying_env(**keywords: Any) -> Any:
    """Lying cylinders beside lying boxes."""
    return gym.make("clutter_env/Retrieve-o10-v0", object_set="lying", shapes="mixed", **keywords).unwrapped


def idle(env: Any, steps: int) -> dict[str, Any]:
    """The info after the robot has stood still for some steps."""
    action = env.joint_action(env.data.qpos[env.world.index.drive_qpos], env.robot.max_opening)
    for _ in range(steps):
        info = env.step(action)[4]
    return info


def place(env: Any, slot: int, position: tuple[float, ...], quaternion: tuple[float, ...]) -> None:
    """Put an object elsewhere, at rest and awake."""
    env.data.qpos[env.world.index.object_qpos].reshape(-1, 7)[slot] = (*position, *quaternion)
    wake(env.model, env.data)


def test_they_lie_along_their_yaw_and_touch_the_table() -> None:
    env = lying_env()
    for seed in range(2):
        env.reset(seed=seed)
        scene = env.world.scene
        assert scene.is_lying.tolist() == [True, False] * 5
        axes = env.data.geom_xmat[env.world.index.object_geoms].reshape(-1, 3, 3)[:, :, 2]
        along = np.column_stack((np.cos(scene.yaws), np.sin(scene.yaws), np.zeros(10)))
        assert np.allclose(axes[scene.is_lying], along[scene.is_lying], atol=1e-12)
        lowest = [env.world.lowest_point(env.measurements, slot) for slot in range(10)]
        assert np.allclose(lowest, TABLE_HEIGHT, atol=1e-12)
        half = scene.half_extents[scene.is_lying]
        assert (half[:, 2] > 1.5 * half[:, 0]).all(), "longer than thick"


def test_they_stay_where_they_are_when_woken() -> None:
    """Awake for 5 s on a table that they share with boxes: no cylinder rolls."""
    env = lying_env()
    env.reset(seed=1)
    env.model.opt.enableflags &= ~int(mujoco.mjtEnableBit.mjENBL_SLEEP)
    before = env.measurements.poses.copy()
    info = idle(env, 100)
    assert np.abs(env.measurements.poses[:, :3] - before[:, :3]).max() < 1e-3
    assert info["num_fallen"] == info["num_disturbed"] == 0


def test_they_have_toppled_when_they_stand_up_and_not_when_they_roll() -> None:
    env, cylinder = lying_env(), 2
    env.reset(seed=1)
    (x, y, z), lying = env.measurements.poses[cylinder, :3], env.measurements.poses[cylinder, 3:]
    rolled = np.empty(4)
    mujoco.mju_mulQuat(rolled, lying, np.array([math.cos(1.0), 0.0, 0.0, math.sin(1.0)]))
    place(env, cylinder, (x, y, z), tuple(rolled))
    assert idle(env, 10)["num_fallen"] == 0
    for standing in ((1.0, 0.0, 0.0, 0.0), (0.0, 1.0, 0.0, 0.0)):
        env.reset(seed=1)
        place(env, cylinder, (x, y, TABLE_HEIGHT + 0.1), standing)
        assert idle(env, 1)["num_fallen"] == 1


def test_they_are_in_the_way_of_grasps_like_boxes_of_the_same_outline() -> None:
    target = {"shape": "cylinder", "radius": 0.03, "height": 0.16, "position": (0.1, 0.0)}
    log = {"shape": "cylinder", "lying": True, "radius": 0.05, "height": 0.12, "yaw": 1.2}
    box = {"shape": "box", "depth": 0.12, "width": 0.1, "height": 0.1, "yaw": 1.2}
    env = gym.make("clutter_env/Retrieve-o5-v0").unwrapped
    found = []
    for shape in (log, box):
        env.reset(options={"objects": [target, *({**shape, "position": (0.02, side)} for side in (-0.1, 0.1))]})
        found.append(count_blockers(side_approaches("fetch"), LAYOUTS["paper"], env.world.scene, FETCH.max_opening))
    assert found[0].tolist() == found[1].tolist()
    assert found[0][0] > 0
