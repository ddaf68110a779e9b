"""The expert moves robots at other rates, by other commands, through `Controller`."""

from __future__ import annotations

import gc
import weakref
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

from assets.robots import FETCH
from planners import ControlledWorld, ExpertError, TampExpert, goals, prepare
from planners.goals import Goal, Region
from planners.motion.arm import tcp_pose
from planners.scene import RobotState
from tests.planners.own_scenes import MOVABLE, SUPPORT, kitchen

Array = NDArray[np.float64]


@dataclass
class Deltas:
    """A simulation that takes limited changes of joint positions, each held for `dt`: the robot always stays behind."""

    model: mujoco.MjModel
    data: mujoco.MjData
    dt: float
    most: float
    done: bool = False
    acts: int = 0

    def observe(self) -> Array:
        return self.data.qpos

    def act(self, configuration: Array, opening: float) -> None:
        joints = [self.model.joint(name).qposadr[0] for name in FETCH.drive_joints]
        motors = [self.model.actuator(name).id for name in FETCH.drive_joints]
        now = self.data.qpos[joints]
        change = configuration - now
        turns = [number for number, name in enumerate(FETCH.drive_joints) if "yaw" in name or number > 3]
        change[turns] = (change[turns] + np.pi) % (2 * np.pi) - np.pi
        self.data.ctrl[motors] = now + np.clip(change, -self.most, self.most)
        self.data.ctrl[[self.model.actuator(name).id for name in FETCH.finger_joints]] = FETCH.finger_position(opening)
        mujoco.mj_step(self.model, self.data, nstep=round(self.dt / self.model.opt.timestep))
        self.acts += 1


def controlled(dt: float, most: float, extra: str = "", **options: Any) -> tuple[Deltas, ControlledWorld]:
    raw, start = kitchen(extra)
    model = prepare(raw, FETCH).model
    data = mujoco.MjData(model)
    data.qpos[:] = start.qpos
    data.ctrl[[model.actuator(name).id for name in FETCH.drive_joints[3:]]] = FETCH.home
    controller = Deltas(model, data, dt, most)
    return controller, ControlledWorld(controller, model, FETCH, movable=MOVABLE, support=SUPPORT, **options)


@pytest.mark.slow
@pytest.mark.parametrize("tolerance", [None, 0.01])
def test_beside_an_object_the_gripper_is_not_farther_behind_than_its_world_allows(tolerance: float | None) -> None:
    options: dict[str, float] = {} if tolerance is None else {"line_tolerance": tolerance}
    _, world = controlled(0.1, 0.02, **options)
    expert = TampExpert(world, grasps="side")
    expert.reset("can")
    behind, sent, phase = [0.0], None, ""
    while not expert.phase.endswith(": retreat"):
        tcp = world.data.site(FETCH.tcp_site).xpos.copy()
        action = expert.act()
        if sent is not None and phase.endswith(("approach", "lift")):
            wanted = tcp_pose(FETCH, RobotState(sent[:3], sent[3:-1], 0.0))[:3, 3]
            if np.abs(action - sent).max() > 1e-6:  # the plan goes on
                behind.append(float(np.linalg.norm(wanted - tcp)))
        world.step(action)
        sent, phase = action, expert.phase
    assert (max(behind) <= 0.01) == (tolerance is not None)


@pytest.mark.slow
@pytest.mark.parametrize(("dt", "most"), [(0.1, 0.1), (0.05, 0.1), (0.02, 0.05)])
def test_an_object_is_fetched_through_limited_changes(dt: float, most: float) -> None:
    controller, world = controlled(dt, most)
    expert = TampExpert(world, grasps="side")
    expert.reset("can")
    while not expert.done:
        world.step(expert.act())
    report = expert.report
    assert report.scored, report
    assert report.clean is None  # nothing counts here
    assert report.replans == 0
    assert report.sim_s == pytest.approx(controller.acts * dt, abs=1.01 * dt)
    assert controller.data.body("can").xpos[2] > 0.74 + 0.1


TRAY = """<body name="tray" pos="1 0.3 0.8" gravcomp="1"><freejoint name="tray"/>
    <geom name="tray" type="box" size="0.1 0.1 0.02" mass="1"/></body>"""
MAT = Region("mat", "tray", (1.0, 0.3), (0.08, 0.08))


@pytest.mark.parametrize(
    ("column", "value", "words"),
    [(4, 0.1, "no support 'tray', which is tilted by 11 degrees"), (1, 0.6, "'mat' lies beside its support 'tray'")],
)
@pytest.mark.parametrize("goal", [goals.inside("can", "mat"), goals.on("can", "plate") & goals.clear("mat")])
def test_a_support_that_has_been_knocked_over_or_away_is_the_failure_of_a_report(
    column: int, value: float, words: str, goal: Goal
) -> None:
    """It raised instead, in the report, and at the end of the plan: there is nothing to do for the second goal."""
    controller, world = controlled(0.1, 0.1, TRAY, more_supports=["tray"], regions=[MAT])
    expert = TampExpert(world, grasps="side")
    expert.reset(goal)
    controller.data.qpos[controller.model.joint("tray").qposadr + column] = value
    for _ in range(60 if "clear" in str(goal) else 1):
        world.step(expert.act())
    assert words in expert.report.failure
    assert not expert.report.scored
    assert expert.done == ("clear" in str(goal))


def test_the_world_of_an_episode_is_gone_when_that_of_the_next_one_is_made() -> None:
    """Twenty episodes of large models took 8 GB: a task and its world refer to each other."""
    gc.disable()
    try:
        controller, world = controlled(0.1, 0.1)
        controller.world = world  # type: ignore[attr-defined]  # as the tasks of the bridges do
        former = weakref.ref(world)
        del controller, world
        controlled(0.1, 0.1)
        assert former() is None
    finally:
        gc.enable()


def test_misuse_of_a_controller_is_told() -> None:
    controller, world = controlled(0.1, 0.1)
    expert = TampExpert(world)
    with pytest.raises(ExpertError, match=r"goal of ControlledWorld.*reset\(goal\)"):
        expert.reset()
    controller.observe = lambda: np.zeros(3)  # type: ignore[method-assign]  # a fault is meant
    with pytest.raises(ExpertError, match=f"{world.model.nq} finite numbers"):
        world.step(np.zeros(12))
    with pytest.raises(ExpertError, match=r"dt=0 of Deltas is not valid"):
        controlled(0, 0.1)
