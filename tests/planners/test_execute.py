"""Plans in the user's own simulation: what the robot passes through is refused, and mended by `prepare`."""

from __future__ import annotations

import re

import mujoco
import numpy as np
import pytest

from assets import robot as find_robot
from assets.robots import FETCH
from planners import ExpertError, Solution, execute, insert_robot, prepare, solve
from planners.scene import Scene
from tests.planners.own_scenes import MOVABLE, SUPPORT, kitchen, read


def planned(model: mujoco.MjModel, data: mujoco.MjData) -> Solution:
    found = solve(read(model, data), "can", rng=np.random.default_rng(0))
    assert isinstance(found, Solution), found
    return found


def test_an_object_that_the_robot_passes_through_is_refused_and_can_be_mended() -> None:
    model, data = kitchen()
    before = model.geom_conaffinity.copy()
    solution = planned(model, data)
    with pytest.raises(ExpertError, match=r"passes through can, box_a, box_b.*prepare"):
        execute(solution, model, data)
    fit = prepare(model, FETCH)
    assert (model.geom_conaffinity == before).all()
    assert "contact bits of plate" in {change.what for change in fit.changes}
    moved = mujoco.MjData(fit.model)
    moved.qpos[:] = data.qpos
    mujoco.mj_forward(fit.model, moved)
    assert execute(solution, fit.model, moved).finished
    assert Scene.from_mujoco(fit.model, moved, FETCH, movable=MOVABLE, support=SUPPORT).body("can").bottom > 0.8


@pytest.mark.parametrize("name", ["fetch", "pr2", "panda_mobile"])
def test_fingers_of_a_prepared_model_press_with_all_their_force_on_thin_objects(name: str) -> None:
    robot = find_robot(name)
    model = prepare(mujoco.MjModel.from_xml_path(str(robot.mjcf_path)), robot).model
    data = mujoco.MjData(model)
    for finger in robot.finger_joints:
        data.joint(finger).qpos = 0.001
        data.actuator(finger).ctrl = model.actuator(finger).ctrlrange[0]
    mujoco.mj_forward(model, data)
    for finger in robot.finger_joints:
        assert data.actuator(finger).force == pytest.approx(model.actuator(finger).forcerange[0])


def test_a_prepared_model_needs_no_changes() -> None:
    model, _ = kitchen()
    model.opt.timestep, model.opt.cone, model.opt.impratio = 0.0035, mujoco.mjtCone.mjCONE_PYRAMIDAL, 1
    fit = prepare(model, FETCH)
    assert (fit.model.opt.cone, fit.model.opt.impratio) == (mujoco.mjtCone.mjCONE_ELLIPTIC, 10)
    assert fit.model.opt.timestep == pytest.approx(0.01 / 3)
    assert prepare(fit.model, FETCH).changes == ()
    assert str(prepare(fit.model, FETCH)) == "no changes"


@pytest.mark.parametrize(
    ("option", "geom"), [("", 'margin="0.01"'), ('<option o_margin="0.01"><flag override="enable"/></option>', "")]
)
def test_margins_at_which_objects_rest_above_their_support_are_mended(option: str, geom: str) -> None:
    """What had been put down rested a centimetre high, and the goal did not hold."""
    table = '<geom name="table" type="box" size="0.3 0.4 0.35" pos="0.9 0 0.35"/>'
    can = f'<body name="can" pos="0.85 0 0.78"><freejoint/><geom type="cylinder" size="0.03 0.06" {geom}/></body>'
    model = insert_robot(f"<mujoco>{option}<worldbody>{table}{can}</worldbody></mujoco>", FETCH)
    fit = prepare(model, FETCH)
    assert [change.before for change in fit.changes if change.what.startswith("margin of")] == ["0.01"]
    data = mujoco.MjData(fit.model)
    data.joint(FETCH.base_joints[0]).qpos = -2.0  # away from the table
    mujoco.mj_step(fit.model, data, 100)
    assert data.body("can").xpos[2] == pytest.approx(0.76, abs=1e-3)


