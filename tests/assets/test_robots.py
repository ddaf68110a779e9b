"""The robot's data agree with its MJCF, so that a second robot is data too."""

from __future__ import annotations

import json
import math
from dataclasses import asdict, replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from assets import path
from assets.robot_parts import rotation_of
from assets.robots import FETCH, PR2, InvalidRobot, RobotSpec, UnknownRobot, robot
from clutter_env.simulation.robot_check import check_robot
from irm import ArmChain, forward

ROBOTS = [FETCH, PR2, PR2.using("left"), robot("panda_mobile")]


@pytest.fixture(params=ROBOTS, ids=lambda spec: spec.name + spec.arm_name)
def spec_and_model(request):
    return request.param, mujoco.MjModel.from_xml_path(str(request.param.mjcf_path))


def test_names_joints_and_frames_of_the_data_are_those_of_the_file(spec_and_model) -> None:
    spec, _ = spec_and_model
    check_robot(spec)


def test_forward_kinematics_of_the_data_is_that_of_the_model(spec_and_model) -> None:
    spec, model = spec_and_model
    data = mujoco.MjData(model)
    rng = np.random.default_rng(0)
    for _ in range(20):
        q = np.array([rng.uniform(link.lower, link.upper) for link in spec.chain])
        data.qpos[:] = 0
        for link, value in zip(spec.chain, q, strict=True):
            data.qpos[model.joint(link.joint).qposadr[0]] = value
        mujoco.mj_kinematics(model, data)
        point, turn = np.zeros(3), np.eye(3)
        for link, value in zip(spec.chain, q, strict=True):
            point, turn = point + turn @ link.offset, turn @ rotation_of(link.quaternion)
            axis = np.array(link.direction)
            if link.prismatic:
                point = point + turn @ axis * value
            else:
                turn = turn @ rotation_of((math.cos(value / 2), *(math.sin(value / 2) * axis)))
        point, turn = point + turn @ spec.tcp_offset, turn @ rotation_of(spec.tcp_quaternion)
        assert np.allclose(data.site(spec.tcp_site).xpos, point, atol=1e-6)
        assert np.allclose(data.site(spec.tcp_site).xmat.reshape(3, 3), turn, atol=1e-6)


def test_home_is_level_high_and_touches_nothing(spec_and_model) -> None:
    spec, model = spec_and_model
    model.geom_conaffinity[:] |= 2
    data = mujoco.MjData(model)
    for joint, value in zip(
        (*spec.drive_joints, *spec.head_joints), (0, 0, 0, *spec.home, *spec.head_configuration), strict=True
    ):
        data.qpos[model.joint(joint).qposadr[0]] = value
    mujoco.mj_forward(model, data)
    rotation = data.site(spec.tcp_site).xmat.reshape(3, 3)
    assert rotation[2, 2] > 0.999, "the gripper is level"
    assert rotation[0, 0] > 0.99, "and points ahead"
    assert data.site(spec.tcp_site).xpos[2] > 1.0
    pairs = {
        tuple(sorted(model.geom(g).name for g in contact.geom)) for contact in data.contact if contact.dist < -1e-3
    }
    assert not {pair for pair in pairs if not _are_neighbours(model, *pair)}


def _are_neighbours(model: mujoco.MjModel, first: str, second: str) -> bool:
    """Links that are at most two joints apart overlap by construction."""
    lineages = []
    for name in (first, second):
        body, lineage = int(model.geom_bodyid[model.geom(name).id]), []
        while body:
            lineage.append(body)
            body = int(model.body_parentid[body])
        lineages.append(lineage)
    return lineages[0][0] in lineages[1][:3] or lineages[1][0] in lineages[0][:3]


def test_finger_positions_invert_openings(spec_and_model) -> None:
    spec, _ = spec_and_model
    for opening in np.linspace(spec.finger_gap_closed, spec.max_opening, 7):
        position = spec.finger_position(opening)
        assert spec.finger_gap_closed + 2 * position == pytest.approx(opening)
    assert spec.finger_position(-1.0) == 0.0
    assert spec.finger_position(1.0) == spec.max_finger_position


