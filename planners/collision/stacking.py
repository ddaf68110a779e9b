"""Which objects stand on others: what stands on an object must be cleared before it is grasped."""

from __future__ import annotations

import numpy as np

from planners.collision.geometry import are_within
from planners.collision.world import SUPPORT_SLACK, CollisionWorld
from planners.scene import Body

_CONTACT = 0.002
"""[m] Objects nearer than this touch each other."""
_STEP = 0.005
"""[m] that the lowest point of an object may be below the highest point of the one it stands on: one of them leans."""


def objects_on(world: CollisionWorld, name: str) -> int:
    """Mask of the objects that stand on that one, directly or on each other.

    Raises:
        UnknownObject: no such object.
    """
    scene = world.scene
    below = [scene.body(name)]
    found = 0
    for supporter in below:
        for index, body in enumerate(scene.objects):
            if not found >> index & 1 and _stands_on(world, body, supporter):
                found |= 1 << index
                below.append(body)
    return found


def with_room_below(world: CollisionWorld, name: str) -> CollisionWorld:
    """The same world with the objects under that one lowered by the padding, so that it can be lifted from them.

    Raises:
        UnknownObject: no such object.
    """
    body = world.scene.body(name)
    for other in world.scene.objects:
        if _stands_on(world, body, other):
            world = world.with_body(other.at(other.position - [0.0, 0.0, world.padding + SUPPORT_SLACK]))
    return world


def _stands_on(world: CollisionWorld, body: Body, supporter: Body) -> bool:
    """Whether one object touches another that is under it; a held object stands on nothing."""
    scene = world.scene
    is_held = any(name in scene.held_names for name in (body.name, supporter.name))
    if is_held or body.bottom < supporter.top - _STEP:
        return False
    solids = world.obstacles.objects
    return bool(
        are_within(solids, scene.index(body.name), solids, scene.index(supporter.name), _CONTACT, np.empty((4, 3)))
    )
