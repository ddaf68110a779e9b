"""Plans for an arm whose controller chooses the joints: which of several is taken, and for which goal."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import planners.following
import planners.tamp.motion_layer
from assets.robots import FETCH
from planners import (
    TOP,
    FollowingPlanner,
    GraspFamily,
    Infeasible,
    Planner,
    Region,
    RobotState,
    Scene,
    Solution,
    goals,
    tcp_pose,
)
from planners.goals import Before, Goal
from planners.motion.tcp_following import Followed
from planners.motion.trajectory import Trajectory
from tests.planners.opening.furniture import drawer_world
from tests.planners.scenes import cylinder, table_scene

SCENE = replace(
    table_scene(*(cylinder(name, -0.2, y, 0.035, 0.08) for name, y in zip("abc", (-0.3, 0, 0.3), strict=True))),
    regions=(Region("left", "table_top", (0.0, 0.15), (0.1, 0.06)),),
)
GOAL = goals.inside("a", "left") & goals.inside("b", "left")
WAITS = 5000
"""Steps, longer than any plan here."""


@dataclass
class Controller:
    """Gets stuck with one object in the gripper if that is the first of a plan, touches one more, or waits for long."""

    first: str = ""
    touched: str = ""
    slow: str = ""

    def reset(self, q: NDArray[np.float64]) -> None:
        raise AssertionError(f"`follow` is replaced: {q}")

    def step(self, T_base_tcp: NDArray[np.float64]) -> NDArray[np.float64]:
        raise AssertionError(f"`follow` is replaced: {T_base_tcp}")

    def follow(self, controller: Any, robot: Any, q: NDArray[np.float64], trajectory: Trajectory) -> Followed | None:
        assert (controller, robot) == (self, FETCH)
        held = [phase.held and phase.touched for phase in trajectory.phases]
        if np.array_equal(q, SCENE.state.q):
            self.before = ""
        names = [one.name for one in held if one]
        is_first, self.before = not self.before, self.before or next(iter(names), "")
        if names and is_first and self.first == names[0]:
            return None
        followed = as_planned(trajectory)
        if names and is_first and self.touched == names[0]:
            X, other = followed.configurations, SCENE.body("c").position
            X = np.vstack((X, np.concatenate((other[:2], X[-1, 2:]))))
            return Followed(X, np.full(len(X), 0.05), (None,) * len(X))
        if names and is_first and self.slow == names[0]:
            X = np.vstack((followed.configurations, np.tile(followed.configurations[-1], (WAITS, 1))))
            return Followed(X, np.full(len(X), 0.05), (None,) * len(X))
        return followed


def as_planned(trajectory: Trajectory) -> Followed:
    X = np.array([np.concatenate((x, q)) for x, q in zip(trajectory.base, trajectory.q, strict=True)])
    return Followed(X, np.full(len(X), 0.05), (None,) * len(X))


def replace_follow(
    monkeypatch: pytest.MonkeyPatch,
    of_plans: Callable[..., Followed | None],
    of_motions: Callable[..., Followed | None] = lambda *arguments: as_planned(arguments[-1]),
) -> None:
    monkeypatch.setattr(planners.following, "follow", of_plans)
    monkeypatch.setattr(planners.tamp.motion_layer, "follow", of_motions)


def order_of(found: Solution | Infeasible) -> list[str]:
    assert isinstance(found, Solution), found
    return [action.target for action in found.actions if action.name == "PickUp"]


@pytest.fixture
def planned() -> list[str]:
    """The order in which a `Planner` takes the objects."""
    return order_of(Planner(FETCH).solve(SCENE, GOAL))


@pytest.mark.parametrize("kind", ["first", "touched"])
def test_a_plan_that_is_not_followed_is_replaced_by_one_in_another_order(
    planned: list[str], kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    controller = Controller(**{kind: planned[0]})
    replace_follow(monkeypatch, controller.follow)
    found = FollowingPlanner(FETCH, controller=controller).solve(SCENE, GOAL)
    assert order_of(found) == planned[::-1]
    assert isinstance(found, Solution)
    assert found.goal == GOAL


def points_down(trajectory: Trajectory) -> bool:
    closing = [trajectory.sample(phase.start) for phase in trajectory.phases if phase.name == "close"]
    poses = [tcp_pose(FETCH, RobotState(sample.base, sample.q, 0.0)) for sample in closing]
    return any(T[2, 0] < -0.9 for T in poses)


def test_a_motion_that_is_not_followed_is_replaced_by_one_with_another_grasp(monkeypatch: pytest.MonkeyPatch) -> None:
    def follow(*arguments: Any) -> Followed | None:
        return None if points_down(arguments[-1]) else as_planned(arguments[-1])

    replace_follow(monkeypatch, follow, follow)
    grasps, goal = (TOP, GraspFamily("tilted", np.radians(50), depth=0.02)), goals.inside("a", "left")
    found = Planner(FETCH, grasps=grasps).solve(SCENE, goal)
    assert isinstance(found, Solution)
    assert any(points_down(action.trajectory) for action in found.actions)
    found = FollowingPlanner(FETCH, grasps=grasps, controller=Controller()).solve(SCENE, goal)
    assert isinstance(found, Solution)
    assert not any(points_down(action.trajectory) for action in found.actions)


def test_a_plan_that_takes_longer_than_there_is_time_for_is_replaced(
    planned: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    controller = Controller(slow=planned[0])
    replace_follow(monkeypatch, controller.follow)
    monkeypatch.setattr(planners.following, "_ENOUGH", 1)
    planner = FollowingPlanner(FETCH, controller=controller)
    assert order_of(planner.solve(SCENE, GOAL)) == planned
    assert order_of(replace(planner, steps_left=lambda: WAITS).solve(SCENE, GOAL)) == planned[::-1]


def test_of_plans_that_are_not_followed_the_nearest_is_taken(
    planned: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The goal leaves one order, and that gets stuck."""
    controller = Controller(first=planned[0])
    replace_follow(monkeypatch, controller.follow)
    goal = GOAL & goals.before(*planned)
    found = FollowingPlanner(FETCH, controller=controller).solve(SCENE, goal)
    assert order_of(found) == planned
    assert isinstance(found, Solution)
    assert found.goal == goal


