"""What a drawer or door touches on its way, and the scene with it elsewhere: of a handle that is to be pulled."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from planners.collision.world import CollisionWorld, are_near
from planners.scene import Opening, Scene, Solid
from planners.scene.moving import carried_by, moved

Array = NDArray[np.float64]

STEPS = 12
"""Places on the way of what opens at which is looked what it touches."""
GAP = 0.004
"""[m] that what opens keeps from objects on its way, and what is put down from there."""


def way(opening: Opening, position: float, steps: int = STEPS) -> Array:
    """Positions (steps,) on the way to another one, without the present one."""
    return np.asarray(np.linspace(opening.position, position, steps + 1)[1:])


def pulled(scene: Scene, position: float | None = None, turned: float | None = None) -> Scene:
    """A scene with a handle after it has been pulled, to a position or as far as it is to be, a lever turned before."""
    assert scene.pull is not None
    pull = scene.pull
    if pull.lever:
        scene = moved(scene, pull.lever, pull.turned if turned is None else turned, [pull.handle])
    return moved(scene, pull.opening, pull.position if position is None else position, [pull.handle])


def is_pushed(scene: Scene, name: str) -> bool:
    """Whether an object stands for a part of what opens that closed fingers push."""
    return scene.pull is not None and scene.pull.pushes and scene.pull.handle == name


def without_moving(scene: Scene) -> Scene:
    """A scene with a handle without the parts that move with it: what stays where it is while it is pulled."""
    assert scene.pull is not None
    moving = {*scene.opening(scene.pull.opening).parts}
    return replace(scene, static_obstacles=tuple(one for one in scene.static_obstacles if one.name not in moving))


def riding(scene: Scene) -> tuple[str, ...]:
    """Names of the objects that move with what is pulled, the handle among them."""
    assert scene.pull is not None
    return (*carried_by(scene, scene.opening(scene.pull.opening)), scene.pull.handle)


def swept_objects(world: CollisionWorld) -> int:
    """Mask of the objects that what is pulled would touch on its way, other than those that ride on it."""
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
