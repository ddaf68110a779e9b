"""Robots made of the files of arms: kinematics, shapes, grippers, and what is refused."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from assets import InvalidRobot, RobotSpec
from assets.robot_making import Mounting, make_robot
from assets.robot_motors import PAYLOAD, given_limit, motors_of, payload_of
from assets.robot_shapes import lowest_height
from assets.robots import robot
from clutter_env.scene.object_sets import OBJECT_SETS
from clutter_env.simulation.robot_check import check_robot
from irm import ArmChain, SelfCollision, forward
from irm.chain import BASE

ARMS = Path(__file__).parents[1] / "data" / "arms"
UR5E = Mounting("base", "wrist_3", on=(0.15, 0.7), lift=(0.0, 0.4), tool=0.16)
HOME = (0.25, 2.6971, -1.372973, 2.419436, -1.046463, 1.126304, -1.570796)
TETRAHEDRA = "0 0 0  .1 0 0  0 .1 0  0 0 .2  .08 .08 .15"


@pytest.fixture(scope="module")
def linkage(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A UR5e with a mesh on its forearm, and a gripper whose fingers turn."""
    spec = mujoco.MjSpec.from_file(str(ARMS / "ur5e.xml"))
    mesh = spec.add_mesh(name="cover")
    mesh.uservert = [float(word) for word in TETRAHEDRA.split()]
    spec.body("forearm").add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname="cover", contype=1)
    for side in (1, -1):
        finger = spec.body("wrist_3").add_body(name=f"knuckle_{side}", pos=[0, 0.03 * side, 0.05])
        finger.add_joint(name=f"knuckle_{side}", axis=[1, 0, 0])
        finger.add_geom(size=[0.02, 0.01, 0.04], type=mujoco.mjtGeom.mjGEOM_BOX, mass=0.1)
    file = tmp_path_factory.mktemp("arm") / "linkage.xml"
    spec.compile()
    file.write_text(spec.to_xml())
    return file


