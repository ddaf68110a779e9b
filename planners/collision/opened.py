"""Swept volume of a drawer or door whose handle is pulled, and the scene after it has moved."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from planners.collision.world import CollisionWorld, are_near
from planners.scene import Opening, Scene, Solid
from planners.scene.moving import carried_by, moved

Array = NDArray[np.float64]

STEPS = 12
"""Places on the way of a drawer or door at which collisions are tested."""
GAP = 0.004
"""[m] Gap between a moving drawer or door and other objects, and between its way and objects that are put down."""


def way(opening: Opening, position: float, steps: int = STEPS) -> Array:
    """Positions (steps,) on the way to another position, without the present one."""
    return np.asarray(np.linspace(opening.position, position, steps + 1)[1:])


def pulled(scene: Scene, position: float | None = None, turned: float | None = None) -> Scene:
    """Scene after its handle has been pulled, to `position` or to the position of the pull. A lever is turned first."""
    assert scene.pull is not None
    pull = scene.pull
    if pull.lever:
        scene = moved(scene, pull.lever, pull.turned if turned is None else turned, [pull.handle])
    return moved(scene, pull.opening, pull.position if position is None else position, [pull.handle])


def is_pushed(scene: Scene, name: str) -> bool:
    """Whether an object represents a part of a drawer or door that closed fingers push."""
    return scene.pull is not None and scene.pull.pushes and scene.pull.handle == name


def without_moving(scene: Scene) -> Scene:
    """Scene without the parts that move with its handle: everything that stays in place during the pull."""
    assert scene.pull is not None
    moving = {*scene.opening(scene.pull.opening).parts}
    return replace(scene, static_obstacles=tuple(one for one in scene.static_obstacles if one.name not in moving))


def riding(scene: Scene) -> tuple[str, ...]:
    """Names of the objects that move with the pulled drawer or door, including the handle."""
    assert scene.pull is not None
    return (*carried_by(scene, scene.opening(scene.pull.opening)), scene.pull.handle)


def swept_objects(world: CollisionWorld) -> int:
    """Mask of the objects in the swept volume of the pulled drawer or door, except those that move with it."""
    scene = world.scene
    assert scene.pull is not None
    opening, mask = scene.opening(scene.pull.opening), 0
    left_alone = {*riding(scene), *scene.held_names}
    parts: list[Solid] = [one for one in scene.static_obstacles if one.name in opening.parts]
    parts += scene.body(scene.pull.handle).placed
    others = [body for body in scene.objects if body.name not in left_alone]
    for position in way(opening, scene.pull.position):
        T = opening.motion(position)
        there = [part.moved(T[:3, :3], T[:3, 3]) for part in parts]
        for body in others:
            bit = 1 << scene.index(body.name)
            if not mask & bit and are_near(there, body, GAP):
                mask |= bit
    return mask
