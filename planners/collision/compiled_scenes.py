"""Collision worlds by scene: the arrangements of objects that occur in one solve are compiled once each."""

from __future__ import annotations

from dataclasses import replace

from planners.collision.world import CollisionWorld
from planners.scene import Scene

_KEPT = 32
"""Arrangements kept, one for each arm; a look-ahead goes through one for each object to clear."""


class CompiledScenes:
    """Compiles scenes and remembers them: where only the robot or what it holds differs, the arrays are shared.

    Created once in a solve and handed down. Two scenes have the same arrangement if they have the very same bodies.
    """

    def __init__(self) -> None:
        """Start with nothing compiled."""
        self._worlds: dict[tuple[object, ...], CollisionWorld] = {}

    def world(self, scene: Scene) -> CollisionWorld:
        """The scene, compiled; its `scene` attribute is the one asked for."""
        key = (scene.robot, *scene.supports, *scene.static_obstacles, *scene.objects, *scene.aside)
        known = self._worlds.pop(key, None)
        if known is None:
            known = CollisionWorld.from_scene(scene)
        elif known.scene is not scene:
            known = replace(known, scene=scene)
        self._worlds[key] = known
        if len(self._worlds) > _KEPT:
            del self._worlds[next(iter(self._worlds))]
        return known