@pytest.fixture(scope="module")
def round_ended(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An arm whose upper arm, a mesh, turns 1 cm above its base: round ends clear it, the corners of a box do not."""
    spec = mujoco.MjSpec()
    spec.compiler.degree = False
    turn = np.linspace(np.pi / 2, 3 * np.pi / 2, 12)
    end = np.column_stack([0.05 * np.cos(turn), 0 * turn, 0.05 * np.sin(turn)])
    both = np.vstack([end, (0.4, 0, 0) - end])
    spec.add_mesh(name="upper_arm").uservert = np.vstack([both + (0, 0.04, 0), both - (0, 0.04, 0)]).ravel()
    body = spec.worldbody.add_body(name="base")
    body.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=[0.1, 0.1, 0.05], pos=[0, 0, 0.05])
    places = [(0, 0, 0.12), (0, 0, 0.04), (0.4, 0, 0), (0.1, 0, 0), (0.1, 0, 0), (0.05, 0, 0)]
    for number, (place, axis) in enumerate(zip(places, "zyyxyx", strict=True), start=1):
        body = body.add_body(name=f"link{number}", pos=place)
        body.add_geom(size=[0.01] * 3, contype=0, conaffinity=0)
        body.add_joint(name=f"joint{number}", axis=np.eye(3)["xyz".index(axis)], range=[-3, 0 if number == 2 else 3])
    spec.body("link2").add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname="upper_arm")
    spec.body("link5").add_geom(size=[0.03] * 3)
    spec.body("link6").add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=[0.02, 0.02, 0.02])
    spec.compile()
    file = tmp_path_factory.mktemp("arm") / "round.xml"
    file.write_text(spec.to_xml())
    return file


ROUND = Mounting("base", "link6", approach="x", on=(0.0, 0.8), tool=0.16)


def test_boxes_do_not_touch_where_the_meshes_in_their_place_never_do(round_ended: Path, tmp_path: Path) -> None:
    text, page, found = make_robot(round_ended, ROUND)
    (tmp_path / "made.xml").write_text(text)
    robot = RobotSpec.from_mjcf(tmp_path / "made.xml", **page, home=(0.0, 0.0, -0.6, 0.9, 0.0, 0.0, 0.0))
    model = mujoco.MjModel.from_xml_path(str(robot.mjcf_path))
    geoms = np.array(robot.collision_geoms(model))
    bodies = {
        frozenset(model.body(model.geom_bodyid[geom]).name for geom in pair) for pair in geoms[robot.shapes.pairs]
    }
    assert "base and link2" in found["touch only as boxes, so not checked"]
    assert frozenset(("base", "link2")) not in bodies
    assert frozenset(("link2", "link5")) in bodies, "these touch in truth"
    free = SelfCollision(ArmChain.from_robot(robot))
    assert free(None, robot.home)
    assert free(None, (0.0, 0.0, -0.8, 0.0, 0.0, 0.0, 0.0)), "the corner of a box would touch"


def test_shapes_of_the_gripper_come_first_wherever_bodies_stand_in_the_file(round_ended: Path, tmp_path: Path) -> None:
    """The planner tells by it what may touch the object that is grasped; the arm's base stands after the arm here."""
    text, page, _ = make_robot(round_ended, replace(ROUND, drive="fixed"))
    (tmp_path / "made.xml").write_text(text)
    robot = RobotSpec.from_mjcf(tmp_path / "made.xml", **page, home=(0.0, 0.0, -0.6, 0.9, 0.0, 0.0, 0.0))
    model = mujoco.MjModel.from_xml_path(str(robot.mjcf_path))
    assert model.body("base").id > model.body("gripper").id
    is_last = robot.shapes.link == len(robot.chain) - 1
    assert is_last.argmin() == is_last.sum() == 5, "the last link, palm, neck and two fingers"


def test_named_bodies_that_cannot_touch_are_left_out(round_ended: Path) -> None:
    assert (
        "link1 and link5"
        in make_robot(round_ended, replace(ROUND, apart=("link1", "link5"))).found[
            "touch only as boxes, so not checked"
        ]
    )
    with pytest.raises(InvalidRobot, match="apart"):
        make_robot(round_ended, replace(ROUND, apart=("link1",)))
    with pytest.raises(InvalidRobot, match=r"two by two; there are .*link5"):
        make_robot(round_ended, replace(ROUND, apart=("link1", "arm")))


def test_the_wrist_bends_before_a_long_tool(round_ended: Path) -> None:
    """The palm is as wide as the fingers open, but only just behind them; at the flange there is a thin neck."""
    model = mujoco.MjModel.from_xml_string(make_robot(round_ended, ROUND).mjcf)
    palm, neck = model.geom("palm"), model.geom("neck")
    assert palm.pos[0] - palm.size[0] > 0.05
    assert neck.size[1] < 0.03 < palm.size[1]
    assert neck.pos[0] + neck.size[0] == pytest.approx(palm.pos[0] - palm.size[0])
    assert neck.pos[0] - neck.size[0] == pytest.approx(0.02), "where the last link's own shape ends"


def made(file: Path, mounting: Mounting, folder: Path) -> RobotSpec:
    text, page, _ = make_robot(file, mounting)
    out = folder / f"{file.stem}_mobile.xml"
    out.write_text(text)
    return RobotSpec.from_mjcf(out, **page, home=HOME)


@pytest.mark.parametrize("lift", [(0.0, 0.4), None])
def test_the_arm_moves_as_in_its_file_and_the_data_agree_with_the_new_one(linkage: Path, tmp_path: Path, lift) -> None:
    text, page, _ = make_robot(linkage, replace(UR5E, lift=lift))
    (tmp_path / "made.xml").write_text(text)
    robot = RobotSpec.from_mjcf(tmp_path / "made.xml", **page, home=(0.0 if lift is None else 0.25, *HOME[1:]))
    check_robot(robot)
    own, chain = ArmChain.from_mjcf(linkage, "base", "wrist_3", "z"), ArmChain.from_robot(robot)
    rng = np.random.default_rng(0)
    for q in rng.uniform(-2, 2, (20, 7)):
        q[0] = 0.0
        wanted = forward(own, q)
        wanted[:3, 3] += wanted[:3, :3] @ (UR5E.tool, 0, 0) + (0.15, 0, 0.7)
        np.testing.assert_allclose(forward(chain, q), wanted, atol=2e-5)


def test_a_gripper_with_a_linkage_becomes_two_sliding_fingers(linkage: Path, tmp_path: Path) -> None:
    robot = made(linkage, replace(UR5E, opening=0.1), tmp_path)
    assert robot.max_opening == pytest.approx(0.1)
    model = mujoco.MjModel.from_xml_path(str(robot.mjcf_path))
    names = {model.body(body).name for body in range(model.nbody)}
    assert "knuckle_1" not in names
    assert {"left_finger", "right_finger"} <= names
    assert (model.body_gravcomp[1:] == 1).all()
    assert model.nmesh == 0


def test_an_arm_on_a_pedestal_does_not_drive(linkage: Path, tmp_path: Path) -> None:
    text, page, _ = make_robot(linkage, replace(UR5E, on=(0.0, 0.9), lift=None, radius=0.12, drive="fixed"))
    (tmp_path / "made.xml").write_text(text)
    robot = RobotSpec.from_mjcf(tmp_path / "made.xml", **page, home=(0.0, *HOME[1:]))
    check_robot(robot)
    assert robot.base_drive == "fixed"
    assert robot.base_radius == pytest.approx(0.12, abs=0.05)
    shapes = robot.shapes
    top = (shapes.position[:, 2] + shapes.bound)[shapes.link == BASE].max()
    assert top > 0.9, "the arm's own base is a part of the pedestal"
    np.testing.assert_allclose(forward(ArmChain.from_robot(robot), (0.0, *HOME[1:]))[2, 3], 0.9 + 0.3, atol=0.6)


def test_what_is_named_is_left_out(linkage: Path, tmp_path: Path) -> None:
    spec = mujoco.MjSpec.from_file(str(linkage))
    spec.body("base").add_body(name="mast", pos=[-0.2, 0, 0]).add_geom(size=[0.03] * 3)
    spec.compile()
    file = tmp_path / "mast.xml"
    file.write_text(spec.to_xml())
    assert "mast" in make_robot(file, UR5E)[0]
    assert 'name="mast"' not in make_robot(file, replace(UR5E, without=("mast",)))[0]


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"base": "bass"}, "no body 'bass'; there are .*'forearm'"),
        ({"tip": "hand"}, "no site or body 'hand'; there are"),
        ({"tip": "forearm"}, "6 or 7 hinges"),
        ({"on": (0.1, 0.05)}, "higher than 0.1 m"),
        ({"approach": "w"}, "no approach axis 'w'"),
        ({"without": ("mast",)}, "no body 'mast' to leave out; there are .*forearm"),
        ({"on": (np.nan, 0.7)}, "on nan 0.7 must be finite"),
        ({"turn": np.inf}, "turn inf must be finite"),
        ({"tool": np.nan}, "tool nan must be finite"),
        ({"radius": 0.0}, "radius 0 must be positive"),
        ({"opening": -1.0}, "opening -1 must be positive"),
        ({"mesh_scale": 0.0, "radius": np.nan}, "radius nan must be positive; mesh_scale 0 must be positive"),
        ({"lift": (0.4, 0.0)}, "lift 0.4 0: the lower end comes first"),
    ],
)
def test_what_is_missing_is_named(linkage: Path, wrong: dict, message: str) -> None:
    with pytest.raises(InvalidRobot, match=message):
        make_robot(linkage, replace(UR5E, **wrong))


