"""The executor: what it commands, sample by sample."""

from __future__ import annotations

import numpy as np
import pytest

from planners.expert.config import MonitorConfig
from planners.expert.executor import Executor
from planners.expert.monitor import Snapshot
from planners.motion.trajectory import CONTROL_STEP, Phase, Trajectory
from planners.tamp.solution import BoundAction
from tests.planners.scenes import table_scene

_SCENE = table_scene()


class _Follows:
    """A robot that is where it was commanded last, among no objects."""

    names: tuple[str, ...] = ()

    def __init__(self) -> None:
        self.drive = np.concatenate((_SCENE.state.base, _SCENE.state.q))

    def read(self) -> Snapshot:
        return Snapshot(np.zeros((0, 3)), np.zeros(0), np.zeros(0), np.eye(4), self.drive)


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