def test_pads_are_as_far_apart_as_the_data_say(spec_and_model) -> None:
    spec, model = spec_and_model
    data = mujoco.MjData(model)
    for position in (0.0, spec.max_finger_position):
        for joint in spec.finger_joints:
            data.qpos[model.joint(joint).qposadr[0]] = position
        mujoco.mj_kinematics(model, data)
        centres = np.array([data.geom(geom).xpos for geom in spec.finger_geoms])
        gap = np.linalg.norm(centres[0] - centres[1]) - spec.finger_thickness
        assert gap == pytest.approx(spec.finger_gap_closed + 2 * position, abs=1e-4)


@pytest.mark.parametrize("name", ["tiago", "", None, 3])
def test_unknown_robots_list_the_known(name: object) -> None:
    with pytest.raises(UnknownRobot, match="fetch"):
        robot(name)


def test_unknown_assets_list_the_known() -> None:
    with pytest.raises(FileNotFoundError, match=r"mjcf/fetch\.xml"):
        path("mjcf/tiago.xml")


@pytest.mark.parametrize(
    ("change", "hint"),
    [
        ({"name": ""}, "name must be a non-empty string"),
        ({"home": (0.25, 0.0)}, "home must have 8 numbers, not 2"),
        ({"home": (9.0, *FETCH.home[1:])}, "home holds 9.0, outside 'torso_lift_joint'"),
        ({"max_velocity": FETCH.max_velocity[:-1]}, "max_velocity must have 11 numbers"),
        ({"max_acceleration": (0.0, *FETCH.max_acceleration[1:])}, "max_acceleration must be positive"),
        ({"base_joints": ("base_x", "base_y")}, "base_joints must be 3 different names"),
        ({"finger_joints": ("a", "a")}, "finger_joints must be 2 different names"),
        ({"head_configuration": (0.0,)}, "head_configuration must have 2 numbers"),
        ({"tcp_offset": (0.1, 0.0, float("nan"))}, "tcp_offset must be finite"),
        ({"base_radius": -0.1}, "base_radius must be positive"),
        ({"chain": FETCH.chain[1:]}, "chain must have a prismatic joint as entry 0"),
        ({"chain": (FETCH.chain[0], FETCH.chain[1]._replace(axis="w"))}, "axis must be 'x', 'y' or 'z'"),
        ({"chain": 3}, "chain must be a tuple of ChainLink"),
        ({"head_joints": 1.0}, "head_joints must be a tuple of names"),
        ({"grasp_axis_offset": "0.1"}, "grasp_axis_offset must be a tuple of numbers"),
        ({"plans_torso": 1}, "plans_torso must be of type bool"),
        ({"idle_arms": (3,)}, "idle_arms must be a tuple of ArmSpec"),
        ({"base_outline": ((0.1,),)}, "base_outline, corner must have 2 numbers"),
    ],
)
def test_a_spec_that_contradicts_itself_names_the_field(change: dict, hint: str) -> None:
    with pytest.raises(InvalidRobot, match=hint):
        replace(FETCH, **change)


def test_a_spec_is_taken_as_it_is_and_from_its_fields() -> None:
    mine = replace(FETCH, name="mine")
    assert robot(mine) is mine
    for one in (mine, PR2):
        assert robot(json.loads(json.dumps(asdict(one)))) == one
    with pytest.raises(InvalidRobot, match=r"fields of a RobotSpec .*legs.*; its fields: name, mjcf"):
        robot({**asdict(mine), "legs": 2})