def test_a_file_that_is_none_is_refused(tmp_path: Path) -> None:
    (tmp_path / "arm.xml").write_text("<mujoco><worldbody>")
    with pytest.raises(InvalidRobot, match=r"arm\.xml"):
        make_robot(tmp_path / "arm.xml", UR5E)


def test_a_mobile_base_of_the_file_s_own_keeps_its_outline(linkage: Path, tmp_path: Path) -> None:
    spec = mujoco.MjSpec.from_file(str(linkage))
    spec.body("base").add_geom(size=[0.3, 0.2, 0.1], pos=[0, 0, 0.1], type=mujoco.mjtGeom.mjGEOM_BOX)
    spec.compile()
    (tmp_path / "rover.xml").write_text(spec.to_xml())
    text, page, _ = make_robot(tmp_path / "rover.xml", replace(UR5E, on=None, lift=None))
    (tmp_path / "made.xml").write_text(text)
    robot = RobotSpec.from_mjcf(tmp_path / "made.xml", **page, home=(0.0, *HOME[1:]))
    assert {tuple(np.abs(corner)) for corner in robot.base_outline} == {(0.3, 0.2)}
    assert robot.base_radius == pytest.approx(np.hypot(0.3, 0.2), abs=1e-6)
    assert robot.base_height == pytest.approx(0.2)
    assert made(linkage, UR5E, tmp_path).base_outline == (), "a round base"


def test_fingers_move_along_the_axis_that_is_said(linkage: Path, tmp_path: Path) -> None:
    """Of a gripper whose fingers move along another axis of the tip: the approach stays, the fingers are turned."""
    straight, turned = (
        ArmChain.from_robot(made(linkage, replace(UR5E, turn=turn), tmp_path)) for turn in (0.0, np.pi / 2)
    )
    own, other = (forward(chain, np.array(HOME)) for chain in (straight, turned))
    np.testing.assert_allclose(other[:3, [0, 3]], own[:3, [0, 3]], atol=1e-6)
    np.testing.assert_allclose(other[:3, 1], own[:3, 2], atol=1e-6)


