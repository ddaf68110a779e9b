"""Arms read from MJCF and URDF files: poses are MuJoCo's, what is no arm is refused, and queries work."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from assets.robots import FETCH
from irm import ArmChain, InverseReachabilityMap, ReachabilityMap, Status, classify, decide, forward
from irm.errors import ChainError
from tests.irm.arms import FOLDER, arm_chain, arm_model, random_configurations


@pytest.mark.parametrize("approach", ["x", "-x", "y", "-y", "z", "-z"])
def test_the_x_axis_of_the_tcp_is_the_approach(approach):
    model = arm_model("panda")
    plain, turned = ArmChain.from_mjcf(model, "base", "tcp"), ArmChain.from_mjcf(model, "base", "tcp", approach)
    q = np.array([0.0, 0.3, -0.4, 0.2, -1.7, 0.4, 1.2, 0.6])
    T, T_turned = forward(plain, q), forward(turned, q)
    sign, axis = (-1, approach[1]) if approach[0] == "-" else (1, approach)
    np.testing.assert_allclose(T_turned[:3, 0], sign * T[:3, "xyz".index(axis)], atol=1e-12)
    np.testing.assert_allclose(T_turned[:3, 3], T[:3, 3], atol=1e-12)
    assert np.linalg.det(T_turned[:3, :3]) == pytest.approx(1.0)


def test_fetch_from_its_own_file_is_fetch():
    chain, fetch = ArmChain.from_mjcf(FETCH.mjcf_path, FETCH.base_body, FETCH.tcp_site), ArmChain.from_robot(FETCH)
    assert chain.has_closed_form
    assert chain.joints == fetch.joints
    for q in random_configurations(fetch, 20, np.random.default_rng(2)):
        np.testing.assert_allclose(forward(chain, q), forward(fetch, q), atol=1e-9)


def test_a_lift_is_a_joint_and_an_arm_without_one_has_one_that_does_not_move():
    lifted, fixed = arm_chain("pr2_arm"), arm_chain("panda")
    assert lifted.joints[0] == "torso_lift"
    assert (lifted.lower[0], lifted.upper[0]) == (0.0115, 0.325)
    assert (fixed.joints[0], fixed.lower[0], fixed.upper[0]) == ("", 0.0, 0.0)
    odd = ArmChain.from_mjcf(FOLDER / "odd.xml", "world", "tool")
    assert odd.joints == ("", "a", "b", "c", "d", "e", "f")
    np.testing.assert_allclose(np.degrees([odd.lower[1], odd.upper[1]]), [-170, 160])
    assert odd.upper[5] - odd.lower[5] >= 2 * np.pi  # it has no limits


def test_self_collision_pairs_are_those_that_the_model_collides():
    model = arm_model("panda")
    pairs = {frozenset(pair) for pair in arm_chain("panda").self_collisions}
    assert frozenset(("link1", "link2")) not in pairs
    assert frozenset(("link1", "link3")) in pairs
    data, rng = mujoco.MjData(model), np.random.default_rng(3)
    touching = set()
    for _ in range(300):
        data.qpos[:] = rng.uniform(*model.jnt_range.T)
        mujoco.mj_forward(model, data)
        bodies = model.geom_bodyid[data.contact.geom]
        touching |= {frozenset((model.body(a).name, model.body(b).name)) for a, b in bodies}
    assert touching
    assert touching <= pairs


def test_what_is_no_arm_is_refused_with_the_reason(tmp_path):
    model = arm_model("pr2_arm")
    with pytest.raises(ChainError, match=r"no body 'bse'; there are 'world', 'base', 'torso'"):
        ArmChain.from_mjcf(model, "bse", "tcp")
    with pytest.raises(ChainError, match=r"no site or body 'tool'; there are the sites 'tcp'"):
        ArmChain.from_mjcf(model, "base", "tool")
    with pytest.raises(ChainError, match="'base' is not attached to 'gripper'"):
        ArmChain.from_mjcf(model, "gripper", "base")
    with pytest.raises(ChainError, match=r"6 or 7 hinges.*wrist_flex \(hinge\)"):
        ArmChain.from_mjcf(model, "forearm", "tcp")
    with pytest.raises(ChainError, match="'-z'"):
        ArmChain.from_mjcf(model, "base", "tcp", "w")
    with pytest.raises(ChainError, match="cannot be read"):
        ArmChain.from_mjcf(tmp_path / "none.xml", "base", "tcp")
    text = (FOLDER / "pr2_arm.xml").read_text()
    for old, new, reason in (
        ('type="slide" axis="0 0 1"', 'type="slide" axis="0 0 -1"', "must slide along"),
        ('type="slide" axis="0 0 1"', 'type="slide" axis="1 0 0"', "must slide along"),
        ('type="slide" axis="0 0 1" range="0.0115 0.325"', 'type="ball"', "'torso_lift'"),
    ):
        with pytest.raises(ChainError, match=reason):
            ArmChain.from_mjcf(mujoco.MjModel.from_xml_string(text.replace(old, new)), "base", "tcp")


AXES = ("0 0 1", "0 1 0", "0 1 0", "1 0 0", "0 1 0", "1 0 0")
MESH = '<visual><geometry><mesh filename="package://nowhere/x.stl"/></geometry></visual>'
JOINT = """<joint name="j{k}" type="revolute"><parent link="l{k}"/><child link="l{n}"/><origin xyz="0 0 0.2"/>
  <axis xyz="{axis}"/><limit lower="-2" upper="2" effort="1" velocity="1"/></joint>"""


def urdf():
    links = "".join(f'<link name="l{k}">{MESH}</link>' for k in range(7))
    joints = "".join(JOINT.format(k=k, n=k + 1, axis=axis) for k, axis in enumerate(AXES))
    fixed = '<parent link="l6"/><child link="tip"/><origin xyz="0 0 0.1"/>'
    tip = f'<link name="tip"/><joint name="t" type="fixed">{fixed}</joint>'
    return f'<robot name="six">{links}{tip}{joints}</robot>'


def test_a_chain_is_that_of_its_file_and_meshes_may_be_missing(tmp_path):
    file = tmp_path / "six.urdf"
    file.write_text(urdf())
    chain = ArmChain.from_urdf(file, base="l0", tip="tip", approach="z")
    assert (chain.size, chain.joints[1:]) == (7, tuple(f"j{k}" for k in range(6)))
    np.testing.assert_allclose(forward(chain, np.zeros(7))[:3, 3], (0.0, 0.0, 1.3), atol=1e-12)
    np.testing.assert_allclose(forward(chain, np.zeros(7))[:3, 0], (0.0, 0.0, 1.0), atol=1e-12)


def test_what_is_no_urdf_file_is_refused(tmp_path):
    file = tmp_path / "none.urdf"
    file.write_text("<robot")
    with pytest.raises(ChainError, match="URDF"):
        ArmChain.from_urdf(file, "l0", "tip")


@pytest.fixture(scope="module")
def ur5e_map():
    return ReachabilityMap.build(arm_chain("ur5e"), voxel=0.1, orientations=26, samples=50_000)


@pytest.mark.slow
def test_from_the_file_to_a_query(ur5e_map):
    placement = InverseReachabilityMap(ur5e_map).query((0.5, 0.0, 0.4), pitch=np.pi / 2, k=3)
    assert placement.status is not Status.NO
    assert len(placement) == 3
    assert np.hypot(*(placement.poses[:, :2] - (0.5, 0.0)).T).max() < 1.2


@pytest.mark.slow
def test_poses_of_the_arm_are_decided_and_what_a_sampled_map_says_no_to_is_asked_again(ur5e_map):
    chain = ur5e_map.chain
    T = np.array([forward(chain, q) for q in random_configurations(chain, 300, np.random.default_rng(0))])
    assert np.all(decide(ur5e_map, T) == Status.YES.value)
    empty, above = ur5e_map.subset(np.zeros(len(ur5e_map), dtype=bool)), T[T[:, 2, 3] > 0]
    assert np.all(classify(empty, above) == Status.NO.value)
    assert np.all(decide(empty, above) == Status.YES.value)
    above[:, 0, 3] += 2.0
    assert np.all(decide(ur5e_map, above) == Status.NO.value)
