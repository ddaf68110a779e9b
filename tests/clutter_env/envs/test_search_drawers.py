"""The search expert where something opens: what is opened, what moves with it, and what is shut again."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

import clutter_env  # noqa: F401  registers the environments
from planners import SearchExpert, goals
from planners.cause import Cause
from planners.scene import StaticObstacle
from planners.search.options import Disclosure, Viewpoint, disclosures
from planners.search.perception import Seen
from planners.search.sensing import BelievedSensor
from planners.strategies import STRATEGIES
from planners.tamp.solution import Infeasible, Solution, SolveStats
from tests.planners.scenes import cylinder

DRAWERS = ("left_drawer", "middle_drawer", "right_drawer")
_SEEN = ("robot", "tcp", "gripper", "head", "target", "joints") + tuple(
    f"head_{kind}" for kind in ("rgb", "depth", "segmentation", "K", "T_base_camera")
)


def begun(layout: str = "drawers") -> tuple[SearchExpert, dict[str, Any]]:
    """An expert before its first action, and the first observation."""
    env = gym.make("clutter_env/Search-o5-v0", layout=layout, image_size=32)
    expert = SearchExpert(env)
    observation, _ = env.reset(seed=1)
    expert.reset(observation)
    return expert, observation


def with_joints(observation: dict[str, Any], *positions: float) -> dict[str, Any]:
    """The observation with other positions of what opens."""
    joints = observation["joints"].copy()
    joints[::6] = positions
    return {**observation, "joints": joints}


def knows(expert: SearchExpert, **places: tuple[float, float]) -> None:
    """Let an expert know objects at x, y in drawers."""
    bodies = [cylinder(name, *place, radius=0.03, height=0.1) for name, place in places.items()]
    bodies = [body.at((*body.position[:2], 0.78 + 0.05)) for body in bodies]
    expert._knowledge.objects = tuple(Seen(body, body.position[None], np.zeros(3), 0.0) for body in bodies)


def nothing_is_left_in(expert: SearchExpert, *drawers: str) -> None:
    """Let an expert have looked into drawers."""
    for name in drawers:
        expert._knowledge.belief._levels[f"{name}_floor"].is_possible[:] = False


def test_with_a_drawer_all_moves_that_stands_in_it_and_what_is_known_of_the_rest() -> None:
    expert, observation = begun()
    known = expert._knowledge
    knows(expert, seen_00=(-0.08, 0.5), seen_01=(-0.08, 0.0))
    before = {name: known.belief.grid(name) for name in known.empty.supports}
    known.observe(with_joints(observation, 0.2, 0.0, 0.0))
    known.look()
    assert [one.body.position[0] for one in known.objects] == pytest.approx([-0.28, -0.08])
    assert known.objects[0].points[0, 0] == pytest.approx(-0.28)
    for name in known.empty.supports:
        by = -0.2 if name == "left_drawer_floor" else 0.0
        assert known.belief.grid(name).x0 - before[name].x0 == pytest.approx(by)
        support = known.empty.support_named(name)
        assert support.lower[0] == pytest.approx(known.belief.grid(name).x0)
        assert any(one is support for one in known.supports)
    assert known.empty.opening("left_drawer").position == pytest.approx(0.2)
    assert expert._knowledge.scene().opening("left_drawer").share == pytest.approx(2 / 3)


def test_what_rides_in_a_drawer_has_not_been_carried_by_the_gripper() -> None:
    """It was put down afresh, on the highest support under it, and the cells around it counted as unseen."""
    expert, observation = begun()
    known = expert._knowledge
    knows(expert, seen_00=(-0.08, 0.5), seen_01=(-0.08, 0.0))
    bodies = tuple(one.body for one in known.objects)
    sensor = BelievedSensor(bodies, known.reading, known.robot, None, known.empty)
    assert sensor.read().openings == dict.fromkeys(DRAWERS, 0.0)
    known.observe(with_joints(observation, 0.0, 0.25, 0.0))
    sensor.update(known.reading)
    assert sensor.read().positions[:, 0] == pytest.approx([-0.08, -0.33])
    assert sensor.read().openings["middle_drawer"] == pytest.approx(0.25)
    for level in known.belief._levels.values():
        level.is_unseen[:] = False
    known.settle(sensor)
    assert not any(level.is_unseen.any() for level in known.belief._levels.values())
    assert [one.body.position[0] for one in known.objects] == pytest.approx([-0.08, -0.33])


def disclosed(expert: SearchExpert) -> dict[str, Disclosure]:
    """What can be opened, by name."""
    known, decisions = expert._knowledge, expert._decisions
    found = disclosures(known.scene(), known.belief, known.places(), *decisions._camera, seconds=lambda _: 5.0)
    return {one.name: one for one in found if not one.shut}


def test_each_drawer_reveals_its_share_and_one_that_has_been_looked_into_nothing() -> None:
    expert, _ = begun()
    for name in ("chest_top", "counter_left", "counter_right"):
        expert._knowledge.belief._levels[name].is_possible[:] = False
    found = disclosed(expert)
    assert sorted(found) == sorted(DRAWERS)
    for one in found.values():
        assert 0.25 < one.view.gain <= 1 / 3 + 1e-9
        assert one.shut == ()
    nothing_is_left_in(expert, "left_drawer")
    found = disclosed(expert)
    assert sorted(found) == ["middle_drawer", "right_drawer"]
    assert all(0.4 < one.view.gain <= 0.5 + 1e-9 for one in found.values())


@pytest.mark.parametrize("layout", ["cupboard", "fridge"])
def test_a_door_reveals_what_is_behind_it(layout: str) -> None:
    expert, _ = begun(layout)
    for name in ("counter_left", "counter_right"):
        expert._knowledge.belief._levels[name].is_possible[:] = False
    found = disclosed(expert)
    assert list(found) == ["door"]
    assert found["door"].view.gain > 0.5


def test_what_opens_is_chosen_by_what_it_reveals_per_second() -> None:
    expert, _ = begun()
    decisions, known = expert._decisions, expert._knowledge
    for name in ("chest_top", "counter_left", "counter_right"):
        known.belief._levels[name].is_possible[:] = False
    nothing_is_left_in(expert, "left_drawer", "middle_drawer")
    view, names, opening = decisions.ranked(known.places(), "")
    assert (view, names) == (None, [])
    assert opening is not None
    assert opening.name == "right_drawer"
    assert decisions.ranked(known.places(), "seen_00")[2] is None, "the planner opens what it needs for the target"
    decisions._refused.add("right_drawer")
    assert decisions.ranked(known.places(), "")[2] is None
    decisions.start_over()
    assert decisions.ranked(known.places(), "")[2] is not None
    decisions._pulled["right_drawer"] = 3
    assert decisions.ranked(known.places(), "")[2] is None, "what jams is not tried for ever"
    assert decisions.unopened == ["right_drawer"]


def planned(scene: Any, goal: goals.Goal) -> Solution:
    """A plan without motions."""
    action: Any = SimpleNamespace(goal=goal, scene=scene)
    return Solution((action,), (), SolveStats(), "", STRATEGIES["lookahead"])


def test_an_empty_drawer_is_shut_where_it_is_in_the_way_of_another_one() -> None:
    expert, observation = begun()
    known, decisions = expert._knowledge, expert._decisions
    known.observe(with_joints(observation, 0.29, 0.0, 0.0))
    known.look()
    nothing_is_left_in(expert, "left_drawer")
    wanted = Disclosure("middle_drawer", (), Viewpoint(np.zeros(3), 0.1, np.zeros(3), gain=0.5))

    def solved(scene: Any, goal: goals.Goal) -> Any:
        (fact,) = goal.openings
        is_free = scene.opening("left_drawer").share < 0.05 or fact.opening == "left_drawer"
        return planned(scene, goal) if is_free else Infeasible(Cause.MOTION, "")

    decisions.solved = solved  # type: ignore[method-assign]  # a planner in whose world one drawer blocks the next
    found = decisions.plan_opening(wanted, known.places())
    assert found is not None
    assert found[:2] == ("shut", "left_drawer")
    known.observe(with_joints(observation, 0.0, 0.0, 0.0))
    known.look()
    found = decisions.plan_opening(wanted, known.places())
    assert found is not None
    assert found[:2] == ("open", "middle_drawer")
    decisions.solved = lambda *_: Infeasible(Cause.UNREACHABLE, "")  # type: ignore[method-assign]  # refuses all
    assert decisions.plan_opening(wanted, known.places()) is None
    assert decisions.unopened == ["middle_drawer"]
    assert decisions.refusals["middle_drawer"] == Cause.UNREACHABLE


def test_a_drawer_that_hides_what_is_in_another_one_is_shut_before_that_is_opened() -> None:
    """One above the other: what stands out of the upper one, a plate here, hides the lower one."""
    expert, observation = begun()
    known, decisions = expert._knowledge, expert._decisions
    left = known.empty.opening("left_drawer")
    lid = StaticObstacle("lid", np.array((-0.05, 0.0, 0.96)), np.array((0.3, 0.4, 0.005)))
    openings = (replace(left, parts=(*left.parts, "lid")), *known.empty.openings[1:])
    known.empty = replace(known.empty, static_obstacles=(*known.empty.static_obstacles, lid), openings=openings)
    known.observe(with_joints(observation, 0.29, 0.0, 0.0))
    known.look()
    for level in known.belief._levels.values():
        level.is_possible[:] = False
    known.belief._levels["middle_drawer_floor"].is_possible[:] = True
    opening = decisions.ranked(known.places(), "")[2]
    assert opening is not None
    assert (opening.name, opening.shut) == ("middle_drawer", ("left_drawer",))
    decisions.solved = planned  # type: ignore[method-assign]  # all can be done
    found = decisions.plan_opening(opening, known.places())
    assert found is not None
    assert found[:2] == ("shut", "left_drawer")


def test_drawers_that_are_shut_are_not_looked_at() -> None:
    expert, observation = begun()
    known = expert._knowledge
    assert [one.name for one in known.shown] == ["counter_left", "counter_right", "chest_top"]
    known.observe(with_joints(observation, 0.0, 0.0, 0.28))
    known.look()
    assert "right_drawer_floor" in [one.name for one in known.shown]


def test_a_drawer_that_stops_twice_in_the_same_place_ends_there() -> None:
    """It was pulled again until the time was up."""
    expert, observation = begun()
    known = expert._knowledge
    known.observe(with_joints(observation, 0.1, 0.0, 0.0))
    known.opened_in_part("left_drawer", 0.1)
    assert known.empty.opening("left_drawer").share == pytest.approx(1 / 3)
    known.opened_in_part("left_drawer", 0.1)
    assert known.scene().opening("left_drawer").share == pytest.approx(1.0)
    known.observe(with_joints(observation, 0.05, 0.0, 0.0))
    known.look()
    assert known.scene().opening("left_drawer").share == pytest.approx(0.5)


def searched(seed: int, colour: tuple[float, ...] = (), layout: str = "drawers") -> tuple[SearchExpert, dict[str, Any]]:
    """An episode in which the expert gets observations and five names of the environment."""
    env = gym.make("clutter_env/Search-o5-v0", layout=layout, frame_every=10)
    observation, info = env.reset(seed=seed)
    inner: Any = env.unwrapped
    names = ("robot", "workplace", "support_name", "control_mode", "joint_action")
    expert, is_over = SearchExpert(SimpleNamespace(**{name: getattr(inner, name) for name in names})), False
    while not is_over:
        given = {name: np.array(observation[name]) for name in _SEEN}
        given["target"][:3] = colour or given["target"][:3]
        if expert._actor is None:
            expert.reset(given)
        observation, _, terminated, truncated, info = env.step(expert.act(given))
        is_over = truncated or (terminated and not colour) or expert.done
    return expert, info


@pytest.mark.slow
@pytest.mark.parametrize("seed", [2, 3, 13])
def test_it_opens_drawers_until_it_sees_the_target_and_takes_it(seed: int) -> None:
    expert, info = searched(seed)
    assert info["is_success"]
    assert len(expert.report.openings) == len(set(expert.report.openings)) == info["num_opened"]


@pytest.mark.slow
def test_it_says_that_an_absent_target_is_in_no_drawer() -> None:
    """From farther away than under their fronts, places right behind these stayed hidden."""
    expert, info = searched(1, (0.5, 0.5, 0.5))
    assert expert.report.failure == "cannot be found"
    assert info["num_opened"] == 3
    assert (info["num_fallen"], info["num_disturbed"]) == (0, 0)


@pytest.mark.slow
def test_behind_a_door_too() -> None:
    expert, info = searched(2, layout="cupboard")
    assert info["is_success"]
    assert expert.report.openings == ["door"]