def fixed_base(spec: mujoco.MjSpec) -> None:
    for side in (1, -1):
        wheel = spec.body("base").add_body(name=f"wheel_{side}", pos=[0, 0.2 * side, 0.05])
        wheel.add_geom(type=mujoco.mjtGeom.mjGEOM_CYLINDER, size=[0.06, 0.02, 0], quat=[1, 1, 0, 0])
    spec.body("base").add_geom(size=[0.3, 0.2, 0.1], pos=[0, 0, 0.15], type=mujoco.mjtGeom.mjGEOM_BOX)


def rewritten(file: Path, folder: Path, change: Callable[[mujoco.MjSpec], object], name: str = "changed.xml") -> Path:
    spec = mujoco.MjSpec.from_file(str(file))
    change(spec)
    spec.compile()
    inertia = '<inertial pos="0 0 0" mass="1" diaginertia="0.01 0.01 0.01"/>'  # `to_xml` forgets it
    text = re.sub(r'(<body name="(?:upper_arm|forearm)"[^>]*>)(?!\s*<inertial)', rf"\1{inertia}", spec.to_xml())
    (folder / name).write_text(text)
    return folder / name


def test_wheels_that_are_in_the_ground_are_raised_with_all_that_stands_on_them(linkage: Path, tmp_path: Path) -> None:
    """A file's wheels were 5 mm in the ground; every grasp was refuted, and no message named them."""
    file = rewritten(linkage, tmp_path, fixed_base)
    text, page, found = make_robot(file, replace(UR5E, on=None, lift=None))
    assert re.search(r"by 10\.0 mm: so far below the ground 'wheel_-?1' is", found["raised"])
    (tmp_path / "made.xml").write_text(text)
    robot = RobotSpec.from_mjcf(tmp_path / "made.xml", **page, home=(0.0, *HOME[1:]))
    model = mujoco.MjModel.from_xml_path(str(robot.mjcf_path))
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    assert min(lowest_height(model, data, geom) for geom in range(model.ngeom)) == pytest.approx(0.0, abs=1e-6)
    own, chain = ArmChain.from_mjcf(linkage, "base", "wrist_3", "z"), ArmChain.from_robot(robot)
    wanted = forward(own, (0.0, *HOME[1:])) + np.pad([[0.01]], ((2, 1), (3, 0)))
    wanted[:3, 3] += wanted[:3, :3] @ (UR5E.tool, 0, 0)
    np.testing.assert_allclose(forward(chain, (0.0, *HOME[1:])), wanted, atol=2e-5)
    assert robot.base_height == pytest.approx(0.26), "box and wheels are one base"
    assert "raised" not in make_robot(linkage, UR5E).found


def test_what_is_fixed_to_a_base_is_of_its_outline(linkage: Path, tmp_path: Path) -> None:
    """A chassis that is a link of its own, as in many URDF files, was not found."""

    def chassis(spec: mujoco.MjSpec) -> None:
        for geom in list(spec.body("base").geoms):
            spec.delete(geom)
        part = spec.body("base").add_body(name="chassis", pos=[0.1, 0, 0.1])
        part.add_geom(size=[0.3, 0.2, 0.1], type=mujoco.mjtGeom.mjGEOM_BOX)

    file = rewritten(linkage, tmp_path, chassis)
    text, page, _ = make_robot(file, replace(UR5E, on=None, lift=None))
    (tmp_path / "made.xml").write_text(text)
    robot = RobotSpec.from_mjcf(tmp_path / "made.xml", **page, home=(0.0, *HOME[1:]))
    assert {corner[0] for corner in robot.base_outline} == {-0.2, 0.4}


def without_shapes(*names: str) -> Callable[[mujoco.MjSpec], object]:
    def remove(spec: mujoco.MjSpec) -> None:
        for name in names:
            for geom in list(spec.body(name).geoms):
                spec.delete(geom)
            spec.body(name).mass, spec.body(name).inertia = 1.0, [0.01] * 3
            spec.body(name).explicitinertial = True

    return remove