def test_a_refusal_is_that_of_the_goal_as_it_is() -> None:
    scene: Scene = replace(SCENE, regions=(Region("left", "table_top", (0.0, 0.15), (0.03, 0.03)),))
    found = FollowingPlanner(FETCH).solve(scene, GOAL)
    assert isinstance(found, Infeasible)
    assert found.goal == GOAL
    assert not any(isinstance(fact, Before) for fact in Goal.of(found.goal).facts)
    assert found.cause == getattr(Planner(FETCH).solve(scene, GOAL), "cause", None)


def test_a_plan_that_opens_something_is_compared_too(monkeypatch: pytest.MonkeyPatch) -> None:
    replace_follow(monkeypatch, lambda *arguments: as_planned(arguments[-1]))
    scene = drawer_world().scene()
    found = FollowingPlanner(FETCH, controller=Controller()).solve(scene, goals.open_("drawer"))
    assert isinstance(found, Solution), found
    assert [action.name for action in found.actions if action.name != "MoveBase"] == ["Open"]


def test_what_an_object_is_put_on_may_be_touched_with_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever was put into a basket touched the basket, so that no plan counted as good, and a minute was spent."""

    def follow(*arguments: Any) -> Followed:
        trajectory: Trajectory = arguments[-1]
        followed, other = as_planned(trajectory), SCENE.body("c").position
        if not trajectory.phases[0].held or trajectory.phases[-1].held:  # not a put-down
            return followed
        X = np.vstack((followed.configurations, np.concatenate((other[:2], followed.configurations[-1, 2:]))))
        return Followed(X, np.full(len(X), 0.05), (None,) * len(X))

    def not_asked(*arguments: Any) -> Followed:
        raise AssertionError(f"there are good plans: {len(arguments)}")

    replace_follow(monkeypatch, follow, not_asked)
    scene = replace(SCENE, objects=tuple(one for one in SCENE.objects if one.name != "b"))
    assert order_of(FollowingPlanner(FETCH, controller=Controller()).solve(scene, goals.on("a", "c"))) == ["a"]
