"""Goals: facts of a scene's geometry, and the same as text."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import permutations

import numpy as np
import pytest

from planners import Body, GoalError, HeldObject, Region, Scene, SceneError, StaticObstacle, goals
from planners.goals import Goal
from planners.regions import footprint, overlap
from tests.planners.pieces import cut_in_two, mug
from tests.planners.scenes import DEPTH, HEIGHT, WIDTH, cylinder, table_scene

LEFT = Region("left", "table_top", (0.0, 0.2), (0.10, 0.06), math.pi / 6)
RIGHT = Region("right", "table_top", (0.0, -0.2), (0.10, 0.06))


def scene_with(*bodies: Body) -> Scene:
    tray = StaticObstacle("tray", np.array([0.3, 0.0, HEIGHT + 0.005]), np.array([0.12, 0.1, 0.005]))
    scene = table_scene(*bodies)
    return replace(
        scene,
        static_obstacles=(*scene.static_obstacles, tray),
        supports=(*scene.supports, "tray"),
        regions=(LEFT, RIGHT, Region("beside", "table_top", (2.0, 0.0), (0.1, 0.1))),
    )


@pytest.fixture
def scene() -> Scene:
    return scene_with(cylinder("a", 0.0, 0.2), cylinder("b", 0.0, -0.2), cylinder("c", -0.3, 0.0))


def raised(scene: Scene, name: str, height: float) -> Scene:
    body = scene.body(name)
    scene = scene.with_body(body.at(body.position + [0.0, 0.0, height]))
    return scene.with_held(HeldObject(name, np.eye(4)))


def on_top(scene: Scene, name: str, level: float, x: float, y: float) -> Scene:
    body = scene.body(name)
    return scene.with_body(body.at([x, y, level + body.half_extents[2]]))


@pytest.mark.parametrize(
    ("goal", "unmet"),
    [
        (goals.inside("a", "left"), 0),
        (goals.on("a", "left"), 0),
        (goals.inside("a", "right"), 1),
        (goals.on("a", "table_top"), 0),
        (goals.inside("c", "table_top"), 0),
        (goals.on("a", "tray"), 1),
        (goals.on("a", "b"), 1),
        (goals.at("a", (0.01, 0.2)), 0),
        (goals.at("a", (0.0, 0.2, 1.0)), 0),  # a cylinder: turning it changes nothing
        (goals.at("a", (0.03, 0.2)), 1),
        (goals.clear("left"), 1),
        (goals.clear("tray"), 0),
        (goals.holding("a"), 1),
        (goals.before("a", "b"), 0),
        (goals.inside("a", "left") & goals.inside("b", "left") & goals.holding("c"), 2),
    ],
)
def test_facts_of_a_scene(scene: Scene, goal: Goal, unmet: int) -> None:
    assert len(goal.unmet(scene)) == unmet
    assert goal.holds(scene) == (unmet == 0)


def test_an_object_over_the_edge_of_a_region_is_not_inside(scene: Scene) -> None:
    inside, clear = goals.inside("a", "right"), goals.clear("right")
    for y, is_inside, is_clear in ((-0.2, True, False), (-0.15, False, False), (-0.09, False, True)):
        moved = on_top(scene.with_body(scene.body("b").at([0.4, 0.3, 1.0])), "a", HEIGHT, 0.0, y)
        assert inside.holds(moved) == is_inside
        assert clear.holds(moved) == is_clear


def test_facts_of_an_object_of_pieces_are_those_of_the_box_that_it_was_cut_from() -> None:
    rng, seen = np.random.default_rng(0), set()
    for _ in range(60):
        x, y, turn = rng.uniform(-0.4, 0.4), rng.uniform(-0.5, 0.5), rng.uniform(-3, 3)
        over = np.clip((x, y), (-DEPTH / 2, -WIDTH / 2), (DEPTH / 2, WIDTH / 2))
        quaternion = np.array((math.cos(turn / 2), 0.0, 0.0, math.sin(turn / 2)))
        whole = Body("a", "box", np.array((0.06, 0.03, 0.05)), np.array((x, y, HEIGHT + 0.05)), quaternion)
        below = replace(whole, name="b", position=whole.position - [0.0, 0.05, 0.1])
        asked = [
            goals.on("a", "table_top"), goals.inside("a", "left"), goals.inside("a", "table_top"), goals.clear("left"),
            goals.at("a", (*over, turn)), goals.at("a", (*over, 0.1)), goals.on("a", "b"), goals.on("a", "left"),
        ]  # fmt: skip
        scenes = [scene_with(one, other) for one, other in ((whole, below), (cut_in_two(whole), cut_in_two(below)))]
        facts = [tuple(goal.holds(scene) for goal in asked) for scene in scenes]
        assert facts[0] == facts[1]
        seen.add(facts[0])
    assert len(seen) >= 5


def test_the_footprint_of_pieces_is_their_convex_hull() -> None:
    body = mug(position=(0.1, 0.2, HEIGHT))
    handle, rim = body.position[:2] + (body.half_extents[0], 0.0), body.position[:2] + (0.02, 0.02)
    for point, inside in ((handle, True), (rim, True), (handle + (0.0, 0.02), False)):
        assert (overlap(footprint(body), point[None]) >= 0) == inside
    inner = footprint(body, -0.01)
    assert overlap(footprint(body), inner) > 0.05
    away = [np.linalg.norm(points - body.position[:2], axis=1) for points in (footprint(body), inner)]
    assert np.allclose(away[0] - away[1], 0.01)


def test_stacked_objects_rest_on_each_other(scene: Scene) -> None:
    stacked = on_top(scene, "a", scene.body("b").top, 0.0, -0.2)
    assert goals.on("a", "b").holds(stacked)
    assert not goals.on("b", "a").holds(stacked)
    assert goals.at("a", (0.0, -0.2)).holds(stacked)
    assert not goals.on("a", "table_top").holds(stacked)
    cleared = stacked.with_body(stacked.body("b").at([0.4, 0.3, 2.0]))
    assert goals.clear("right").holds(cleared)  # what hangs in the air stands nowhere
    assert not goals.on("a", "b").holds(on_top(scene, "a", scene.body("b").top, 0.0, -0.1))


def test_held_is_high_above_where_it_stood(scene: Scene) -> None:
    goal = goals.holding("a")
    assert goal.holds(raised(scene, "a", 0.10), scene)
    assert not goal.holds(raised(scene, "a", 0.08), scene)
    high = on_top(scene, "a", HEIGHT + 0.4, 0.0, 0.2)
    assert not goal.holds(raised(high, "a", 0.05), high)
    assert goal.holds(raised(high, "a", 0.05))  # without its start, by what is below it


def test_a_toppled_object_rests_nowhere(scene: Scene) -> None:
    body = scene.body("a")
    lying = body.at([0.0, 0.2, HEIGHT + body.half_extents[0]], [math.sqrt(0.5), math.sqrt(0.5), 0.0, 0.0])
    toppled = scene.with_body(lying)
    assert not goals.on("a", "table_top").holds(toppled)
    assert goals.on("a", "table_top").holds(toppled, toppled)  # it lay already


def test_a_list_of_facts_is_a_goal_as_task_files_write_it() -> None:
    assert Goal.of([["on", "a", "tray"], ["holding", "b"]]) == Goal.from_pddl("(and (on a tray) (holding b))")
    at = goals.at("a", (0.5, -1.0))
    assert Goal.of([["at", "a", ["x", 0.5], ["y", "-1"]]]) == at
    for wrong in ([["balanced", "a", "5"]], [None], [0], [[]], [["on", "a", None]], [["at", "a", ["x", [0.5]]]]):
        with pytest.raises(GoalError, match=r"is no fact|each once"):
            Goal.of(wrong)  # type: ignore[arg-type]  # on purpose


def test_text_and_back_again() -> None:
    goal = goals.and_(
        goals.on("a", "tray"),
        goals.inside("b", "left"),
        goals.at("c", (0.1, -0.2, 0.3), 0.01),
        goals.at("d", np.eye(4)),
        goals.clear("right"),
        goals.before("a", "b"),
        goals.holding("e"),
    )
    assert Goal.from_pddl(goal.to_pddl()) == goal
    for one in goal.facts:
        assert Goal.from_pddl(Goal((one,)).to_pddl()) == Goal((one,))
    assert Goal.of("(and (on object_1 tray) (holding object_2))") == goals.on("object_1", "tray") & goals.holding(
        "object_2"
    )
    assert Goal.of("object_2") == goals.holding("object_2")
    assert Goal.of("object_2").target == "object_2"
    assert goal.target == ""


@pytest.mark.parametrize(
    "text",
    [
        "(AND (On a tray) (HOLDING b))",
        "(and (and (on a tray)) (and (and (holding b))))",
        "(:goal (and (on a tray) (holding b)))",
        "(:GOAL (and (on a tray) (and (holding b) (on a tray))))  ; twice",
        "(and (and) (on a tray) (holding b))",
    ],
)
def test_the_same_goal_as_other_planners_write_it(text: str) -> None:
    assert Goal.of(text) == goals.on("a", "tray") & goals.holding("b")


def test_a_name_in_quotation_marks_is_no_variable() -> None:
    goal = goals.on("?a", "?tray") & goals.clear("?left side") & goals.holding("?b", (0.1, 0.2, 0.9))
    assert Goal.from_pddl(goal.to_pddl()) == goal
    assert Goal.of('(on "?a" "tray")') == goals.on("?a", "tray")
    with pytest.raises(GoalError, match="no variables here"):
        Goal.of('(on "a" ?tray)')


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("(or (on a tray) (on a left))", "'or' .* all of its facts"),
        ("(and (on a tray) (not (on b tray)))", "'not' .* \\(clear region\\)"),
        ("(forall (?x - object) (on ?x tray))", "'forall' .* one fact for each object"),
        ("(exists (?x) (on ?x tray))", "'exists' .* name the object"),
        ("(imply (on a tray) (on b tray))", "'imply' .* all of its facts"),
        ("on a tray", "parentheses: \\(on a tray\\)"),
        ("HOLDING a", "parentheses: \\(holding a\\)"),
        ("(and (on ?x tray))", "no variables here"),
        ("(and)", "at least one fact"),
    ],
)
def test_what_a_goal_cannot_say_is_named(text: str, said: str) -> None:
    with pytest.raises(GoalError, match=said):
        Goal.of(text)


def test_deeply_nested_text_is_read_or_refused() -> None:
    for depth in (40, 3000):
        deep = "(and " * depth + "(holding b)" + ")" * depth
        assert Goal.of(deep) == goals.holding("b")
        with pytest.raises(GoalError, match="parentheses"):
            Goal.of(deep[:-1])


@pytest.mark.parametrize(
    "text", ["", "(", ")", "(and)", "(on a)", "(at a)", "(at a (x 1))", "(at a (x 1) (y b))", "(on a b) (on c d)", "()"]
)
def test_text_that_is_no_goal_is_refused(text: str) -> None:
    with pytest.raises(GoalError):
        Goal.from_pddl(text)


@pytest.mark.parametrize(
    ("goal", "message"),
    [
        (goals.holding("x"), "objects: a, b, c"),
        (goals.on("a", "x"), "regions: left, right, beside; supports: table_top, tray; objects: a, b, c"),
        (goals.inside("a", "b"), "regions: left, right"),
        (goals.clear("x"), "supports: table_top, tray"),
        (goals.on("a", "tray") & goals.holding("a"), "twice: a"),
        (goals.holding("a") & goals.holding("b"), "2 objects to hold"),
        (goals.on("a", "b") & goals.on("b", "a"), "circle"),
        (goals.before("a", "b") & goals.before("b", "a"), "circle"),
        (goals.on("a", "left") & goals.clear("table_top"), "is to be clear"),
        (goals.on("a", "b") & goals.holding("b"), "is to be held"),
        (goals.at("a", (0.0, -0.2)) & goals.clear("right"), "is to be clear"),
        (goals.at("a", (-0.1, 0.0)) & goals.clear("table_top"), "is to be clear"),
        (goals.at("a", (50.0, 50.0)), r"no support under \(50.00, 50.00\) m for 'a'; supports: table_top, tray"),
        (goals.inside("a", "beside"), "beside its support 'table_top', which reaches from"),
    ],
)
def test_a_goal_without_meaning_is_refused(scene: Scene, goal: Goal, message: str) -> None:
    with pytest.raises(GoalError, match=message):
        goal.holds(scene)


def test_order_of_moves() -> None:
    goal = goals.before("a", "b")
    moves = [("a", "b"), ("b",), ("a",), ("a", "c", "b", "b"), ("b", "a"), ("a", "b", "a")]
    assert [goal.is_in_order(one) for one in moves] == [True, True, True, True, False, False]


def test_any_order_of_facts_is_the_same_to_a_scene(scene: Scene) -> None:
    facts = (goals.inside("a", "left"), goals.on("b", "tray"), goals.clear("right"))
    assert {len(goals.and_(*order).unmet(scene)) for order in permutations(facts)} == {2}


@pytest.mark.parametrize("region", [Region("a", "table_top", (0, 0), (1, 1)), Region("new", "shelf", (0, 0), (1, 1))])
def test_a_region_has_its_own_name_and_a_support(scene: Scene, region: Region) -> None:
    with pytest.raises(SceneError, match="region"):
        replace(scene, regions=(region,))
