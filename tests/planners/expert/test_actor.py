"""The actor: steps of an agenda in their order, decisions in no time, motions step by step."""

from __future__ import annotations

import numpy as np
import pytest

from assets.robots import FETCH
from planners.expert.actor import Actor, Steps, Straight, Wait, home_of, planned_from, straight_seconds
from planners.expert.executor import Command

START = Command(np.zeros(11), 0.1, "right")


def drives(actor: Actor) -> list[float]:
    """The first joint, as commanded until nothing is left."""
    actor.decide()
    found = []
    while not actor.is_idle:
        found.append(float(actor.command().drive[0]))
        actor.decide()
    return found


def test_what_a_decision_returns_comes_before_the_rest_of_the_agenda() -> None:
    order: list[str] = []

    def inner() -> Steps:
        order.append("inner")
        return []

    def outer() -> Steps:
        order.append("outer")
        return [Wait(1), inner]

    def last() -> Steps:
        order.append("last")
        return []

    actor = Actor(START, outer, last)
    actor.decide()
    assert order == ["outer"], "a motion comes first"
    assert actor.command() == START
    actor.decide()
    assert order == ["outer", "inner", "last"]
    assert actor.is_idle


def test_the_last_command_is_repeated_once_nothing_is_left() -> None:
    actor = Actor(START, Straight(np.zeros(11), np.ones(11), 0.1))
    assert drives(actor) == [0.5, 1.0]
    assert actor.is_idle
    np.testing.assert_array_equal(actor.command().drive, np.ones(11))


@pytest.mark.parametrize("steps", [0, 1, 3])
def test_a_wait_lasts_its_steps(steps: int) -> None:
    assert len(drives(Actor(START, Wait(steps)))) == steps


def test_a_head_turns_while_its_motion_lasts() -> None:
    actor = Actor(START, Wait(1, head=np.array([0.1, 0.2])), Wait(1))
    actor.decide()
    np.testing.assert_array_equal(actor.command().head, [0.1, 0.2])
    actor.decide()
    assert actor.command().head is None


def test_a_straight_motion_lasts_as_long_as_the_slowest_joint_and_ends_at_rest() -> None:
    goal = np.zeros(11)
    goal[5] = 1.0
    seconds = straight_seconds(FETCH, np.zeros(11), goal, 0.5)
    assert seconds == pytest.approx(2 * straight_seconds(FETCH, np.zeros(11), goal, 1.0), rel=0.5)
    actor = Actor(START, Straight(np.zeros(11), goal, seconds))
    actor.decide()
    found = []
    while not actor.is_idle:
        found.append(actor.command().drive[5])
        actor.decide()
    assert len(found) == int(np.ceil(seconds / 0.05))
    speeds = np.diff([0.0, *found]) / 0.05
    assert speeds.max() <= FETCH.max_velocity[5] * 0.5 * 1.01
    assert speeds[-1] < speeds.max() / 4


def test_a_configuration_near_home_is_planned_from_as_home_whatever_turns_its_joints_have() -> None:
    home, turned = np.array(FETCH.home), np.array(FETCH.home)
    free = next(i for i, link in enumerate(FETCH.chain) if home[i] - 2 * np.pi > link.lower)
    turned[free] -= 2 * np.pi
    np.testing.assert_array_equal(home_of(FETCH, turned + 0.01), turned)
    np.testing.assert_array_equal(planned_from(FETCH, turned + 0.01), turned)
    np.testing.assert_array_equal(planned_from(FETCH, home + 0.01), home)
    away = home + 0.1
    np.testing.assert_array_equal(planned_from(FETCH, away), away)
