"""Checks that a scene can be planned in."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations

import numpy as np

from planners.collision.geometry import are_within
from planners.collision.world import CollisionWorld
from planners.scene import STATIC_BIT, Scene, SceneError

OVERLAP = 0.002
"""[m] by which objects may overlap, and the robot may overlap static obstacles: more than soft contacts allow."""


def validate(world: CollisionWorld) -> None:
    """Check that the objects of a scene do not overlap and that the robot is not inside a static obstacle.

    Raises:
        SceneError: they do, or it is; the message names them.
    """
    scene = world.scene
    pairs = [pair for pair in _overlaps(world) if not set(scene.held_names) & set(pair)]
    if pairs:
        raise SceneError(f"objects overlap: {', '.join(f'{one} and {other}' for one, other in pairs)}")
    if _touches_static(world.with_padding(-OVERLAP)):
        raise SceneError(
            f"the robot is inside {' and '.join(_around(scene))} at base pose {np.round(scene.state.base, 3).tolist()}"
        )


def _around(scene: Scene) -> list[str]:
    """What the robot is inside of."""
    if _is_inside(replace(scene, static_obstacles=())):
        return ["the ground"]
    return [one.name for one in scene.static_obstacles if _is_inside(replace(scene, static_obstacles=(one,)))]


def _is_inside(scene: Scene) -> bool:
    """Whether the robot overlaps the ground or a static obstacle by more than `OVERLAP`."""
    return _touches_static(CollisionWorld.from_scene(replace(scene, objects=(), held=None, aside=()), padding=-OVERLAP))


def _touches_static(world: CollisionWorld) -> bool:
    """Whether the robot, where it stands, hits the ground or a static obstacle."""
    state, objects = world.scene.state, world.scene.mask(world.scene.names)
    return bool(world.hits(state.base, state.q, 0.0, ignore=objects) >> STATIC_BIT & 1)


def _overlaps(world: CollisionWorld) -> list[tuple[str, str]]:
    """Pairs of objects that overlap by more than `OVERLAP`."""
    obstacles, names = world.obstacles, world.scene.names
    shrunk = obstacles.objects._replace(half=np.maximum(obstacles.objects.half - OVERLAP / 2, 1e-4))
    simplex = np.empty((4, 3))
    found: list[tuple[str, str]] = []
    for i, j in combinations(range(len(names)), 2):
        away = np.linalg.norm(shrunk.position[i, :2] - shrunk.position[j, :2])
        if away < obstacles.radius[i] + obstacles.radius[j] and are_within(shrunk, i, shrunk, j, 0.0, simplex):
            found.append((names[i], names[j]))
    return found
