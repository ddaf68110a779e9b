"""Scores of answers to questions, and what simple rules answer that know where everything stands."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clutter_env.errors import LearningError
from clutter_env.evaluation.question_balance import SQUARE
from clutter_env.evaluation.questions import BAR, KINDS
from clutter_env.reporting.intervals import Interval, wilson

NEAR = 0.10
"""[m] between the edges of two objects, within which the nearest-first rule counts one as in the way of another:
about the width of the open gripper."""
_MOST = 3
"""The random rule says numbers from 0 to this, and the names of so many objects at most."""

_TOGETHER = 5
"""Scenes in a row that belong to one half: so many have all kinds among them."""

Record = Mapping[str, Any]


def scored(questions: Sequence[Record], answers: Mapping[str, Any]) -> dict[str, Interval]:
    """The share of right answers by kind, and of all. A question without an answer counts as wrong.

    Args:
        questions: lines of `questions.jsonl`.
        answers: by the questions' ids: true or false, a number, or a list of names in any order.

    Raises:
        LearningError: an answer to a question that there is not.
    """
    known = {question["id"] for question in questions}
    if unknown := [name for name in answers if name not in known]:
        raise LearningError(f"there is no question {unknown[0]!r}")
    right = {one["id"]: one["id"] in answers and _is_right(one["answer"], answers[one["id"]]) for one in questions}
    found: dict[str, Interval] = {}
    for kind in KINDS:
        of_kind = [right[one["id"]] for one in questions if one["kind"] == kind]
        if of_kind:
            found[kind] = wilson(sum(of_kind), len(of_kind))
    found["all"] = wilson(sum(right.values()), len(right))
    return found


def _is_right(answer: Any, given: Any) -> bool:
    if isinstance(answer, list):
        return isinstance(given, list) and all(isinstance(one, str) for one in given) and set(answer) == set(given)
    return type(answer) is type(given) and bool(answer == given)


def answered(rule: str, questions: Sequence[Record], scenes: Sequence[Record], seed: int = 0) -> dict[str, Any]:
    """Answers of a rule to each question.

    Args:
        rule: a name in `BASELINES`.
        questions, scenes: lines of the two files.
        seed: of the random rule.
    """
    if rule == COMMONEST:
        return _commonest(questions)
    if rule in LEARNED:
        return _learned(rule, questions, scenes)
    placed = {scene["scene"]: _Placed(scene) for scene in scenes}
    rng = np.random.default_rng(seed)
    return {one["id"]: RULES[rule](one, placed[one["scene"]], rng) for one in questions}


def _commonest(questions: Sequence[Record]) -> dict[str, Any]:
    """The answer that is right most often among the questions of a kind: what can be won without any image."""
    best = _best((one["kind"], one) for one in questions)
    return {one["id"]: best[one["kind"]] for one in questions}


def _best(keyed: Iterable[tuple[Hashable, Record]]) -> dict[Hashable, Any]:
    """The commonest answer of the questions with each key."""
    counts: dict[Hashable, Counter[str]] = {}
    for key, one in keyed:
        counts.setdefault(key, Counter())[json.dumps(one["answer"])] += 1
    return {key: json.loads(found.most_common(1)[0][0]) for key, found in counts.items()}


def _learned(rule: str, questions: Sequence[Record], scenes: Sequence[Record]) -> dict[str, Any]:
    """Answers of a rule that knows one property of the object, learned from the other half of the scenes.

    If the other half has no question of the kind about such an object, the answer is the commonest of the kind there.
    If it has no question of the kind, the rule gives no answer.
    """
    half = {scene["scene"]: index // _TOGETHER % 2 for index, scene in enumerate(scenes)}
    of = {scene["scene"]: {one["name"]: one for one in scene["objects"]} for scene in scenes}
    answers: dict[str, Any] = {}
    for part in (0, 1):
        known = [one for one in questions if half[one["scene"]] != part]
        best = _best(((one["kind"], LEARNED[rule](of[one["scene"]][one["about"]])), one) for one in known)
        usual = _best((one["kind"], one) for one in known)
        for one in questions:
            if half[one["scene"]] == part and one["kind"] in usual:
                key = one["kind"], LEARNED[rule](of[one["scene"]][one["about"]])
                answers[one["id"]] = best.get(key, usual[one["kind"]])
    return answers


def _colour(placed: Record) -> Hashable:
    return tuple(placed["colour"])


def _place(placed: Record) -> Hashable:
    """The square of the table on which an object stands."""
    x, y, _ = placed["position"]
    return round(x / SQUARE), round(y / SQUARE)


class _Placed:
    """Positions of the objects of a scene."""

    def __init__(self, scene: Record) -> None:
        self.names = [one["name"] for one in scene["objects"]]
        self.positions = np.array([one["position"] for one in scene["objects"]])
        self.half_extents = np.array([one["half_extents"] for one in scene["objects"]])

    def by_gap(self, name: str) -> list[tuple[float, str]]:
        """[m] from the edge of one object to those of the others, seen from above, nearest first."""
        own = self.names.index(name)
        apart = np.hypot(*(self.positions - self.positions[own])[:, :2].T)
        gaps = apart - self.half_extents[:, 0] - self.half_extents[own, 0]
        return sorted((float(gap), one) for gap, one in zip(gaps, self.names, strict=True) if one != name)

    def away(self, name: str, other: str) -> NDArray[np.float64]:
        """From one object to another one (3,) [m]."""
        return np.asarray(self.positions[self.names.index(other)] - self.positions[self.names.index(name)])

    def above(self, name: str) -> list[str]:
        """Objects that are higher, and not beside it."""
        own = self.half_extents[self.names.index(name)]
        away = {other: self.away(name, other) for other in self.names if other != name}
        return sorted(one for one, at in away.items() if at[2] > own[2] and np.hypot(*at[:2]) < own[0])


def _random(question: Record, placed: _Placed, rng: np.random.Generator) -> Any:  # noqa: ARG001  as of the other rules
    answer, choices = question["answer"], question["choices"]
    if isinstance(answer, bool):
        return bool(rng.integers(2))
    if isinstance(answer, int):
        return int(rng.integers(_MOST + 1))
    return rng.choice(choices, rng.integers(min(_MOST, len(choices)) + 1), replace=False).tolist()


def _nearest_first(question: Record, placed: _Placed, rng: np.random.Generator) -> Any:  # noqa: ARG001
    """Rule: objects nearer than a hand are in the way."""
    name = question["about"]
    near = [other for gap, other in placed.by_gap(name) if gap < NEAR]
    return _by_what_is_in_the_way(question, near, [_side(placed.away(name, other)) for other in near], placed)


def _shadow(question: Record, placed: _Placed, rng: np.random.Generator) -> Any:  # noqa: ARG001
    """Rule: objects between robot and object, as wide as a hand, are in the way, and the robot comes from the front."""
    name = question["about"]
    hidden = []
    for _, other in placed.by_gap(name):
        x, y, _ = placed.away(name, other)
        if x < 0 and abs(y) < BAR / 2 + placed.half_extents[placed.names.index(other), 0]:
            hidden.append(other)
    taken = ["left", "right", "behind", *(["front"] if hidden else [])]
    return _by_what_is_in_the_way(question, hidden, taken, placed)


def _by_what_is_in_the_way(question: Record, names: Sequence[str], sides: Sequence[str], placed: _Placed) -> Any:
    """The answer of a rule that says which objects are in the way, and from which sides."""
    match question["kind"]:
        case "taken now":
            return not names
        case "fewest":
            return len(names)
        case "from where":
            return [side for side in question["choices"] if side not in sides]
        case "falls":
            return placed.above(question["about"])
        case _:
            return list(names)


def _side(away: NDArray[np.float64]) -> str:
    """The side on which something stands."""
    if abs(away[0]) >= abs(away[1]):
        return "front" if away[0] < 0 else "behind"
    return "left" if away[1] > 0 else "right"


RULES: Mapping[str, Callable[[Record, _Placed, np.random.Generator], Any]] = {
    "random": _random,
    "nearest-first": _nearest_first,
    "shadow": _shadow,
}
"""Rules by name that answer question by question. The last two know where everything stands, which a model must see."""
COMMONEST = "commonest"
"""The rule that gives every question the commonest answer of its kind, which it knows from the right answers."""
LEARNED: Mapping[str, Callable[[Record], Hashable]] = {"colour": _colour, "place": _place}
"""Rules that know the colour of the object that a question is about, or the square of the table on which it stands, and
nothing of the others."""
BASELINES = (COMMONEST, *LEARNED, *RULES)
"""Names of all rules."""
