"""robosuite's controller without its physics: where the gripper and the elbow go, and what a joint's limit does."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from assets import robot
from clutter_env.bridges.osc import Lead, OscFollower, change
from planners import FollowingPlanner, Region, RobotState, Solution, goals, tcp_pose
from planners.collision.world import CompiledScenes
from planners.motion.tcp_following import follow, is_behind
from planners.warming import warmup_scene

PANDA = robot("panda_mobile").fixed()
HOME = np.array(PANDA.in_front)
MOST = np.array([0.05] * 3 + [0.5] * 3)


STRENGTH = np.array([80.0] * 5 + [12.0] * 2)


def arm_in_air() -> mujoco.MjModel:
    """The arm with links, motors and air as robosuite has them: the inertia is that of boxes of half a metre."""
    spec = mujoco.MjSpec.from_file(str(PANDA.mjcf_path))
    spec.option.density, spec.option.viscosity, spec.option.timestep = 1.2, 2e-5, 0.002
    spec.option.disableflags = mujoco.mjtDisableBit.mjDSBL_CONTACT | mujoco.mjtDisableBit.mjDSBL_ACTUATION
    model = spec.compile()
    model.dof_armature[:] = 1e9  # the base stands
    for number, name in enumerate(PANDA.arm_joints):
        body, dof = int(model.joint(name).bodyid[0]), int(model.joint(name).dofadr[0])
        model.body_inertia[body] = 0.1 * model.body_mass[body]
        model.dof_armature[dof] = 5 / (number + 1)
    model.body_gravcomp[:] = model.dof_damping[:] = model.dof_frictionloss[:] = 0.0
    mujoco.mj_setConst(model, mujoco.MjData(model))
    return model


def controller(start: NDArray[np.float64] = HOME, in_air: bool = False) -> OscFollower:
    """Of an arm like robosuite's, or of ours with motors that are strong enough for everything."""
    model = arm_in_air() if in_air else mujoco.MjModel.from_xml_path(str(PANDA.mjcf_path))
    model.dof_damping[:] = model.body_gravcomp[:] = 0.0
    data = mujoco.MjData(model)
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
        strength=STRENGTH if in_air else np.full(7, np.inf),
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


def simulated(poses: list[NDArray[np.float64]]) -> NDArray[np.float64]:
    """(n, 7) where MuJoCo's physics takes the arm: robosuite's equations, 25 times a step, with its motors' limits."""
    model = arm_in_air()
    data = mujoco.MjData(model)
    qpos = np.array([model.joint(name).qposadr[0] for name in PANDA.arm_joints])
    dofs = np.array([model.joint(name).dofadr[0] for name in PANDA.arm_joints])
    data.joint(PANDA.torso_joint).qpos, data.qpos[qpos] = HOME[0], HOME[1:]
    found = []
    site = data.site(PANDA.tcp_site)
    lead = Lead(pose(HOME), 2 / np.sqrt(150.0) / 0.05, MOST)
    for wanted in poses:
        now = pose(np.append(HOME[0], data.qpos[qpos]))
        goal, action = now.copy(), lead.action(wanted, now) * MOST
        goal[:3, 3] += action[:3]
        goal[:3, :3] = Rotation.from_rotvec(action[3:]).as_matrix() @ now[:3, :3]
        for _ in range(25):
            mujoco.mj_forward(model, data)
            J, M = np.empty((6, model.nv)), np.empty((model.nv, model.nv))
            mujoco.mj_jacSite(model, data, J[:3], J[3:], model.site(PANDA.tcp_site).id)
            mujoco.mj_fullM(model, data, M)
            J, M, qd, inertia = J[:, dofs], M[np.ix_(dofs, dofs)], data.qvel[dofs], np.zeros((6, 6))
            inverse = np.linalg.inv(M)
            for rows in (slice(0, 3), slice(3, 6)):
                inertia[rows, rows] = np.linalg.pinv(J[rows] @ inverse @ J[rows].T)
            here = np.eye(4)
            here[:3, :3], here[:3, 3] = site.xmat.reshape(3, 3), site.xpos
            force = 150 * change(here, goal) - 2 * np.sqrt(150) * (J @ qd)
            free = np.eye(7) - J.T @ np.linalg.pinv(J @ inverse @ J.T) @ J @ inverse
            elbow = M @ (10 * (HOME[1:] - data.qpos[qpos]) - 2 * np.sqrt(10) * qd)
            torque = J.T @ inertia @ force + free @ elbow + data.qfrc_bias[dofs]
            data.qfrc_applied[dofs] = np.clip(torque, -STRENGTH, STRENGTH)
            mujoco.mj_step(model, data)
        found.append(data.qpos[qpos].copy())
    return np.array(found)


def test_the_arm_goes_where_air_and_weak_motors_let_it_go() -> None:
    end = pose(HOME)
    end[:3, 3] += -0.05, 0.25, -0.1
    end[:3, :3] = Rotation.from_euler("zy", (1.2, 0.7)).as_matrix() @ end[:3, :3]
    turn, poses = change(pose(HOME), end)[3:], []
    for share in np.minimum(np.arange(1, 41) / 16, 1.0):
        wanted = pose(HOME)
        wanted[:3, 3] += share * (end[:3, 3] - wanted[:3, 3])
        wanted[:3, :3] = Rotation.from_rotvec(share * turn).as_matrix() @ wanted[:3, :3]
        poses.append(wanted)
    osc = controller(in_air=True)
    osc.reset(HOME)
    expected, away = np.array([osc.step(wanted)[1:] for wanted in poses]), simulated(poses)
    assert np.abs(away - HOME[1:]).max() > 1.0
    np.testing.assert_allclose(expected, away, atol=0.1)


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
