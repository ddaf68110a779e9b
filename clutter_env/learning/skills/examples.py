"""Examples of what to do next by skills: labelled scenes with each of their objects as the target."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clutter_env.envs.skill import BODY_FIELDS
from clutter_env.learning.skills.labels import skill_labels
from clutter_env.learning.skills.scenes import LabelledScenes

__all__ = ["SkillExamples", "examples_of"]

_PRESENT, _IS_TARGET = BODY_FIELDS.index("present"), BODY_FIELDS.index("is_target")


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

    def bodies(self, rows: NDArray[np.int64]) -> NDArray[np.float32]:
        """(k, n, f) `BODY_FIELDS` of some choices, their targets marked."""
        bodies = self.scenes.bodies[self.scene[rows]].copy()
        bodies[..., _IS_TARGET] = 0
        bodies[np.arange(len(rows)), self.target[rows], _IS_TARGET] = 1
        return bodies


def examples_of(scenes: LabelledScenes) -> SkillExamples:
    """All choices with a good skill, every object of every scene being the target once."""
    found = [
        (scene, target, skill_labels(scenes.obstacles(scene), target))
        for scene in range(len(scenes))
        for target in np.flatnonzero(scenes.bodies[scene, :, _PRESENT]).tolist()
    ]
    kept = [(scene, target, labels) for scene, target, labels in found if labels.is_good.any()]
    return SkillExamples(
        scenes=scenes,
        scene=np.array([scene for scene, _, _ in kept]),
        target=np.array([target for _, target, _ in kept]),
        is_good=np.array([labels.is_good for _, _, labels in kept]),
        is_free=np.array([labels.is_free for _, _, labels in kept]),
        clearances=np.array([labels.clearances for _, _, labels in kept]),
    )
