"""Scenes of the Skill environment on its kinematic model, with what is in the way of every grasp."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from clutter_env.envs.skill import BODY_FIELDS
from clutter_env.learning.skills.obstacles import GraspObstacles, grasp_obstacles
from planners import DIRECTIONS, SkillGeometry, skill_geometry

__all__ = ["LabelledScenes", "collect_scenes"]


@dataclass(frozen=True, eq=False)
class LabelledScenes:
    """k scenes of n objects with the grasps of all objects.

    Attributes:
        bodies: (k, n, f) `BODY_FIELDS` of the observation.
        is_reachable, masks: (k, n, yaws) see `GraspObstacles`.
    """

    bodies: NDArray[np.float32]
    is_reachable: NDArray[np.bool_]
    masks: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.bodies)

    def obstacles(self, index: int) -> GraspObstacles:
        """The grasps of one scene."""
        return GraspObstacles(self.is_reachable[index], self.masks[index])

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
        """All of several."""
        return cls(*(np.concatenate([getattr(part, field.name) for part in parts]) for field in fields(cls)))


def collect_scenes(env: gym.Env[Any, Any], seeds: Sequence[int], rng: np.random.Generator) -> LabelledScenes:
    """One scene for every seed, with its labels: as it is drawn, or after some of its objects have been cleared.

    Args:
        env: a Skill environment on the kinematic model.
        seeds: of the scenes.
        rng: chooses how many skills are tried, and which.
    """
    skills: Any = env.unwrapped
    bodies: list[NDArray[np.float32]] = []
    found: list[GraspObstacles] = []
    geometry: SkillGeometry | None = None
    for seed in seeds:
        observation, _ = env.reset(seed=seed)
        geometry = geometry or skill_geometry(skills.scene)
        for _ in range(rng.integers(skills.budget)):
            clearing = np.flatnonzero(skills.action_masks(geometric=False)[:-1])
            observation, *_ = env.step(int(rng.choice(clearing)))
        rows = observation[:-2].reshape(len(skills.scene.names), len(BODY_FIELDS) + DIRECTIONS)
        bodies.append(rows[:, : len(BODY_FIELDS)])
        found.append(grasp_obstacles(geometry, skills.scene))
    return LabelledScenes(
        bodies=np.array(bodies),
        is_reachable=np.array([obstacles.is_reachable for obstacles in found]),
        masks=np.array([obstacles.masks for obstacles in found]),
    )