def test_links_without_a_shape_are_refused_by_name(linkage: Path, tmp_path: Path) -> None:
    """A robot without an arm scored 6 of 6: nothing of it ever touched anything."""
    with pytest.raises(InvalidRobot, match=r"no shape in the file.*: upper_arm, forearm; give each"):
        make_robot(rewritten(linkage, tmp_path, without_shapes("upper_arm", "forearm")), UR5E)


def test_the_base_of_an_arm_that_has_no_shape_gets_a_column(linkage: Path, tmp_path: Path) -> None:
    text, _, found = make_robot(rewritten(linkage, tmp_path, without_shapes("base")), UR5E)
    assert "'base' has no shape" in found["base of the arm"]
    model = mujoco.MjModel.from_xml_string(text)
    (column,) = np.flatnonzero(model.geom_bodyid == model.body("base").id)
    assert model.geom_size[column, 1] == pytest.approx(0.163 / 2, abs=1e-3), "up to the first joint"


def test_a_base_whose_shapes_are_on_links_that_are_fixed_to_it_gets_no_column(linkage: Path, tmp_path: Path) -> None:
    def mounted(spec: mujoco.MjSpec) -> None:
        without_shapes("base")(spec)
        spec.body("base").add_body(name="mount").add_geom(size=[0.05, 0.05, 0.01], type=mujoco.mjtGeom.mjGEOM_BOX)

    assert "base of the arm" not in make_robot(rewritten(linkage, tmp_path, mounted), UR5E).found


def test_a_driving_base_without_a_shape_is_refused(linkage: Path, tmp_path: Path) -> None:
    rewritten(linkage, tmp_path, without_shapes("base"))
    with pytest.raises(InvalidRobot, match=r"the base 'base' has no shape in the file.*--on"):
        make_robot(tmp_path / "changed.xml", replace(UR5E, on=None, lift=None))


def test_what_is_for_the_eye_is_a_shape_of_a_body_that_has_no_other(linkage: Path, tmp_path: Path) -> None:
    """It was so for a whole file alone, and a file with a single other shape had no arm."""

    def for_the_eye(spec: mujoco.MjSpec) -> None:
        for name in ("shoulder", "upper_arm", "forearm"):
            for geom in spec.body(name).geoms:
                geom.contype = geom.conaffinity = 0

    model = mujoco.MjModel.from_xml_string(make_robot(rewritten(linkage, tmp_path, for_the_eye), UR5E).mjcf)
    for name in ("shoulder", "upper_arm", "forearm"):
        assert (model.geom_bodyid == model.body(name).id).any()


def test_a_scene_s_world_is_a_base_without_what_else_is_in_the_scene(linkage: Path, tmp_path: Path) -> None:
    """`--base world` ended in a traceback."""

    def scene(spec: mujoco.MjSpec) -> None:
        spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0, 0, 1])
        spec.worldbody.add_body(name="cube", pos=[1, 0, 0]).add_geom(size=[0.1] * 3)

    text = make_robot(rewritten(linkage, tmp_path, scene), replace(UR5E, base="world")).mjcf
    model = mujoco.MjModel.from_xml_string(text)
    names = {model.body(body).name for body in range(1, model.nbody)}
    assert {"own_world", "base", "forearm"} <= names
    assert "cube" not in names
    assert (model.geom_type != int(mujoco.mjtGeom.mjGEOM_PLANE)).all()


def test_meshes_are_scaled_as_said(linkage: Path, tmp_path: Path) -> None:
    def in_millimetres(spec: mujoco.MjSpec) -> None:
        spec.mesh("cover").uservert = [1000 * value for value in spec.mesh("cover").uservert]

    file = rewritten(linkage, tmp_path, in_millimetres)
    with pytest.raises(InvalidRobot, match=r"mesh of 'forearm' is .* m long.*--mesh-scale 0.001"):
        make_robot(file, UR5E)
    texts = (make_robot(file, replace(UR5E, mesh_scale=0.001)).mjcf, make_robot(linkage, UR5E).mjcf)
    longest = [mujoco.MjModel.from_xml_string(text).geom_rbound.max() for text in texts]
    assert longest[0] == pytest.approx(longest[1], abs=0.01)


