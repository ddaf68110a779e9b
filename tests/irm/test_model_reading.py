"""Arms read from MJCF and URDF files: poses are MuJoCo's, what is no arm is refused, and queries work."""

from __future__ import annotations

import itertools
import re

import mujoco
import numpy as np
import pytest

import assets
from assets.robots import FETCH
from irm import ArmChain, InverseReachabilityMap, ReachabilityMap, SelfCollision, Status, classify, decide, forward
from irm.errors import ChainError
from irm.self_contact import CLEARANCE, link_of_body
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


@pytest.mark.parametrize("name", ["fetch", "pr2", "panda_mobile"])
def test_shapes_count_whatever_their_masks(name):
    """The robots of the package pass through themselves in physics: every configuration was called free."""
    robot = assets.robot(name)
    chain, model = ArmChain.from_robot(robot), mujoco.MjModel.from_xml_path(str(robot.mjcf_path))
    data, is_free = mujoco.MjData(model), SelfCollision(chain)
    for joint, angle in zip(robot.still_joints, robot.still_configuration, strict=True):
        data.joint(joint).qpos = angle
    for joint in robot.finger_joints:
        data.joint(joint).qpos = robot.max_finger_position
    columns = [int(model.joint(link.joint).qposadr[0]) for link in robot.chain]
    links, geoms = link_of_body(model, robot.drive_joints[3:]), robot.collision_geoms(model)
    of_geom = {geom: links[int(model.geom_bodyid[geom])] for geom in geoms}
    pairs = [(a, b) for a, b in itertools.combinations(geoms, 2) if abs(of_geom[a] - of_geom[b]) > 1]
    touching = 0
    for q in random_configurations(chain, 150, np.random.default_rng(3)):
        data.qpos[columns] = q
        mujoco.mj_kinematics(model, data)
        apart = min(mujoco.mj_geomDistance(model, data, a, b, 0.01, None) for a, b in pairs)
        if abs(apart - CLEARANCE) > 1e-4:
            assert is_free(np.zeros(3), q) == (apart > CLEARANCE), apart
        touching += apart < 0
    assert touching > 20


def test_pairs_that_always_touch_belong_together():
    """A collar on the second link that encloses a pin on the fourth would make every configuration collide."""
    text = (FOLDER / "pr2_arm.xml").read_text()
    plain = arm_chain("pr2_arm")
    collar = text.replace('<body name="elbow"', '<geom type="sphere" size="0.3" pos="0.3 0 0"/><body name="elbow"', 1)
    if collar == text:
        pytest.fail("the model has no elbow")
    chain = ArmChain.from_mjcf(mujoco.MjModel.from_xml_string(collar), "base", "tcp")
    added = len(chain.shapes.pairs) - len(plain.shapes.pairs)
    assert 0 <= added < len(plain.shapes.core)
    links = chain.shapes.link[chain.shapes.pairs]
    assert np.abs(np.diff(links, axis=1)).min() > 1


def test_hulls_of_meshes_are_shapes():
    corners = " ".join(f"{x} {y} {z}" for x in (-0.1, 0.1) for y in (-0.1, 0.1) for z in (0, 0.2))
    text = (FOLDER / "panda.xml").read_text()
    mesh = text.replace("<worldbody>", f'<asset><mesh name="block" vertex="{corners}"/></asset><worldbody>', 1)
    mesh = mesh.replace('<body name="base">', '<body name="base"><geom type="mesh" mesh="block" pos="-0.3 0 0"/>', 1)
    plain, chain = arm_chain("panda"), ArmChain.from_mjcf(mujoco.MjModel.from_xml_string(mesh), "base", "tcp", "z")
    assert len(chain.shapes.core) == len(plain.shapes.core) + 1
    free, free_of_block = SelfCollision(plain), SelfCollision(chain)
    model = mujoco.MjModel.from_xml_string(mesh)
    data, block = mujoco.MjData(model), int(np.flatnonzero(model.geom_type == int(mujoco.mjtGeom.mjGEOM_MESH))[0])
    far = [g for g in range(model.ngeom) if model.geom_bodyid[g] > model.body("link1").id]
    touching = 0
    for q in random_configurations(plain, 400, np.random.default_rng(0)):
        data.qpos[:7] = q[1:]
        mujoco.mj_kinematics(model, data)
        apart = min(mujoco.mj_geomDistance(model, data, block, g, 0.01, None) for g in far)
        assert free_of_block(None, q) == (free(None, q) and apart > CLEARANCE) or abs(apart - CLEARANCE) < 1e-4
        touching += apart < 0 and free(None, q)
    assert touching > 5


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


