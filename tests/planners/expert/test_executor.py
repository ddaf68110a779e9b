"""The executor: what it commands, sample by sample."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from planners.expert.config import MonitorConfig
from planners.expert.executor import Executor
from planners.expert.monitor import Snapshot
from planners.motion.arm import tcp_pose
from planners.motion.tcp_following import PATIENCE
from planners.motion.trajectory import CONTROL_STEP, Phase, Trajectory
from planners.scene import Body, HeldObject, RobotState
from planners.tamp.solution import BoundAction
from tests.planners.scenes import table_scene

_SCENE = table_scene()


class _Follows:
    """A robot that is where it was commanded last, among no objects."""

    names: tuple[str, ...] = ()

    def __init__(self) -> None:
        self.drive = np.concatenate((_SCENE.state.base, _SCENE.state.q))

    def read(self) -> Snapshot:
        return Snapshot(np.zeros((0, 3)), np.zeros(0), np.zeros((0, 4)), np.eye(4), self.drive)


@pytest.mark.parametrize("share", [1.0, 0.8, 0.5, 1.5])
def test_a_motion_goes_on_evenly_from_one_action_to_the_next(share: float) -> None:
    """After the plan was followed more slowly for a while, the robot stopped short at the end of each action."""
    states = np.tile(np.concatenate((_SCENE.state.base, _SCENE.state.q, [0.0])), (21, 1))
    states[:, 0] += 0.01 * np.arange(21)
    parts = [Trajectory.of_states(states[one : one + 6], Phase("drive", 0.0)) for one in (0, 5, 10, 15)]
    actions = [BoundAction("MoveBase", ("here", "there", "path"), part, _SCENE) for part in parts]
    robot = _Follows()
    executor, commanded = Executor(actions, _SCENE.robot, robot, MonitorConfig(), dt=share * CONTROL_STEP), []
    while not executor.is_over:
        robot.drive = executor.advance(robot.read()).drive
        commanded.append(robot.drive[0])
    steps = np.diff(commanded)
    assert commanded[-1] == pytest.approx(states[-1, 0])
    assert steps[steps > 1e-9][:-1] == pytest.approx(0.01 * share)
    assert (steps[:-2] > 0).all()


class _StaysBehind(_Follows):
    """A robot that the TCP of which does not get nearer than so far [m], from a place on."""

    def __init__(self, by: float) -> None:
        super().__init__()
        self.by = by

    def read(self) -> Snapshot:
        x = self.drive.copy()
        if x[0] > _SCENE.state.base[0] + 0.05:
            x[1] += self.by
        T_world_tcp = tcp_pose(_SCENE.robot, RobotState(x[:3], x[3:], 0.0))
        return Snapshot(np.zeros((0, 3)), np.zeros(0), np.zeros((0, 4)), T_world_tcp, x)


@pytest.mark.parametrize(("by", "waits", "is_stuck"), [(0.0, 0, False), (0.02, 1, False), (0.05, 1, True)])
def test_a_gripper_that_does_not_arrive_is_waited_for_once(by: float, waits: int, is_stuck: bool) -> None:
    """Where fingers close it may be near enough; what is farther away is stuck, and the plan ends there."""
    states = np.tile(np.concatenate((_SCENE.state.base, _SCENE.state.q, [0.0])), (21, 1))
    states[:11, 0] += 0.01 * np.arange(11)
    states[11:, 0] = states[10, 0]
    phases = Phase("approach", 0.0), Phase("close", 0.5, "", HeldObject("can", np.eye(4)))
    motion = Trajectory(CONTROL_STEP * np.arange(21), states[:, :3], states[:, 3:-1], states[:, -1], phases)
    robot, steps = _StaysBehind(by), 0
    executor = Executor(
        [BoundAction("MoveBase", ("a", "b", "c"), motion, _SCENE)],
        _SCENE.robot,
        robot,
        MonitorConfig(base=1.0),
        by_tcp=True,
        line_tolerance=0.03,
    )
    while not executor.is_over:
        robot.drive = executor.advance(robot.read()).drive
        steps += 1
    assert waits * PATIENCE < steps < waits * PATIENCE + 40
    assert (executor.deviation is not None) == is_stuck
    if is_stuck:
        assert robot.drive[0] < _SCENE.state.base[0] + 0.05  # back on its line


class _Sees(_Follows):
    """A robot that follows, and sees a box where it lies, turned from the plan's orientation."""

    names = ("box",)

    def __init__(self, box: Body, turn: Rotation) -> None:
        super().__init__()
        self.box, self.seen = box, turn * Rotation.from_quat(box.quaternion, scalar_first=True)

    def read(self) -> Snapshot:
        quaternion = self.seen.as_quat(scalar_first=True)[None]
        return Snapshot(self.box.position[None], np.ones(1), quaternion, np.eye(4), self.drive)


@pytest.mark.parametrize(
    ("turn", "has_turned"), [((1e-4, 1e-4, 0.0), False), ((0.0, 0.0, 0.2), False), ((0.0, 0.0, 0.4), True)]
)
def test_a_box_on_its_side_has_turned_only_if_it_has_turned_about_the_vertical(
    turn: tuple[float, float, float], has_turned: bool
) -> None:
    """The yaw of a box whose x axis points down is anything: LIBERO's cream cheese was taken for moved."""
    lying = Rotation.from_euler("y", np.pi / 2).as_quat(scalar_first=True)
    box = Body("box", "box", np.array((0.01, 0.02, 0.04)), np.array((0.6, 0.0, 0.8)), lying)
    scene = replace(_SCENE, objects=(box,))
    states = np.tile(np.concatenate((_SCENE.state.base, _SCENE.state.q, [0.0])), (61, 1))
    phases = Phase("transit", 0.0), Phase("approach", 2.0)
    motion = Trajectory(CONTROL_STEP * np.arange(61), states[:, :3], states[:, 3:-1], states[:, -1], phases)
    robot = _Sees(box, Rotation.from_rotvec(turn))
    executor = Executor([BoundAction("PickUp", ("box",), motion, scene, "box")], scene.robot, robot, MonitorConfig())
    for _ in range(61):
        robot.drive = executor.advance(robot.read()).drive
    assert (executor.deviation is not None) == has_turned
