"""Goals as PDDL says them, read with a scene: capitals, alternatives, negation, several facts of one object."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from assets.robots import PR2
from planners import Body, GoalError, Region, RobotState, Scene, StaticObstacle, goals
from planners.goals import At, Goal, Inside, On
from tests.planners.scenes import BOARD_HEIGHT, HEIGHT, UPRIGHT, cylinder, shelf_scene, table_scene

SUPPORTS = ("table_top", "counter_left", "counter_right", "tray")


def scene_with(*more: Body) -> Scene:
    """Three cylinders on the table, a tray on the right counter, regions on the left one; one lies in the other."""
    tray = StaticObstacle("tray", np.array([-0.15, -0.72, HEIGHT + 0.004]), np.array([0.17, 0.17, 0.004]))
    bodies = (cylinder(name, -0.2, y) for name, y in zip("abc", (-0.3, 0.0, 0.3), strict=True))
    scene = table_scene(*bodies, *more)
    return replace(
        scene,
        static_obstacles=(*scene.static_obstacles, tray),
        supports=SUPPORTS,
        regions=(
            Region("left", "counter_left", (-0.15, 0.72), (0.12, 0.12)),
            Region("corner", "counter_left", (-0.20, 0.77), (0.05, 0.05), 0.3),
        ),
    )


ON = {name: f"(on {name} table_top)" for name in "abc"}


@pytest.mark.parametrize(
    ("text", "same"),
    [
        ("(ON A Counter_Left)", goals.on("a", "counter_left")),
        ("(and (Inside B LEFT) (at C (x 0) (y 0)) (before A B) (CLEAR Tray))",
         goals.inside("b", "left") & goals.at("c", (0.0, 0.0)) & goals.before("a", "b") & goals.clear("tray")),
        ("(forall (?x) (on ?x counter_left))", goals.and_(*(goals.on(name, "counter_left") for name in "abc"))),
        ("(forall (?X - object) (and (inside ?x Left)))", goals.and_(*(goals.inside(name, "left") for name in "abc"))),
        ("(forall (?p - support) (or (= ?p table_top) (clear ?p)))",
         goals.and_(*(goals.clear(name) for name in SUPPORTS[1:]))),
        ("(forall (?p - (either region)) (clear ?p))", goals.clear("left") & goals.clear("corner")),
        ("(not (not (on a tray)))", goals.on("a", "tray")),
        ("(not (or (not (on a tray)) (not (on b tray))))", goals.on("a", "tray") & goals.on("b", "tray")),
        ("(or (on a tray))", goals.on("a", "tray")),
        ("(or (on a tray) (and (on a tray) (on b tray)))", goals.on("a", "tray")),
        # One alternative holds already.
        (f"(or (on a tray) {ON['a']})", goals.on("a", "table_top")),
        ("(exists (?x) (on ?x table_top))", goals.on("a", "table_top")),
        # The others contradict the rest.
        ("(and (holding a) (or (on a tray) (on b tray)))", goals.holding("a") & goals.on("b", "tray")),
        ("(and (clear tray) (exists (?p - place) (or (= ?p tray) (and (= ?p left) (on a ?p)))))",
         goals.clear("tray")),
        ("(and (on a tray) (imply (on a tray) (on b tray)))", goals.on("a", "tray") & goals.on("b", "tray")),
        ("(and (on a tray) (exists (?p - region) (inside b ?p)) (clear corner))",
         goals.on("a", "tray") & goals.inside("b", "left") & goals.clear("corner")),
        # What is denied follows from the rest.
        ("(and (on a tray) (not (on a table_top)) (not (holding a)) (not (on a b)))", goals.on("a", "tray")),
        ("(and (inside a left) (not (on a tray)))", goals.inside("a", "left")),
        # None is on a support, that is that it is clear.
        ("(forall (?x) (not (on ?x table_top)))", goals.clear("table_top")),
        ("(not (exists (?x) (ON ?x tray)))", goals.clear("tray")),
        ("(and (on a tray) (not (on b table_top)) (not (on c table_top)))",
         goals.on("a", "tray") & goals.clear("table_top")),
        ("(forall (?x) (not (inside ?x left)))", goals.clear("left")),
        ("(forall (?x) (imply (on ?x table_top) (on ?x tray)))", goals.clear("table_top")),
        ("(and (on a tray) (on b tray) (on c tray) (or (clear table_top) (not (on a table_top))))",
         goals.and_(*(goals.on(name, "tray") for name in "abc"), goals.clear("table_top"))),
    ],
)  # fmt: skip
def test_text_that_a_scene_makes_a_conjunction(text: str, same: Goal) -> None:
    read = Goal.of(text, scene_with())
    assert set(read.facts) == set(same.facts)
    assert Goal.of(read.to_pddl(), scene_with()) == read
    read.check(scene_with())


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("(or (on a tray) (on a left))", r"^'or' in .*\(on a tray\), or \(on a left\).*plan for each alternative"),
        ("(exists (?x) (on ?x tray))", r"^'exists' in .*\(on a tray\), or \(on b tray\).*name the object"),
        ("(not (on a table_top))", r"^'not' in .*say where.*\(clear region\)"),
        ("(not (before a b))", "^'not' in .*say where"),
        ("(not (clear tray))", "^'not' in .*say where"),
        ("(not (holding a))", "^'not' in .*says nothing"),
        ("(and (on a tray) (not (on A Tray)))", "holds, and that it does not"),
        (
            "(forall (?x - thing) (on ?x tray))",
            "^'forall' in .*'thing' is no type; valid are object, support, region, place",
        ),
        ("(forall ?x (on ?x tray))", "^'forall' in .*as PDDL has it"),
        ("(forall (x) (on x tray))", "^'forall' in .*x is no variable"),
        ("(not (on a tray) (on b tray))", "^'not' in .*as PDDL has it"),
        ("(or)", "^'or' in .*as PDDL has it|no alternative"),
        ("(or (on a a) (on b b))", "^'or' in .*no alternative can be: .*circle"),
        ("(exists (?x - object ?y - object ?z - object ?u - object ?v ?w) (on ?x tray))", "^'exists' in .*more than"),
        ("(= a b)", "^'=' in .*no alternative"),
        ("(and (on ?x tray))", "no variables here"),
        ("(not (on z table_top))", "names 'z', which the scene does not have"),
        ("(forall (?x) (or (on ?x tray) (on ?x left)))", "^'or' in .*plan for each alternative"),
    ],
)
def test_what_stays_undecided_is_refused_by_a_sentence(text: str, words: str) -> None:
    with pytest.raises(GoalError, match=f"(?s){words}"):
        Goal.of(text, scene_with())


def test_conditions_agree_with_their_truth_in_the_scene() -> None:
    """Random conditions: where the goal that is read holds, the condition is true."""
    rng, scene, read = np.random.default_rng(0), scene_with(), 0
    atoms = [("on", name, place) for name in "abc" for place in (*SUPPORTS, "left", "corner", *"abc") if name != place]

    def condition(depth: int) -> tuple[str, bool]:
        kind = str(rng.choice(["atom", "and", "or", "not", "imply"])) if depth else "atom"
        if kind == "atom":
            word, name, place = atoms[rng.integers(len(atoms))]
            return f"({word} {name} {place})", goals.on(name, place).holds(scene)
        parts = [condition(depth - 1) for _ in range(1 if kind == "not" else 2)]
        texts, truths = [text for text, _ in parts], [truth for _, truth in parts]
        truth = {
            "and": all(truths),
            "or": any(truths),
            "not": not truths[0],
            "imply": not truths[0] or truths[-1],
        }[kind]
        return f"({kind} {' '.join(texts)})", truth

    for _ in range(600):
        text, is_true = condition(3)
        try:
            goal = Goal.of(text, scene)
            holds = goal.holds(scene)
        except GoalError:
            continue
        read += 1
        # A goal may leave out what another fact implies, not what is false.
        assert not holds or is_true, (text, str(goal))
    assert read > 100


def test_a_name_that_fits_one_of_the_scene_s_is_that_one() -> None:
    scene = scene_with(replace(cylinder("A", -0.2, 0.15), name="A"))
    assert Goal.of("(on A tray)", scene) == goals.on("A", "tray")
    assert Goal.of("(on a TRAY)", scene) == goals.on("a", "tray")
    assert Goal.of("(on B tray)", scene) == goals.on("b", "tray")
    twice = replace(
        scene,
        objects=tuple(replace(one, name={"a": "Cup", "A": "cup"}.get(one.name, one.name)) for one in scene.objects),
    )
    assert Goal.of("(on Cup tray)", twice) == goals.on("Cup", "tray")
    with pytest.raises(GoalError, match="'CUP' may be 'Cup' or 'cup'"):
        Goal.of("(on CUP tray)", twice)
    with pytest.raises(GoalError, match="'A', which the scene does not have"):
        Goal.of("(on A tray)").check(scene_with())


POSE = goals.at("a", (-0.15, 0.72), 0.02)


@pytest.mark.parametrize(
    ("goal", "end"),
    [
        (goals.on("a", "counter_left") & POSE, POSE),
        (POSE & goals.on("a", "counter_left") & goals.on("a", "left"), None),
        (goals.on("a", "counter_left") & goals.inside("a", "counter_left"), goals.inside("a", "counter_left")),
        (goals.inside("a", "left") & goals.inside("a", "corner"), goals.inside("a", "corner")),
        (goals.on("a", "corner") & goals.on("a", "counter_left"), goals.on("a", "corner")),
        (POSE & goals.at("a", (-0.155, 0.72), 0.01), goals.at("a", (-0.155, 0.72), 0.01)),
        (goals.on("a", "tray") & goals.at("a", (-0.15, -0.72)), None),
    ],
)
def test_facts_that_agree_are_one_of_which_the_narrower_says_where(goal: Goal, end: Goal | None) -> None:
    scene = scene_with()
    settled = goal.in_scene(scene)
    assert settled == goal
    assert settled.in_scene(scene) is settled
    (placed,) = settled.placed
    if end is not None:
        assert (placed,) == end.facts
    else:
        assert isinstance(placed, At)
    goal.check(scene)


@pytest.mark.parametrize(
    ("goal", "said"),
    [
        (goals.on("a", "tray") & goals.on("a", "counter_left"), r"\(on a tray\) and \(on a counter_left\)"),
        (goals.on("a", "table_top") & POSE, r"\(on a table_top\) and \(at a "),
        (goals.inside("a", "left") & goals.at("a", (-0.15, 0.85)), r"\(inside a left\) and \(at a "),
        (goals.inside("a", "left") & goals.on("a", "b"), r"\(inside a left\) and \(on a b\)"),
        (goals.holding("a") & POSE, r"\(holding a\) and \(at a "),
        (goals.at("a", (-0.15, 0.6)) & POSE, r"\(at a .* and \(at a "),
        # The tray lies there.
        (goals.on("a", "counter_right") & goals.at("a", (-0.15, -0.72)), r"\(on a counter_right\) and \(at a "),
        (goals.on("a", "b") & goals.at("a", (-0.2, 0.1)), r"\(on a b\) and \(at a "),
    ],
)
def test_facts_that_contradict_each_other_are_both_named(goal: Goal, said: str) -> None:
    for order in (goal, Goal(goal.facts[::-1])):
        with pytest.raises(GoalError, match=r"twice: a: "):
            order.check(scene_with())
    with pytest.raises(GoalError, match=said):
        goal.check(scene_with())


def test_a_pose_on_another_object_says_where_on_it() -> None:
    wide = Body("wide", "box", np.array([0.08, 0.08, 0.03]), np.array([-0.15, 0.72, HEIGHT + 0.03]), UPRIGHT)
    goal = (goals.on("a", "wide") & goals.at("a", (-0.12, 0.70))).in_scene(scene_with(wide))
    assert goal.placed == (On("a", "wide", At("a", -0.12, 0.70)),)
    assert goal.to_pddl() == (goals.on("a", "wide") & goals.at("a", (-0.12, 0.70))).to_pddl()


def test_a_pose_without_a_height_means_the_support_where_it_stands_else_the_highest_that_is_free() -> None:
    scene = shelf_scene(cylinder("a", -0.22, -0.2), cylinder("b", -0.22, 0.7))
    scene = replace(scene, supports=("table_top", "counter_left", "shelf_board"))
    board = HEIGHT + BOARD_HEIGHT
    for name, low, high in (("a", HEIGHT, board), ("b", board, board + 0.2)):
        (end,) = goals.at(name, (-0.22, 0.2)).in_scene(scene).placed
        assert isinstance(end, At)
        assert end.z is not None
        assert low < end.z < high
    (end,) = (goals.at("b", (-0.22, 0.2)) & goals.on("b", "table_top")).in_scene(scene).placed
    assert isinstance(end, At)
    assert end.z is not None
    assert end.z < board
    # The counter below the tray is filled by it.
    (end,) = goals.at("a", (-0.15, -0.72)).in_scene(scene_with()).placed
    assert isinstance(end, At)
    assert end.z == pytest.approx(HEIGHT + 0.008 + 0.08)


def test_as_many_objects_are_held_as_the_robot_has_hands_that_act() -> None:
    scene, both = scene_with(), goals.holding("a") & goals.holding("b")
    with pytest.raises(GoalError, match="2 objects to hold"):
        both.check(scene)
    robot = PR2.with_all_arms()
    state = RobotState(scene.state.base, np.array(robot.home), robot.max_finger_position)
    with_two = replace(scene, robot=robot, state=state)
    both.check(with_two)
    with pytest.raises(GoalError, match="3 objects to hold"):
        (both & goals.holding("c")).check(with_two)


def test_a_region_and_its_object_stay_as_they_are_said() -> None:
    goal = goals.inside("a", "left") & goals.at("a", (-0.15, 0.72))
    (end,) = goal.in_scene(scene_with()).placed
    assert end == At("a", -0.15, 0.72, within=("left",))
    assert [type(fact) for fact in goal.facts] == [Inside, At]
    assert len(goal.unmet(scene_with())) == 2