@pytest.mark.parametrize("entry", ["base_joints", "finger_joints", "finger_geoms", "tip", "home", "max_velocity"])
@pytest.mark.parametrize("value", [None, 3, "nothing", (None, None), np.zeros(3)])
def test_a_page_with_a_wrong_entry_is_refused(entry: str, value: object) -> None:
    """MuJoCo looks up a name that is None, which ended the process."""
    page = {"base_joints": ("base_x", "base_y", "base_yaw"), "tip": "tcp", "home": robot("panda_mobile").home}
    page |= {"finger_joints": ("finger_joint1", "finger_joint2")}
    with pytest.raises(InvalidRobot):
        RobotSpec.from_mjcf("mjcf/panda_mobile.xml", **{**page, entry: value})


def test_another_arm_becomes_active_and_back() -> None:
    left = PR2.using("left")
    assert left.tcp_site == "l_tcp"
    assert left.arm_joints == PR2.idle_arms[0].joints
    assert left.chain[0] == PR2.chain[0]
    assert [arm.name for arm in left.arms] == ["left", "right"]
    assert left.home[0] == PR2.home[0]
    assert left.using("right") == PR2
    assert PR2.using("right") == PR2
    with pytest.raises(InvalidRobot, match="pr2 has no arm 'third'; its arms: 'left', 'right'"):
        PR2.using("third")


def test_the_arms_are_mirror_images() -> None:
    left = PR2.using("left")
    for mine, other in zip(PR2.chain[1:], left.chain[1:], strict=True):
        turns = -1 if mine.axis in ("x", "z") else 1
        assert mine.offset == (other.offset[0], -other.offset[1], other.offset[2])
        assert sorted((turns * mine.lower, turns * mine.upper)) == pytest.approx([other.lower, other.upper])


def test_a_file_with_its_page_beside_it_is_a_robot(tmp_path: Path) -> None:
    panda = robot("panda_mobile")
    page = {"base_joints": panda.base_joints, "tip": "tcp", "finger_joints": panda.finger_joints, "home": panda.home}
    (file := tmp_path / "arm.xml").write_text(panda.mjcf_path.read_text())
    with pytest.raises(UnknownRobot, match=r"its page arm\.json beside it"):
        robot(str(file))
    file.with_suffix(".json").write_text(json.dumps({**page, "base": "fixed"}))
    found = robot(str(file))
    assert found.chain == panda.chain
    assert found.base_drive == "fixed"
    file.with_suffix(".json").write_text(json.dumps({**page, "hands": 2}))
    with pytest.raises(InvalidRobot, match=r"arm\.json: .*unknown or missing: hands"):
        robot(str(file))


def test_a_robot_with_two_arms_is_read_from_its_file() -> None:
    """PR2, whose data are written by hand, is the oracle."""
    arms = {
        arm.name: {
            "tip": arm.tcp_site,
            "finger_joints": arm.finger_joints,
            "finger_geoms": arm.finger_geoms,
            "home": (PR2.home[0], *arm.home),
        }
        for arm in PR2.arms
    }
    page = {"base_joints": PR2.base_joints, "head_joints": PR2.head_joints, "head_configuration": (0.0, 0.75)}
    read = RobotSpec.from_mjcf(PR2.mjcf, **page, arms=arms)
    check_robot(read.with_all_arms())
    assert [arm.name for arm in read.arms] == ["right", "left"]
    assert read.still_joints == PR2.still_joints
    for name in ("right", "left"):
        chain, other = (ArmChain.from_robot(one.using(name)) for one in (read, PR2))
        np.testing.assert_allclose(
            forward(chain, PR2.using(name).home), forward(other, PR2.using(name).home), atol=1e-6
        )
    assert len(read.shapes.link) == len(PR2.shapes.link)
    with pytest.raises(InvalidRobot, match="must share one lift"):
        RobotSpec.from_mjcf(
            PR2.mjcf, **page, arms={**arms, "left": {**arms["left"], "home": (0.1, *PR2.idle_arms[0].home)}}
        )
    for wrong in ({"right": arms["right"]}, ("r_tcp", "l_tcp")):
        with pytest.raises(InvalidRobot, match="what is said of each arm by its name, of two or more"):
            RobotSpec.from_mjcf(PR2.mjcf, **page, arms=wrong)
