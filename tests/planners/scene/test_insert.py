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