def six_links(folder: Path, of_link: dict[int, str], of_camera: str, limit: str = 'effort="1" velocity="1"') -> Path:
    """A URDF file of an arm with spheres, where `of_link` says nothing else, and a camera on its fourth link."""
    sphere = '<collision><geometry><sphere radius="0.05"/></geometry></collision>'
    text = "".join(f'<link name="l{k}">{of_link.get(k, sphere)}</link>' for k in range(7))
    for k, axis in enumerate(("0 0 1", "0 1 0", "0 1 0", "1 0 0", "0 1 0", "1 0 0")):
        text += f'<joint name="j{k}" type="revolute"><parent link="l{k}"/><child link="l{k + 1}"/><axis xyz="{axis}"/>'
        text += '<origin xyz="0 0 0.2"/><limit lower="-2" upper="2" ' + limit + "/></joint>"
    text += f'<link name="camera">{of_camera}</link><joint name="c" type="fixed"><parent link="l3"/>'
    (folder / "six.urdf").write_text(f'<robot name="six">{text}<child link="camera"/></joint></robot>')
    return folder / "six.urdf"


def test_joints_without_limits_are_named(tmp_path: Path) -> None:
    file = six_links(tmp_path, {}, "")
    assert "limits" not in make_robot(file, Mounting("l0", "l6", on=(0.0, 0.8))).found
    file.write_text(file.read_text().replace('lower="-2" upper="2"', "", 2))
    assert "without end: j0, j1" in make_robot(file, Mounting("l0", "l6", on=(0.0, 0.8))).found["limits"]


def test_a_mesh_that_cannot_be_read_is_refused_with_what_to_do(tmp_path: Path) -> None:
    """Unless its link is left out, or it is for the eye alone and the link has other shapes, or is short."""
    six = Mounting("l0", "l6", on=(0.0, 0.8))
    mesh = '<{0}><geometry><mesh filename="x.glb"/></geometry></{0}>'
    file = six_links(tmp_path, {}, mesh.format("collision"))
    with pytest.raises(InvalidRobot, match=r"'camera' has no shape: .*'x.glb'.*trimesh.*--without camera"):
        make_robot(file, six)
    assert make_robot(file, replace(six, without=("camera",))).mjcf
    found = make_robot(six_links(tmp_path, {}, mesh.format("visual")), six).found
    assert "trimesh" in found["no shape of camera"]
    with pytest.raises(InvalidRobot, match=r"no shape in the file.*: l4 \(MuJoCo does not read .*'x.glb'"):
        make_robot(six_links(tmp_path, {4: mesh.format("visual")}, ""), six)


def test_a_chassis_on_a_frame_without_shapes_is_the_base(linkage: Path, tmp_path: Path) -> None:
    """Such a base "had no shape" where its chassis carries the arm, or the arm's lift; it rode on the lift."""
    text = """<mujoco><worldbody><body name="footprint"><body name="chassis">
      <geom type="box" size=".3 .2 .1" pos="0 0 .1"/>{}</body></body></worldbody></mujoco>"""
    torso = """<body name="torso" pos="0 0 .6"><joint name="torso" type="slide" axis="0 0 1" range="0 .3"/>
      <geom type="box" size=".1 .1 .1" mass="1"/></body>"""
    mounting = replace(UR5E, base="footprint", tip="arm_wrist_3", on=None, lift=None)
    for carried, carrier in (("", "chassis"), (torso, "torso")):
        spec = mujoco.MjSpec.from_string(text.format(carried))
        arm = mujoco.MjSpec.from_file(str(linkage))
        spec.body(carrier).add_frame(pos=[0, 0, 0.25]).attach_body(arm.body("base"), "arm_", "")
        spec.compile()
        (tmp_path / "rover.xml").write_text(spec.to_xml())
        made, page, _ = make_robot(tmp_path / "rover.xml", mounting)
        (tmp_path / "made.xml").write_text(made)
        robot = RobotSpec.from_mjcf(tmp_path / "made.xml", **page, home=(0.0, *HOME[1:]))
        assert robot.base_height == pytest.approx(0.2)
        assert {tuple(np.abs(corner)) for corner in robot.base_outline} == {(0.3, 0.2)}
        assert robot.chain[0].joint == ("torso" if carried else "lift")


def test_radians_that_are_read_as_degrees_are_refused_unless_said(linkage: Path, tmp_path: Path) -> None:
    """The robot "reached no grasp": its joints turned by 3°."""
    text = linkage.read_text()
    assert 'angle="radian"' in text
    (tmp_path / "degrees.xml").write_text(text.replace('angle="radian"', ""))
    with pytest.raises(InvalidRobot, match=r"turn by no more than 0.11 rad.*--radians"):
        make_robot(tmp_path / "degrees.xml", UR5E)
    made, wanted = (
        make_robot(file, replace(UR5E, radians=file.stem == "degrees")).mjcf
        for file in (tmp_path / "degrees.xml", linkage)
    )
    ranges = [mujoco.MjModel.from_xml_string(text).jnt_range for text in (made, wanted)]
    np.testing.assert_allclose(*ranges)


