"""Which scenes are for learning and which for evaluation: their seeds decide."""

from __future__ import annotations

from clutter_env.errors import LearningError

HELD_OUT = 1_000_000
"""Seeds from this one on, the suites' too, are for evaluation: nothing is collected or trained on them."""


def training_seeds(first: int, count: int = 1) -> range:
    """The seeds of `count` scenes to learn from, from `first` on.

    Every scene that is collected or trained on has a seed from here.

    Raises:
        LearningError: a seed is negative, or for evaluation.
    """
    seeds = range(first, first + count)
    if first < 0 or seeds.stop > HELD_OUT:
        raise LearningError(
            f"scenes to learn from have seeds from 0 to {HELD_OUT - 1}, the others are for evaluation; these would be "
            f"{first} to {seeds.stop - 1}: choose another --seed or fewer scenes"
        )
    return seeds


def held_out_seeds(count: int) -> range:
    """Seeds on which nothing is trained."""
    return range(HELD_OUT, HELD_OUT + count)