def test_a_time_step_too_long_for_the_integrator_and_disabled_physics_are_mended() -> None:
    """The arm shook at 0.01 s with the explicit integrator, and fell behind the plan."""
    model, data = kitchen()
    flags = (mujoco.mjtDisableBit.mjDSBL_CONTACT, mujoco.mjtDisableBit.mjDSBL_ACTUATION)
    model.opt.timestep, model.opt.disableflags = 0.01, sum(int(flag) for flag in flags)
    fit = prepare(model, FETCH)
    assert model.opt.disableflags
    assert {"time step [s]", "contacts", "motors"} <= {change.what for change in fit.changes}
    moved = mujoco.MjData(fit.model)
    moved.qpos[:] = data.qpos
    mujoco.mj_forward(fit.model, moved)
    assert execute(planned(model, data), fit.model, moved).finished
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    assert prepare(model, FETCH).model.opt.timestep == 0.01


@pytest.mark.parametrize(
    ("section", "words"),
    [
        ('<equality><weld body1="box_a" body2="table"/></equality>', "'box_a' is welded to 'table'.* as free"),
        ('<equality><weld body1="can"/></equality>', "'can' is welded to 'world'.* as free"),
        ('<equality><connect site1="lid" site2="hook"/></equality>', r"'can' is joined \(<connect>\) to 'table'"),
        ('<equality><weld body1="box_a" body2="table" active="false"/></equality>', ""),
        ('<contact><exclude body1="can" body2="table"/></contact>', "'can' passes through .*'table'.* as solid"),
        ('<contact><exclude body1="lamp" body2="table"/></contact>', ""),
        (
            '<tendon><spatial name="rope" stiffness="5"><site site="hook"/><site site="lid"/></spatial></tendon>',
            "'can' hangs by tendon 'rope' on 'table'.* as free",
        ),
        ('<tendon><spatial><site site="hook"/><site site="lid"/></spatial></tendon>', ""),
        ('<tendon><spatial stiffness="5"><site site="hook"/><site site="tip"/></spatial></tendon>', ""),
    ],
)
def test_what_holds_an_object_or_lets_it_through_is_named(section: str, words: str) -> None:
    """It showed only as deviations during execution."""
    scene = f"""<mujoco><worldbody><body name="table"><geom size="0.3 0.3 0.3" type="box"/><site name="hook"/></body>
      <body name="can" pos="0 0 0.5"><freejoint/><geom size="0.1"/><site name="lid"/></body>
      <body name="box_a" pos="0 0 0.8"><freejoint/><geom size="0.1"/></body>
      <body name="lamp" pos="1 0 2"><geom size="0.1"/><site name="tip"/></body></worldbody>{section}</mujoco>"""
    model = insert_robot(scene, FETCH, (2.0, 0.0, 0.0))
    fit = prepare(model, FETCH)
    assert len(fit.not_mended) == bool(words)
    assert re.search(words, str(fit))


@pytest.mark.parametrize(
    ("shape", "height"),
    [
        ('type="sphere" size="0.035"', 0.035),
        ('type="sphere" size="0.025"', 0.025),
        ('type="capsule" size="0.03 0.03"', 0.06),
        ('type="ellipsoid" size="0.06 0.04 0.03"', 0.03),
    ],
    ids=["ball", "small ball", "standing capsule", "egg"],
)
def test_what_rests_on_no_flat_face_is_lifted(shape: str, height: float) -> None:
    scene_text = f"""<mujoco><worldbody>
      <geom name="plate" type="box" size="0.35 0.5 0.02" pos="1.1 0 0.72"/>
      <body name="can" pos="0.95 0 {0.74 + height}"><freejoint/><geom {shape} mass="0.3"/></body>
    </worldbody></mujoco>"""
    model = prepare(insert_robot(scene_text, FETCH), FETCH).model
    data = mujoco.MjData(model)
    for joint, value in zip(FETCH.drive_joints[3:], FETCH.home, strict=True):
        data.joint(joint).qpos = value
    mujoco.mj_forward(model, data)
    scene = Scene.from_mujoco(model, data, FETCH, movable=["can"], support="plate")
    solution = solve(scene, "can", rng=np.random.default_rng(0))
    assert isinstance(solution, Solution), solution
    assert execute(solution, model, data).finished
    assert data.body("can").xpos[2] > 0.74 + height + 0.1
