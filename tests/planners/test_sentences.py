"""Goals as sentences: each is read back as it was, and what people write means what they mean."""

from __future__ import annotations

import math

import numpy as np
import pytest

from planners import goals
from planners.facts import At, Before, Clear, Closed, Fact, Holding, Inside, On, Open, Turned
from planners.goal_sentence import facts_of
from planners.goals import Goal, GoalError, from_sentence
from tests.planners.opening.furniture import drawer_world
from tests.planners.scenes import random_scene

NAMES = (
    "red", "red_can", "object_03", "Tray", "left on tray", "the", "box_of_tea", "Jar-2", "table_top", "open_box", "a b",
    "naïve", "x.y", "it", "pick_up",
)  # fmt: skip


def drawn_fact(rng: np.random.Generator) -> Fact:
    one, other = (str(name) for name in rng.choice(NAMES, 2, replace=False))
    number = lambda: float(rng.normal(0.0, 10.0 ** rng.integers(-6, 3)))  # noqa: E731
    positive = lambda: abs(number()) + 1e-7  # noqa: E731
    choices: list[Fact] = [
        Holding(one),
        Holding(one, (number(), number(), number()), positive()),
        On(one, other),
        Inside(one, other),
        At(one, number(), number()),
        At(one, number(), number(), number(), number(), positive(), positive()),
        Clear(one),
        Before(one, other),
        Open(one),
        Open(one, float(rng.uniform(0.01, 1.0))),
        Open(one, amount=positive()),
        Closed(one),
        Turned(one, number()),
        Turned(one, number(), positive()),
    ]
    return choices[int(rng.integers(len(choices)))]


def test_five_hundred_goals_are_said_and_read_again() -> None:
    rng = np.random.default_rng(0)
    for _ in range(500):
        facts = tuple(dict.fromkeys(drawn_fact(rng) for _ in range(rng.integers(1, 5))))
        moved = [fact.object for fact in facts if isinstance(fact, On | Inside | At)]
        held = [fact.object for fact in facts if isinstance(fact, Holding)]
        if {*moved} & {*held}:
            continue  # who is put somewhere is not held, and a sentence says so
        goal = Goal(facts)
        assert facts_of(goal.sentence(), NAMES) == facts, goal.sentence()
        assert from_sentence(goal.sentence()) == goal, goal.sentence()


def test_sentences_mean_on_a_scene_what_the_goal_means() -> None:
    checked = {True: 0, False: 0}
    for seed in range(20):
        scene = random_scene(6, seed)
        rng = np.random.default_rng(seed)
        for _ in range(10):
            name, support = str(rng.choice(scene.names)), str(rng.choice(scene.supports))
            x, y = scene.body(name).position[:2] + rng.choice([0.0, 0.03], 2)
            goal = [goals.on(name, support), goals.at(name, (x, y)), goals.holding(name), goals.clear(support)][
                int(rng.integers(4))
            ]
            read = from_sentence(goal.sentence(), scene)
            assert read.holds(scene) is goal.holds(scene)
            checked[goal.holds(scene)] += 1
    assert min(checked.values()) > 20


