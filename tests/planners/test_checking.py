"""Scenes that are odd: each is named with its number, before anything is planned in it."""

from __future__ import annotations

import re

import mujoco
import numpy as np
import pytest

from assets.robots import FETCH, robot as find_robot
from planners import (
    Infeasible,
    Reason,
    Scene,
    SceneError,
    Solution,
    check,
    execute,
    goals,
    insert_robot,
    prepare,
    settle,
    solve,
)
from planners.cause import Cause

TOP = 0.72
CUBE = '<body name="cube" pos="1 0 {z}"><freejoint/><geom type="box" size="0.02 0.02 0.02" {more}/></body>'


def at_rest(objects: str, section: str = "") -> tuple[mujoco.MjModel, mujoco.MjData]:
    """A table with its top at `TOP`, these objects, and Fetch at home before it."""
    scene = f"""<mujoco><worldbody><geom name="floor" type="plane" size="0 0 1"/>
      <body name="table" pos="1.1 0 0.36"><geom name="plate" type="box" size="0.35 0.5 0.36"/></body>
      {objects}</worldbody>{section}</mujoco>"""
    model = prepare(insert_robot(scene, FETCH), FETCH).model
    data = mujoco.MjData(model)
    for joint, value in zip(FETCH.drive_joints[3:], FETCH.home, strict=True):
        data.joint(joint).qpos = value
    mujoco.mj_forward(model, data)
    return model, data


def read(objects: str, movable: tuple[str, ...] = ("cube",), section: str = "") -> Scene:
    return Scene.from_mujoco(*at_rest(objects, section), FETCH, movable=movable)


def cube(z: float = TOP + 0.0202, more: str = 'mass="0.1"') -> str:
    return CUBE.format(z=z, more=more)


LYING = '<body name="cube" pos="1 0 0.7502" euler="90 0 0"><freejoint/><geom type="cylinder" size="0.03 0.05"/></body>'
MUG = (
    '<body name="cube" pos="1 0 0.7602"><freejoint/><geom type="cylinder" size="0.02 0.04" mass="0.1"/>'
    '<geom type="box" size="0.08 0.01 0.01" pos="0.1 0 0.02" mass="{mass}"/></body>'
)


@pytest.mark.parametrize(
    ("objects", "reason", "amount", "words"),
    [
        (cube(0.735), Reason.SUNK, 5, "cube: 5 mm inside plate"),
        (cube(0.72), Reason.SUNK, 20, "cube: 20 mm inside plate"),
        (cube(0.85), Reason.FLOATING, 110, "cube: 110 mm above plate"),
        (cube(0.85).replace("1 0 0.85", "-1 0 0.85"), Reason.FLOATING, 830, "cube: 830 mm above the ground"),
        (MUG.format(mass=0.5), Reason.UNSTABLE, 63, "centre of mass is 63 mm beside"),
        (cube().replace("1 0 0.7402", "0.735 0 0.7402"), Reason.UNSTABLE, 15, "centre of mass is 15 mm beside"),
        (cube(more='mass="20"'), Reason.TOO_HEAVY, 20, r"20 kg, and 'fetch' holds 8.19 kg with its arm"),
        (
            cube(more='mass="0.3" condim="1" priority="2"'),
            Reason.SLIPPERY,
            0,
            r"friction 0 .* priority 2 over theirs, 1",
        ),
        (cube(more='mass="4" friction="0.2 0 0" priority="2"'), Reason.TOO_HEAVY, 4, "the fingers hold 2.45 kg"),
        (cube().replace("1 0 0.7402", "0.25 0 0.1"), Reason.TOUCHES_ROBOT, 0, "cube: touches the robot"),
    ],
)
def test_what_is_odd_about_an_object_is_named_with_its_number(
    objects: str, reason: Reason, amount: float, words: str
) -> None:
    report = check(read(objects))
    found = [one for one in report.findings if one.reason is reason]
    assert found, report
    assert found[0].object == "cube"
    assert found[0].amount == pytest.approx(amount, abs=0.6)
    assert any(re.search(words, one.text) for one in found), report
    assert str(report).startswith(str(report.findings[0].reason))


@pytest.mark.parametrize(
    ("objects", "section"),
    [
        (cube(), ""),
        (cube(0.737), ""),  # 3 mm deep, as soft contacts are
        (MUG.format(mass=0.001), ""),
        (cube().replace("1 0 0.7402", "0.755 0 0.7402"), ""),  # over the edge, its middle above the table
        (LYING, ""),
        ('<body name="cube" pos="1 0 0.7502"><freejoint/><geom type="sphere" size="0.03"/></body>', ""),
    ],
)
def test_a_scene_in_order_has_no_findings(objects: str, section: str) -> None:
    report = check(read(objects, section=section))
    assert not report, report
    assert str(report) == "nothing odd"


