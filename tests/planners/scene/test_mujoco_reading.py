"""What is read from a simulation of the user's own: movable bodies, the support, every other geom as an obstacle."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from assets.contacts import paired_name
from assets.robots import FETCH, RobotSpec, robot
from planners.expert.monitor import Sensor
from planners.scene import Scene, SceneError
from planners.scene.mujoco_reading import static_obstacles_of
from planners.scene.robot_names import robot_prefix
from tests.planners.own_scenes import MOVABLE, SUPPORT, TABLE_X, TOP, kitchen, read

PLACE = 'pos="0.4 1.2 0.6" euler="0.3 -0.5 0.9"'
GEOMS = {
    "box": f'<geom name="extra" type="box" size="0.04 0.06 0.4" {PLACE}/>',
    "cylinder": f'<geom name="extra" type="cylinder" size="0.04 0.4" {PLACE}/>',
    "capsule": f'<geom name="extra" type="capsule" size="0.04 0.4" {PLACE}/>',
    "sphere": f'<geom name="extra" type="sphere" size="0.2" {PLACE}/>',
    "ellipsoid": f'<geom name="extra" type="ellipsoid" size="0.04 0.06 0.4" {PLACE}/>',
    "hull": f'<geom name="extra" type="mesh" mesh="wedge" {PLACE}/>',
}


@pytest.mark.parametrize("shape", GEOMS)
def test_every_static_geom_is_an_obstacle_with_its_true_extent(shape: str) -> None:
    model, data = kitchen(GEOMS[shape])
    obstacle = next(one for one in read(model, data).static_obstacles if one.name == "extra")
    assert obstacle.shape == shape
    for axis in range(3):
        for sign, corner in ((-1, obstacle.lower), (1, obstacle.upper)):
            assert _farthest(model, data, axis, sign) == pytest.approx(sign * corner[axis], abs=1e-4)
    assert np.all(obstacle.position - obstacle.extent <= obstacle.lower + 1e-12)
    assert np.all(obstacle.position + obstacle.extent >= obstacle.upper - 1e-12)


def _farthest(model: mujoco.MjModel, data: mujoco.MjData, axis: int, sign: int) -> float:
    """How far geom "extra" reaches along an axis: MuJoCo's distance to a plate 5 m away, or the mesh's vertices."""
    geom, placed = model.geom("extra"), data.geom("extra")
    if geom.type[0] == mujoco.mjtGeom.mjGEOM_MESH:
        start, count = model.mesh_vertadr[geom.dataid[0]], model.mesh_vertnum[geom.dataid[0]]
        world = placed.xpos + model.mesh_vert[start : start + count] @ placed.xmat.reshape(3, 3).T
        return float((sign * world[:, axis]).max())
    spec, half, quaternion = mujoco.MjSpec(), np.full(3, 3.0), np.empty(4)
    half[axis] = 0.5
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=half, pos=np.eye(3)[axis] * sign * 5.5)
    mujoco.mju_mat2Quat(quaternion, placed.xmat)
    spec.worldbody.add_geom(type=mujoco.mjtGeom(int(geom.type[0])), pos=placed.xpos, quat=quaternion, size=geom.size)
    own = spec.compile()
    scratch = mujoco.MjData(own)
    mujoco.mj_kinematics(own, scratch)
    return 5.0 - mujoco.mj_geomDistance(own, scratch, 0, 1, 10.0, None)


def test_movable_bodies_by_name_and_by_predicate() -> None:
    model, data = kitchen()
    assert read(model, data).names == MOVABLE
    boxes = Scene.from_mujoco(model, data, FETCH, movable=lambda name: name.startswith("box"), support=SUPPORT)
    assert boxes.names == ("box_a", "box_b")
    can = next(one for one in boxes.static_obstacles if one.name.startswith("can/"))
    assert can.shape == "cylinder"
    assert np.allclose(can.position, [TABLE_X, 0.02, TOP + 0.06])


def test_free_and_jointed_bodies_that_are_not_movable_are_obstacles_where_they_are() -> None:
    model, data = kitchen(
        '<body name="bottle" pos="1.2 0.3 0.85"><freejoint name="b"/>'
        '<geom name="glass" type="capsule" size="0.03 0.07"/></body>'
        '<body name="door" pos="1.5 1 0.5"><joint name="hinge" axis="0 0 1"/>'
        '<geom name="leaf" type="box" size="0.3 0.02 0.5" pos="0.3 0 0"/></body>'
    )
    data.joint("b").qpos[:3] = [1.2, -0.3, 0.85]
    data.joint("hinge").qpos = np.pi / 2
    mujoco.mj_forward(model, data)
    found = {one.name: one for one in read(model, data).static_obstacles}
    assert np.allclose(found["glass"].position, [1.2, -0.3, 0.85])
    assert found["glass"].shape == "capsule"
    assert np.allclose(found["leaf"].position, [1.5, 1.3, 0.5])
    assert np.allclose(found["leaf"].half_extents, [0.02, 0.3, 0.5], atol=1e-6)


def test_geoms_that_touch_nothing_count_only_if_asked_for() -> None:
    decoration = '<geom name="rug" type="box" size="0.1 0.1 0.1" pos="0 2 0.2" contype="0" conaffinity="0" group="2"/>'
    model, data = kitchen(
        decoration + '<geom name="post" type="box" size="0.1 0.1 0.1" pos="0 -2 0.2" contype="8" conaffinity="0"/>'
    )
    names = {one.name for one in read(model, data).static_obstacles}
    assert "rug" not in names
    assert "post" in names
    asked = Scene.from_mujoco(
        model, data, FETCH, movable=MOVABLE, support=SUPPORT, obstacles=lambda geom: geom.name != "post"
    )
    assert {"rug", "plate"} <= {one.name for one in asked.static_obstacles}
    assert "post" not in {one.name for one in asked.static_obstacles}


def test_a_geom_that_touches_by_an_explicit_pair_is_an_obstacle() -> None:
    model, data = kitchen(
        '<geom name="rail" type="box" size="0.1 0.1 0.1" pos="0 2 0.2" contype="0" conaffinity="0"/></worldbody>'
        '<contact><pair geom1="rail" geom2="palm"/></contact><worldbody>'
    )
    assert "rail" in {one.name for one in read(model, data).static_obstacles}


def test_planes_are_the_floor_or_thick_boxes() -> None:
    model, data = kitchen('<geom name="ramp" type="plane" size="1 1 0.1" pos="0 -1 0" zaxis="0 0.6 0.8"/>')
    found = {one.name: one for one in read(model, data).static_obstacles}
    assert "ground" not in found
    assert found["left_wall"].lower[1] == pytest.approx(0.9)
    assert found["left_wall"].upper[1] == pytest.approx(1.9)
    ramp = found["ramp"]
    assert np.allclose(ramp.rotation[:, 2], [0, 0.6, 0.8])
    assert np.allclose(ramp.position + 0.5 * ramp.rotation[:, 2], [0, -1, 0])


def test_the_support_is_a_geom_or_a_body_of_that_name() -> None:
    model, data = kitchen('<body name="stool"><geom name="seat" type="cylinder" size="0.2 0.02" pos="2 0 0.5"/></body>')
    assert read(model, data).support.name == "plate"
    for wanted, name in (("plate", "plate"), ("stool", "seat")):
        assert Scene.from_mujoco(model, data, FETCH, movable=MOVABLE, support=wanted).support.name == name
    listed = r"'table_top'.*: plate \(0.74 m, body table, with 3 objects\), seat \(0.52 m, body stool\), leg"
    with pytest.raises(SceneError, match=listed):
        Scene.from_mujoco(model, data, FETCH, movable=MOVABLE, support="table_top")


def test_without_a_table_top_the_support_is_what_most_objects_stand_on() -> None:
    """It was an error, for a name of ours."""
    model, data = kitchen('<body name="stool"><geom name="seat" type="cylinder" size="0.6 0.02" pos="3 0 0.5"/></body>')
    assert Scene.from_mujoco(model, data, FETCH, movable=MOVABLE).supports == ("plate",)
    assert Scene.from_mujoco(model, data, FETCH, movable=()).supports == ("floor",)  # nothing stands anywhere


STOOL = '<body name="stool"><geom name="seat" type="cylinder" size="0.2 0.02" pos="2 0 0.5"/></body>'
DECLARED = (
    '</worldbody><custom><tuple name="supports"><element objtype="geom" objname="seat"/>'
    '<element objtype="body" objname="table"/><element objtype="geom" objname="plate"/></tuple></custom><worldbody>'
)


@pytest.mark.parametrize(
    ("extra", "more", "supports"),
    [
        ("", None, ("plate",)),
        ("", ("stool",), ("plate", "seat")),
        (DECLARED, None, ("plate", "seat")),
        (DECLARED, (), ("plate",)),
    ],
)
def test_more_supports_are_those_that_are_named_or_that_the_model_declares(
    extra: str, more: tuple[str, ...] | None, supports: tuple[str, ...]
) -> None:
    model, data = kitchen(STOOL + extra)
    scene = Scene.from_mujoco(model, data, FETCH, movable=MOVABLE, support=SUPPORT, more_supports=more)
    assert scene.supports == supports
    assert scene.support.name == "plate"


HFIELD = '</worldbody><asset><hfield name="hills" nrow="3" ncol="3" size="1 1 1 0.1"/></asset><worldbody>'
GHOST = '<body name="ghost"><freejoint/><geom size="0.1" contype="0" conaffinity="0"/></body>'
LID = '<body name="pot" pos="2 0 1"><freejoint/><geom size="0.1"/><body><joint/><geom size="0.1"/></body></body>'


@pytest.mark.parametrize(
    ("extra", "movable", "message"),
    [
        (
            HFIELD + '<body name="garden"><geom name="hill" type="hfield" hfield="hills"/></body>',
            MOVABLE,
            "'hill'.*'garden'.*'hfield'",
        ),
        (GHOST, ("ghost",), "'ghost' has no geom that can touch.*static obstacle"),
        (LID, ("pot",), "'pot' has joints"),
        (
            "",
            ("table",),
            "no free body 'table'; free bodies: can, box_a, box_b; what can be moved has one <freejoint/>",
        ),
        ("", "can", r"use \['can'\]"),
        ("", ("base_link",), "no free body"),
        ("", (name for name in ("can", "tin")), "no free body 'tin'; free bodies: can, box_a, box_b"),
    ],
)
def test_what_cannot_be_represented_is_named(extra: str, movable: object, message: str) -> None:
    model, data = kitchen(extra)
    with pytest.raises(SceneError, match=message):
        Scene.from_mujoco(model, data, FETCH, movable=movable, support=SUPPORT)  # type: ignore[arg-type] # misuse


def test_names_may_come_from_a_generator_and_bodies_without_a_name_are_static() -> None:
    """The generator was empty once its names had been looked up, and no object was movable."""
    model, data = kitchen(
        '<body pos="1.2 0.3 0.8"><freejoint/><geom name="nut" type="box" size="0.03 0.03 0.03"/></body>'
    )
    given = Scene.from_mujoco(model, data, FETCH, movable=(name for name in MOVABLE), support=SUPPORT)
    assert given.names == MOVABLE
    every = Scene.from_mujoco(model, data, FETCH, movable=lambda _: True, support=SUPPORT)
    assert every.names == MOVABLE
    assert "nut" in {one.name for one in every.static_obstacles}


@pytest.mark.parametrize(
    ("given", "message"),
    [({"more_supports": "floor"}, r"use \['floor'\]"), ({"regions": ["left"]}, "planners.Region, not 'left'")],
)
def test_names_in_place_of_collections_or_regions_are_refused(given: dict[str, object], message: str) -> None:
    model, data = kitchen()
    with pytest.raises(SceneError, match=message):
        Scene.from_mujoco(model, data, FETCH, movable=MOVABLE, support=SUPPORT, **given)  # type: ignore[arg-type] # misuse


@pytest.mark.parametrize(("height", "message"), [(-0.2, "plane 'ground' at -0.2 m, onto which"), (-0.002, None)])
def test_a_lower_floor_is_no_support(height: float, message: str | None) -> None:
    """What was put on the floor at z = 0 fell onto it."""
    model, data = kitchen()
    data.geom("ground").xpos[2] = height
    assert read(model, data).supports == ("plate",)
    for given in ({"support": "floor"}, {"support": SUPPORT, "more_supports": ["floor"]}):
        if message is None:
            assert "floor" in Scene.from_mujoco(model, data, FETCH, movable=MOVABLE, **given).supports
        else:
            with pytest.raises(SceneError, match=message):
                Scene.from_mujoco(model, data, FETCH, movable=MOVABLE, **given)


def test_an_object_may_have_visual_geoms_and_its_geom_may_lie_anywhere_in_its_body() -> None:
    model, data = kitchen(
        '<body name="mug" pos="1.2 0.3 1" euler="0 0 0.4"><freejoint/>'
        '<geom type="cylinder" size="0.03 0.05" pos="0.1 0 0.05" euler="1.5707963 0 0"/>'
        '<geom type="mesh" mesh="wedge" contype="0" conaffinity="0"/></body>'
    )
    scene = Scene.from_mujoco(model, data, FETCH, movable=("mug",), support=SUPPORT)
    (mug,) = scene.objects
    geom = int(model.body("mug").geomadr[0])
    assert np.allclose(mug.position, data.geom_xpos[geom])
    assert np.allclose(mug.rotation, data.geom_xmat[geom].reshape(3, 3))
    assert not mug.is_upright
    snapshot = Sensor(model, data, FETCH, scene.names).read()
    assert np.allclose(snapshot.positions[0], mug.position)
    assert snapshot.uprightness[0] == pytest.approx(mug.rotation[2, 2])


TOOL = """
<body name="tool" pos="1.2 0.3 1" euler="0.3 0.1 0.4"><freejoint/>
  <geom type="mesh" mesh="wedge" euler="0 0.2 0" pos="0 0 0.1" density="300"/>
  <geom type="capsule" size="0.02 0.1" pos="0 0.1 0" euler="1 0 0"/>
  <body pos="0.1 0 0" euler="0 0 0.5"><geom size="0.03" pos="0 0.02 0" density="5000"/>
    <body pos="0 0 0.1"><geom type="ellipsoid" size="0.02 0.03 0.04"/><geom type="cylinder" size="0.01 0.1"/></body>
  </body>