def test_bodies_of_several_shapes_that_always_touch_do_not_count(tmp_path: Path) -> None:
    """Each shape of the base is touched in some configurations alone, and one of them in all: no configuration was
    free. The PR2's shoulder touched its upper arm so."""
    half = '<collision><origin xyz="0 {} 0.4"/><geometry><box size="1 0.5 0.6"/></geometry></collision>'
    ball = '<collision><origin xyz="0.1 0 0"/><geometry><sphere radius="0.02"/></geometry></collision>'
    file = six_links(tmp_path, {0: half.format(0.25) + half.format(-0.25), 2: ball}, "")
    text, _, found = make_robot(file, SIX)
    assert "l0 and l2" in found["touch nearly always, so not checked"]
    model = mujoco.MjModel.from_xml_string(text)
    pairs = {frozenset((int(pair) >> 16, int(pair) & 0xFFFF)) for pair in model.exclude_signature}
    assert frozenset((model.body("l0").id, model.body("l2").id)) in pairs
    assert frozenset((model.body("l0").id, model.body("l5").id)) not in pairs


def limits_of(model: mujoco.MjModel, joints: Sequence[str]) -> list[float]:
    motors = [model.actuator(name) for name in joints]
    assert all(motor.forcelimited[0] and motor.forcerange[0] == -motor.forcerange[1] for motor in motors)
    return [float(motor.forcerange[1]) for motor in motors]


SIX = Mounting("l0", "l6", on=(0.0, 0.8))


def test_efforts_and_velocities_of_a_urdf_file_are_limits(tmp_path: Path) -> None:
    """All joints had 1000 N m and 1.5 rad/s, whatever the file said."""
    text, page, found = make_robot(six_links(tmp_path, {}, "", 'effort="17" velocity="0.8"'), SIX)
    model, arm = mujoco.MjModel.from_xml_string(text), [f"j{k}" for k in range(6)]
    assert limits_of(model, arm) == [17.0] * 6
    assert page["max_velocity"] == (1.0, 1.0, 1.5, 0.1, *[0.8] * 6)
    assert "j0 17, " in found["torques [N m], forces [N]"]
    assert not any(f"{name} 17 (assumed)" in found["torques [N m], forces [N]"] for name in arm)
    (tmp_path / "made.xml").write_text(text)
    assert RobotSpec.from_mjcf(tmp_path / "made.xml", **page, home=(0.0,) * 7).max_velocity == page["max_velocity"]


def test_a_velocity_beyond_the_slow_one_is_no_limit(tmp_path: Path) -> None:
    for limit in ('effort="17" velocity="3"', 'effort="17" velocity="0"', 'effort="17"'):
        assert "max_velocity" not in make_robot(six_links(tmp_path, {}, "", limit), SIX).page
    with pytest.raises(InvalidRobot, match=r"velocity.*'fast'"):
        make_robot(six_links(tmp_path, {}, "", 'velocity="fast"'), SIX)


@pytest.mark.parametrize("limit", ['effort="0" velocity="1"', 'velocity="1"'])
def test_torques_are_assumed_where_the_file_gives_none(tmp_path: Path, limit: str) -> None:
    """Twice what holds the arm and an object stretched out; the arm weighs 1 kg a link, 0.2 m apart."""
    mass = '<inertial><mass value="1"/><inertia ixx=".01" iyy=".01" izz=".01" ixy="0" ixz="0" iyz="0"/></inertial>'
    ball = '<collision><geometry><sphere radius="0.05"/></geometry></collision>'
    file = six_links(tmp_path, dict.fromkeys(range(7), mass + ball), "", limit)
    text, _, found = make_robot(file, SIX)
    model, arm = mujoco.MjModel.from_xml_string(text), [f"j{k}" for k in range(6)]
    torques = limits_of(model, arm)
    stretched = 9.81 * (0.2 * (1 + 2 + 3 + 4) + (0.5 + 0.25) * 0.8)  # links beyond the second joint, gripper, object
    assert 1.6 * stretched < torques[1] < 2.4 * stretched
    assert torques[0] == pytest.approx(torques[1], rel=0.3), "a joint about the vertical has its share"
    assert torques[5] == pytest.approx(0.1 * max(torques)), "a joint that bears nothing"
    assert text.count("assumed_torques") == 1
    assert all(
        f"{name} {torque:.3g} (assumed)" in found["torques [N m], forces [N]"]
        for name, torque in zip(arm, torques, strict=True)
    )


