"""Goals in which one thing that opens serves several facts: plans, bounds and refusals agree with each other."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from clutter_env.envs.retrieve import RetrieveEnv
from planners import Cause, Infeasible, Scene, Solution, goals, lower_bound, solve
from planners.collision.world import CollisionWorld, is_inside_static
from planners.goals import Goal
from planners.scene import Body
from tests.planners.opening.furniture import World, box_world, cupboard_world, drawer_world

OUT = goals.on("red", "side_table")


def planned(world: World, goal: str | Goal) -> tuple[list[str], Solution]:
    """Names of picks, pulls and put-downs of a plan that ends as the goal says, with a bound that is not too high."""
    scene = world.scene()
    wanted, plan, bound = Goal.of(goal, scene), solve(scene, goal, time_limit=60), lower_bound(scene, goal)
    assert isinstance(plan, Solution), plan
    assert plan.end is not None
    assert wanted.holds(plan.end, scene)
    count = plan.picks + plan.pulls
    for one in (bound, plan.bound):
        assert one is None or one.least <= count
        assert one is None or not one.proved or one.picks == count
    return [action.name for action in plan.actions if action.name != "MoveBase"], plan


def _can(name: str, x: float, y: float, z: float) -> Body:
    half, position, upright = np.array((0.02, 0.02, 0.04)), np.array((x, y, z)), np.array((1.0, 0.0, 0.0, 0.0))
    return Body(name, "cylinder", half, position, upright)


@pytest.mark.parametrize("world", [drawer_world(share=0.6), drawer_world(share=0.75), cupboard_world(angle=0.9)])
def test_what_is_half_open_is_opened_further_if_that_is_not_enough(world: World) -> None:
    assert planned(world, "red")[0][0] == "Open"


@pytest.mark.parametrize("share", [0.3, 0.8])
def test_what_is_opened_by_the_goal_is_opened_once_as_far_as_the_rest_needs_it(share: float) -> None:
    goal = goals.open_("drawer", share=share) & goals.holding("red")
    assert planned(drawer_world(), goal)[0] == ["Open", "PickUp"]


def test_what_is_opened_farther_meanwhile_is_at_the_wanted_angle_in_the_end() -> None:
    names, plan = planned(drawer_world(), goals.turned("drawer", 0.1, 0.02) & OUT)
    assert names == ["Open", "PickUp", "PutDownGeneral", "Close"]
    assert plan.end is not None
    assert plan.end.opening("drawer").position == pytest.approx(0.1)


def test_nothing_is_opened_for_what_is_inside_already() -> None:
    world = drawer_world()
    assert planned(world, goals.on("red", "drawer_floor") & goals.closed("drawer"))[0] == []
    planned(world, goals.on("red", "drawer_floor"))


@pytest.mark.parametrize("share", [0.0, 0.97])
def test_the_bound_counts_that_a_drawer_is_shut_in_the_end_and_no_more(share: float) -> None:
    names, _ = planned(drawer_world(share=share), OUT & goals.closed("drawer"))
    assert names == ["Open"] * (share == 0.0) + ["PickUp", "PutDownGeneral", "Close"]
    assert lower_bound(drawer_world(share=share).scene(), OUT & goals.closed("drawer")).least == 3 - (share > 0)


def test_nothing_is_turned_beyond_its_end() -> None:
    _, plan = planned(box_world(), goals.turned("knob", 2.5, tolerance=1.0))
    assert plan.end is not None
    assert plan.end.opening("knob").position == 2.0


@pytest.mark.parametrize(
    ("joint", "share", "is_possible"),
    [
        ('stiffness="12.5"', 0.8, False),  # 2 N hold it to 0.57 of its range, and so in the middle
        ('stiffness="20"', 0.2, True),  # and this one to 0.36, not in the middle
        ('stiffness="20"', 0.5, False),
    ],
)
def test_a_spring_shuts_what_is_farther_open_than_friction_holds_it(
    joint: str, share: float, is_possible: bool
) -> None:
    found = solve(drawer_world(joint=joint).scene(), goals.open_("drawer", share=share))
    assert isinstance(found, Solution) == is_possible
    assert is_possible or (isinstance(found, Infeasible) and found.cause is Cause.SPRINGS_SHUT)


def test_what_a_spring_opens_is_not_shut() -> None:
    world = drawer_world(friction=0.2, share=0.97, joint='stiffness="20" springref="0.28"')
    found = solve(world.scene(), goals.closed("drawer"))
    assert isinstance(found, Infeasible)
    assert found.cause is Cause.SPRINGS_OPEN


def test_what_is_put_on_a_lid_or_a_bare_tray_needs_no_opening() -> None:
    world = box_world()
    movable = World(*world[:3], (), ("table", "lid_plate"))
    scene = movable.scene()
    plate = scene.support_named("lid_plate")
    can = _can("can", 0.85, 0.3, 0.7401)
    scene = replace(scene, objects=(can,))
    found = solve(scene, goals.on("can", "lid_plate"), time_limit=60)
    assert isinstance(found, Solution)
    assert (found.pulls, found.picks) == (0, 1)
    assert lower_bound(scene, goals.on("can", "lid_plate")).least == 1
    raised = solve(scene, goals.open_("lid"), time_limit=60)
    assert isinstance(raised, Solution)
    assert raised.end is not None
    assert plate.name not in raised.end.supports


def test_a_full_scene_is_no_proof_that_nothing_opens() -> None:
    scene = drawer_world().scene()
    places = [(0.68 + 0.08 * (k % 6), -1.04 + 0.055 * (k // 6)) for k in range(57)]
    more = [_can(f"c{k}", x, y, 0.6401) for k, (x, y) in enumerate(places)]
    scene = replace(scene, objects=(*scene.objects, *more))
    found, bound = solve(scene, goals.open_("drawer")), lower_bound(scene, goals.open_("drawer"))
    assert isinstance(found, Infeasible)
    assert (found.cause, bound.cause, bound.proved) == (Cause.GIVEN_UP, Cause.GIVEN_UP, False)
    assert "60 objects" in found.detail


def test_what_is_sunk_into_a_part_that_could_be_pushed_is_no_error() -> None:
    scene = drawer_world(handle="none").scene()
    red = scene.body("red")
    lower = red.at_pose(np.array([*red.pose[:2], red.pose[2] - (0, 0, 0, 0.005), red.pose[3]]))
    scene = replace(scene, objects=tuple(lower if one is red else one for one in scene.objects))
    assert isinstance(solve(scene, goals.open_("drawer"), time_limit=60), Solution | Infeasible)


def test_the_hand_is_off_the_handle_when_the_next_motion_begins() -> None:
    env = RetrieveEnv(layout="fridge", num_objects=5, base="differential")
    env.reset(seed=3)
    scene = Scene.from_mujoco(env.model, env.data, env.robot)
    plan = solve(scene, goals.open_("door", share=0.97), time_limit=60)
    assert isinstance(plan, Solution)
    assert plan.end is not None
    assert not is_inside_static(CollisionWorld.from_scene(plan.end))
