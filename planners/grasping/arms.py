"""The grasps of a robot that acts with several arms: each arm has its own, and all are offered together."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from planners.grasping.candidates import GraspCandidate, GraspCandidates, best_first
from planners.scene import Scene

Array = NDArray[np.float64]


class _Merged(NamedTuple):
    """The grasps of one object by arm, and all of them."""

    parts: tuple[tuple[GraspCandidate, ...], ...]
    merged: tuple[GraspCandidate, ...]


@dataclass
class ArmCandidates(GraspCandidates):
    """The grasps of a scene's objects through every arm. The idle arms are at home, with what they hold.

    Attributes:
        by_arm: the grasps of each arm, by its name; the other attributes are those of one of them.
    """

    by_arm: Mapping[str, GraspCandidates] = field(default_factory=lambda: MappingProxyType({}))
    _seen: Scene | None = None
    _views: dict[str, Scene] = field(default_factory=dict)
    _merged: dict[str, _Merged] = field(default_factory=dict)

    @classmethod
    def of(cls, by_arm: Mapping[str, GraspCandidates]) -> ArmCandidates:
        """The grasps of several arms; they share their compiled scenes."""
        one = next(iter(by_arm.values()))
        return cls(one.placer, one.chain, one.config, one.compiled, one.families, by_arm=MappingProxyType({**by_arm}))

    def for_object(self, scene: Scene, name: str) -> tuple[GraspCandidate, ...]:
        """As `GraspCandidates.for_object`, of all arms."""
        if scene is not self._seen:
            self._seen, self._views = scene, {arm: scene.using(arm) for arm in self.by_arm}
        parts = tuple(source.for_object(self._views[arm], name) for arm, source in self.by_arm.items())
        known = self._merged.get(name)
        if known is None or any(part is not before for part, before in zip(parts, known.parts, strict=True)):
            known = self._merged[name] = _Merged(parts, best_first(grasp for part in parts for grasp in part))
        return known.merged

    def from_base(self, scene: Scene, name: str, base: Array) -> tuple[GraspCandidate, ...]:
        """As `GraspCandidates.from_base`, of all arms."""
        views = {arm: scene.using(arm) for arm in self.by_arm}
        return best_first(
            grasp for arm, source in self.by_arm.items() for grasp in source.from_base(views[arm], name, base)
        )

    def blank_copy(self) -> ArmCandidates:
        """As `GraspCandidates.blank_copy`."""
        copies = {arm: candidates.blank_copy() for arm, candidates in self.by_arm.items()}
        return replace(self, by_arm=MappingProxyType(copies), _seen=None, _views={}, _merged={})

    def ban(self, scene: Scene, grasp: GraspCandidate) -> None:
        """As `GraspCandidates.ban`."""
        self.by_arm[grasp.arm].ban(scene.using(grasp.arm), grasp)

    def obstruct(self, scene: Scene, grasp: GraspCandidate, blockers: int) -> None:
        """As `GraspCandidates.obstruct`."""
        self.by_arm[grasp.arm].obstruct(scene.using(grasp.arm), grasp, blockers)
