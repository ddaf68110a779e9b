"""`clutter-env robot check`: good robots have no problem, faults are named, a missing home is suggested."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from assets.robots import FETCH, RobotSpec, robot
from clutter_env.cli.main import main
from clutter_env.cli.robot_report import (
    LevelReach,
    _most_often_touching,
    home_candidates,
    least_grasp_height,
    level_reach,
    report_of,
    why_no_home,
)
from clutter_env.cli.robot_trials import SceneTrials, try_scenes
from clutter_env.scene.layout import find_layout
from clutter_env.simulation.model import compile_model
from irm.chain import ArmChain
from irm.kinematics import forward

PANDA = robot("panda_mobile")


@pytest.fixture(scope="module")
def reach() -> LevelReach:
    return level_reach(PANDA)


@pytest.fixture
def reach_once(reach: LevelReach, monkeypatch: pytest.MonkeyPatch) -> None:
    """The robot's reach, which takes seconds to compute and which no fault below changes."""
    monkeypatch.setattr("clutter_env.cli.robot_report.level_reach", lambda *_: reach)


@pytest.mark.usefixtures("reach_once")
def test_a_good_robot_is_drawn_and_has_no_problem(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    main(["robot", "check", "panda_mobile", "--scenes", "0", "--out", str(tmp_path / "robot.png")])
    text = capsys.readouterr().out
    assert "no problem found" in text
    assert "7 joints, closed form: three axes meet" in text
    assert (tmp_path / "robot.png").stat().st_size > 20_000


@pytest.mark.usefixtures("reach_once")
@pytest.mark.parametrize(
    ("old", "new", "hint"),
    [
        (' gravcomp="1">\n            <joint name="joint2"', '>\n            <joint name="joint2"', "without gravcomp"),
        ('<joint name="finger_coupling"', '<joint active="true" name="finger_coupling"', ""),
        ('joint1="finger_joint1" joint2="finger_joint2"', 'joint1="joint1" joint2="joint2"', "couples the fingers"),
        ('condim="4"', 'condim="3"', "from which objects slip"),
        ('type="box" size="0.032 0.10 0.034"', 'type="ellipsoid" size="0.032 0.10 0.034"', "is none of"),
        ('name="link4" class="panda_grey"', 'name="link4" conaffinity="1" class="panda_grey"', ""),
        ('forcerange="-12 12"', 'forcerange="-0.2 0.2"', "the motors hold 0.089 kg at the TCP"),
    ],
)
def test_faults_of_the_file_are_named(tmp_path: Path, old: str, new: str, hint: str) -> None:
    text = PANDA.mjcf_path.read_text()
    assert old in text
    (tmp_path / "robot.xml").write_text(text.replace(old, new))
    problems = report_of(replace(PANDA, mjcf=str(tmp_path / "robot.xml"))).problems
    assert hint in "; ".join(problems)
    assert bool(problems) == bool(hint)


def test_contact_bits_of_the_file_do_not_matter_to_a_simulation(tmp_path: Path) -> None:
    """They are set anew: the robot meets what the planner's rule counts."""
    other = changed_panda(tmp_path, 'name="link4" class', 'name="link4" contype="1" conaffinity="7" class')
    models = [compile_model(robot, find_layout("paper"), ()) for robot in (PANDA, other)]
    for bits in ("geom_contype", "geom_conaffinity"):
        np.testing.assert_array_equal(*(getattr(model, bits) for model in models))


@pytest.mark.usefixtures("reach_once")
def test_an_arm_that_its_motors_do_not_hold_stretched_out_is_named(tmp_path: Path) -> None:
    """It is no problem of a simulation, in which the arm weighs nothing."""
    text = PANDA.mjcf_path.read_text().replace('forcerange="-87 87"', 'forcerange="-30 30"')
    text = text.replace(
        "<worldbody>", '<custom><text name="assumed_torques" data="joint 1, joint 2"/></custom><worldbody>'
    )
    (tmp_path / "weak.xml").write_text(text)
    report = report_of(replace(PANDA, mjcf=str(tmp_path / "weak.xml")))
    assert "do not hold the arm alone stretched out ('joint2' has 30 N m)" in report.facts["motors"]
    assert report.facts["motors"].endswith("assumed, since the arm's file gives none: joint 1, joint 2")
    assert report.problems == ()
    assert report_of(PANDA).facts["motors"].startswith("hold 3.3 kg with the arm stretched out")


@pytest.mark.usefixtures("reach_once")
def test_a_bad_home_is_named() -> None:
    low = replace(PANDA, home=(0.0, *PANDA.home[1:]))
    assert any("the TCP is" in problem for problem in report_of(low).problems)
    assert not any("the TCP is" in problem for problem in report_of(low, table=0.4).problems)
    tilted = replace(PANDA, home=(*PANDA.home[:-1], 1.0))
    assert any("not level" in problem for problem in report_of(tilted).problems)


@pytest.mark.usefixtures("reach_once")
def test_a_gripper_that_touches_the_table_in_level_grasps_is_named() -> None:
    assert least_grasp_height(PANDA) <= PANDA.grasp_height
    low = report_of(replace(PANDA, grasp_height=least_grasp_height(PANDA) - 0.005)).problems
    assert any("nears the table" in problem for problem in low)


def test_the_report_counts_all_grasps_not_the_level_ones_alone(
    reach: LevelReach, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An arm on a high pedestal takes objects from above: that is no problem."""
    none = reach._replace(reached=np.zeros_like(reach.reached))
    monkeypatch.setattr("clutter_env.cli.robot_report.level_reach", lambda *_: none)
    report = report_of(PANDA.fixed())
    assert report.problems == ()
    assert report.facts["base"].startswith("fixed, ")
    assert report.facts["grasps at the table, straight ahead"].startswith("level none, tilted by 60° x = ")
    nothing = none._replace(tilted=np.zeros(0), from_above=np.zeros(0))
    monkeypatch.setattr("clutter_env.cli.robot_report.level_reach", lambda *_: nothing)
    assert any("no grasp reaches" in problem for problem in report_of(PANDA).problems)


def test_why_there_is_no_home_is_said() -> None:
    assert "reaches no grasp on a table of 3.0 m" in why_no_home(PANDA, 3.0)
    said = why_no_home(PANDA, 0.75)
    assert "touch neither the robot itself nor the ground" in said
    assert "--apart" in said
    assert "none" not in said
    down = np.array([[0.04, 0.0, 1.5, 0.0, 0.0, 0.0, 0.0, 0.0]])
    assert "and the ground (100%)" in _most_often_touching(FETCH, down), "what the ground hits was touched by none"


def changed_panda(folder: Path, old: str, new: str) -> RobotSpec:
    text = PANDA.mjcf_path.read_text()
    assert old in text
    (folder / "panda.xml").write_text(text.replace(old, new, 1))
    page = {name: getattr(PANDA, name) for name in ("base_joints", "finger_joints", "home", "grasp_height")}
    return RobotSpec.from_mjcf(folder / "panda.xml", tip="tcp", **page)


@pytest.mark.usefixtures("reach_once")
@pytest.mark.parametrize(("z", "where"), [(0.043, "20 mm ahead of"), (0.083, "20 mm behind"), (0.1034, "")])
def test_a_palm_that_leaves_no_room_before_it_is_named(tmp_path: Path, z: float, where: str) -> None:
    """It said: palm -80 mm behind the TCP, no problem found."""
    robot = changed_panda(tmp_path, 'name="tcp" pos="0 0 0.1034"', f'name="tcp" pos="0 0 {z}"')
    found = [problem for problem in report_of(robot).problems if "--tool" in problem]
    assert [where in problem for problem in found] == ([True] if where else [])


@pytest.mark.usefixtures("reach_once")
@pytest.mark.parametrize("depth", [0.0, 0.0053])
def test_a_base_in_the_ground_is_named_with_the_depth(tmp_path: Path, depth: float) -> None:
    """All plans were refuted, and no message named the wheel."""
    joint = '<joint name="base_x"'
    wheel = (
        f'<body name="wheel" gravcomp="1"><geom type="sphere" size="0.05" pos="0 0 {0.05 - depth}" mass="1"/></body>'
    )
    robot = changed_panda(tmp_path, joint, f"{wheel}{joint}")
    found = [problem for problem in report_of(robot).problems if "ground" in problem]
    assert found == (["'wheel' is 5.3 mm below the ground: raise what stands on the base"] if depth else [])


@pytest.mark.usefixtures("reach_once")
@pytest.mark.parametrize(("x", "z", "is_named"), [(0.7, 0.74, True), (0.7, 0.9, False), (0.4, 0.74, False)])
def test_what_stands_in_the_table_at_the_start_is_named(tmp_path: Path, x: float, z: float, is_named: bool) -> None:
    """The second arm of a robot, straight ahead, ended the command with an exception of the planner."""
    joint = '<joint name="base_x"'
    arm = f'<body name="arm" gravcomp="1"><geom type="capsule" size="0.03" fromto="0 0.2 {z} {x} 0.2 {z}"/></body>'
    report = report_of(changed_panda(tmp_path, joint, f"{arm}{joint}"))
    found = [problem for problem in report.problems if "ahead of where robots start" in problem]
    assert [problem.partition(" does not")[0] for problem in found] == (["'arm'"] if is_named else [])


def test_no_problem_is_found_only_after_scenes_were_executed(
    reach: LevelReach, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A robot whose every plan was refuted had no problem."""
    monkeypatch.setattr("clutter_env.cli.robot_report.level_reach", lambda *_: reach)
    asked = []

    def failing(robot: RobotSpec, count: int) -> SceneTrials:
        asked.append((robot.name, count))
        return SceneTrials({0: "", 1: "motion: wheel and floor overlap by 5.3 mm", 2: "unreachable"})

    monkeypatch.setattr("clutter_env.cli.robot_trials.try_scenes", failing)
    with pytest.raises(SystemExit):
        main(["robot", "check", "panda_mobile", "--out", str(tmp_path / "robot.png")])
    text = capsys.readouterr().out
    assert asked == [("panda_mobile", 3)]
    assert "no problem found" not in text
    assert "PROBLEM: 1 of 3 scenes with 5 objects planned and executed, clean; seed 1: motion: wheel and floor" in text
    main(["robot", "check", "panda_mobile", "--scenes", "0", "--out", str(tmp_path / "robot.png")])
    assert "no problem found" in capsys.readouterr().out


@pytest.mark.slow
def test_scenes_are_planned_and_executed() -> None:
    trials = try_scenes(robot("fetch"), 2)
    assert trials.reasons == {0: "", 1: ""}
    assert trials.is_good


def test_suggested_homes_are_level_ahead_and_high() -> None:
    found = home_candidates(PANDA)
    assert found
    for candidate in found:
        T = forward(ArmChain.from_robot(PANDA), candidate.q)
        assert T[0, 0] > 0.999
        assert T[2, 2] > 0.999
        assert T[2, 3] > 1.05


def test_a_page_without_a_home_ends_with_suggestions(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    page = {"base_joints": PANDA.base_joints, "tip": "tcp", "finger_joints": PANDA.finger_joints}
    (tmp_path / "page.json").write_text(json.dumps(page))
    with pytest.raises(SystemExit, match="says no home"):
        main(["robot", "check", str(PANDA.mjcf_path), "--page", str(tmp_path / "page.json")])
    line = capsys.readouterr().out.splitlines()[1]
    home = json.loads(line[line.index("[") : line.index("]") + 1])
    assert RobotSpec.from_mjcf(PANDA.mjcf_path, **page, home=tuple(home)).home == tuple(home)


ARM = Path(__file__).parents[2] / "data" / "arms" / "ur5e.xml"


def test_make_says_what_it_needs(capsys: pytest.CaptureFixture[str]) -> None:
    for wrong, message in ([], "--base"), (["--base", "base", "--tip", "hand"], "there is no site or body 'hand'"):
        with pytest.raises(SystemExit):
            main(["robot", "make", str(ARM), *wrong])
        assert message in capsys.readouterr().err


def test_a_robot_s_file_is_one_of_its_own(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "arm.xml"
    file.write_text(ARM.read_text())
    with pytest.raises(SystemExit):
        main(["robot", "make", str(file), "--base", "base", "--tip", "wrist_3", "--on", "0", "0.7", "--out", str(file)])
    assert "is the arm's own file" in capsys.readouterr().err
    for other in ("made", "made.json"):  # its page was written over it
        with pytest.raises(SystemExit):
            main(["robot", "make", str(file), "--base", "base", "--tip", "wrist_3", "--out", str(tmp_path / other)])
        assert "must end with .xml" in capsys.readouterr().err
    assert file.read_text() == ARM.read_text()


@pytest.mark.slow
def test_a_robot_is_made_of_an_arm_s_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """And its home is one that the check accepts."""
    file, place = tmp_path / "made.xml", ["--on", "0.15", "0.75", "--lift", "0", "0.4", "--tool", "0.24"]
    main(["robot", "make", str(ARM), "--base", "base", "--tip", "wrist_3", *place, "--out", str(file)])
    assert "no problem found" in capsys.readouterr().out
    page = json.loads(file.with_suffix(".json").read_text())
    assert report_of(RobotSpec.from_mjcf(file, **page)).problems == ()
    assert file.with_suffix(".png").stat().st_size > 10_000


@pytest.mark.slow
def test_a_wrist_with_narrow_limits_may_need_half_a_turn(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """No home was found, though two fingers are the same upside down: the Puma's wrist turns by 90° either way."""
    file, out = tmp_path / "narrow.xml", tmp_path / "made.xml"
    text = ARM.read_text()
    for joint, limits in (("shoulder_pan", "2 3.5"), ("wrist_2", "0.2 2.9"), ("wrist_3", "0.9 2.3")):
        text, changed = re.subn(rf'(name="{joint}" axis="0 0 1" range=)"[^"]*"', rf'\1"{limits}"', text)
        assert changed == 1
    file.write_text(text)
    place = ["--on", "0.15", "0.75", "--lift", "0", "0.4", "--tool", "0.24", "--scenes", "0"]
    main(["robot", "make", str(file), "--base", "base", "--tip", "wrist_3", *place, "--out", str(out)])
    text = capsys.readouterr().out
    assert "no problem found" in text
    assert "turn: the gripper is turned by half a turn, --turn 3.1416: else" in text
    page = json.loads(out.with_suffix(".json").read_text())
    assert 0.9 <= page["home"][-1] <= 2.3


def test_no_home_is_no_misuse(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The message ended with "did you mean 'lift'?", of a flag that it advises."""
    place = ["--on", "0.15", "0.75", "--lift", "0", "0.4", "--tool", "0.24", "--table", "3"]
    with pytest.raises(SystemExit) as ended:
        main(
            ["robot", "make", str(ARM), "--base", "base", "--tip", "wrist_3", *place, "--out", str(tmp_path / "m.xml")]
        )
    assert ended.value.code == 1
    text = capsys.readouterr().err
    assert "reaches no grasp on a table of 3.0 m" in text
    assert "did you mean" not in text
