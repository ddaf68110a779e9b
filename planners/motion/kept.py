"""Cache of motions for later scenes. A motion is reused if no moved object comes near it."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple, TypeVar

from planners.collision.world import CollisionWorld
from planners.motion.path import CLEARANCE, WholeBodyPath
from planners.scene import Scene

Found = TypeVar("Found")


class _Entry(NamedTuple):
    found: object
    scene: Scene
    paths: Sequence[WholeBodyPath]


@dataclass
class KeptMotions:
    """Motions planned before, by query.

    Motions of the present scene are only reused in later scenes. So the first solve is the same with and without the
    cache.
    """

    _before: dict[Hashable, _Entry] = field(default_factory=dict, repr=False)
    _now: dict[Hashable, _Entry] = field(default_factory=dict, repr=False)

    def for_next_scene(self) -> KeptMotions:
        """Motions of this scene, reused ones included, for the next scene."""
        return KeptMotions(self._now)

    def find(self, key: Hashable, kind: type[Found], world: CollisionWorld) -> Found | None:
        """Find the motion of an earlier, equal query, if it keeps `CLEARANCE` from all objects that have moved since.

        Args:
            key: the query: start, end, and the object that is taken or put down.
            kind: class of the result.
            world: the compiled scene as it is now, with the same static obstacles as before.
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
        """Keep a motion for later scenes."""
        self._now[key] = _Entry(found, scene, paths)
