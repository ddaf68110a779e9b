"""Observations agree with MuJoCo, relative to the base."""

from __future__ import annotations

import gymnasium as gym
import mujoco
import numpy as np
import pytest

import clutter_env  # noqa: F401 - registers the environments
from clutter_env.envs.observation import OBJECT_FIELDS, OBSERVATION_LAYOUT, entry_slices
from clutter_env.errors import ActionError
from clutter_env.simulation.world import Grip


def shaken(seed: int, **keywords):
    """An environment after a while among the objects, and its observation."""
    env = gym.make("clutter_env/Retrieve-o15-v0", **keywords).unwrapped
    env.reset(seed=seed)
    rng = np.random.default_rng(seed)
    for _ in range(100):
        action = rng.uniform(-1, 1, 12)
        action[0], action[5] = 0.3, 0.1
        observation, *_, info = env.step(action)
    return env, observation, info


def T_world_base(env) -> np.ndarray:
    x, y, yaw = env.data.qpos[:3]
    pose = np.eye(4)
    pose[:2, :2] = ((np.cos(yaw), -np.sin(yaw)), (np.sin(yaw), np.cos(yaw)))
    pose[:2, 3] = x, y
    return pose


def as_matrix(position: np.ndarray, quaternion: np.ndarray) -> np.ndarray:
    pose, rotation = np.eye(4), np.empty(9)
    mujoco.mju_quat2Mat(rotation, np.asarray(quaternion, float))
    pose[:3, :3], pose[:3, 3] = rotation.reshape(3, 3), position
    return pose


@pytest.mark.parametrize("seed", range(2))
def test_object_rows_are_poses_relative_to_the_base(seed: int) -> None:
    env, observation, info = shaken(seed, shapes="mixed")
    rows = observation["objects"].reshape(15, len(OBJECT_FIELDS))
    base = T_world_base(env)
    for slot, row in enumerate(rows):
        values = dict(zip(OBJECT_FIELDS, row.tolist(), strict=True))
        name = f"object_{slot:02d}"
        expected = np.linalg.inv(base) @ as_matrix(env.data.body(name).xpos, env.data.body(name).xquat)
        measured = as_matrix([values[k] for k in "xyz"], [values[k] for k in ("qw", "qx", "qy", "qz")])
        assert np.allclose(measured, expected, atol=1e-5)
        assert values["qw"] >= 0
        assert values["present"] == 1
        assert values["is_target"] == (name == info["target"])
        assert values["held"] == (name == info["held"])
        geom = env.model.geom(name)
        is_box = int(geom.type[0]) == int(mujoco.mjtGeom.mjGEOM_BOX)
        assert values["is_box"] == is_box
        size = geom.size if is_box else geom.size[[0, 0, 1]]
        assert np.allclose([values[f"half_{axis}"] for axis in "xyz"], size)


@pytest.mark.parametrize("seed", range(2))
def test_robot_tcp_gripper_and_goal_agree_with_mujoco(seed: int) -> None:
    env, observation, info = shaken(seed)
    base, data = T_world_base(env), env.data
    x, y, sine, cosine, *q = observation["robot"][:12]
    assert np.allclose((x, y), data.qpos[:2])
    assert np.arctan2(sine, cosine) == pytest.approx(np.angle(np.exp(1j * data.qpos[2])), abs=1e-5)
    assert np.allclose(q, data.qpos[env.world.index.drive_qpos[3:]], atol=1e-6)
    assert np.allclose(base[:2, :2] @ observation["robot"][12:14], data.qvel[:2], atol=1e-5)
    assert np.allclose(observation["robot"][14:], data.qvel[env.world.index.drive_dof[2:]], atol=1e-5)
    site = data.site("tcp")
    expected = np.eye(4)
    expected[:3, :3], expected[:3, 3] = site.xmat.reshape(3, 3), site.xpos
    measured = as_matrix(observation["tcp"][:3], observation["tcp"][3:])
    assert np.allclose(base @ measured, expected, atol=1e-5)
    opening = env.robot.finger_gap_closed + data.qpos[env.world.index.finger_qpos].sum()
    assert observation["gripper"][0] == pytest.approx(opening, abs=1e-6)
    offset = base[:3, :3] @ observation["goal"][:3]
    assert np.allclose(offset, data.body(info["target"]).xpos - site.xpos, atol=1e-5)