def test_what_is_held_up_by_something_else_is_tied_and_does_not_fall() -> None:
    weld = '<equality><weld body1="cube"/></equality>'
    for objects, section in ((cube(0.85), weld), (cube(0.85).replace("<body", '<body gravcomp="1"'), "")):
        assert [one.reason for one in check(read(objects, section=section)).findings] == [Reason.TIED]


def test_free_bodies_that_no_plan_can_move_are_named() -> None:
    """They became static silently."""
    report = check(read(cube() + cube(1.5).replace('name="cube"', "") + cube(2.0).replace("cube", "lamp")))
    assert [one.reason for one in report.findings] == [Reason.FLOATING, Reason.FLOATING, Reason.UNNAMED]
    assert "lamp: not movable, but free to fall" in str(report)
    assert "has a free joint and no name: it is taken as a static obstacle" in str(report)


@pytest.mark.parametrize(
    ("objects", "cause", "words"),
    [
        (cube(0.735), Cause.NOT_AT_REST, "^cube: 5 mm inside plate; so: unreachable"),
        (cube(0.85), Cause.NOT_AT_REST, "^cube: 110 mm above plate$"),
        (cube(more='mass="20"'), Cause.TOO_HEAVY, "^cube: 20 kg"),
        (cube(more='mass="0.3" condim="1" priority="2"'), Cause.TOO_SLIPPERY, "^cube: friction 0"),
    ],
)
def test_a_solve_gives_the_true_cause(objects: str, cause: Cause, words: str) -> None:
    """It said "unreachable" or "motion", or planned what slipped or had moved."""
    found = solve(read(objects), "cube", rng=0)
    assert isinstance(found, Infeasible)
    assert found.cause is cause
    assert re.search(words, found.detail), found.detail
    assert found.objects == ("cube",)


def test_settled_objects_are_taken_and_the_same_state_ends_in_the_same_one() -> None:
    model, data = at_rest(cube(0.85) + cube(0.735).replace("cube", "deep").replace("1 0 ", "1 0.3 "))
    before = data.qpos.copy()
    first, second = (settle(model, data, FETCH) for _ in range(2))
    np.testing.assert_array_equal(data.qpos, before)
    np.testing.assert_array_equal(first.data.qpos, second.data.qpos)
    assert first.is_at_rest
    assert {name: round(1000 * moved) for name, moved in first.moved.items()} == {"cube": 110, "deep": 5}
    assert str(first).splitlines() == ["cube: moved by 110 mm", "deep: moved by 5 mm"]
    joints = [int(model.joint(name).qposadr[0]) for name in FETCH.drive_joints]
    np.testing.assert_array_equal(first.data.qpos[joints], before[joints])
    scene = Scene.from_mujoco(model, first.data, FETCH, movable=["cube", "deep"])
    assert not check(scene)
    solution = solve(scene, "deep", rng=0)
    assert isinstance(solution, Solution), solution
    assert execute(solution, model, first.data).finished
    with pytest.raises(SceneError, match="a time"):
        settle(model, data, FETCH, seconds=0)


def test_an_execution_that_stops_says_what_was_odd_from_the_start() -> None:
    """Another object in the air falls on the way: "moved"."""
    model, data = at_rest(cube() + cube(0.85).replace("cube", "other").replace("1 0 ", "1 0.3 "))
    solution = solve(Scene.from_mujoco(model, data, FETCH, movable=["cube", "other"]), "cube", rng=0)
    assert isinstance(solution, Solution), solution
    result = execute(solution, model, data)
    assert not result.finished
    assert result.why == "other: 110 mm above plate"
    assert str(result).endswith(": other: 110 mm above plate")


def test_prepare_prints_its_changes_by_reason_and_what_is_odd_about_objects() -> None:
    """A kitchen took 176 rows."""
    boxes = "".join(cube().replace("cube", f"box_{i}").replace("1 0 ", f"1 {0.05 * i - 0.4} ") for i in range(16))
    scene = f"""<mujoco><worldbody><geom name="plate" type="box" size="0.35 0.5 0.36" pos="1.1 0 0.36"/>
      {boxes}{cube(more='mass="20" condim="1" priority="2"').replace("1 0 ", "1 0.45 ")}</worldbody></mujoco>"""
    fit = prepare(insert_robot(scene, FETCH), FETCH)
    lines = str(fit).splitlines()
    assert len(fit.changes) == 22
    assert lines[0] == "the robot passed through it:"
    assert lines[1].startswith("  contact bits of plate, box_0/geom_1, box_1/geom_2")
    assert lines[1].endswith(" and 12 more: 1/1 -> 1/3")
    assert len(lines) == 9
    assert [line[:24] for line in lines[-2:]] == ["not mended: cube: 20 kg,", "not mended: cube: fricti"]


