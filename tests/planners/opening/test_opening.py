"""Drawers, doors and lids, planned for and opened in physics."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from assets import FETCH, PR2, RobotSpec, robot as robot_named
from planners import Cause, Infeasible, Planner, Scene, Solution, execute, goals, lower_bound, solve
from planners.collision.world import CollisionWorld
from planners.goals import Goal, GoalError
from planners.grasping.bar_grasps import with_hand_turned
from planners.scene import UnknownOpening
from planners.scene.moving import carried_by, moved
from tests.planners.opening.furniture import FRONT, World, box_world, cupboard_world, drawer_world


def planned(world: World, goal: str | Goal) -> Solution:
    found = solve(world.scene(), goal, time_limit=60)
    assert isinstance(found, Solution), found
    return found


def done(world: World, goal: str | Goal) -> tuple[Solution, Scene]:
    """The plan, carried out, and the scene at its end."""
    plan = planned(world, goal)
    result = execute(plan, world.model, world.data)
    assert result.finished, result
    return plan, world.scene()


def moves(plan: Solution) -> list[tuple[str, str]]:
    return [(action.name, action.target) for action in plan.actions if action.name != "MoveBase"]


def test_a_scene_says_what_opens_and_by_which_handle() -> None:
    scene = drawer_world(share=0.5).scene()
    (drawer,) = scene.openings
    assert (drawer.name, drawer.kind, drawer.handles) == ("drawer", "slide", ("drawer_handle",))
    assert np.allclose(drawer.axis, (-1.0, 0.0, 0.0))
    assert drawer.share == pytest.approx(0.5)
    assert (drawer.shut, drawer.open, drawer.friction) == (0.0, 0.28, 2.0)
    assert set(carried_by(scene, drawer)) == {"red", "blue", "green"}
    with pytest.raises(UnknownOpening, match="what does: drawer"):
        scene.opening("door")


def test_what_stands_in_a_drawer_moves_with_it() -> None:
    scene = drawer_world().scene()
    opened = moved(scene, "drawer", 0.2)
    assert opened.opening("drawer").position == 0.2
    for name in ("red", "blue"):
        assert np.allclose(opened.body(name).position - scene.body(name).position, (-0.2, 0.0, 0.0))
    floor = opened.support_named("drawer_floor")
    assert np.allclose(floor.position - scene.support_named("drawer_floor").position, (-0.2, 0.0, 0.0))
    back = moved(opened, "drawer", 0.0)
    assert all(np.allclose(a.position, b.position) for a, b in zip(back.objects, scene.objects, strict=True))


def test_a_door_turns_about_its_hinge() -> None:
    scene = cupboard_world().scene()
    opened = moved(scene, "door", np.pi / 2)
    panel = next(one for one in opened.static_obstacles if one.name == "door_panel")
    assert np.allclose(panel.position[:2], (FRONT - 0.245, 0.25), atol=1e-6)
    assert carried_by(scene, scene.opening("door")) == ()


@pytest.mark.parametrize("handle", ["upright", "level"])
def test_what_is_in_a_drawer_is_taken_without_being_told_to_open_it(handle: str) -> None:
    plan, scene = done(drawer_world(handle=handle), "red")
    assert moves(plan) == [("Open", "drawer"), ("PickUp", "red")]
    assert scene.opening("drawer").share > 0.9
    assert scene.body("red").bottom > 0.9


@pytest.mark.parametrize("hinge", ["left", "right"])
def test_what_is_behind_a_door_is_taken(hinge: str) -> None:
    plan, scene = done(cupboard_world(hinge=hinge), "red")
    assert moves(plan)[0] == ("Open", "door")
    assert moves(plan)[-1] == ("PickUp", "red")
    assert scene.opening("door").share > 0.9


def test_what_is_in_the_way_of_a_drawer_is_put_aside_first() -> None:
    world = drawer_world(blocked=True)
    bound = lower_bound(world.scene(), "red")
    plan, scene = done(world, "red")
    assert [name for name, _ in moves(plan)] == ["PickUp", "PutDownForClearance"] * 2 + ["Open", "PickUp"]
    assert {target for _, target in moves(plan)[:4]} == {"one", "other"}
    assert scene.opening("drawer").share > 0.9
    assert bound.picks == plan.picks + 1, "a pull counts as a pick"
    assert bound.least <= bound.picks


def test_a_drawer_is_opened_by_a_share_and_shut_again() -> None:
    world = drawer_world()
    _, scene = done(world, goals.open_("drawer", share=0.5))
    assert 0.45 < scene.opening("drawer").share < 0.75
    plan, scene = done(world, goals.closed("drawer"))
    assert moves(plan) == [("Close", "drawer")]
    assert scene.opening("drawer").share < 0.05


def test_a_lid_is_raised() -> None:
    _, scene = done(box_world(), goals.open_("lid"))
    assert scene.opening("lid").share > 0.75


def test_a_knob_is_turned() -> None:
    plan, scene = done(box_world(), goals.turned("knob", 1.2))
    assert moves(plan) == [("Open", "knob")]
    assert goals.turned("knob", 1.2, tolerance=0.15).holds(scene)


def test_a_drawer_is_shut_before_what_was_in_it_is_held() -> None:
    plan, scene = done(drawer_world(), goals.holding("red") & goals.closed("drawer"))
    assert [one for one, _ in moves(plan)] == ["Open", "PickUp", "PutDownGeneral", "Close", "PickUp"]
    assert scene.opening("drawer").share < 0.05


def test_something_is_put_into_a_drawer_that_is_shut() -> None:
    world = drawer_world()
    done(world, goals.on("red", "side_table") & goals.closed("drawer"))
    plan, scene = done(world, goals.on("red", "drawer_floor") & goals.closed("drawer"))
    assert [one for one, _ in moves(plan)] == ["Open", "PickUp", "PutDownGeneral", "Close"]
    assert goals.on("red", "drawer_floor").holds(scene)


@pytest.mark.parametrize("handle", ["upright", "level"])
def test_a_drawer_near_the_floor_is_opened(handle: str) -> None:
    _, scene = done(drawer_world(handle=handle, height=0.17), goals.open_("drawer"))
    assert scene.opening("drawer").share >= 0.8


def test_a_hand_that_sits_turned_hits_what_the_last_joint_turned_hits() -> None:
    for robot in (FETCH, PR2.using("left"), robot_named("panda_mobile")):
        world = CollisionWorld.from_scene(drawer_world(robot).scene())
        turned, arm, rng = with_hand_turned(world), world.robot, np.random.default_rng(0)
        hits = []
        for _ in range(400):
            q = rng.uniform(np.maximum(arm.lower, -np.pi), np.minimum(arm.upper, np.pi))
            base = rng.uniform((-0.2, -0.4, -1.0), (0.5, 0.4, 1.0))
            other = q + np.pi / 2 * np.eye(len(q))[-1]
            hits.append(world.hits(base, other, 0.04))
            assert turned.hits(base, q, 0.04) == hits[-1]
        assert 0 < np.count_nonzero(hits) < len(hits)


@pytest.mark.slow
@pytest.mark.parametrize("robot", [PR2, FETCH.differential()], ids=["pr2", "differential"])
def test_other_robots_open_too(robot: RobotSpec) -> None:
    _, scene = done(cupboard_world(robot), "red")
    assert scene.opening("door").share > 0.9


def test_a_spring_that_shuts_what_nobody_holds_is_the_cause() -> None:
    found = solve(drawer_world(joint='stiffness="60" springref="-0.05"').scene(), "red")
    assert isinstance(found, Infeasible)
    assert found.cause is Cause.SPRINGS_SHUT


def test_a_drawer_that_does_not_move_as_planned_is_a_deviation() -> None:
    world = drawer_world()
    plan = planned(world, "red")
    world.model.jnt_range[world.model.joint("drawer_joint").id] = (0.0, 0.14)  # it jams at half
    result = execute(plan, world.model, world.data)
    assert not result.finished
    assert result.deviation is not None
    assert result.deviation.object in ("drawer", "")
    assert world.scene().opening("drawer").share < 0.6


def test_goals_about_what_opens_are_texts_too() -> None:
    scene = drawer_world().scene()
    goal = Goal.of("(and (open drawer (share 0.5)) (on red side_table))", scene)
    assert goal.openings == (goals.Open("drawer", 0.5),)
    assert Goal.from_pddl(goal.to_pddl(), scene) == goal
    assert Goal.of("(closed DRAWER)", scene).holds(scene)
    assert not goals.open_("drawer").holds(scene)
    assert goals.open_("drawer", amount=0.1).holds(drawer_world(share=0.4).scene())
    with pytest.raises(GoalError, match="what opens: drawer"):
        goals.open_("door").holds(scene)
    with pytest.raises(GoalError, match="twice how"):
        (goals.open_("drawer") & goals.closed("drawer")).check(scene)
    with pytest.raises(GoalError, match="share"):
        goals.open_("drawer", share=1.5)


def test_a_plan_that_opens_is_kept_in_a_file(tmp_path: Path) -> None:
    plan, path = planned(drawer_world(), "red"), tmp_path / "plan.npz"
    plan.save(path)
    assert Solution.load(path) == plan


def test_the_same_seed_gives_the_same_plan() -> None:
    scene = cupboard_world().scene()
    one, other = solve(scene, "red", rng=3), solve(scene, "red", rng=3)
    assert isinstance(one, Solution)
    assert isinstance(other, Solution)
    assert [action.name for action in one.actions] == [action.name for action in other.actions]
    for a, b in zip(one.actions, other.actions, strict=True):
        assert np.array_equal(a.trajectory.states, b.trajectory.states)


def test_what_is_open_already_needs_no_plan() -> None:
    plan = planned(drawer_world(share=0.9), goals.open_("drawer"))
    assert plan.actions == ()


def test_a_problem_that_is_kept_opens_too() -> None:
    world = drawer_world()
    planner = Planner(FETCH)
    plan = planner.solve_problem(planner.problem(world.scene(), "red"))
    assert isinstance(plan, Solution)
    assert moves(plan)[0] == ("Open", "drawer")
