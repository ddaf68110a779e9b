"""Motions that are kept for scenes that follow: they are used again where nothing that has moved comes near them."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple, TypeVar

from planners.collision.world import CollisionWorld
from planners.motion.path import CLEARANCE, WholeBodyPath
from planners.scene import Scene

Found = TypeVar("Found")


class _Entry(NamedTuple):
    """A motion, the scene that it was planned in, and its paths."""

    found: object
    scene: Scene
    paths: Sequence[WholeBodyPath]


@dataclass
class KeptMotions:
    """Motions that were planned before, by what was asked.

    What is planned now is used in later scenes alone: so a first solve is the same whether its motions are kept or not.
    """

    _before: dict[Hashable, _Entry] = field(default_factory=dict, repr=False)
    _now: dict[Hashable, _Entry] = field(default_factory=dict, repr=False)

    def for_next_scene(self) -> KeptMotions:
        """The motions of this scene, those used again among them, for the scene that follows."""
        return KeptMotions(self._now)

    def find(self, key: Hashable, kind: type[Found], world: CollisionWorld) -> Found | None:
        """The motion planned for the same before, if it keeps `CLEARANCE` from all objects that have moved since.

        Args:
            key: what is asked for: where the motion begins and ends, and what it takes or puts down.
            kind: class of the answer.
            world: the scene as it is now, compiled; its static obstacles are those of before.
        """
        entry = self._before.get(key)
        if entry is None or not isinstance(entry.found, kind):
            return None
        moved, clear = world.scene.moved_since(entry.scene), world.with_padding(CLEARANCE)
        for path in entry.paths if moved else ():
            left_alone = ~moved | path.ignore
            if clear.path_hits(path.configurations, path.opening, path.held, left_alone, first_only=True):
                return None
        self.keep(key, entry.found, world.scene, entry.paths)
        return entry.found

    def keep(self, key: Hashable, found: object, scene: Scene, paths: Sequence[WholeBodyPath]) -> None:
        """Remember a motion for scenes that follow."""
        self._now[key] = _Entry(found, scene, paths)
