"""robosuite's controller without its physics: where the gripper and the elbow go, and what a joint's limit does."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
from numpy.typing import NDArray

from assets import robot
from clutter_env.bridges.osc import Lead, OscFollower
from planners import FollowingPlanner, Region, RobotState, Solution, goals, tcp_pose
from planners.collision.world import CompiledScenes
from planners.motion.tcp_following import follow, is_behind
from planners.warming import warmup_scene

PANDA = robot("panda_mobile").fixed()
HOME = np.array(PANDA.home)
MOST = np.array([0.05] * 3 + [0.5] * 3)


def controller(start: NDArray[np.float64] = HOME) -> OscFollower:
    data = mujoco.MjData(mujoco.MjModel.from_xml_path(str(PANDA.mjcf_path)))
    data.joint(PANDA.torso_joint).qpos = HOME[0]
    return OscFollower(
        data,
        list(PANDA.arm_joints),
        PANDA.tcp_site,
        start[1:],
        np.zeros(3),
        np.eye(4),
        lift=HOME[0],
        dt=0.05,
        stiffness=150.0,
        lag=2 / np.sqrt(150.0) / 0.05,
        most=MOST,
    )


def pose(q: NDArray[np.float64]) -> NDArray[np.float64]:
    return tcp_pose(PANDA, RobotState(np.zeros(3), q, 0.0))


def test_the_gripper_arrives_and_no_faster_than_an_action_takes_it() -> None:
    osc, wanted = controller(), pose(HOME)
    wanted[:3, 3] += 0.1, -0.1, 0.05
    osc.reset(HOME)
    before = pose(HOME)
    for _ in range(40):
        now = pose(osc.step(wanted))
        assert np.abs(now[:3, 3] - before[:3, 3]).max() < 0.4 * 0.05  # [m] 0.31 m/s, and a little more on the way
        before = now
    assert not is_behind(wanted, before, 0.003)


def test_the_elbow_goes_back_to_where_it_started_and_the_gripper_stays() -> None:
    elsewhere = HOME.copy()
    elsewhere[3] += 0.6  # the third joint of the arm
    osc, wanted, q = controller(elsewhere), pose(HOME), HOME
    osc.reset(HOME)
    for _ in range(60):
        q = osc.step(wanted)
    assert np.abs(q - HOME).max() > 0.15
    assert not is_behind(wanted, pose(q), 0.005)
    osc = controller()
    osc.reset(q)
    for _ in range(60):
        q = osc.step(wanted)
        assert not is_behind(wanted, pose(q), 0.02)
    np.testing.assert_allclose(q, HOME, atol=0.02)


def test_while_a_plan_waits_the_lead_fades_but_is_not_lost_at_once() -> None:
    start, wanted = pose(HOME), pose(HOME)
    lead = Lead(start, 3.0, MOST)
    wanted[0, 3] += 0.01
    first = lead.action(wanted, start)
    np.testing.assert_allclose(first, [(0.01 + 3 * 0.01) / 0.05, 0, 0, 0, 0, 0], atol=1e-9)
    later = [lead.action(wanted, wanted)[0] for _ in range(20)]
    assert 0.5 * 3 * 0.01 / 0.05 < later[0] < first[0]
    assert np.all(np.diff(later) < 0)
    assert later[-1] < 0.01


def test_a_joint_at_its_limit_stays_there() -> None:
    osc, wanted, upper = controller(), pose(HOME), PANDA.chain[-1].upper
    osc.reset(HOME)
    for _ in range(60):  # about the axis of the gripper, farther than its last joint goes
        now = pose(osc.step(wanted))
        wanted = now @ _turned_about_x(0.3)
    q = osc.step(wanted)
    assert abs(q[-1]) <= upper
    assert abs(q[-1]) > upper - 0.2
    assert is_behind(wanted, pose(q), 0.03)


def _turned_about_x(angle: float) -> NDArray[np.float64]:
    T = np.eye(4)
    T[1:3, 1:3] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    return T


def test_a_plan_for_the_controller_is_followed_and_touches_nothing() -> None:
    scene = replace(warmup_scene(PANDA), regions=(Region("left", "table_top", (0.05, 0.35), (0.15, 0.1)),))
    osc = controller()
    found = FollowingPlanner(PANDA, controller=osc).solve(scene, goals.inside("object_01", "left"))
    assert isinstance(found, Solution), found
    q = np.array(scene.state.q)
    for action in found.actions:
        followed = follow(osc, PANDA, q, action.trajectory)
        assert followed is not None
        q = followed.configurations[-1, 3:]
        world, own = CompiledScenes().world(action.scene), (action.target,) if action.target else ()
        hits = followed.hits(world.with_padding(0.0), action.scene.mask(own))
        assert not action.scene.names_of(hits)
