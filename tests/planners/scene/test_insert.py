"""A robot in somebody else's model."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

from assets.robots import FETCH
from planners import Scene, SceneError, insert_robot

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
        insert_robot(CELL.replace("crane", FETCH.base_body), FETCH)


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