def test_the_robot_inside_something_is_told_which_link_and_where_it_would_be_free() -> None:
    model, data = at_rest(cube())
    data.joint(FETCH.base_joints[0]).qpos = 0.6
    mujoco.mj_forward(model, data)
    scene = Scene.from_mujoco(model, data, FETCH, movable=["cube"])
    with pytest.raises(
        SceneError, match=r"inside plate with its base.* at base pose \[0.6,.*nearest free one is"
    ) as told:
        solve(scene, "cube", rng=0)
    x, y, _ = map(float, str(told.value).rpartition("[")[2].rstrip("]").split(","))
    data.joint(FETCH.base_joints[0]).qpos, data.joint(FETCH.base_joints[1]).qpos = x, y
    mujoco.mj_forward(model, data)
    assert isinstance(solve(Scene.from_mujoco(model, data, FETCH, movable=["cube"]), "cube", rng=0), Solution)


@pytest.mark.parametrize("goal", [goals.on("cube", "table"), "(on cube table)", goals.on("cube", "plate")])
def test_a_body_stands_for_the_one_support_that_is_a_part_of_it(goal: str | goals.Goal) -> None:
    """It was no name of the scene: `plate` was."""
    scene = read(cube())
    assert scene.support_bodies == (("table", "plate"),)
    found = solve(scene, goal, rng=0)
    assert isinstance(found, Solution), found
    assert found.goal is not None
    assert found.goal.facts == goals.on("cube", "plate").facts
    with pytest.raises(goals.GoalError, match="shelf"):
        solve(scene, goals.on("cube", "shelf"))


@pytest.mark.parametrize("height", [0.0, 0.8])
def test_an_arm_that_is_bolted_to_a_table_plans_and_acts_at_any_height(height: float) -> None:
    """Its base had to be on z = 0."""
    panda = find_robot("panda_mobile").fixed()
    scene = f"""<mujoco><worldbody><geom name="floor" type="plane" size="0 0 1"/>
      <geom name="top" type="box" size="0.9 0.9 0.4" pos="0.4 0 {height - 0.4}"/>
      <geom name="stand" type="box" size="0.15 0.3 0.3" pos="0.75 0 {height + 0.3}"/>
      <body name="cup" pos="0.7 0 {height + 0.6501}"><freejoint/>
        <geom type="cylinder" size="0.03 0.05" mass="0.2"/></body></worldbody></mujoco>"""
    model = prepare(insert_robot(scene, panda, (0.0, 0.0, height, 0.0)), panda).model
    data = mujoco.MjData(model)
    for joint, value in zip(panda.drive_joints[3:], panda.home, strict=True):
        data.joint(joint).qpos = value
    mujoco.mj_forward(model, data)
    read_scene = Scene.from_mujoco(model, data, panda, movable=["cup"])
    assert (read_scene.ground, read_scene.supports) == (height, ("stand",))
    found = solve(read_scene, "cup", rng=0)
    assert isinstance(found, Solution), found
    assert execute(found, model, data).finished
    assert data.body("cup").xpos[2] > height + 0.7


def test_of_two_robots_in_a_scene_one_is_planned_for_and_the_other_is_an_obstacle() -> None:
    panda = find_robot("panda_mobile")
    spec = mujoco.MjSpec.from_string(f"""<mujoco><worldbody><geom name="floor" type="plane" size="0 0 1"/>
      <geom name="plate" type="box" size="0.35 0.5 0.36" pos="1.1 0 0.36"/>{cube()}</worldbody></mujoco>""")
    theirs = mujoco.MjSpec.from_file(str(panda.mjcf_path))
    spec.attach(theirs, frame=spec.worldbody.add_frame(pos=[2.2, 0, 0]), prefix="panda/")
    model = prepare(insert_robot(spec, FETCH), FETCH).model
    data = mujoco.MjData(model)
    for joint, value in zip(FETCH.drive_joints[3:], FETCH.home, strict=True):
        data.joint(joint).qpos = value
    mujoco.mj_forward(model, data)
    scene = Scene.from_mujoco(model, data, FETCH, movable=["cube"])
    assert any(one.name.startswith("panda/") for one in scene.static_obstacles)
    found = solve(scene, "cube", rng=0)
    assert isinstance(found, Solution), found
    assert execute(found, model, data).finished
    assert Scene.from_mujoco(model, data, panda, movable=["cube"]).state.base[0] == pytest.approx(2.2)
