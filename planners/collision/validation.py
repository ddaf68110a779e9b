"""Is a scene one that can be planned in?"""

from __future__ import annotations

from itertools import combinations

import numpy as np

from planners.collision.geometry import are_within
from planners.collision.world import CollisionWorld
from planners.scene import FURNITURE_BIT, Scene, SceneError

__all__ = ["validate"]

OVERLAP = 0.002
"""[m] by which objects may sink into each other or into furniture: what soft contacts allow, and more."""


def validate(scene: Scene) -> None:
    """Check that objects do not overlap and that the robot is not inside the furniture.

    Raises:
        SceneError: they do, or it is; the message names them.
    """
    world = CollisionWorld.from_scene(scene, padding=0.0)
    held = "" if scene.held is None else scene.held.name
    pairs = [pair for pair in _overlaps(world) if held not in pair]
    if pairs:
        raise SceneError(f"objects overlap: {', '.join(f'{one} and {other}' for one, other in pairs)}")
    state = scene.state
    hits = world.with_padding(-OVERLAP).hits(state.base, state.q, 0.0, ignore=scene.mask(scene.names))
    if hits >> FURNITURE_BIT & 1:
        raise SceneError(f"the robot is inside the furniture at base pose {np.round(state.base, 3).tolist()}")


def _overlaps(world: CollisionWorld) -> list[tuple[str, str]]:
    """Pairs of objects that share more than a soft contact."""
    obstacles, names = world.obstacles, world.scene.names
    shrunk = obstacles.objects._replace(half=np.maximum(obstacles.objects.half - OVERLAP / 2, 1e-4))
    simplex = np.empty((4, 3))
    found: list[tuple[str, str]] = []
    for i, j in combinations(range(len(names)), 2):
        away = np.linalg.norm(shrunk.position[i, :2] - shrunk.position[j, :2])
        if away < obstacles.radius[i] + obstacles.radius[j] and are_within(shrunk, i, shrunk, j, 0.0, simplex):
            found.append((names[i], names[j]))
    return found
