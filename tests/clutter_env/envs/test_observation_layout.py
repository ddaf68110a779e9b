"""The published layout of the observations names every number where the environments put it."""

from __future__ import annotations

import gymnasium as gym
import numpy as np
import pytest

import clutter_env  # noqa: F401 - registers the environments
from clutter_env.envs.observation import OBSERVATION_LAYOUT, entry_slices
from clutter_env.errors import ActionError


def moving(env_id: str = "clutter_env/Retrieve-o5-v0", **keywords):
    """An environment whose robot moves, and its observation."""
    env = gym.make(env_id, **keywords).unwrapped
    env.reset(seed=2)
    for _ in range(10):
        observation, *_ = env.step(np.linspace(-0.4, 0.6, env.action_size))
    return env, observation


def test_every_entry_has_as_many_columns_as_numbers_and_their_bounds() -> None:
    env, observation = moving()
    for name, layout in OBSERVATION_LAYOUT.items():
        rows = 5 if name == "objects" else 1
        assert observation[name].shape == (rows * layout.size,)
        assert np.array_equal(env.observation_space[name].high, np.tile(layout.bounds, rows).astype(np.float32))
        covered = [index for place in layout.values() for index in range(layout.size)[place]]
        assert covered == list(range(layout.size))


def test_named_slices_hold_what_they_say() -> None:
    env, observation = moving()
    layout, index = OBSERVATION_LAYOUT["robot"], env.world.index
    robot, q, qd = observation["robot"], env.data.qpos[index.drive_qpos], env.data.qvel[index.drive_dof]
    assert np.allclose(robot[layout["base_position"]], q[:2], atol=1e-6)
    assert np.allclose(robot[layout["base_heading"]], (np.sin(q[2]), np.cos(q[2])), atol=1e-6)
    assert np.allclose(robot[layout["torso_position"]], q[3], atol=1e-6)
    assert np.allclose(robot[layout["arm_position"]], q[4:], atol=1e-6)
    assert np.linalg.norm(robot[layout["base_velocity"]][:2]) == pytest.approx(np.linalg.norm(qd[:2]), rel=1e-4)
    assert robot[layout.index("base_yaw_rate")] == pytest.approx(qd[2], rel=1e-4)
    assert np.allclose(robot[layout["arm_velocity"]], qd[4:], atol=1e-5)
    row = OBSERVATION_LAYOUT["objects"]
    rows = observation["objects"].reshape(5, row.size)
    assert np.allclose(rows[:, row["half_extents"]], env.world.scene.half_extents, atol=1e-6)
    assert list(np.flatnonzero(rows[:, row.index("is_target")])) == [env.target_slot]


def test_units_are_those_of_the_joints() -> None:
    columns = {column.name: column.unit for column in OBSERVATION_LAYOUT["robot"].columns}
    assert columns["torso_position"] == "m"
    assert columns["elbow_flex_velocity"] == "rad/s"
    with pytest.raises(KeyError, match="base_yaw_rate"):
        OBSERVATION_LAYOUT["robot"].index("yaw_rate")


@pytest.mark.parametrize("env_id", ["clutter_env/Pick-v0", "clutter_env/Reach-v0"])
def test_goal_environments_write_the_entries_one_after_the_other(env_id: str) -> None:
    env, observation = moving(env_id, num_objects=3)
    places = entry_slices(OBSERVATION_LAYOUT, ("robot", "tcp", "gripper", "objects"), 3)
    vector = observation["observation"]
    assert places["objects"].stop == len(vector)
    tcp = vector[places["tcp"]][OBSERVATION_LAYOUT["tcp"]["position"]]
    x, y, yaw = env.data.qpos[:3]
    ahead = np.array([np.cos(yaw), np.sin(yaw)]) @ (env.data.site("tcp").xpos[:2] - (x, y))
    assert tcp[0] == pytest.approx(ahead, abs=1e-5)
    assert vector[places["gripper"]][0] == pytest.approx(
        env.robot.finger_gap_closed + env.data.qpos[env.world.index.finger_qpos].sum(), abs=1e-6
    )


def test_control_mode_target_and_goal_are_public() -> None:
    env, _ = moving(control_mode="ee")
    assert env.control_mode == "ee"
    assert env.target == env.world.names[env.target_slot]
    with pytest.raises(ActionError, match="reset"):
        _ = gym.make("clutter_env/Retrieve-o5-v0").unwrapped.target
    reach, observation = moving("clutter_env/Reach-v0")
    assert reach.target == ""
    assert np.array_equal(reach.goal, observation["desired_goal"])
    reach.goal[:] = 0
    assert np.array_equal(reach.goal, observation["desired_goal"])
