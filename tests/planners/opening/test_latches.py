"""A lever that latches a door: seen in the shapes, turned, and held while the door is pulled, in physics."""

from __future__ import annotations

import math

import pytest

from planners import goals
from planners.opening.latches import latches
from planners.scene.moving import moved
from tests.planners.opening.furniture import cupboard_world, latched_world
from tests.planners.opening.test_opening import done, moves


def test_a_bolt_behind_a_post_latches_a_door() -> None:
    scene = latched_world().scene()
    one, other = latches(scene, "door", 1.2)
    assert one.lever == other.lever == "lever"
    assert one.position == pytest.approx(-other.position)
    end = 0.09  # the bolt ends so far from the axle, and the post begins 0.07 m from it
    assert math.acos(0.07 / end) < abs(one.position) < 1.5


def test_a_lever_that_has_been_turned_latches_nothing() -> None:
    scene = moved(latched_world().scene(), "lever", 1.4)
    assert latches(scene, "door", 1.2) == ()


def test_a_door_that_is_ajar_is_not_latched() -> None:
    scene = moved(latched_world().scene(), "door", 0.5)
    assert latches(scene, "door", 1.2) == ()


def test_a_door_without_a_lever_is_not_latched() -> None:
    assert latches(cupboard_world().scene(), "door", 1.2) == ()


def test_a_latched_door_is_opened_by_one_hand() -> None:
    plan, scene = done(latched_world(), goals.open_("door"))
    assert moves(plan) == [("Open", "door")]
    assert plan.actions[-1].scene.pull is not None
    assert plan.actions[-1].scene.pull.lever == "lever"
    assert scene.opening("door").share > 0.75


def test_a_lever_is_let_back_before_the_hand_leaves_it() -> None:
    # A spring of 3 N m/rad would turn it against the open fingers, and they would push the door shut.
    plan, scene = done(latched_world(stiffness=3.0), goals.open_("door"))
    pull = plan.actions[-1].scene.pull
    assert pull is not None
    assert scene.opening("door").position == pytest.approx(pull.position, abs=0.02)
    assert scene.opening("lever").position == pytest.approx(0.0, abs=0.05)
