"""A choice of questions in which neither an object's colour or place nor the kind of question gives the answer away.

Of obstructed targets, most answers are "no", and what stands far back is reached from fewer sides. So each of the
commonest answers of a kind is kept equally often, for targets and for other objects. For questions about grasps this
holds on each square of the table. The rest is not asked.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clutter_env.evaluation.questions import Answer, Question

COMMON: Mapping[str, int] = {"taken now": 2, "fewest": 2, "which": 4, "from where": 4, "touched": 3, "falls": 3}
"""Answers of each kind of question that are as common as each other. No other answer is more common. Of "touched" and
"falls" it is the number of names that counts: of none there is one answer, of one name as many as objects."""
ON_SQUARE: Mapping[str, int] = {"taken now": 2, "fewest": 2, "from where": 3}
"""The same among objects that stand on one square of the table."""
SQUARE = 0.2
"""[m] Sides of the squares."""
_BY_NUMBER = ("touched", "falls")


@dataclass(frozen=True)
class Asked:
    """A question, and what it must not give away.

    Attributes:
        question: it.
        is_target: whether it is about the target, which is red.
        position: [m] of the object (3,). The table is symmetric about the x axis.
    """

    question: Question
    is_target: bool
    position: Sequence[float] | NDArray[np.float64]

    @property
    def group(self) -> tuple[str, bool]:
        """The questions among which answers are to be equally common."""
        return self.question.kind, self.is_target

    @property
    def square(self) -> tuple[int, int]:
        """The square of the table on which the object stands, or that on the other side of the robot."""
        x, y, *_ = self.position
        return round(x / SQUARE), round(abs(y) / SQUARE)

    @property
    def answer(self) -> Answer:
        """The part of its answer that counts."""
        answer = self.question.answer
        return len(answer) if self.question.kind in _BY_NUMBER and isinstance(answer, tuple) else answer


def balanced(asked: Sequence[Asked], rng: np.random.Generator) -> list[int]:
    """Indices of the questions that are kept, in their order: see `COMMON` and `ON_SQUARE`.

    Of a group with fewer different answers than that, nothing is kept.

    Args:
        asked: all questions about some scenes.
        rng: chooses which of the questions with a common answer.
    """
    order = rng.permutation(len(asked)).tolist()
    by_square = [index for index in order if asked[index].question.kind in ON_SQUARE]
    kept = set(_kept(asked, by_square, lambda one: (*one.group, *one.square), ON_SQUARE))
    rest = [index for index in order if index in kept or asked[index].question.kind not in ON_SQUARE]
    return sorted(_kept(asked, rest, lambda one: one.group, COMMON))


def _kept(
    asked: Sequence[Asked], order: Sequence[int], group: Callable[[Asked], tuple[Any, ...]], common: Mapping[str, int]
) -> Iterator[int]:
    """The first questions in an order with each answer, as many as are kept in their groups."""
    counts: dict[tuple[Any, ...], Counter[Answer]] = {}
    for one in (asked[index] for index in order):
        counts.setdefault(group(one), Counter())[one.answer] += 1
    left = {of: _limits(found, common[of[0]]) for of, found in counts.items()}
    for index in order:
        one = asked[index]
        if left[group(one)][one.answer]:
            left[group(one)][one.answer] -= 1
            yield index


def _limits(counts: Counter[Answer], common: int) -> dict[Answer, int]:
    """Number of questions to keep with each answer."""
    ordered = sorted(counts.values(), reverse=True)
    most = ordered[common - 1] if len(ordered) >= common else 0
    return {answer: min(count, most) for answer, count in counts.items()}