PARAPHRASES = {
    "put the red can on the tray": (On("red_can", "tray"),),
    "Please place red can onto tray.": (On("red_can", "tray"),),
    "pick up the red can and put it on the tray": (On("red_can", "tray"),),
    "Pick up the red can, then place it in the basket.": (Inside("red_can", "basket"),),
    "take the red can out of the basket": (Holding("red_can"),),
    "put both the red can and the blue can into the basket": (
        Inside("red_can", "basket"),
        Inside("blue_can", "basket"),
    ),
    "move the red can, the blue can and the jar to the tray": (
        On("red_can", "tray"),
        On("blue_can", "tray"),
        On("jar", "tray"),
    ),
    "open the drawer, put the jar inside it and close it": (
        Open("drawer"),
        Inside("jar", "drawer"),
        Closed("drawer"),
    ),
    "put the jar in the drawer and close it": (Inside("jar", "drawer"), Closed("drawer")),
    "empty the drawer and close it": (Clear("drawer"), Closed("drawer")),
    "take the jar from the drawer, then shut it": (Holding("jar"), Closed("drawer")),
    "take the red can, close the drawer and put it on the tray": (Closed("drawer"), On("red_can", "tray")),
    "open the drawer by 50% and bring the jar to (0.5, -0.25) m turned by 90 degrees": (
        Open("drawer", 0.5),
        At("jar", 0.5, -0.25, math.pi / 2),
    ),
    "shut the drawer; clear the tray": (Closed("drawer"), Clear("tray")),
    "rotate the knob to 45 degrees": (Turned("knob", math.pi / 4),),
    'stack "red can" on top of the blue_can': (On("red_can", "blue_can"),),
    "lift the jar": (Holding("jar"),),
    "hold the jar at (0.5, 0, 1.2) m within 3 cm": (Holding("jar", (0.5, 0.0, 1.2), 0.03),),
}
KNOWN = ("red_can", "blue_can", "jar", "tray", "basket", "drawer", "knob", "red can")


@pytest.mark.parametrize("text", [text for text, facts in PARAPHRASES.items() if facts and '"' not in text])
def test_what_people_write(text: str) -> None:
    assert facts_of(text, KNOWN[:-1]) == PARAPHRASES[text]


def test_a_name_that_two_phrases_fit_is_written_in_quotation_marks() -> None:
    with pytest.raises(GoalError, match="fits red_can and red can: write the name in quotation marks"):
        facts_of("lift the red can", KNOWN)
    assert facts_of('lift "red can" and open the drawer', KNOWN) == (Holding("red can"), Open("drawer"))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "says nothing"),
        ("make me a sandwich", "is no clause.*put the A on the B"),
        ("put the cup on the tray", "'cup' is none of red_can"),
        ("put it on the tray", "nothing was named before"),
        ("put the jar", "is no clause"),
        ("put the jar at (1) m", "two or three numbers"),
        ("hold the jar at (1, 2) m", "point"),
        ("turn the knob", "is no clause"),
        ("pick up the jar from the moon", "'moon' is none of"),
        ("put the jar at (1, 2, x) m", "'x' is no number"),
        ("put the jar at (1, 2) degrees", "is no length; units: m, cm, mm"),
        ("put the jar at (1, 2) m turned to 90", "90 is no angle; units: rad"),
        ("turn the knob to 90", "90 is no angle; units: rad"),
        ("turn the knob to 1.2 m", "1.2 m is no angle"),
        ("pick up ‹0›", "quotation marks"),
        ("turn the knob to 1 rad and close it", "nothing was named before"),
        ("put the jar on the tray and the red can on it", "'it' is no place here"),
    ],
)
def test_what_is_no_goal_says_why(text: str, message: str) -> None:
    with pytest.raises(GoalError, match=message):
        facts_of(text, KNOWN)


@pytest.mark.parametrize(
    "text",
    [
        "pick up the bowl between the plate and the cup and place it on the tray",
        "pick the can up and put it on the tray",
        "put the can in the basket and the jar on the tray",
        "put the can not on the tray",
        "put the can or the jar on the tray",
        "take the can off the tray",
        "put the can next to the jar",
        "put the can on it",
        "put the can on the tray before the jar",
        "open the drawer before you take the can",
    ],
)
def test_without_a_scene_words_of_the_grammar_make_no_name(text: str) -> None:
    with pytest.raises(GoalError, match=r"quotation marks|is no place here"):
        facts_of(text)


def test_a_sentence_is_planned_for_in_a_scene() -> None:
    scene = drawer_world().scene()
    read = from_sentence("open the drawer and put the red onto the side table", scene)
    assert {*read.facts} == {Open("drawer"), On("red", "side_table")}
    with pytest.raises(GoalError, match="none of"):
        from_sentence("open the fridge", scene)