</body>"""


def test_a_body_of_several_geoms_is_read_as_its_pieces_wherever_they_are_attached() -> None:
    model, data = kitchen(TOOL)
    (tool,) = Scene.from_mujoco(model, data, FETCH, movable=("tool",), support=SUPPORT).objects
    geoms = np.flatnonzero(model.body_rootid[model.geom_bodyid] == model.body("tool").id)
    shapes = ["hull", "capsule", "sphere", "ellipsoid", "cylinder"]
    assert [piece.shape for piece in tool.placed] == shapes
    for piece, geom in zip(tool.placed, geoms, strict=True):
        if piece.shape != "hull":
            assert np.allclose(piece.position, data.geom_xpos[geom])
        assert np.allclose(piece.rotation, data.geom_xmat[geom].reshape(3, 3))
    assert np.allclose(tool.mass_centre, data.subtree_com[model.body("tool").id])
    points = data.geom_xpos[geoms[0]] + model.mesh_vert @ data.geom_xmat[geoms[0]].reshape(3, 3).T
    for direction in np.random.default_rng(0).normal(size=(9, 3)):
        wedge = tool.placed[0]
        assert wedge.position @ direction + wedge.reach(direction[None])[0] == pytest.approx((points @ direction).max())
    sensor = Sensor(model, data, FETCH, ("tool",))
    mujoco.mj_step(model, data, nstep=20)
    mujoco.mj_forward(model, data)
    (moved,) = Scene.from_mujoco(model, data, FETCH, movable=("tool",), support=SUPPORT).objects
    assert np.allclose(moved.placed[2].position, data.geom_xpos[geoms[2]])
    assert np.allclose(sensor.read().positions[0], moved.position)


@pytest.mark.parametrize("held", MOVABLE)
def test_the_object_in_the_gripper_is_found_by_its_body(held: str) -> None:
    model, data = kitchen()
    scene = Scene.from_mujoco(model, data, FETCH, held, movable=MOVABLE, support=SUPPORT)
    assert scene.held is not None
    site = data.site(FETCH.tcp_site)
    grip = site.xmat.reshape(3, 3) @ scene.held.T_tcp_object[:3, 3] + site.xpos
    assert np.allclose(grip, scene.body(held).position)


def test_the_base_pose_is_that_in_the_world_wherever_the_robot_was_attached() -> None:
    robot = mujoco.MjSpec.from_file(str(FETCH.mjcf_path))
    robot.body(FETCH.base_body).pos = [1.0, -2.0, 0.0]
    robot.body(FETCH.base_body).quat = [np.cos(0.6), 0.0, 0.0, np.sin(0.6)]
    robot.worldbody.add_geom(name="table_top", type=mujoco.mjtGeom.mjGEOM_BOX, size=[0.3, 0.3, 0.1], pos=[5, 5, 1])
    model = robot.compile()
    data = mujoco.MjData(model)
    for joint, value in zip(FETCH.base_joints, (0.3, 0.4, 0.5), strict=True):
        data.joint(joint).qpos = value
    mujoco.mj_forward(model, data)
    base = Scene.from_mujoco(model, data, FETCH).state.base
    body = data.body(FETCH.base_body)
    assert np.allclose(base[:2], body.xpos[:2])
    assert np.allclose([np.cos(base[2]), np.sin(base[2])], body.xmat[[0, 3]])
    robot.body(FETCH.base_body).pos = [0.0, 0.0, 0.2]
    raised = robot.compile()
    data = mujoco.MjData(raised)
    with pytest.raises(SceneError, match="mj_forward"):
        Scene.from_mujoco(raised, data, FETCH)
    mujoco.mj_forward(raised, data)
    with pytest.raises(SceneError, match="z = 0"):
        Scene.from_mujoco(raised, data, FETCH)


def test_what_rides_on_the_robot_is_refused() -> None:
    spec = mujoco.MjSpec.from_file(str(FETCH.mjcf_path))
    spec.worldbody.add_geom(name="table_top", type=mujoco.mjtGeom.mjGEOM_BOX, size=[0.3, 0.3, 0.1], pos=[5, 5, 1])
    label = spec.body("torso_lift_link").add_geom(
        name="label", type=mujoco.mjtGeom.mjGEOM_BOX, size=[0.1, 0.1, 0.01], contype=0, conaffinity=0
    )
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    assert [one.name for one in Scene.from_mujoco(model, data, FETCH).static_obstacles] == ["table_top"]
    tray = spec.body("torso_lift_link").add_body(name="tray")
    tray.add_geom(name="tray_bottom", type=mujoco.mjtGeom.mjGEOM_BOX, size=[0.1, 0.1, 0.01])
    for name, part in (("tray_bottom", tray), ("label", None)):
        model = spec.compile()
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        with pytest.raises(SceneError, match=f"'{name}'.*moves with the robot"):
            Scene.from_mujoco(model, data, FETCH)
        if part is not None:
            spec.delete(part)
            label.contype = 1
    empty = mujoco.MjModel.from_xml_string('<mujoco><worldbody><geom size=".1"/></worldbody></mujoco>')
    data = mujoco.MjData(empty)
    mujoco.mj_forward(empty, data)
    with pytest.raises(SceneError, match=r"lacks base_link, base_x.*its joints: none; .*insert_robot"):
        Scene.from_mujoco(empty, data, FETCH)


def test_a_robot_behind_a_prefix_is_found() -> None:
    """It was refused: every scene that comes from URDF has a `base_link`."""
    theirs = mujoco.MjSpec()
    theirs.worldbody.add_body(name=FETCH.base_body, pos=[3, 3, 0]).add_geom(size=[0.1, 0.1, 0.1])
    robots = [mujoco.MjSpec.from_file(str(FETCH.mjcf_path)) for _ in range(2)]
    theirs.attach(robots[0], prefix="robot0/", frame=theirs.worldbody.add_frame(pos=[1, 2, 0]))
    model, data = _at_rest(theirs)
    assert robot_prefix(model, FETCH) == "robot0/"
    scene = Scene.from_mujoco(model, data, FETCH, support="floor")
    np.testing.assert_allclose(scene.state.base, (1, 2, 0))
    assert [one.name for one in scene.static_obstacles] == [f"{FETCH.base_body}/geom_0"]
    theirs.attach(robots[1], prefix="robot1/", frame=theirs.worldbody.add_frame(pos=[-1, 2, 0]))
    with pytest.raises(SceneError, match="there 2 times, as robot0/, robot1/"):
        Scene.from_mujoco(*_at_rest(theirs), FETCH, support="floor")


def _at_rest(spec: mujoco.MjSpec) -> tuple[mujoco.MjModel, mujoco.MjData]:
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return model, data


def test_base_and_lift_have_any_names(tmp_path: Path) -> None:
    """They are those of the robot's file, and no code knows others."""
    panda = robot("panda_mobile")
    text, names = (
        panda.mjcf_path.read_text(),
        dict(zip(panda.drive_joints[:4], ("jx", "jy", "jth", "column"), strict=True)),
    )
    for old, new in names.items():
        text = text.replace(f'"{old}"', f'"{new}"')
    (tmp_path / "own.xml").write_text(text)
    own = RobotSpec.from_mjcf(
        tmp_path / "own.xml",
        base_joints=("jx", "jy", "jth"),
        tip="tcp",
        finger_joints=panda.finger_joints,
        home=panda.home,
    )
    spec = mujoco.MjSpec.from_file(str(own.mjcf_path))
    spec.worldbody.add_geom(name="table_top", type=mujoco.mjtGeom.mjGEOM_BOX, size=[0.3, 0.3, 0.1], pos=[5, 5, 1])
    model = spec.compile()
    data = mujoco.MjData(model)
    data.joint("jx").qpos, data.joint("column").qpos = 0.5, 0.2
    mujoco.mj_forward(model, data)
    state = Scene.from_mujoco(model, data, own).state
    assert state.base[0] == 0.5
    assert state.q[0] == 0.2


def test_shapes_without_names_that_a_simulation_names_are_the_robot_s_own(tmp_path: Path) -> None:
    """Where some shapes of two bodies count and others do not, those that do get names: the planner refused them."""
    text = re.sub(r'(<geom) name="(?!.*finger)[^"]*"', r"\1", FETCH.mjcf_path.read_text())
    (tmp_path / "fetch.xml").write_text(text)
    robot = replace(FETCH, mjcf=str(tmp_path / "fetch.xml"))
    spec = mujoco.MjSpec.from_file(str(robot.mjcf_path))
    spec.compile()
    unnamed = next(geom for geom in spec.geoms if not geom.name and (geom.contype or geom.conaffinity))
    unnamed.name = paired_name(unnamed.id)
    model = spec.compile()
    assert static_obstacles_of(model, mujoco.MjData(model), robot, ()) == (), "it is refused otherwise"
    unnamed.name = "of_another"
    other = spec.compile()
    with pytest.raises(SceneError, match="moves with the robot"):
        static_obstacles_of(other, mujoco.MjData(other), robot, ())