def test_fixed_links_of_a_urdf_file_are_frames_either_way(tmp_path):
    """`from_mjcf` lost them: MuJoCo joins what is fixed to its parent."""
    text = urdf().replace('<link name="l0">', '<link name="root"/><link name="l0">', 1)
    fixed = (
        '<joint name="b" type="fixed"><parent link="root"/><child link="l0"/><origin xyz="0 0 0.3"/></joint></robot>'
    )
    file = tmp_path / "six.urdf"
    file.write_text(text.replace("</robot>", fixed).replace(MESH, ""))
    for read in (ArmChain.from_urdf, ArmChain.from_mjcf):
        for base, height in (("root", 1.6), ("l0", 1.3)):
            chain = read(file, base, "tip", "z")
            np.testing.assert_allclose(forward(chain, np.zeros(7))[:3, 3], (0.0, 0.0, height), atol=1e-12)


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
    Q = random_configurations(chain, 300, np.random.default_rng(0))
    T = np.array([forward(chain, q) for q in Q if SelfCollision(chain)(None, q)])
    assert np.all(decide(ur5e_map, T) == Status.YES.value)
    empty, above = ur5e_map.subset(np.zeros(len(ur5e_map), dtype=bool)), T[T[:, 2, 3] > 0]
    assert np.all(classify(empty, above) == Status.UNKNOWN.value)  # it said NO
    assert np.all(decide(empty, above) == Status.YES.value)
    above[:, 0, 3] += 2.0
    assert np.all(decide(ur5e_map, above) == Status.NO.value)


CUBE = "".join(f"v {x} {y} {z}\n" for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)) + "f 1 2 3\nf 2 3 5\n"
"""An .obj file of a cube of 2 m."""


def shaped(tag: str, size: str = "0.05 0.05 0.05", name: str = "cube.obj") -> str:
    return f'<{tag}><geometry><mesh filename="{name}" scale="{size}"/></geometry></{tag}>'


def write(folder, text):
    (folder / "cube.obj").write_text(CUBE)
    (folder / "six.urdf").write_text(text)
    return folder / "six.urdf"


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('velocity="1"', 'velocity="1" drake:acceleration="2"'),
        (
            "</robot>",
            '<drake:transmission/><mujoco><compiler meshdir="meshes" discardvisual="false"/></mujoco></robot>',
        ),
        ("<robot", "\n<!-- made -- by hand --><robot"),
    ],
)
def test_urdf_files_that_mujoco_reads_are_read(tmp_path, old, new):
    """They were refused: unbound prefixes, a <compiler> of the file's own, comments that XML does not allow."""
    text = urdf().replace(MESH, "").replace(old, new)
    chain = ArmChain.from_urdf(write(tmp_path, text), "l0", "tip", "z")
    np.testing.assert_allclose(forward(chain, np.zeros(7))[:3, 3], (0.0, 0.0, 1.3), atol=1e-12)


def test_meshes_are_found_in_the_folder_that_the_file_names(tmp_path):
    (tmp_path / "meshes").mkdir()
    text = urdf().replace(MESH, shaped("collision", name="package://gone/x/cube.obj"))
    file = write(tmp_path, text.replace("</robot>", '<mujoco><compiler meshdir="meshes"/></mujoco></robot>'))
    (tmp_path / "cube.obj").rename(tmp_path / "meshes" / "cube.obj")
    assert len(ArmChain.from_urdf(file, "l0", "tip", "z").shapes.core) == 7


def test_meshes_of_urdf_files_are_shapes_and_visuals_where_there_is_nothing_else(tmp_path):
    """Of link 0 both, of link 1 what is for the eye, of link 2 the mark of a frame; all were dropped."""
    mark = '<visual><geometry><box size="0.01 0.01 0.01"/></geometry></visual>'
    shapes = [shaped("visual", "0.9 0.9 0.9") + shaped("collision"), shaped("visual"), mark]
    text = urdf().replace(MESH, "")
    for k, shape in enumerate(shapes):
        text = text.replace(f'<link name="l{k}">', f'<link name="l{k}">{shape}')
    chain = ArmChain.from_urdf(write(tmp_path, text), "l0", "tip", "z")
    assert sorted(chain.shapes.link) == [0, 1]
    assert chain.shapes.bound.max() < 0.2, "the large one is for the eye of a link that has another"


@pytest.mark.parametrize(("name", "reason"), [("x.glb", "trimesh"), ("x.dae", r"\.stl, \.obj"), ("x.stl", "no mesh")])
def test_meshes_that_are_no_shapes_are_logged_by_the_name_of_the_link(tmp_path, caplog, name, reason):
    text = urdf().replace(MESH, "").replace('<link name="l3">', f'<link name="l3">{shaped("collision", name=name)}')
    with caplog.at_level("WARNING"):
        ArmChain.from_urdf(write(tmp_path, text), "l0", "tip", "z")
    (record,) = caplog.records
    assert "'l3'" in record.message
    assert name in record.message
    assert re.search(reason, record.message)


