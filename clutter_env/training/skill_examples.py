"""Examples for the skill network: scenes with what is in the way of every grasp, and the good skills that follow.

Labels are found from the grasps in a scene without motions. Every object of a scene is the target once.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields
from functools import reduce
from operator import or_
from pathlib import Path
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from clutter_env.envs.skill import BODY_FIELDS
from clutter_env.errors import DatasetError
from clutter_env.policies.skill_network import YAWS, YAWS_OF_DIRECTION
from planners import DIRECTIONS, Scene, SkillPlanner, generate_grasps

MAX_CLEARANCES = 4
"""Scenes that need more clearances get no labels: the search grows with the power of their number."""
_PRESENT, _IS_TARGET = BODY_FIELDS.index("present"), BODY_FIELDS.index("is_target")


@dataclass(frozen=True, eq=False)
class LabelledScenes:
    """k scenes of n objects with the grasps of all objects.

    Attributes:
        bodies: (k, n, f) `BODY_FIELDS` of the observation.
        is_reachable: (k, n, yaws) whether there is a grasp at that yaw, whatever stands in its way.
        masks: (k, n, yaws) objects in the way of the grasp with the fewest, bit j for object j; 0 where there is none.
    """

    bodies: NDArray[np.float32]
    is_reachable: NDArray[np.bool_]
    masks: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.bodies)

    def save(self, path: Path) -> None:
        """Write them to a file (npz)."""
        np.savez_compressed(path, **{field.name: getattr(self, field.name) for field in fields(self)})

    @classmethod
    def load(cls, path: Path) -> LabelledScenes:
        """Read them from a file."""
        with np.load(path) as file:
            return cls(*(file[field.name] for field in fields(cls)))

    @classmethod
    def joined(cls, parts: Sequence[LabelledScenes]) -> LabelledScenes:
        """Join several."""
        return cls(*(np.concatenate([getattr(part, field.name) for part in parts]) for field in fields(cls)))


def collect_scenes(env: gym.Env[Any, Any], seeds: Sequence[int], rng: np.random.Generator) -> LabelledScenes:
    """One scene for every seed of a kinematic Skill environment: as drawn, or after some random clearing skills."""
    skills: Any = env.unwrapped
    bodies: list[NDArray[np.float32]] = []
    grasps: list[tuple[NDArray[np.bool_], NDArray[np.int64]]] = []
    planner: SkillPlanner | None = None
    for seed in seeds:
        observation, _ = env.reset(seed=seed)
        planner = planner or SkillPlanner.of(skills.scene)
        for _ in range(rng.integers(skills.budget)):
            clearing = np.flatnonzero(skills.action_masks(geometric=False)[:-1])
            observation, *_ = env.step(int(rng.choice(clearing)))
        rows = observation[:-2].reshape(len(skills.scene.names), len(BODY_FIELDS) + DIRECTIONS)
        bodies.append(rows[:, : len(BODY_FIELDS)])
        grasps.append(grasp_obstacles(planner, skills.scene))
    is_reachable, masks = (np.array(part) for part in zip(*grasps, strict=True))
    return LabelledScenes(np.array(bodies), is_reachable, masks)


def grasp_obstacles(planner: SkillPlanner, scene: Scene) -> tuple[NDArray[np.bool_], NDArray[np.int64]]:
    """Reachable grasps (n, yaws) of a scene in which nothing is held, and masks of what is in their way.

    Yaws of boxes count as the nearest ones of round objects.
    """
    is_reachable = np.zeros((len(scene.objects), YAWS), dtype=np.bool_)
    masks = np.zeros(is_reachable.shape, dtype=np.int64)
    for i, body in enumerate(scene.objects):
        for pose in generate_grasps(body, scene.robot):
            yaw = round(pose.yaw / (2 * math.pi / YAWS)) % YAWS
            found = [grasp.blockers for grasp in planner.candidates(scene, body, [pose])]
            if is_reachable[i, yaw]:
                found.append(int(masks[i, yaw]))
            if found:
                is_reachable[i, yaw], masks[i, yaw] = True, min(found, key=int.bit_count)
    return is_reachable, masks


@dataclass(frozen=True, eq=False)
class SkillExamples:
    """k choices in labelled scenes, all of which have a good skill.

    Attributes:
        scenes: the scenes.
        scene: (k,) index of the scene of each choice.
        target: (k,) index of the target.
        is_good, is_free: (k, m) see `SkillLabels`.
        clearances: (k,) see `SkillLabels`.
    """

    scenes: LabelledScenes
    scene: NDArray[np.int64]
    target: NDArray[np.int64]
    is_good: NDArray[np.bool_]
    is_free: NDArray[np.bool_]
    clearances: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.scene)

    @classmethod
    def of(cls, scenes: LabelledScenes) -> SkillExamples:
        """All choices with a good skill, every object of every scene being the target once.

        Raises:
            DatasetError: there are none.
        """
        found = [
            (scene, target, skill_labels(scenes.is_reachable[scene], scenes.masks[scene], target))
            for scene in range(len(scenes))
            for target in np.flatnonzero(scenes.bodies[scene, :, _PRESENT]).tolist()
        ]
        kept = [(scene, target, *labels) for scene, target, labels in found if labels.is_good.any()]
        if not kept:
            raise DatasetError("none of these scenes has a good skill; use more of them")
        return cls(scenes, *(np.array(column) for column in zip(*kept, strict=True)))

    def bodies(self, rows: NDArray[np.int64]) -> NDArray[np.float32]:
        """(k, n, f) `BODY_FIELDS` of some choices, their targets marked."""
        bodies = self.scenes.bodies[self.scene[rows]].copy()
        bodies[..., _IS_TARGET] = 0
        bodies[np.arange(len(rows)), self.target[rows], _IS_TARGET] = 1
        return bodies


class SkillLabels(NamedTuple):
    """Labels of the skills in one scene; their order is that of the actions of `Skill`.

    Attributes:
        is_good: (m,) free skills after which the fewest clearances are left; none if there is no solution.
        is_free: (m,) whether the skill has a grasp with nothing in its way.
        clearances: how many are needed before the target is free; -1 if more than `MAX_CLEARANCES`, or if there is no
            solution.
    """

    is_good: NDArray[np.bool_]
    is_free: NDArray[np.bool_]
    clearances: int


def skill_labels(is_reachable: NDArray[np.bool_], masks: NDArray[np.int64], target: int) -> SkillLabels:
    """The labels of a scene in which nothing is held, from its grasps (n, yaws); see `grasp_obstacles`.

    Cleared objects are taken to be in nothing's way: they are put where they keep clear of the target's grasp.
    """
    is_free_yaw = is_reachable & (masks == 0)
    takes = is_free_yaw[target].any()
    clears = is_free_yaw[:, YAWS_OF_DIRECTION].any(axis=2)
    clears[target] = False
    in_the_way = [set(row[reached].tolist()) for row, reached in zip(masks, is_reachable, strict=True)]
    clearances, first = clearances_left(in_the_way, target)
    is_helpful = np.array([bool(first >> i & 1) for i in range(len(clears))])
    return SkillLabels(np.append(clears & is_helpful[:, None], takes), np.append(clears, takes), clearances)


def clearances_left(in_the_way: Sequence[set[int]], target: int, most: int = MAX_CLEARANCES) -> tuple[int, int]:
    """Fewest clearances before some grasp of the target is free, and the mask of objects with which they can begin.

    Args:
        in_the_way: for every object the masks of what is in the way of its grasps.
        target: its index.
        most: clearances at most.

    Returns:
        -1 and 0 if more than `most` are needed, or if none frees it.
    """
    matters = _matter(in_the_way, target)
    reached = {0: 0}  # what can be gone after `count` clearances, and the objects with which this can begin
    for count in range(most + 1):
        firsts = [first for gone, first in reached.items() if any(not mask & ~gone for mask in in_the_way[target])]
        if firsts:
            return count, _union(firsts)
        after: dict[int, int] = {}
        for gone, first in reached.items():
            for i in matters:
                bit = 1 << i
                if not gone & bit and any(not mask & ~gone for mask in in_the_way[i]):
                    after[gone | bit] = after.get(gone | bit, 0) | (first if count else bit)
        reached = after
    return -1, 0


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
