"""Random scenes and random goals: the judgement of `planners.goals` against a second judge, and refusals."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import gymnasium
import numpy as np
import pytest

import clutter_env  # noqa: F401  registers the environments
from planners import Body, ExpertConfig, Infeasible, Scene, Solution, TampExpert, goals, lower_bound, solve
from planners.goals import Goal, GoalError, Region
from planners.scene import HeldObject, StaticObstacle
from tests.planners.goal_judge import margin
from tests.planners.scenes import DEPTH, HEIGHT, SHELF, WIDTH, cylinder, random_scene, table_scene

THIN = 0.003
"""[m] of a tray on the table: less than what counts as resting on the table below it."""


def messy_scene(rng: np.random.Generator) -> Scene:
    """Cylinders and boxes on the table, on a thin tray, on each other, a little in the air or aslant, one held."""
    tray = StaticObstacle("tray", np.array([0.1, 0.1, HEIGHT + THIN / 2]), np.array([0.1, 0.1, THIN / 2]))
    scene = table_scene(*(cylinder(name, 0.0, 0.0, 0.03, 0.1) for name in "abcd"))
    regions = (
        Region("left", "table_top", (-0.1, 0.15), (0.08, 0.06), rng.uniform(-2, 2)),
        Region("small", "tray", (0.1, 0.1), (0.031, 0.031)),
    )
    scene = replace(
        scene,
        static_obstacles=(*scene.static_obstacles, tray),
        supports=("table_top", "tray", "counter_left"),
        regions=regions,
    )
    for name in "abcd":
        scene = scene.with_body(messy_body(rng, scene, name))
    if rng.random() < 0.3:
        scene = scene.with_held(HeldObject(str(rng.choice(list("abcd"))), np.eye(4)))
    return scene


def messy_body(rng: np.random.Generator, scene: Scene, name: str) -> Body:
    half = np.array([rng.uniform(0.02, 0.04)] * 2 + [rng.uniform(0.02, 0.08)])
    shape = "cylinder" if rng.random() < 0.5 else "box"
    yaw, tilt, about = rng.uniform(-3, 3), rng.choice([0.0, rng.uniform(0, 0.3), math.pi / 2], p=(0.6, 0.3, 0.1)), 0.0
    turned = (math.cos(yaw / 2), 0.0, 0.0, math.sin(yaw / 2))
    leant = (math.cos(tilt / 2), math.sin(tilt / 2), 0.0, 0.0)
    w, z, cosine, sine = turned[0], turned[3], leant[0], leant[1]
    quaternion = np.array([w * cosine, w * sine, z * sine, z * cosine])
    below = rng.choice(["table_top", "tray", *(one.name for one in scene.objects if one.name < name)])
    if below in scene.names:
        x, y, level = *scene.body(below).position[:2] + rng.uniform(-0.05, 0.05, 2), scene.body(below).top
    else:
        face = scene.support_named(str(below))
        x, y, level = *face.position[:2] + rng.uniform(-1.1, 1.1, 2) * np.minimum(face.extent[:2], 0.25), face.top
    body = Body(name, shape, half, np.array([x, y, 1.0]), quaternion)
    level += about + rng.choice([0.0, 0.0, 0.1, rng.uniform(-0.008, 0.008)])
    return body.at(body.position + [0.0, 0.0, level - body.bottom])


def random_goal(rng: np.random.Generator, scene: Scene) -> Goal:
    """A fact about objects and places that are there."""
    name, other = rng.choice(list("abcd"), 2, replace=False)
    body = scene.body(str(name))
    place = str(rng.choice(["table_top", "tray", "left", "small", str(other)]))
    area = str(rng.choice(["table_top", "tray", "left", "small"]))
    table = np.array((DEPTH / 2, WIDTH / 2))  # no goal means a place off all supports
    pose = (*np.clip(body.position[:2] + rng.normal(0, 0.015, 2), -table, table), body.yaw + rng.normal(0, 0.1))
    z = None if rng.random() < 0.5 else float(body.position[2] + rng.normal(0, 0.015))
    facts = [
        goals.on(str(name), place),
        goals.inside(str(name), area),
        goals.holding(str(name)),
        goals.clear(area),
        Goal((goals.At(str(name), *map(float, pose), z),)),
    ]
    return facts[rng.integers(len(facts))]


@pytest.mark.parametrize("scenes", [25, pytest.param(500, marks=pytest.mark.slow)])
def test_a_second_judge_agrees(scenes: int) -> None:
    rng = np.random.default_rng(0)
    decided = np.zeros(2, int)
    for _ in range(scenes):
        scene = messy_scene(rng)
        start = scene if rng.random() < 0.5 else messy_scene(rng)
        start = replace(start, regions=scene.regions, held=None)
        for _ in range(4):
            goal = random_goal(rng, scene)
            away = margin(goal, scene, start)
            if abs(away) > 0.001:
                assert goal.holds(scene, start) == (away > 0), (goal, away, scene.objects)
                decided[int(away > 0)] += 1
    assert decided.min() > scenes / 3


WORDS = ("(", ")", "and", "on", "at", "clear", "before", "a", "(x 0.5)", "(y 0.2)", "(z nan)", "(x", "1e999", ";", "é")
FACTS = ("(on a tray)", "(holding b)", '(on "my cup" a)', "(before a b)", "(at a (x 1) (y 0))", '"', "\n", "()")


def test_any_text_is_a_goal_or_refused_in_linear_time() -> None:
    rng = np.random.default_rng(0)
    read = 0
    for draw in range(3000):
        text = " ".join(rng.choice((*WORDS, *FACTS), rng.integers(0, 8)))
        try:
            goal = Goal.from_pddl(f"(and {text})" if draw % 2 else text)
        except GoalError:
            continue
        read += 1
        assert Goal.from_pddl(goal.to_pddl()) == goal
    assert read > 30
    for text in ("(" * 100_000, "(and " * 3000 + ")" * 3000, ")" * 1000, '"' * 999):
        with pytest.raises(GoalError):
            Goal.from_pddl(text)
    assert len(Goal.from_pddl(f"(and {'(on a b) ' * 20_000})").facts) == 1


@pytest.mark.parametrize(
    "make",
    [
        lambda: goals.At("a", math.nan, 0.0),
        lambda: goals.at("a", (0, 0), tolerance=-1.0),
        lambda: goals.at("a", (0, 0), yaw_tolerance=math.inf),
        lambda: goals.at("a", "xy"),
        lambda: goals.holding(""),
        lambda: goals.holding(3),
        lambda: goals.on("a", None),
        lambda: goals.on(["a"], "b"),
        lambda: goals.on('a"', "b"),
        lambda: goals.and_(),
        lambda: goals.and_(3),
        lambda: Goal(None),
        lambda: Goal.from_pddl(3),
        lambda: Goal.from_pddl("(at a (x 1) (x 2) (y 0))"),
        lambda: Region("r", "table_top", (0,), (1, 1)),
        lambda: Region("r", "table_top", (0, 0), ("a", 1)),
        lambda: Region("r", "table_top", (0, 0), (1, 1), None),
        lambda: Region(3, "table_top", (0, 0), (1, 1)),
    ],
)
def test_what_is_no_goal_is_an_error_of_goals(make: Callable[[], object]) -> None:
    with pytest.raises(GoalError):
        make()


def test_names_with_blanks_and_numbers_of_numpy_are_kept_in_text() -> None:
    goal = goals.on("my cup", "a (new) plate") & Goal((goals.At("b;", *np.array([0.1, 0.2])),))
    assert Goal.from_pddl(goal.to_pddl()) == goal


def places(rng: np.random.Generator, scene: Scene) -> Scene:
    """The scene under a shelf, with regions, turned ones too, on the table, on the shelf and on a counter."""
    scene = replace(scene, static_obstacles=(*scene.static_obstacles, *SHELF))
    supports = "table_top", "shelf_board", "counter_left"
    found = []
    for name in supports:
        face, half = scene.support_named(name), rng.uniform(0.04, 0.15, 2)
        middle = face.position[:2] + 0.9 * rng.uniform(-1, 1, 2) * (face.extent[:2] - half)
        found.append(Region(f"on_{name}", name, tuple(middle), tuple(half), rng.choice([0.0, rng.uniform(-1, 1)])))
    return replace(scene, supports=supports, regions=tuple(found))


def random_wish(rng: np.random.Generator, scene: Scene) -> Goal:
    """One to three facts that may contradict each other, hold already, or be out of reach."""
    facts: list[Goal] = []
    for kind in rng.choice(9, rng.integers(1, 4)):
        name, other = map(str, rng.choice(scene.names, 2, replace=False))
        region, support = str(rng.choice([one.name for one in scene.regions])), str(rng.choice(scene.supports))
        face = scene.support_named(support)
        place = face.position[:2] + rng.uniform(-0.7, 0.7, 2) * face.extent[:2]
        facts.append(
            (
                goals.on(name, support),
                goals.inside(name, region),
                goals.clear(region),
                goals.at(name, [*place, rng.uniform(-3, 3)]),
                goals.at(name, place),
                goals.on(name, other),
                goals.holding(name),
                goals.before(name, other),
                goals.inside(name, support),
            )[kind]
        )
    return goals.and_(*facts)


@pytest.mark.slow
def test_what_solve_and_bound_say_of_any_goal_agrees() -> None:
    rng, answers = np.random.default_rng(0), set()
    for wish in range(60):
        scene = places(rng, random_scene(int(rng.integers(3, 7)), int(rng.integers(1000))))
        goal = random_wish(rng, scene)
        try:
            goal.check(scene)
        except GoalError:
            for ask in (solve, lower_bound):
                with pytest.raises(GoalError):
                    ask(scene, goal)
            continue
        bound, plan = lower_bound(scene, goal), solve(scene, goal, time_limit=60)
        answers.add(type(plan))
        if isinstance(plan, Infeasible):
            assert plan.detail, goal
            assert not goal.holds(scene), goal
            continue
        assert isinstance(plan, Solution)
        assert plan.end is not None
        assert goal.holds(plan.end, scene), goal
        assert bound.picks is not None, goal
        assert bound.least <= plan.picks, goal
        assert goal.is_in_order([action.target for action in plan.actions if action.name == "PickUp"]), goal
        assert bool(plan.actions) != goal.holds(scene), goal
        if wish % 5 == 0:
            again = solve(scene, goal.to_pddl(), time_limit=60)
            assert isinstance(again, Solution)
            assert again.actions == plan.actions
    assert Solution in answers


@pytest.mark.slow
@pytest.mark.parametrize("first", range(0, 40, 10))
def test_the_expert_plans_for_any_goal_or_says_why_not(first: int) -> None:
    """Tasks and layouts in turn, a quarter of the scenes with an object that lies."""
    settings = [("sort", "trays"), ("stack", "paper"), ("fetch", "two_tables"), ("set", "shelf"), ("swap", "cabinet")]
    for seed in range(first, first + 10):
        rng, (task, layout) = np.random.default_rng(seed), settings[seed % len(settings)]
        env = gymnasium.make("clutter_env/Rearrange-o4-v0", task=task, layout=layout)
        env.reset(seed=seed)
        inner: Any = env.unwrapped
        if seed % 4 == 0:
            inner.data.joint("object_00_joint").qpos[3:] = math.sqrt(0.5), math.sqrt(0.5), 0.0, 0.0
        expert = TampExpert(env, config=ExpertConfig(planning_s=20.0))
        scene = Scene.from_mujoco(inner.model, inner.data, inner.robot)
        regions = [
            Region("here", scene.supports[0], tuple(rng.uniform(-0.2, 0.2, 2)), tuple(rng.uniform(0.04, 0.15, 2)))
        ]
        goal = random_wish(rng, replace(scene, regions=(*(inner.regions or regions),)))
        try:
            expert.reset(goal)
        except GoalError:
            continue
        report = expert.report
        assert report.planned == isinstance(expert.solution, Solution), goal
        if not report.planned:
            assert expert.done
            assert ": " in report.failure, goal
            if isinstance(expert.solution, Infeasible):
                assert expert.solution.detail in report.failure, goal
        env.close()