def test_absent_slots_are_zero() -> None:
    env = gym.make("clutter_env/Retrieve-o5-v0").unwrapped
    objects = [{"radius": 0.03, "height": 0.15, "position": (0.1, y)} for y in (-0.1, 0.1)]
    observation, info = env.reset(seed=0, options={"objects": objects, "target": "object_01"})
    rows = observation["objects"].reshape(5, -1)
    assert rows[:, 0].tolist() == [1, 1, 0, 0, 0]
    assert not rows[2:].any()
    assert info["target"] == "object_01"
    assert observation in env.observation_space


def test_numbers_stay_in_their_boxes_whatever_happens() -> None:
    env = gym.make("clutter_env/Retrieve-o5-v0").unwrapped
    env.reset(seed=0)
    env.data.qvel[:] = 400.0
    for _ in range(5):
        observation, *_ = env.step(np.ones(12))
        assert observation in env.observation_space


def test_lowest_points_and_falls() -> None:
    env = gym.make("clutter_env/Retrieve-o5-v0", shapes="mixed").unwrapped
    env.reset(seed=0)
    rng = np.random.default_rng(0)
    poses = env.data.qpos[env.world.index.object_qpos].reshape(-1, 7)
    for _ in range(10):
        quaternions = rng.normal(size=(5, 4))
        poses[:, 3:] = quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True)
        measured = env.world.measure()
        for slot, name in enumerate(env.world.names):
            down = as_matrix(poses[slot, :3], poses[slot, 3:])[2, :3]
            half = env.world.scene.half_extents[slot]
            if env.world.scene.is_box[slot]:
                reach = np.abs(down) @ half
            else:
                reach = half[2] * abs(down[2]) + half[0] * np.hypot(down[0], down[1])
            assert env.world.lowest_point(measured, slot) == pytest.approx(poses[slot, 2] - reach), name
            assert measured.is_fallen[slot] == (down[2] < np.cos(np.radians(45)))


def test_what_the_fingers_hold_has_not_toppled_though_it_grazes_something() -> None:
    """An object that was tilted by 46° in the hand grazed the table for 2 ms: it counted as fallen."""
    env = gym.make("clutter_env/Retrieve-o5-v0").unwrapped
    env.reset(seed=0)
    poses = env.data.qpos[env.world.index.object_qpos].reshape(-1, 7)
    poses[1, 3:] = np.cos(0.5), np.sin(0.5), 0.0, 0.0  # 1 rad
    grips = [Grip((slot,), (is_carried,), True) for slot, is_carried in ((-1, False), (1, False), (1, True))]
    assert [env.world.measure_objects(grip).is_fallen[1] for grip in grips] == [True, False, False]
    poses[1, 2] = 0.3  # below the table top
    assert [env.world.measure_objects(grip).is_fallen[1] for grip in grips] == [True, True, False]


def test_every_entry_has_as_many_columns_as_numbers_and_their_bounds() -> None:
    env, observation, _ = shaken(0)
    for name, layout in OBSERVATION_LAYOUT.items():
        rows = 15 if name == "objects" else 1
        assert observation[name].shape == (rows * layout.size,)
        assert np.array_equal(env.observation_space[name].high, np.tile(layout.bounds, rows).astype(np.float32))
        covered = [index for place in layout.values() for index in range(layout.size)[place]]
        assert covered == list(range(layout.size))


def test_units_are_those_of_the_joints() -> None:
    columns = {column.name: column.unit for column in OBSERVATION_LAYOUT["robot"].columns}
    assert columns["torso_position"] == "m"
    assert columns["elbow_flex_velocity"] == "rad/s"
    with pytest.raises(KeyError, match="base_yaw_rate"):
        OBSERVATION_LAYOUT["robot"].index("yaw_rate")


def test_goal_environments_write_the_entries_one_after_the_other() -> None:
    env = gym.make("clutter_env/Pick-v0", num_objects=3, control_mode="joint").unwrapped
    observation, _ = env.reset(seed=2)
    entries = env.observe_world(env.target_slot, 0.0, 0.0)
    places = entry_slices(OBSERVATION_LAYOUT, ("robot", "tcp", "gripper", "objects"), 3)
    assert places["objects"].stop == len(observation["observation"])
    for name, place in places.items():
        assert np.array_equal(observation["observation"][place], entries[name])


def test_control_mode_target_and_goal_are_public() -> None:
    env = gym.make("clutter_env/Reach-v0", num_objects=2, control_mode="joint").unwrapped
    with pytest.raises(ActionError, match="reset"):
        _ = env.target
    observation, info = env.reset(seed=0)
    assert (env.control_mode, env.target) == ("joint", info["target"])
    env.goal[:] = 0
    assert np.array_equal(env.goal, observation["desired_goal"])
