"""Comparison of two policies on the same scenes: significant differences, and those that so many scenes can show."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import combinations
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from clutter_env.errors import LearningError

SIGNIFICANT = 0.05
"""Level of the tests, two-sided."""
POWER = 0.8
"""Share of the comparisons that are to show a difference."""
_NEAR = 1e-4
"""To which `smallest_shown` finds a difference."""


class Discordant(NamedTuple):
    """Scenes that only the one policy wins, and those that only the other one wins."""

    one: int
    other: int

    @classmethod
    def of(cls, one: Sequence[bool], other: Sequence[bool]) -> Discordant:
        """Of the outcomes on the same scenes, in the same order."""
        pairs = list(zip(one, other, strict=True))
        return cls(sum(a and not b for a, b in pairs), sum(b and not a for a, b in pairs))

    @property
    def p_value(self) -> float:
        """The exact test of McNemar 1947 (Psychometrika 12, pp. 153-157): a fair coin decides a discordant scene."""
        total, most = sum(self), max(self)
        return min(1.0, 2.0 * sum(math.comb(total, k) for k in range(most, total + 1)) / 2.0**total)


@dataclass(frozen=True)
class Pair:
    """Two policies on the same scenes.

    Attributes:
        scenes: their name.
        policies: the two.
        clean: clean success of each.
        count: of scenes.
        p_value: of the paired test.
    """

    scenes: str
    policies: tuple[str, str]
    clean: tuple[float, float]
    count: int
    p_value: float

    @property
    def is_difference(self) -> bool:
        """Whether the two rates are different numbers, which a table shows as a better and a worse policy."""
        return self.clean[0] != self.clean[1]

    @property
    def is_significant(self) -> bool:
        """Whether a paired test agrees that they differ."""
        return self.p_value < SIGNIFICANT


def pairs_of(contents: Sequence[Mapping[str, Any]]) -> list[Pair]:
    """All pairs of results files of the same scenes, played by different policies.

    Args:
        contents: of results files, see docs/verification.md. Of the same scenes, as many are compared as both have.

    Raises:
        LearningError: a file lacks an entry, or has no episode.
    """
    try:
        outcomes = [[bool(episode["clean"]) for episode in content["episodes"]] for content in contents]
        places = [_scenes(content) for content in contents]
    except KeyError as problem:
        raise LearningError(f"a results file lacks {problem}") from None
    if not all(outcomes):
        raise LearningError("a results file has no episode")
    found = []
    for i, k in combinations(range(len(contents)), 2):
        one, other = contents[i], contents[k]
        if places[i] != places[k] or one["policy"] == other["policy"]:
            continue
        count = min(len(outcomes[i]), len(outcomes[k]))
        won = outcomes[i][:count], outcomes[k][:count]
        found.append(
            Pair(
                one["scenes"],
                (one["policy"], other["policy"]),
                (sum(won[0]) / count, sum(won[1]) / count),
                count,
                Discordant.of(*won).p_value,
            )
        )
    return found


def _scenes(content: Mapping[str, Any]) -> tuple[Any, ...]:
    """Comparison of two results files of the same scenes."""
    by_seed = () if content["suite"] else (content["env_id"], content["first_seed"], content["objects"])
    return content["suite_sha256"], content["split"], content["scenes"], *by_seed


def fewest_won(scenes: int) -> int | None:
    """Scenes that one policy must win more for a significant difference, if it loses none that the other wins.

    None where all the scenes do not suffice.
    """
    enough = (k for k in range(1, scenes + 1) if Discordant(k, 0).p_value < SIGNIFICANT)
    return next(enough, None)


def smallest_shown(scenes: int, rate: float) -> float | None:
    """The smallest difference below a rate that a paired test shows in `POWER` of the comparisons.

    The outcomes of the two policies on a scene are taken to be independent. This is the worse case, since fewer scenes
    are discordant if the same scenes are hard for both.

    Args:
        scenes: number of scenes.
        rate: success of the better policy.

    Returns:
        The difference. None if even a policy that never succeeds cannot be told apart.
    """
    if _power(scenes, rate, 0.0) < POWER:
        return None
    low, high = 0.0, rate  # differences: not shown, shown
    while high - low > _NEAR:
        middle = (low + high) / 2
        low, high = (low, middle) if _power(scenes, rate, rate - middle) >= POWER else (middle, high)
    return high


def _power(scenes: int, rate: float, other: float) -> float:
    """Probability that the paired test calls two independent policies with these rates different."""
    from scipy.stats import binom  # takes a moment to import

    only_one, only_other = rate * (1 - other), other * (1 - rate)
    discordant = only_one + only_other
    if not discordant:
        return 0.0
    totals = np.arange(scenes + 1)
    needed = _needed(scenes)
    # Of the scenes that are discordant, so many or more on either side.
    shown = binom.sf(needed - 1, totals, only_one / discordant) + binom.cdf(
        totals - needed, totals, only_one / discordant
    )
    return float(binom.pmf(totals, scenes, discordant) @ shown)


@cache
def _needed(scenes: int) -> NDArray[np.int64]:
    """The scenes that one policy must win of each number of discordant ones, (scenes + 1,). A number above the scenes
    says that none suffices."""
    found = [0]
    for total in range(scenes + 1):  # one discordant scene more needs at most one more
        least = found[-1]
        while least <= total and Discordant(least, total - least).p_value >= SIGNIFICANT:
            least += 1
        found.append(max(least, total // 2 + 1))
    return np.array(found[1:])
