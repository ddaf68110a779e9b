"""Plans leave: one trajectory of joints, and a file of ROS 2 messages that is read back."""

from __future__ import annotations

import ast
import sys
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from planners import CONTROL_STEP, Solution, solve
from planners.drawing.mcap_file import MissingExtra
from planners.motion.arm import tcp_pose
from planners.motion.mujoco_check import scene_model
from planners.scene import RobotState
from tests.planners.scenes import cylinder, table_scene

PLAYER = Path(__file__).parents[2] / "examples" / "ros2_player.py"


@pytest.fixture(scope="module")
def plan() -> Solution:
    """One object is put aside for another one."""
    row = (cylinder("object_00", -0.25, 0.0), cylinder("object_01", -0.15, 0.0), cylinder("object_02", -0.2, 0.09))
    scene = table_scene(*row, cylinder("object_03", -0.2, -0.09))
    found = solve(scene, "object_01", grasps="side", rng=np.random.default_rng(0))
    assert isinstance(found, Solution), found
    return found


def test_the_trajectory_of_a_plan_has_its_states_in_order(plan: Solution) -> None:
    found, robot = plan.to_joint_trajectory(), plan.actions[0].scene.robot
    n, m = found.positions.shape
    assert found.joint_names == robot.drive_joints[3:]
    assert (found.times.shape, found.velocities.shape, found.base.shape) == ((n,), (n, m), (n, 3))
    assert found.gripper.shape == (n, len(found.arms)) == (n, 1)
    assert (np.diff(found.times) > 0).all()
    assert found.times[-1] == pytest.approx(plan.duration)
    start = 0.0
    for action in plan.actions:
        for time in np.linspace(0.0, action.trajectory.duration, 7):
            sample = action.trajectory.sample(float(time))
            at = start + float(time)
            q = [np.interp(at, found.times, column) for column in found.positions.T]
            np.testing.assert_allclose(q, sample.q, atol=1e-9)
            np.testing.assert_allclose([np.interp(at, found.times, c) for c in found.base.T], sample.base, atol=1e-9)
            opening = robot.opening(sample.finger_position)
            assert np.interp(at, found.times, found.gripper[:, 0]) == pytest.approx(opening, abs=1e-9)
        start += action.trajectory.duration


def test_velocities_are_those_of_the_positions_and_within_the_limits(plan: Solution) -> None:
    found, robot = plan.to_joint_trajectory(), plan.actions[0].scene.robot
    assert not found.velocities[[0, -1]].any()
    assert (np.abs(found.velocities) <= 1.01 * np.array(robot.max_velocity[3:])).all()
    moved = np.cumsum(found.velocities, axis=0) * CONTROL_STEP
    np.testing.assert_allclose(found.positions[0] + moved[-1], found.positions[-1], atol=0.02)


def test_a_plan_without_actions_has_no_trajectory(plan: Solution) -> None:
    empty = replace(plan, actions=())
    with pytest.raises(ValueError, match="no actions"):
        empty.to_joint_trajectory()


def test_without_the_extra_the_error_names_it(plan: Solution, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "mcap_ros2.writer", None)
    with pytest.raises(MissingExtra, match=r"clutter-env\[ros\]"):
        plan.to_mcap(tmp_path / "plan.mcap")
    assert not (tmp_path / "plan.mcap").exists()


def test_the_file_is_read_back(plan: Solution, tmp_path: Path) -> None:
    reader = pytest.importorskip("mcap_ros2.reader")
    path, found = tmp_path / "plan.mcap", plan.to_joint_trajectory()
    plan.to_mcap(path)
    messages: dict[str, list] = {}
    for message in reader.read_ros2_messages(str(path)):
        messages.setdefault(message.channel.topic, []).append(message)
    assert set(messages) == {"/markers", "/joint_trajectory", "/joint_states", "/tf"}
    (trajectory,) = (message.ros_msg for message in messages["/joint_trajectory"])
    assert tuple(trajectory.joint_names) == found.joint_names
    np.testing.assert_array_equal([point.positions for point in trajectory.points], found.positions)
    np.testing.assert_array_equal([point.velocities for point in trajectory.points], found.velocities)
    times = [point.time_from_start.sec + 1e-9 * point.time_from_start.nanosec for point in trajectory.points]
    np.testing.assert_allclose(times, found.times, atol=1e-9)
    states = [message.ros_msg for message in messages["/joint_states"]]
    np.testing.assert_array_equal([state.position[:3] for state in states], found.base)
    assert [message.log_time_ns for message in messages["/joint_states"]] == [round(1e9 * t) for t in found.times]
    # The frames are where the robot and the objects are, and every marker has one of them.
    first, last = plan.actions[0].scene, plan.actions[-1]
    poses = {one.child_frame_id: one.transform for one in messages["/tf"][0].ros_msg.transforms}
    for body in first.objects:
        moved = poses[body.name].translation
        np.testing.assert_allclose((moved.x, moved.y, moved.z), body.position, atol=1e-6)
    end = last.trajectory.sample(last.trajectory.duration)
    tcp = tcp_pose(last.scene.robot, RobotState(end.base, end.q, 0.0))
    poses = {one.child_frame_id: one.transform for one in messages["/tf"][-1].ros_msg.transforms}
    held = plan.actions[-1].trajectory.phases[-1].touched
    assert held is not None
    target = poses[plan.target].translation
    np.testing.assert_allclose((target.x, target.y, target.z), (tcp @ held.T_tcp_object)[:3, 3], atol=1e-5)
    (markers,) = (message.ros_msg.markers for message in messages["/markers"])
    assert {marker.header.frame_id for marker in markers} <= {*poses, "world"}
    model = scene_model(first)
    capsules = np.count_nonzero(model.geom_type == int(mujoco.mjtGeom.mjGEOM_CAPSULE))
    assert len(markers) == model.ngeom + 2 * capsules


def test_the_player_is_a_program() -> None:
    text = PLAYER.read_text(encoding="utf-8")
    ast.parse(text)
    assert len(text.splitlines()) <= 30