@pytest.mark.parametrize(
    ("actuator", "limit"),
    [
        ({"forcerange": [-40, 40], "gear": [2, 0, 0, 0, 0, 0]}, 80.0),
        ({"ctrlrange": [-3, 3], "gainprm": [10, *[0] * 9], "gear": [2, 0, 0, 0, 0, 0]}, 60.0),
        ({"ctrlrange": [-3, 3], "forcerange": [-40, 40]}, 3.0),
        ({"ctrlrange": [-3, 3], "gainprm": [10, *[0] * 9], "biasprm": [0, -10, *[0] * 8]}, None),
        ({"ctrlrange": [-3, 3], "frc": [-7, 7], "forcerange": [-40, 40], "gear": [9, 0, 0, 0, 0, 0]}, 7.0),
    ],
)
def test_an_actuator_s_limit_is_that_of_the_joint(linkage: Path, actuator: dict, limit: float | None) -> None:
    """A motor exerts its control times its gain; the control of a position servo is no force."""
    spec, given = mujoco.MjSpec.from_file(str(linkage)), dict(actuator)
    joint = spec.joint("elbow")
    if "frc" in given:
        joint.actfrcrange, joint.actfrclimited = given.pop("frc"), True
    motor = spec.add_actuator(name="m", target="elbow", trntype=mujoco.mjtTrn.mjTRN_JOINT)
    motor.gaintype = mujoco.mjtGain.mjGAIN_FIXED
    motor.biastype = mujoco.mjtBias.mjBIAS_AFFINE if "biasprm" in given else mujoco.mjtBias.mjBIAS_NONE
    for name, value in given.items():
        setattr(motor, name, value)
    motor.ctrllimited, motor.forcelimited = "ctrlrange" in given, "forcerange" in given
    model = spec.compile()
    assert given_limit(model, model.joint("elbow").id) == limit


def test_the_base_pushes_as_hard_as_its_wheels_hold(linkage: Path) -> None:
    """It had 1000 N an axis, and 1000 N m."""
    model = mujoco.MjModel.from_xml_string(make_robot(linkage, UR5E).mjcf)
    most = 0.6 * 9.81 * model.body_subtreemass[model.body("mobile_base").id]
    x, y, yaw = limits_of(model, ("base_x", "base_y", "base_yaw"))
    assert np.hypot(x, y) == pytest.approx(most, rel=1e-3)
    assert yaw == pytest.approx(most * UR5E.radius * 2 / 3, rel=1e-3)


@pytest.mark.parametrize(("name", "published"), [("fetch", 6.0), ("panda_mobile", 3.0)])
def test_what_published_torques_hold_is_the_published_payload(name: str, published: float) -> None:
    """6 kg of Fetch and 3 kg of the Panda, on their data sheets."""
    own = robot(name)
    found = payload_of(mujoco.MjModel.from_xml_path(str(own.mjcf_path)), own.arm_joints, own.tcp_site)
    assert found is not None
    assert published <= found.kg < 1.2 * published
    assert found.weightless_kg > found.kg


@pytest.mark.parametrize("name", ["fetch", "panda_mobile", "pr2"])
def test_stiffness_is_like_that_of_published_gains(name: str) -> None:
    """Within a factor of 2.5, of the joints that bear something."""
    own = robot(name)
    model = mujoco.MjModel.from_xml_path(str(own.mjcf_path))
    motors = motors_of(model, own.torso_joint, own.arm_joints, own.tcp_site, {})
    ratios = [motors[joint].stiffness / model.actuator(joint).gainprm[0] for joint in own.arm_joints[:-1]]
    assert min(ratios) > 0.4
    assert max(ratios) < 2.5


def test_the_object_of_the_rule_is_the_heaviest_standard_one() -> None:
    assert OBJECT_SETS["standard"].mass[1] == PAYLOAD


def test_an_arm_s_first_link_may_be_near_what_it_stands_on(linkage: Path) -> None:
    """A lift of a millimetre stands between them; on a pedestal they counted, and touched in every configuration."""
    pedestal = replace(UR5E, on=(0.0, 0.9), lift=None, radius=0.12, drive="fixed")
    model = mujoco.MjModel.from_xml_string(make_robot(linkage, pedestal).mjcf)
    pairs = {frozenset((int(pair) >> 16, int(pair) & 0xFFFF)) for pair in model.exclude_signature}
    assert frozenset((model.body("base").id, model.body("shoulder").id)) in pairs
