"""Why a solve ends without a plan: one cause, the true one."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from assets.robots import FETCH
from planners import (
    STRATEGIES,
    Cause,
    Infeasible,
    NoPlan,
    Planner,
    Solution,
    TaskPlan,
    clearance_floor,
    lower_bound,
    solve,
)
from planners.clock import Deadline
from planners.motion.path import BlockedBy, NoPath
from planners.symbolic.astar import AStar
from planners.symbolic.problem import TaskProblem
from planners.tamp import motion_layer
from planners.tamp.attempts import best_outcome
from planners.tamp.state import Search
from tests.planners.scenes import HEIGHT, cylinder, table_scene


def test_where_no_motion_leads_to_any_grasp_the_cause_is_motion(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(motion_layer, "plan_pick", lambda *_, **__: NoPath("no way"))
    found = solve(table_scene(cylinder("object_00", 0.3, 0.45)), "object_00", "ngr")
    assert isinstance(found, Infeasible)
    assert found.cause is Cause.MOTION
    assert "object_00" in found.detail


@pytest.mark.parametrize(("tilt", "leans"), [(0.1, False), (0.6, True), (1.5, False), (2.4, True), (3.1, False)])
def test_a_refusal_says_what_leans(tilt: float, leans: bool) -> None:
    body = cylinder("b", -0.1, 0.0)
    turned = body.at(body.position, [math.cos(tilt / 2), math.sin(tilt / 2), 0.0, 0.0])
    found = solve(table_scene(cylinder("far", 0.0, 0.0).at([0.0, 0.0, 3.0]), turned), "far")
    assert isinstance(found, Infeasible)
    assert found.detail.endswith("neither upright nor lying: b") == leans


@pytest.mark.parametrize("tilt", [0.0, 0.08])
def test_what_presses_into_its_support_is_taken_all_the_same(tilt: float) -> None:
    """It was refused as if the table were in the way of its lift."""
    body = cylinder("b", -0.1, 0.0)
    aslant = body.at(body.position, [math.cos(tilt / 2), math.sin(tilt / 2), 0.0, 0.0])
    sunk = aslant.at(aslant.position + [0.0, 0.0, HEIGHT - 0.0014 - aslant.bottom])
    assert isinstance(solve(table_scene(sunk), "b"), Solution)


def test_the_bound_of_what_presses_into_its_support_is_that_of_the_plan() -> None:
    """It was "unreachable", with a proof, beside a plan: the gripper was taken to touch the table."""
    scene = table_scene(cylinder("b", -0.1, 0.0, 0.01, 0.012).at([-0.1, 0.0, HEIGHT + 0.003]))
    found = solve(scene, "b")
    assert isinstance(found, Solution)
    assert lower_bound(scene, "b") == found.bound
    assert clearance_floor(scene, "b").count == 0


def refusal(cause: Cause) -> Infeasible:
    return Infeasible(cause, f"evidence of {cause}", target="object_00")


@pytest.mark.parametrize(
    ("causes", "is_proved", "is_late", "expected"),
    [
        ([Cause.NO_CLEARANCE_LOCATION], False, True, Cause.TIME_LIMIT),
        ([Cause.NO_CLEARANCE_LOCATION, Cause.TIME_LIMIT], True, True, Cause.TIME_LIMIT),
        ([Cause.NO_CLEARANCE_LOCATION, Cause.MOTION], False, False, Cause.MOTION),
        ([Cause.UNREACHABLE], True, True, Cause.UNREACHABLE),
        ([Cause.UNREACHABLE, Cause.NO_CLEARANCE_LOCATION], False, False, Cause.NO_CLEARANCE_LOCATION),
    ],
)
def test_a_refusal_that_is_not_proved_is_the_time_limits_once_the_time_is_up(
    causes: list[Cause], is_proved: bool, is_late: bool, expected: Cause
) -> None:
    """9 of 12 refusals for want of a location had used up their time. The fourth is proved by the grasps alone."""
    found = best_outcome([refusal(cause) for cause in causes], is_proved, Deadline(0.0 if is_late else math.inf))
    assert isinstance(found, Infeasible)
    assert found.cause is expected
    assert f"evidence of {causes[0]}" in found.detail or not is_late


class GetsStuck:
    """Says at every second call that objects wait for one another."""

    def __init__(self) -> None:
        self.calls = 0

    def plan(self, problem: TaskProblem, time_limit: float) -> TaskPlan | NoPlan:
        self.calls += 1
        return AStar().plan(problem, time_limit) if self.calls % 2 else NoPlan("cyclic", (problem.target,))


def test_after_a_refuted_motion_the_grasps_alone_are_not_the_cause(monkeypatch: pytest.MonkeyPatch) -> None:
    """The floor was 1 or more there, so a self-clearable set exists."""
    monkeypatch.setattr(motion_layer, "plan_pick", lambda *_, **__: BlockedBy(frozenset({"object_01"}), "grasp"))
    forgets = property(lambda _: {}, lambda _, __: None)  # or the engine would not be asked the same twice
    monkeypatch.setattr(Search, "answers", forgets, raising=False)
    scene = table_scene(cylinder("object_00", 0.0, 0.0), cylinder("object_01", 0.0, 0.3))
    found = Planner(FETCH, engine=GetsStuck()).solve(scene, "object_00", "ngr")
    assert isinstance(found, Infeasible)
    assert found.cause is Cause.MOTION


class StuckFollower:
    """A model of a controller whose arm does not move."""

    def __init__(self) -> None:
        self._q = np.array(FETCH.home)

    def reset(self, q: np.ndarray) -> None:
        self._q = q

    def step(self, T_base_tcp: np.ndarray) -> np.ndarray:  # noqa: ARG002  it ignores what it is told
        return self._q


@pytest.mark.slow
def test_a_robot_that_cannot_follow_any_motion_is_told_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Planner, "_exercise", lambda *_: None)  # with this follower it would try everything
    scene = table_scene(cylinder("wanted", -0.2, 0.0))
    once = replace(STRATEGIES["ngr"], attempts=1)
    found = Planner(FETCH, follower=StuckFollower(), grasps="side").solve(scene, "wanted", once)
    assert isinstance(found, Infeasible)
    assert found.cause is Cause.MOTION
    assert "the TCP cannot follow the trajectory" in found.detail
