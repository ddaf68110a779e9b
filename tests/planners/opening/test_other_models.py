"""What models from elsewhere say of what opens: strange ranges, bodies without names, a slope."""

from __future__ import annotations

import mujoco
import pytest

from planners import Cause, Infeasible, Scene, SceneError, goals, solve
from planners.goals import GoalError, from_sentence
from tests.planners.opening.furniture import FRONT, World, _world, box_world, drawer_world

JOINT = '<joint name="j" type="slide" axis="-1 0 0" range="0 0.28" damping="5" frictionloss="1"/>'


def drawer(joint: str = JOINT, handle: str = 'name="handle"', other: str = "") -> World:
    """A drawer whose handle is a body of its own, and what else stands there."""
    parts = f"""
      <geom name="side_table" type="box" size="0.3 0.3 0.3" pos="0.88 -0.8 0.3"/>{other}
      <body name="drawer" pos="{FRONT} 0 0.68">{joint}
        <geom name="front" type="box" size="0.01 0.2 0.08" mass="0.5"/>
        <body {handle} pos="-0.06 0 0"><geom name="bar" type="box" size="0.01 0.012 0.06" mass="0.1"/></body>
      </body>"""
    return _world(parts, drawer_world().robot, [], ["side_table"], {})


def test_parts_are_those_of_its_own_bodies_where_bodies_have_no_names() -> None:
    shelf = '<body pos="0 2 0.5"><geom name="shelf" type="box" size="0.2 0.2 0.02"/></body>'
    (opening,) = drawer(handle="", other=shelf).scene().openings
    assert {*opening.parts} == {"front", "bar"}


def test_two_openings_without_names_are_two() -> None:
    flap = (
        '<body pos="0 {} 1"><joint type="hinge" axis="0 1 0" range="0 1"/><geom type="box" size="0.1 0.1 0.01"/></body>'
    )
    openings = drawer(other=flap.format(2) + flap.format(3)).scene().openings
    names = [one.name for one in openings]
    assert len({*names}) == 3
    assert "" not in names
    assert {len(one.parts) for one in openings if one.name != "drawer"} == {1}


@pytest.mark.parametrize(
    "of", ['type="slide" axis="-1 0 0" range="0 1e9"', 'type="hinge" axis="0 0 1" range="-1e9 1e9"']
)
def test_a_range_without_end_is_no_range(of: str) -> None:
    scene = drawer(f'<joint name="j" {of} damping="5"/>').scene()
    assert scene.openings == ()
    with pytest.raises(GoalError, match="what opens: none"):
        solve(scene, goals.open_("drawer"))


def test_what_slopes_falls_shut_where_nobody_holds_it() -> None:
    steep = JOINT.replace('axis="-1 0 0"', 'axis="-1 0 0.5"')
    opening = drawer(steep).scene().opening("drawer")
    assert opening.springs_shut
    assert opening.spring == pytest.approx(0.6 * 9.81 * 0.5 / 1.25**0.5, rel=1e-3)
    found = solve(drawer(steep).scene(), goals.open_("drawer"))
    assert isinstance(found, Infeasible)
    assert found.cause is Cause.SPRINGS_SHUT
    for held in (steep.replace('frictionloss="1"', 'frictionloss="5"'), JOINT.replace("-1 0 0", "-1 0 -0.5"), JOINT):
        assert not drawer(held).scene().opening("drawer").springs_shut


def test_a_trapdoor_falls_shut_and_a_lid_that_leans_back_does_not() -> None:
    hatch = """<body name="hatch" pos="0 2 1"><joint type="hinge" axis="0 -1 0" range="0 {}"/>
      <geom type="box" size="0.2 0.2 0.01" pos="0.2 0 0" mass="1"/></body>"""
    assert drawer(other=hatch.format(1.0)).scene().opening("hatch").springs_shut
    assert not drawer(other=hatch.format(1.9)).scene().opening("hatch").springs_shut
    assert not box_world().scene().opening("lid").springs_shut


def test_friction_below_zero_is_no_spring() -> None:
    assert not drawer(JOINT.replace('frictionloss="1"', 'frictionloss="-2"')).scene().opening("drawer").springs_shut


def test_without_gravity_nothing_falls() -> None:
    world = drawer(JOINT.replace('axis="-1 0 0"', 'axis="-1 0 0.5"'))
    world.model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_GRAVITY)
    assert world.scene().opening("drawer").spring == 0.0


@pytest.mark.parametrize(
    ("goal", "message"),
    [
        (goals.open_("drawer", amount=50.0), r"'drawer' opens by 0.28 m, not by 50"),
        (goals.turned("drawer", 90.0), r"'drawer' moves from 0 to 0.28 m, not to 90"),
        (goals.turned("drawer", -1.0), r"not to -1"),
    ],
)
def test_a_goal_beyond_the_range_says_what_the_range_is(goal: goals.Goal, message: str) -> None:
    scene = drawer().scene()
    with pytest.raises(GoalError, match=message):
        solve(scene, goal)
    with pytest.raises(GoalError, match=r"not by 50"):
        from_sentence("open the drawer by 50", scene)


def test_what_lacks_a_little_of_an_amount_is_within_the_range() -> None:
    goals.open_("drawer", amount=0.29).check(drawer().scene())


def test_handles_are_lists_of_names() -> None:
    world = drawer()
    with pytest.raises(SceneError, match=r"handles of 'drawer' are a list of names, such as \['bar'\], not 'bar'"):
        Scene.from_mujoco(world.model, world.data, world.robot, support="side_table", handles={"drawer": "bar"})
