"""Examples of what to do next by skills: states of the Skill environment on its kinematic model, with their labels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from clutter_env.learning.skills.labels import SkillLabels, skill_labels
from planners.skills.geometry import SkillGeometry, skill_geometry

__all__ = ["SkillExamples", "collect_skills"]

_GOOD_SHARE = 0.6
"""Share of the steps of a collection that take a good skill; the others try any, so that failures are seen too."""
_OTHERS = 3
"""Objects of which it is found in every state from where they can be grasped, whether they must be cleared or not."""


@dataclass(frozen=True, eq=False)
class SkillExamples:
    """States with their labels, k of them.

    Attributes:
        observation: (k, f) of the Skill environment.
        mask: (k, n) skills worth trying, see `SkillEnv.action_masks`.
        is_good, is_free, is_known: (k, n) see `SkillLabels`.
        clearances: (k,) see `SkillLabels`.
    """

    observation: NDArray[np.float32]
    mask: NDArray[np.bool_]
    is_good: NDArray[np.bool_]
    is_free: NDArray[np.bool_]
    is_known: NDArray[np.bool_]
    clearances: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.observation)

    def save(self, path: Path) -> None:
        """Write them to a file (npz)."""
        np.savez_compressed(path, **{field.name: getattr(self, field.name) for field in fields(self)})

    @classmethod
    def load(cls, path: Path) -> SkillExamples:
        """Read them from a file."""
        with np.load(path) as file:
            return cls(*(file[field.name] for field in fields(cls)))

    @classmethod
    def joined(cls, parts: Sequence[SkillExamples]) -> SkillExamples:
        """All of several."""
        return cls(*(np.concatenate([getattr(part, field.name) for part in parts]) for field in fields(cls)))


def collect_skills(env: gym.Env[Any, Any], seeds: Sequence[int], rng: np.random.Generator) -> SkillExamples:
    """Play the scenes of some seeds by good skills and by others, and label all states that have a good one.

    Args:
        env: a Skill environment on the kinematic model.
        seeds: of the scenes.
        rng: chooses the skills.
    """
    skills: Any = env.unwrapped
    rows: list[tuple[NDArray[np.float32], NDArray[np.bool_], SkillLabels]] = []
    geometry: SkillGeometry | None = None
    for seed in seeds:
        observation, _ = env.reset(seed=seed)
        geometry = geometry or skill_geometry(skills.scene)
        labels, labelled, is_over = None, None, False
        while not is_over:
            if labels is None or labelled is not skills.scene:
                also = rng.choice(skills.scene.names, _OTHERS, replace=False)
                labels, labelled = skill_labels(geometry, skills.scene, skills.target, also), skills.scene
            mask = skills.action_masks(geometric=False)
            good = np.flatnonzero(mask & labels.is_good)
            if not len(good):
                break
            rows.append((observation, mask, labels))
            tried = good if rng.random() < _GOOD_SHARE else np.flatnonzero(mask)
            observation, _, terminated, truncated, _ = env.step(int(rng.choice(tried)))
            is_over = terminated or truncated
    return SkillExamples(
        observation=np.array([observation for observation, _, _ in rows]),
        mask=np.array([mask for _, mask, _ in rows]),
        is_good=np.array([labels.is_good for _, _, labels in rows]),
        is_free=np.array([labels.is_free for _, _, labels in rows]),
        is_known=np.array([labels.is_known for _, _, labels in rows]),
        clearances=np.array([labels.clearances for _, _, labels in rows]),
    )
