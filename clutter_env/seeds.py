"""Seeds divide the scenes into those for learning and those for evaluation."""

from __future__ import annotations

from clutter_env.errors import LearningError

HELD_OUT = 1_000_000
"""Seeds from this value on are for evaluation, as are the suites' seeds. Nothing is collected or trained on them."""


def training_seeds(first: int, count: int = 1) -> range:
    """Seeds of `count` scenes to learn from, from `first` on.

    Every scene for collection or training has a seed from here.

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
