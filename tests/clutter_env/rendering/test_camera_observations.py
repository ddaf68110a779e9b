"""Camera observations: what a pixel shows is where the calibration says; segmentations, clouds, heads that turn."""

from __future__ import annotations

import gc
from itertools import product
from typing import Any

import gymnasium as gym
import mujoco
import numpy as np
import pytest

import clutter_env  # noqa: F401 - registers the environments
from clutter_env.errors import ActionError, ConfigError
from clutter_env.rendering.calibration import back_project
from clutter_env.rendering.cameras import FIRST_OBJECT, FURNITURE, MAX_DEPTH, ROBOT
from clutter_env.scene.layout import TABLE_HEIGHT

ID = "clutter_env/Retrieve-o5-v0"
SIZE = 96
BOX = np.array((0.03, 0.04, 0.06))
ROBOTS = ["fetch", pytest.param("pr2", marks=pytest.mark.slow), pytest.param("panda_mobile", marks=pytest.mark.slow)]
ROUND = [int(mujoco.mjtGeom.mjGEOM_CAPSULE), int(mujoco.mjtGeom.mjGEOM_CYLINDER)]
"""Drawn with 24 facets: up to 3 mm from where a ray ends that grazes them."""
SEEN_GROUPS = np.array((1, 1, 1, 0, 0, 0), np.uint8)


def seen_by(robot: str) -> tuple[Any, dict[str, Any], dict[str, Any]]:
    """An environment of which one box is on the table, its observation and info."""
    env = gym.make(
        ID, obs_mode="rgbd", segmentation=True, image_size=SIZE, robot=robot, cameras=("top", *env_cameras(robot))
    ).unwrapped
    size = dict(zip(("depth", "width", "height"), (2 * BOX).tolist(), strict=True))
    box = {"shape": "box", **size, "position": (0.0, 0.05), "yaw": 0.3}
    observation, info = env.reset(seed=0, options={"objects": [box]})
    return env, observation, info


def env_cameras(robot: str) -> tuple[str, ...]:
    return ("head", "r_gripper", "l_gripper") if robot == "pr2" else ("head", "gripper")


def ray(env: Any, eye: np.ndarray, direction: np.ndarray) -> tuple[float, int]:
    """Distance to, and number of, the first geom that is drawn along a ray."""
    geom = np.zeros(1, np.int32)
    length = mujoco.mj_ray(env.model, env.data, eye, direction, SEEN_GROUPS, 1, -1, geom)
    return length, int(geom[0])


@pytest.mark.usefixtures("needs_gl")
@pytest.mark.parametrize("robot", ROBOTS)
def test_pixels_and_points_agree_within_a_pixel_and_two_millimetres(robot: str) -> None:
    env, observation, info = seen_by(robot)
    world, rng, model = env.world, np.random.default_rng(0), env.model
    base = np.eye(4)
    base[:3, :3], base[:2, 3] = env.data.xmat[world.index.base_body].reshape(3, 3), world.data.qpos[:2]
    object_pose = np.eye(4)
    mujoco.mju_quat2Mat(turn := np.empty(9), env.measurements.poses[0, 3:])
    object_pose[:3, :3], object_pose[:3, 3] = turn.reshape(3, 3), env.measurements.poses[0, :3]
    corners = np.array(list(product(*zip(-BOX, BOX, strict=True)))) @ object_pose[:3, :3].T + object_pose[:3, 3]
    silhouettes = 0
    for camera in env.config.cameras:
        K, T_world_camera = info["K"][camera], base @ info["T_base_camera"][camera]
        depth = observation[f"{camera}_depth"]
        assert depth.shape == (SIZE, SIZE, 1)
        segments = observation[f"{camera}_segmentation"][..., 0]
        # Known points to pixels: the corners of the box bound the pixels that show it.
        inside = (corners - T_world_camera[:3, 3]) @ T_world_camera[:3, :3]
        pixels = (inside / inside[:, 2:]) @ K.T
        rows, columns = np.nonzero(segments == FIRST_OBJECT)
        low, high = pixels[:, :2].min(axis=0), pixels[:, :2].max(axis=0)
        if (inside[:, 2] > 0).all() and low.min() >= 0 and high.max() <= SIZE - 1:
            hidden = [ray(env, T_world_camera[:3, 3], c - T_world_camera[:3, 3])[0] < 0.98 for c in corners]
            if sum(hidden) <= 1:  # the corner behind, or none
                found = np.array(((columns.min(), rows.min()), (columns.max(), rows.max())))
                assert np.abs(found - (low, high)).max() <= 1.0, camera
                silhouettes += 1
        # Pixels to points: the ray through a pixel ends where its depth says.
        for pixel in rng.integers(1, SIZE - 1, (40, 2)):
            neighbours = depth[pixel[1] - 1 : pixel[1] + 2, pixel[0] - 1 : pixel[0] + 2, 0]
            if depth[pixel[1], pixel[0], 0] >= MAX_DEPTH or np.ptp(neighbours) > 0.05:
                continue  # nothing is there, or an edge
            point = back_project(pixel[None], [depth[pixel[1], pixel[0], 0]], K, T_world_camera)[0]
            direction = point - T_world_camera[:3, 3]
            share, geom = ray(env, T_world_camera[:3, 3], direction)
            if model.geom_type[geom] not in ROUND:
                assert abs(share - 1) * np.linalg.norm(direction) <= 0.002, (camera, model.geom(geom).name)
            kinds = {-1: 0, world.index.object_geoms.start: FIRST_OBJECT}
            is_robot = model.body_rootid[model.geom_bodyid[geom]] == model.body_rootid[world.index.base_body]
            is_ground = model.geom_type[geom] == int(mujoco.mjtGeom.mjGEOM_PLANE)
            assert segments[pixel[1], pixel[0]] == kinds.get(geom, ROBOT if is_robot else 0 if is_ground else FURNITURE)
    assert silhouettes >= 1, "the box is wholly in view of some camera"
    env.close()


