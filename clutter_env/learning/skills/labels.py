"""Which skills bring the target nearest: labels for a network, found from the grasps in a scene without motions."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planners.scene import Scene
from planners.skills.geometry import DIRECTIONS, Skill, SkillGeometry

__all__ = ["MOST_CLEARANCES", "SkillLabels", "clearances_left", "skill_labels"]

MOST_CLEARANCES = 4
"""Scenes that need more clearances get no labels: the search grows with the power of their number."""


@dataclass(frozen=True, eq=False)
class SkillLabels:
    """What is known of the skills in one scene; their order is that of the actions of `Skill`.

    Attributes:
        is_good: (m,) free skills after which the fewest clearances are left; none if there is no solution.
        is_free: (m,) whether the skill has a grasp with nothing in its way, of those in `is_known`.
        is_known: (m,) for which skills `is_free` was found.
        clearances: how many are needed before the target is free; -1 if more than `MOST_CLEARANCES`, or if there is no
            solution.
    """

    is_good: NDArray[np.bool_]
    is_free: NDArray[np.bool_]
    is_known: NDArray[np.bool_]
    clearances: int


def skill_labels(geometry: SkillGeometry, scene: Scene, target: str, also: Collection[str] = ()) -> SkillLabels:
    """The labels of a scene in which nothing is held.

    Cleared objects are taken to be in nothing's way: they are put where they keep clear of the target's grasp.

    Args:
        geometry: of the skills.
        scene: with the target on the table.
        target: its name.
        also: objects that need not be cleared, for which free skills are found as well.
    """
    in_the_way = _obstructions(geometry, scene, target)
    needed = clearances_left(in_the_way, target)
    helpful = [
        name
        for name in in_the_way
        if name != target and needed > 0 and clearances_left(in_the_way, target, {name}, needed - 1) >= 0
    ]
    size = len(scene.names) * DIRECTIONS + 1
    is_good, is_free, is_known = (np.zeros(size, dtype=np.bool_) for _ in range(3))
    for name in {target, *helpful, *also}:
        actions = slice(scene.names.index(name) * DIRECTIONS, (scene.names.index(name) + 1) * DIRECTIONS)
        is_known[actions] = True
        is_free[actions] = [_is_free(geometry, scene, Skill(name, direction)) for direction in range(DIRECTIONS)]
        is_good[actions] = is_free[actions] & (name in helpful)
    is_known[-1] = True
    is_free[-1] = is_good[-1] = needed == 0
    return SkillLabels(is_good, is_free, is_known, needed)


def clearances_left(
    in_the_way: Mapping[str, Collection[frozenset[str]]],
    target: str,
    cleared: Collection[str] = (),
    most: int = MOST_CLEARANCES,
) -> int:
    """Fewest clearances before some grasp of the target is free; -1 if more than `most`, or if none frees it.

    Args:
        in_the_way: the objects in the way of each grasp of an object, for the target and for what can be cleared.
        target: its name.
        cleared: objects that are out of the way already.
        most: clearances at most.
    """
    reached = {frozenset(cleared)}
    for count in range(most + 1):
        if any(obstacles <= gone for gone in reached for obstacles in in_the_way[target]):
            return count
        reached = {
            gone | {name}
            for gone in reached
            for name, grasps in in_the_way.items()
            if name != target and name not in gone and any(obstacles <= gone for obstacles in grasps)
        }
    return -1


def _obstructions(geometry: SkillGeometry, scene: Scene, target: str) -> dict[str, list[frozenset[str]]]:
    """What is in the way of the grasps of the target, and of all that may have to be cleared for it."""
    found: dict[str, list[frozenset[str]]] = {}
    todo = [target]
    while todo:
        name = todo.pop()
        masks = {grasp.blockers for grasp in geometry.options(scene, Skill(name))}
        sets = [frozenset(scene.names_of(mask)) for mask in masks]
        found[name] = [obstacles for obstacles in sets if target not in obstacles and len(obstacles) <= MOST_CLEARANCES]
        if frozenset() in found[name]:
            continue
        todo += [other for other in frozenset().union(*found[name]) if other not in found and other not in todo]
    return found


def _is_free(geometry: SkillGeometry, scene: Scene, skill: Skill) -> bool:
    return any(grasp.blockers == 0 for grasp in geometry.options(scene, skill))