def test_meshes_in_millimetres_are_refused(tmp_path):
    text = urdf().replace(MESH, "").replace('<link name="l3">', f'<link name="l3">{shaped("collision", "50 50 50")}')
    with pytest.raises(ChainError, match=r"mesh of 'l3' is \d+ m long: .*millimetres.*scale"):
        ArmChain.from_urdf(write(tmp_path, text), "l0", "tip", "z")


def test_joints_that_follow_others_are_no_joints_of_an_arm(tmp_path):
    """They were read as free: poses were called reachable that are not. Beyond the tip they do not matter."""
    text = urdf().replace(MESH, "")
    mimic = '<mimic joint="{}" multiplier="-1"/></joint>'
    third, last = (text.index("</joint>", text.index(f'name="j{k}"')) for k in (2, 5))
    with pytest.raises(ChainError, match=r"'j2' follows 'j1'"):
        ArmChain.from_urdf(
            write(tmp_path, text[:third] + mimic.format("j1") + text[third + 8 :]), "l0", "tip", approach="z"
        )
    finger = text[: last + 8] + (
        '<link name="finger"/><joint name="f" type="revolute"><parent link="l6"/><child link="finger"/>'
        '<axis xyz="0 0 1"/><limit lower="-1" upper="1" effort="1" velocity="1"/>' + mimic.format("j5")
    )
    assert ArmChain.from_urdf(write(tmp_path, finger + text[last + 8 :]), "l0", "tip", "z").size == 7
    panda = (FOLDER / "panda.xml").read_text()
    coupled = panda.replace("</mujoco>", '<equality><joint joint1="joint3" joint2="joint2"/></equality></mujoco>')
    with pytest.raises(ChainError, match=r"'joint3' follows 'joint2'"):
        ArmChain.from_mjcf(mujoco.MjModel.from_xml_string(coupled), "base", "tcp")


@pytest.mark.parametrize(("rpy", "is_upright"), [("1.2 0 0", False), ("3.14159 0 0", False), ("0.0001 0 2", True)])
def test_a_base_that_does_not_stand_upright_is_refused(tmp_path, rpy, is_upright):
    """Answers about the floor take z to point up."""
    text = urdf().replace(MESH, "").replace('<link name="l0">', '<link name="root"/><link name="l0">', 1)
    joint = f'<joint name="b" type="fixed"><parent link="root"/><child link="l0"/><origin rpy="{rpy}"/></joint></robot>'
    file = write(tmp_path, text.replace("</robot>", joint))
    assert ArmChain.from_urdf(file, "root", "tip", "z").size == 7
    if is_upright:
        assert ArmChain.from_urdf(file, "l0", "tip", "z").size == 7
        return
    with pytest.raises(ChainError, match=r"'l0' is .* rad off the vertical.*: 'root', 'world'"):
        ArmChain.from_urdf(file, "l0", "tip", "z")


def test_a_joint_of_the_base_body_itself_is_not_dropped(tmp_path):
    """It was, and an arm of seven joints became one of six; the joints of a base that drives are not the arm's."""
    panda = arm_model("panda")
    with pytest.raises(ChainError, match=r"'joint1' moves 'link1' itself.*choose 'base'"):
        ArmChain.from_mjcf(panda, "link1", "tcp")
    assert ArmChain.from_mjcf(FETCH.mjcf_path, FETCH.base_body, FETCH.tcp_site).size == 8
    text = urdf().replace(MESH, "")
    for k, (kind, axis) in enumerate((("prismatic", "1 0 0"), ("prismatic", "0 1 0"), ("continuous", "0 0 1"))):
        child = "l0" if k == 2 else f"b{k + 1}"
        text = text.replace(
            "</robot>",
            f'<link name="b{k}"/><joint name="d{k}" type="{kind}"><parent link="b{k}"/><child link="{child}"/>'
            f'<axis xyz="{axis}"/><limit lower="-9" upper="9" effort="1" velocity="1"/></joint></robot>',
        )
    file = write(tmp_path, text)
    assert ArmChain.from_urdf(file, "l0", "tip", "z").size == 7, "a base that drives, link by link"
    with pytest.raises(ChainError, match=r"6 or 7 hinges|'j0' moves 'l1' itself"):
        ArmChain.from_urdf(file, "l1", "tip", "z")


def test_a_xacro_file_is_named_as_such(tmp_path):
    include = '<xacro:include filename="arm.xacro"/><link'
    text = urdf().replace("<robot", '<robot xmlns:xacro="http://ros.org/wiki/xacro"', 1)
    assert ArmChain.from_urdf(write(tmp_path, text.replace(MESH, "")), "l0", "tip", "z").size == 7
    with pytest.raises(ChainError, match=r"xacro six\.urdf > robot\.urdf"):
        ArmChain.from_urdf(write(tmp_path, text.replace("<link", include, 1)), "l0", "tip", "z")


