"""A robot in somebody else's model."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

from assets.robots import FETCH
from planners import (
    ControlledWorld,
    Scene,
    SceneError,
    Sensor,
    Solution,
    TampExpert,
    execute,
    insert_robot,
    prepare,
    robot_prefix,
    solve,
    tcp_pose,
)
from tests.planners.expert.test_controller import Deltas

CELL = """
<mujoco>
  <worldbody>
    <geom name="floor" type="plane" size="0 0 1"/>
    <body name="table" pos="0.9 1 0.2"><geom name="top" type="box" size="0.3 0.3 0.2"/></body>
    <body name="cup" pos="0.9 1 0.45"><freejoint name="cup"/><geom type="cylinder" size="0.03 0.05"/></body>
    <body name="crane" pos="0 0 1"><joint name="turn" axis="0 0 1"/><geom size="0.1"/></body>
  </worldbody>
  <actuator><motor name="turn" joint="turn"/></actuator>
  <equality><joint joint1="turn"/></equality>
  <sensor><jointpos joint="turn"/></sensor>
  <keyframe><key qpos="0.9 1 0.45 1 0 0 0 0.3"/></keyframe>
</mujoco>
"""


def test_the_robot_takes_the_place_of_another_one_under_its_own_names() -> None:
    model = insert_robot(CELL, FETCH, (0.2, 1.0, 0.5), without=["crane"])
    assert model.nq == 7 + len(FETCH.drive_joints) + len(FETCH.head_joints) + len(FETCH.finger_joints)
    assert "turn" not in {model.joint(number).name for number in range(model.njnt)}
    assert (model.nkey, model.nsensor) == (0, 0)
    data = mujoco.MjData(model)
    for name, value in zip(FETCH.drive_joints[3:], FETCH.home, strict=True):
        data.joint(name).qpos = value
    mujoco.mj_forward(model, data)
    scene = Scene.from_mujoco(model, data, FETCH, movable=["cup"], support="table")
    np.testing.assert_allclose(scene.state.base, (0.2, 1.0, 0.5), atol=1e-12)
    assert scene.names == ("cup",)


def test_mujoco_writes_no_warning_and_no_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    insert_robot(CELL, FETCH)
    assert capfd.readouterr() == ("", "")
    assert not list(tmp_path.iterdir())


def test_what_stands_in_the_way_is_told() -> None:
    with pytest.raises(SceneError, match="no body 'robot' to leave out; bodies: table, cup, crane"):
        insert_robot(CELL, FETCH, without=["robot"])
    with pytest.raises(SceneError, match=f"'fetch' cannot be put into this scene.*{FETCH.base_body}"):
        insert_robot(CELL.replace("crane", FETCH.base_body), FETCH, prefix="")


@pytest.mark.parametrize(("prefix", "found"), [(None, "fetch/"), ("my_", "my_")])
def test_names_of_the_robot_that_the_scene_has_put_a_prefix_before_the_robots(prefix: str | None, found: str) -> None:
    """Every scene that comes from URDF has a `base_link`: "repeated name"."""
    model = insert_robot(CELL.replace("crane", FETCH.base_body), FETCH, prefix=prefix)
    assert robot_prefix(model, FETCH) == found
    assert robot_prefix(insert_robot(CELL, FETCH), FETCH) == ""


LOW = -0.9


@pytest.mark.parametrize("base", [(0.0, 0.0, 0.0), (0.0, 0.0, LOW, 0.0)])
def test_a_world_whose_floor_is_not_at_zero_is_read_from_where_the_robot_stands(base: tuple[float, ...]) -> None:
    """The robot was put on z = 0, in the air, and elsewhere it was refused."""
    scenes = []
    for height in (0.0, LOW):
        model = insert_robot(at_height(height), FETCH, base if height else (0.0, 0.0, 0.0))
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        before = data.qpos.copy()
        scenes.append(Scene.from_mujoco(model, data, FETCH, movable=["cup"]))
        np.testing.assert_array_equal(data.qpos, before)
        seen = Sensor(model, data, FETCH, ["cup"]).read()
        np.testing.assert_allclose(seen.positions[0], scenes[-1].body("cup").position)
        np.testing.assert_allclose(seen.T_world_tcp, tcp_pose(FETCH, scenes[-1].state), atol=1e-9)
    level, low = scenes
    assert (level.ground, low.ground) == (0.0, LOW)
    assert low.supports == level.supports == ("top",)
    np.testing.assert_allclose(low.body("cup").position, level.body("cup").position)
    for one, other in zip(low.static_obstacles, level.static_obstacles, strict=True):
        np.testing.assert_allclose(one.position, other.position, atol=1e-12)
    np.testing.assert_allclose(low.opening("drawer").point, level.opening("drawer").point, atol=1e-12)


def test_in_a_world_whose_floor_is_low_a_plan_is_made_and_executed() -> None:
    fit = prepare(insert_robot(at_height(LOW), FETCH), FETCH)
    data = mujoco.MjData(fit.model)
    for name, value in zip(FETCH.drive_joints[3:], FETCH.home, strict=True):
        data.joint(name).qpos = value
    mujoco.mj_forward(fit.model, data)
    solution = solve(Scene.from_mujoco(fit.model, data, FETCH, movable=["cup"]), "cup", rng=0)
    assert isinstance(solution, Solution), solution
    assert execute(solution, fit.model, data).finished
    assert data.body("cup").xpos[2] > 0.1


def test_the_base_stands_on_something() -> None:
    model = insert_robot(at_height(LOW), FETCH, (0.0, 0.0, -0.5, 0.0))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    with pytest.raises(SceneError, match=r"must stand upright.*; floors are at z = -0\.9"):
        Scene.from_mujoco(model, data, FETCH, movable=["cup"])
    assert Scene.from_mujoco(model, data, FETCH.fixed(), movable=["cup"]).ground == -0.5  # bolted somewhere


def at_height(floor: float) -> str:
    """A table with a cup and a drawer, on a floor at a height [m]."""
    return f"""<mujoco><worldbody><body name="all" pos="0 0 {floor}"><geom name="floor" type="plane" size="0 0 1"/>
      <body name="table" pos="0.9 0 0.45"><geom name="top" type="box" size="0.35 0.5 0.45"/></body>
      <body name="drawer" pos="0.9 3 0.4"><joint type="slide" axis="0 1 0" range="0 0.3"/>
        <geom name="tray" type="box" size="0.2 0.2 0.1"/></body></body>
      <body name="cup" pos="0.8 0 {floor + 0.9501}"><freejoint/>
        <geom type="cylinder" size="0.03 0.05" mass="0.2"/></body>
    </worldbody></mujoco>"""


@pytest.mark.parametrize(
    ("given", "words"),
    [
        # MuJoCo ended the process where the world was deleted.
        ({"without": ["world"]}, "no body 'world' to leave out; bodies: table, cup, crane"),
        ({"without": [3]}, "no body 3 to leave out; bodies: table, cup, crane"),
        ({"without": "crane"}, r"use \['crane'\]"),
        ({"base": (0.0, float("nan"), 0.0)}, r"^base is x, y \[m\], yaw \[rad\], three finite numbers"),
        ({"base": (0.0, 0.0)}, "^base is"),
        ({"base": None}, "^base is"),
        ({"scene": mujoco.MjModel.from_xml_string(CELL)}, "compiled MjModel"),
    ],
)
def test_arguments_that_mean_nothing_are_refused(given: dict[str, object], words: str) -> None:
    with pytest.raises(SceneError, match=words):
        insert_robot(**({"scene": CELL, "robot": FETCH} | given))  # type: ignore[arg-type]  # misuse


def test_a_body_is_left_out_once_however_often_it_is_named() -> None:
    arm = CELL.replace('<geom size="0.1"/></body>', '<body name="jib"><geom size="0.1"/></body></body>')
    assert bodies(arm, ["crane", "jib"]) == bodies(arm, ["jib", "crane", "crane"]) == bodies(CELL, ["crane"])
    assert "jib" in bodies(arm, [])


def test_static_bodies_stay_apart_where_the_scene_would_fuse_them() -> None:
    """The robot lost its wrist, and the table its name."""
    fused = CELL.replace("<worldbody>", '<compiler fusestatic="true"/><worldbody>')
    assert bodies(fused, []) == bodies(CELL, [])


def bodies(scene: str, without: list[str]) -> list[str]:
    """Names of the bodies with a robot put in."""
    model = insert_robot(scene, FETCH, without=without)
    return [model.body(number).name for number in range(model.nbody)]


@pytest.mark.parametrize(
    ("fault", "words"),
    [
        ('<geom type="mesh" mesh="cup"/>', "mesh 'cup' not found"),
        ('<geom colour="red"/>', "unrecognized attribute: 'colour'"),
        ('<body name="bead"><freejoint/><geom size="0.01" mass="0"/></body>', "mass and inertia.*'bead'"),
    ],
)
@pytest.mark.parametrize("without", [(), ("crane",)])
def test_a_scene_that_mujoco_cannot_read_is_not_blamed_on_the_robot(
    fault: str, words: str, without: tuple[str, ...]
) -> None:
    scene = CELL.replace("<worldbody>", f"<worldbody>{fault}")
    which = " without crane" if without else ""
    with pytest.raises(SceneError, match=rf"(?s)^MuJoCo cannot read this scene{which}, even with no robot.*{words}"):
        insert_robot(scene, FETCH, without=without)


@pytest.mark.slow
def test_the_expert_fetches_through_a_controller_where_the_floor_is_low() -> None:
    model = prepare(insert_robot(at_height(LOW), FETCH), FETCH).model
    data = mujoco.MjData(model)
    for name, value in zip(FETCH.drive_joints[3:], FETCH.home, strict=True):
        data.joint(name).qpos = value
        data.actuator(name).ctrl = value
    world = ControlledWorld(Deltas(model, data, 0.1, 0.1), model, FETCH, movable=["cup"])
    assert world.support_name == "top"
    expert = TampExpert(world)
    expert.reset("cup")
    while not expert.done:
        world.step(expert.act())
    assert expert.report.scored, expert.report
    assert expert.report.replans == 0
    assert data.body("cup").xpos[2] > 0.1
