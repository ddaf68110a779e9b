"""Drawers and doors that closed fingers push, in physics: where no hand gets around the handle, or there is none."""

from __future__ import annotations

import pytest

from assets import FETCH
from planners import Cause, Infeasible, Solution, goals, lower_bound, solve
from tests.planners.opening.furniture import cupboard_world, drawer_world
from tests.planners.opening.test_opening import done, moves


def pushes(plan: Solution) -> list[bool]:
    """Of each action that opens or shuts something, whether it pushes."""
    return [one.scene.pull.pushes for one in plan.actions if one.name in ("Open", "Close") and one.scene.pull]


@pytest.mark.parametrize("handle", ["none", "thick"])
def test_a_drawer_without_a_handle_for_the_hand_is_pushed_shut(handle: str) -> None:
    world = drawer_world(handle=handle, share=0.8)
    bound = lower_bound(world.scene(), goals.closed("drawer"))
    plan, scene = done(world, goals.closed("drawer"))
    assert moves(plan) == [("Close", "drawer")]
    assert pushes(plan) == [True]
    assert scene.opening("drawer").share < 0.05
    assert bound.picks == 1


def test_a_handle_that_is_too_thick_is_pushed_from_behind() -> None:
    plan, scene = done(drawer_world(handle="thick"), goals.open_("drawer"))
    assert pushes(plan) == [True]
    assert scene.opening("drawer").share > 0.75


@pytest.mark.parametrize("hinge", ["left", "right"])
def test_a_door_without_a_handle_is_pushed_shut(hinge: str) -> None:
    plan, scene = done(cupboard_world(hinge=hinge, handle="none", angle=1.2), goals.closed("door"))
    assert pushes(plan) == [True]
    assert scene.opening("door").share < 0.05


@pytest.mark.parametrize("hinge", ["left", "right"])
def test_a_door_that_is_ajar_is_pushed_open_from_behind(hinge: str) -> None:
    plan, scene = done(cupboard_world(hinge=hinge, handle="none", angle=0.7), goals.open_("door"))
    assert pushes(plan) == [True]
    assert scene.opening("door").share > 0.75


def test_a_handle_that_the_hand_can_take_is_taken() -> None:
    plan, _ = done(drawer_world(share=0.8), goals.closed("drawer"))
    assert pushes(plan) == [False]


def test_a_drawer_without_a_handle_is_pushed_open_at_the_inside_of_its_front() -> None:
    plan, scene = done(drawer_world(handle="none"), goals.open_("drawer"))  # there is room over it for a hand
    assert pushes(plan) == [True]
    assert scene.opening("drawer").share > 0.75


def test_a_door_that_is_shut_and_has_no_handle_stays_shut() -> None:
    found = solve(cupboard_world(handle="none").scene(), goals.open_("door"), time_limit=60)
    assert isinstance(found, Infeasible)
    assert found.cause is Cause.UNREACHABLE


def test_what_sticks_too_much_is_not_pushed() -> None:
    found = solve(drawer_world(handle="none", share=0.8, friction=60.0).scene(), goals.closed("drawer"))
    assert isinstance(found, Infeasible)


def test_a_door_whose_handle_leaves_reach_is_opened_in_two_motions() -> None:
    plan, scene = done(cupboard_world(FETCH.fixed(), hinge="right", base=(0.0, 0.4, 0.0)), goals.open_("door"))
    assert [name for name, _ in moves(plan)] == ["Open", "Open"]
    assert pushes(plan) == [False, True]
    assert plan.bound is None, "one motion may be enough for another hand"
    assert scene.opening("door").share > 0.75
