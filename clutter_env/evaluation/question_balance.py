"""A choice of questions in which neither the colour of an object nor the kind of a question gives the answer away.

Of obstructed targets, most answers are "no". So of each kind as many questions are kept with each of its commonest
answers, about targets and about other objects alike. The rest is not asked.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from clutter_env.evaluation.questions import Answer, Question

COMMON: Mapping[str, int] = {"taken now": 2, "fewest": 2, "which": 4, "from where": 4, "touched": 3, "falls": 3}
"""Answers of each kind of question that are as common as each other; no other one is more common. Of "touched" and
"falls" it is the number of names that counts: of none there is one answer, of one name as many as objects."""
_BY_NUMBER = ("touched", "falls")


@dataclass(frozen=True)
class Asked:
    """A question, and what it must not give away.

    Attributes:
        question: it.
        is_target: whether it is about the target, which is red.
    """

    question: Question
    is_target: bool

    @property
    def group(self) -> tuple[str, bool]:
        """The questions among which answers are to be equally common."""
        return self.question.kind, self.is_target

    @property
    def answer(self) -> Answer:
        """What counts of its answer."""
        answer = self.question.answer
        return len(answer) if self.question.kind in _BY_NUMBER and isinstance(answer, tuple) else answer


def balanced(asked: Sequence[Asked], rng: np.random.Generator) -> list[int]:
    """Indices of the questions that are kept, in their order: see `COMMON`.

    Of a group with fewer different answers than that, nothing is kept.

    Args:
        asked: all questions about some scenes.
        rng: chooses which of the questions with a common answer.
    """
    counts: dict[tuple[str, bool], Counter[Answer]] = {}
    for one in asked:
        counts.setdefault(one.group, Counter())[one.answer] += 1
    left = {group: _limits(found, COMMON[group[0]]) for group, found in counts.items()}
    kept = []
    for index in rng.permutation(len(asked)).tolist():
        one = asked[index]
        if left[one.group][one.answer]:
            left[one.group][one.answer] -= 1
            kept.append(index)
    return sorted(kept)


def _limits(counts: Counter[Answer], common: int) -> dict[Answer, int]:
    """How many questions are kept with each answer."""
    ordered = sorted(counts.values(), reverse=True)
    most = ordered[common - 1] if len(ordered) >= common else 0
    return {answer: min(count, most) for answer, count in counts.items()}
