"""Which skills bring the target nearest: labels for a network, found from the grasps in a scene without motions."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import reduce
from operator import or_

import numpy as np
from numpy.typing import NDArray

from clutter_env.learning.skills.obstacles import YAWS_OF_DIRECTION, GraspObstacles

__all__ = ["MOST_CLEARANCES", "SkillLabels", "clearances_left", "skill_labels"]

MOST_CLEARANCES = 4
"""Scenes that need more clearances get no labels: the search grows with the power of their number."""


@dataclass(frozen=True, eq=False)
class SkillLabels:
    """What is known of the skills in one scene; their order is that of the actions of `Skill`.

    Attributes:
        is_good: (m,) free skills after which the fewest clearances are left; none if there is no solution.
        is_free: (m,) whether the skill has a grasp with nothing in its way.
        clearances: how many are needed before the target is free; -1 if more than `MOST_CLEARANCES`, or if there is no
            solution.
    """

    is_good: NDArray[np.bool_]
    is_free: NDArray[np.bool_]
    clearances: int


def skill_labels(obstacles: GraspObstacles, target: int) -> SkillLabels:
    """The labels of a scene in which nothing is held.

    Cleared objects are taken to be in nothing's way: they are put where they keep clear of the target's grasp.

    Args:
        obstacles: of the scene's grasps.
        target: index of the target.
    """
    is_free_yaw = obstacles.is_reachable & (obstacles.masks == 0)
    takes = is_free_yaw[target].any()
    clears = is_free_yaw[:, YAWS_OF_DIRECTION].any(axis=2)
    clears[target] = False
    rows = zip(obstacles.masks, obstacles.is_reachable, strict=True)
    clearances, first = clearances_left([set(masks[reached].tolist()) for masks, reached in rows], target)
    is_helpful = np.array([bool(first >> i & 1) for i in range(len(clears))])
    return SkillLabels(
        is_good=np.append(clears & is_helpful[:, None], takes),
        is_free=np.append(clears, takes),
        clearances=clearances,
    )


def clearances_left(in_the_way: Sequence[set[int]], target: int, most: int = MOST_CLEARANCES) -> tuple[int, int]:
    """Fewest clearances before some grasp of the target is free, and the mask of objects with which they can begin.

    Args:
        in_the_way: for every object the masks of what is in the way of its grasps.
        target: its index.
        most: clearances at most.

    Returns:
        -1 and 0 if more than `most` are needed, or if none frees it.
    """
    matters = _matter(in_the_way, target)
    reached = {0: 0}
    for count in range(most + 1):
        ways = [first for gone, first in reached.items() if any(not mask & ~gone for mask in in_the_way[target])]
        if ways:
            return count, _union(ways)
        reached = _after_one_more(in_the_way, matters, reached, is_first=count == 0)
    return -1, 0


def _after_one_more(
    in_the_way: Sequence[set[int]], matters: Sequence[int], reached: dict[int, int], is_first: bool
) -> dict[int, int]:
    """What can be gone after one more clearance, and the objects with which this can begin."""
    found: dict[int, int] = {}
    for gone, first in reached.items():
        for i in matters:
            bit = 1 << i
            if not gone & bit and any(not mask & ~gone for mask in in_the_way[i]):
                found[gone | bit] = found.get(gone | bit, 0) | (bit if is_first else first)
    return found


def _matter(in_the_way: Sequence[set[int]], target: int) -> list[int]:
    """The objects that may have to be cleared: in the way of the target, or of one of these; without the target."""
    found, new = 0, _union(in_the_way[target])
    while new:
        found |= new
        hidden = [row for i, row in enumerate(in_the_way) if new >> i & 1 and 0 not in row]
        new = _union(mask for row in hidden for mask in row) & ~found
    return [i for i in range(len(in_the_way)) if found >> i & 1 and i != target]


def _union(masks: Iterable[int]) -> int:
    return reduce(or_, masks, 0)
