"""Radius of the trunk, and solid boxes against gripper, wrist and forearm, against MuJoCo."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from assets.robots import FETCH
from irm.errors import QueryError
from irm.robot_shape import SolidBoxes, robot_radius

BANDS = [(0.0, 0.7), (0.0, 0.3), (0.36, 0.82), (0.9, 1.2)]


@pytest.fixture(scope="module")
def deepest():
    """Largest penetration [m] of base, torso and head with a box of the given heights, over turns and torso heights."""
    arm = set()

    def measure(gap, low, high):
        spec = mujoco.MjSpec.from_file(str(FETCH.mjcf_path))
        box = spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, name="obstacle")
        box.size, box.pos = [0.5, 1.0, (high - low) / 2], [0.5 + gap, 0.0, (low + high) / 2]
        model = spec.compile()
        data = mujoco.MjData(model)
        first_arm_body = model.joint(FETCH.arm_joints[0]).bodyid[0]
        arm.clear()
        for body in range(model.nbody):
            if body == first_arm_body or model.body_parentid[body] in arm:
                arm.add(body)
        trunk = [g for g in range(model.ngeom) if model.geom_bodyid[g] and model.geom_bodyid[g] not in arm]
        trunk = [g for g in trunk if model.geom_contype[g] or model.geom_conaffinity[g]]
        worst = np.inf
        for yaw in np.linspace(-np.pi, np.pi, 181):
            for torso in np.linspace(FETCH.chain[0].lower, FETCH.chain[0].upper, 5):
                data.qpos[model.joint(FETCH.base_joints[2]).qposadr[0]] = yaw
                data.qpos[model.joint(FETCH.torso_joint).qposadr[0]] = torso
                mujoco.mj_forward(model, data)
                apart = [mujoco.mj_geomDistance(model, data, g, model.geom("obstacle").id, 0.2, None) for g in trunk]
                worst = min(worst, *apart)
        return -worst

    return measure


@pytest.mark.parametrize(("low", "high"), BANDS)
def test_a_base_outside_the_radius_touches_nothing_and_the_radius_is_not_larger_than_needed(deepest, low, high):
    radius = robot_radius(FETCH, low, high)
    assert deepest(radius + 0.001, low, high) <= 0.0
    assert deepest(radius - 0.006, low, high) > 0.0


def test_the_torso_extends_farther_than_the_base():
    assert robot_radius(FETCH, 0.0, 0.3) < robot_radius(FETCH, 0.36, 0.82) == robot_radius(FETCH)
    assert robot_radius(FETCH, 0.0, 0.3) == pytest.approx(FETCH.base_radius, rel=0.005)
    assert robot_radius(FETCH) > FETCH.base_radius + 0.02
    assert robot_radius(FETCH, 3.0, 4.0) == 0.0


TABLE = (0.75, 0.0, 0.73, 0.7, 1.0, 0.04)


@pytest.fixture(scope="module")
def table():
    return SolidBoxes.of(FETCH, [TABLE])


@pytest.fixture(scope="module")
def scene():
    """Fetch and the table; only the table's contacts count."""
    spec = mujoco.MjSpec.from_file(str(FETCH.mjcf_path))
    for geom in spec.geoms:
        if geom.contype or geom.conaffinity:
            geom.contype, geom.conaffinity = 1, 2
    box = {"type": mujoco.mjtGeom.mjGEOM_BOX, "pos": TABLE[:3], "size": [half / 2 for half in TABLE[3:]]}
    spec.worldbody.add_geom(name="table", contype=2, conaffinity=0, **box)
    model = spec.compile()
    return model, mujoco.MjData(model)


def random_arm(scene, rng):
    """A random configuration (1 + n,) with its TCP pose (4, 4), and how deep each body is in the table [m]."""
    model, data = scene
    lower, upper = np.array([(max(link.lower, -3.1), min(link.upper, 3.1)) for link in FETCH.chain]).T
    q = rng.uniform(lower, upper)
    for link, value in zip(FETCH.chain, q, strict=True):
        data.joint(link.joint).qpos[0] = value
    for name in FETCH.finger_joints:
        data.joint(name).qpos[0] = FETCH.max_finger_position
    mujoco.mj_kinematics(model, data)
    mujoco.mj_collision(model, data)
    T, site = np.eye(4), data.site(FETCH.tcp_site)
    T[:3, :3], T[:3, 3] = site.xmat.reshape(3, 3), site.xpos
    depths = {}
    for contact in data.contact[: data.ncon]:
        names = {model.body(int(model.geom_bodyid[geom])).name for geom in contact.geom}
        for name in names:
            depths[name] = max(depths.get(name, 0.0), -contact.dist)
    return q, T, depths


@pytest.mark.slow
def test_what_is_said_agrees_with_the_simulator(table, scene):
    hand = {"gripper_link", "wrist_roll_link", "r_gripper_finger_link", "l_gripper_finger_link"}
    wrist = {"wrist_flex_link", "forearm_roll_link"}
    rng = np.random.default_rng(0)
    blocked = clear = 0
    for _ in range(3000):
        q, T, depths = random_arm(scene, rng)
        if np.abs(T[:3, 3] - TABLE[:3]).max() > 0.8:
            continue
        if table.block(T[None], T[None, :2, 3])[0]:
            blocked += 1
            assert (hand | wrist) & depths.keys()
        elif not table.may_block(T[None])[0]:
            assert depths.get("wrist_flex_link", 0.0) < 0.003
        if table.are_clear(T, q[None])[0]:
            clear += 1
            assert max((depths.get(name, 0.0) for name in wrist), default=0.0) < 0.003
    assert blocked > 50
    assert clear > 50


def test_turning_about_the_target_is_taken_into_account(table):
    """A hand 2 cm behind the table's edge comes free if the pose may turn, one in the middle does not."""
    T = np.tile(np.eye(4), (2, 1, 1))
    T[:, :3, 3] = (0.75, 0.0, 0.73), (0.75, 0.62, 0.73)
    pivots = np.array([(0.75, 0.0), (0.75, 0.0)])
    assert table.block(T, pivots).tolist() == [True, False]
    T[1, 1, 3] = 0.53
    assert table.block(T, pivots).tolist() == [True, True]
    assert table.block(T, pivots, 0.2).tolist() == [True, False]


def test_a_turned_box_is_a_box(scene):
    turned = SolidBoxes.of(FETCH, [(*TABLE[:3], TABLE[4], TABLE[3], TABLE[5], np.pi / 2)])
    plain, rng = SolidBoxes.of(FETCH, [TABLE]), np.random.default_rng(1)
    poses = np.array([random_arm(scene, rng)[1] for _ in range(300)])
    np.testing.assert_array_equal(turned.may_block(poses), plain.may_block(poses))


@pytest.mark.parametrize("boxes", [[(0, 0, 0, 1, 1)], [(0, 0, 0, 1, 1, 0)], [(0, 0, np.nan, 1, 1, 1)], "table", [1, 2]])
def test_wrong_boxes_are_an_error(boxes):
    with pytest.raises(QueryError, match="rows of 6 or 7"):
        SolidBoxes.of(FETCH, boxes)