LIMITS = 'lower="-2" upper="2"'


@pytest.mark.parametrize("limits", ["2 -2", "0 0", "1.5 1.5", "nan 1", "-inf inf"])
def test_limits_that_leave_no_motion_are_refused(tmp_path, limits):
    """MuJoCo reads equal ones, inverted ones and NaN as none: the joint turned without end."""
    lower, upper = limits.split()
    text = urdf().replace(MESH, "")
    with pytest.raises(ChainError, match=r"'j0' has the limits .* leave it no motion; .*continuous"):
        ArmChain.from_urdf(write(tmp_path, text.replace(LIMITS, f'lower="{lower}" upper="{upper}"')), "l0", "tip", "z")
    spec = mujoco.MjSpec.from_file(str(FOLDER / "panda.xml"))
    if lower != upper or float(lower):  # equal to 0 is MJCF's word for none
        spec.joint("joint2").range = float(lower), float(upper)
        with pytest.raises(ChainError, match=r"'joint2' has the limits"):
            ArmChain.from_mjcf(spec.compile(), "base", "tcp")


def test_a_limit_that_a_urdf_file_leaves_out_is_0(tmp_path):
    """With one of two, MuJoCo read none; a joint without any has none."""
    text = urdf().replace(MESH, "")
    chain = ArmChain.from_urdf(write(tmp_path, text.replace(LIMITS, 'upper="1.5"', 1)), "l0", "tip", "z")
    assert (chain.lower[1], chain.upper[1], chain.upper[2]) == (0.0, 1.5, 2.0)
    chain = ArmChain.from_urdf(write(tmp_path, text.replace(LIMITS, "", 1)), "l0", "tip", "z")
    assert (chain.lower[1], chain.upper[1]) == (-2 * np.pi, 2 * np.pi)
    with pytest.raises(ChainError, match="a limit of 'j0'"):
        ArmChain.from_urdf(write(tmp_path, text.replace('lower="-2"', 'lower="two"', 1)), "l0", "tip", "z")


def test_limits_in_degrees_are_refused(tmp_path):
    """They were read as radians, so that no joint had a limit that matters."""
    text = urdf().replace(MESH, "")
    for degrees, is_refused in ((120, True), (6.2832, False), (1e4, False)):
        file = write(tmp_path, text.replace(LIMITS, f'lower="-{degrees}" upper="{degrees}"'))
        if is_refused:
            with pytest.raises(ChainError, match=r"up to 120 rad: .*degrees"):
                ArmChain.from_urdf(file, "l0", "tip", "z")
        else:
            assert ArmChain.from_urdf(file, "l0", "tip", "z").upper[1] == degrees


def test_numbers_that_are_none_are_refused_by_the_name_of_the_body(tmp_path):
    text = urdf().replace(MESH, "").replace('xyz="0 0 0.2"', 'xyz="0 nan 0.2"', 1)
    with pytest.raises(ChainError, match=r"of 'l1' .* is not a finite number"):
        ArmChain.from_urdf(write(tmp_path, text), "l0", "tip", "z")


@pytest.mark.parametrize(
    ("constraint", "tied"),
    [
        ('<connect body1="link2" body2="link4" anchor="0 0 0.1"/>', "'joint3', 'joint4'"),
        ('<weld body1="base" body2="link2"/>', "'joint1', 'joint2'"),
        ('<tendon tendon1="both"/>', "'joint2', 'joint4'"),
        ('<weld body1="base" body2="link2" active="false"/>', None),
        ('<weld body1="link7" body2="dragged"/>', None),
    ],
)
def test_joints_that_a_constraint_ties_together_are_no_joints_of_an_arm(constraint, tied):
    """Only `<joint>` constraints were seen; loops and tendons were read as free."""
    tendon = (
        '<tendon><fixed name="both"><joint joint="joint2" coef="1"/><joint joint="joint4" coef="1"/></fixed></tendon>'
    )
    text = (FOLDER / "panda.xml").read_text()
    text = text.replace("</worldbody>", '<body name="dragged" mocap="true"/></worldbody>' + tendon)
    model = mujoco.MjModel.from_xml_string(text.replace("</mujoco>", f"<equality>{constraint}</equality></mujoco>"))
    if tied is None:
        assert ArmChain.from_mjcf(model, "base", "tcp").size == 8
    else:
        with pytest.raises(ChainError, match=f"ties {tied} together"):
            ArmChain.from_mjcf(model, "base", "tcp")