@pytest.mark.usefixtures("needs_gl")
def test_clouds_have_a_fixed_number_of_points_which_are_where_things_are() -> None:
    env = gym.make(ID, obs_mode="pointcloud", num_points=700, segmentation=True, cameras=("top", "gripper"))
    observation, info = env.reset(seed=3)
    points, kinds = observation["points"], observation["point_segmentation"][:, 0]
    assert points.shape == (700, 3)
    assert points[:, 2].min() > 0, "none of the ground"
    world = env.unwrapped.world
    x, y, yaw = world.data.qpos[world.index.drive_qpos[:3]]
    turn = np.array(((np.cos(yaw), -np.sin(yaw)), (np.sin(yaw), np.cos(yaw))))
    for slot, pose in enumerate(env.unwrapped.measurements.poses):
        seen = points[kinds == FIRST_OBJECT + slot]
        near = np.linalg.norm(seen[:, :2] @ turn.T + (x, y) - pose[:2], axis=1)
        half = world.scene.half_extents[slot]
        assert (near <= half[0] + 0.002).all()
        assert (np.abs(seen[:, 2] - pose[2]) <= half[2] + 0.002).all()
    assert (kinds >= FIRST_OBJECT).sum() > 10
    assert np.abs(points[kinds == FURNITURE][:, 2] - TABLE_HEIGHT).min() < 0.002
    again = env.reset(seed=3)[0]
    assert all(np.array_equal(observation[name], again[name]) for name in observation)
    assert not np.array_equal(env.reset(seed=4)[0]["points"], points)
    assert sorted(info["K"]) == ["gripper", "top"]
    env.close()


def test_the_head_turns_as_commanded_within_its_range_and_saved_states_know_where() -> None:
    env = gym.make(ID, head="commanded").unwrapped
    still = gym.make(ID).unwrapped
    observation, _ = env.reset(seed=0)
    still.reset(seed=0)
    assert env.action_space.shape == (still.action_size + 2,)
    np.testing.assert_allclose(observation["head"], (*env.robot.head_configuration, 0.0, 0.0), atol=1e-6)
    q = env.world.controller.state.target
    for _ in range(25):
        observation = env.step(env.joint_action(q, 0.1, (0.6, 9.0)))[0]
    tilt = env.model.joint(env.robot.head_joints[1]).range[1]
    np.testing.assert_allclose(observation["head"][:2], (0.6, tilt), atol=0.01)
    state, action = env.save_state(), np.full(env.action_size, 0.4, np.float32)
    first = env.step(action)[0]
    env.restore_state(state)
    assert all(np.array_equal(first[name], value) for name, value in env.step(action)[0].items())
    with pytest.raises(ActionError, match="head='commanded'"):
        still.joint_action(q, 0.1, (0.0, 0.0))
    with pytest.raises(ConfigError, match="whose head moves"):
        gym.make(ID, head="commanded", robot="panda_mobile")


@pytest.mark.usefixtures("needs_gl")
def test_an_environment_that_nobody_closed_spoils_no_other_ones_images() -> None:
    lost, kept = (gym.make(ID, obs_mode="rgbd", image_size=32) for _ in range(2))
    lost.reset(seed=0)
    before = kept.reset(seed=1)[0]["head_rgb"]
    del lost
    gc.collect()
    assert np.array_equal(kept.reset(seed=1)[0]["head_rgb"], before)
    kept.close()
