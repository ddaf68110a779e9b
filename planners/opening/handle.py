"""The scene in which a handle stands among the objects, so that it is taken as they are: among others in its way.

What is in the way of the drawer or door is in the way of the handle: it blocks all grasps of it, and nothing is put
where they pass. The rest of planning needs to know no more.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from planners.collision.opened import GAP, STEPS, way
from planners.collision.world import CollisionWorld, are_near, is_inside_static, overlaps
from planners.opening.latches import Latch
from planners.problem import not_sunk
from planners.regions import Region
from planners.scene import MAX_OBJECTS, Body, Opening, Pull, Scene, Solid, StaticObstacle
from planners.scene.moving import carried_by, moved

Array = NDArray[np.float64]

HANDLE_OF = "handle of "
"""Before the name of what opens: the name of the object that stands for its handle."""
_BACK = (0.0, 0.3, 0.6, 0.9, 1.2)
"""[m] that a robot is farther back where it stands in the way of what opens."""
_OVER = 0.3
"""[m] above a support up to which something passes in the way of what is put down there."""


def with_handle(
    scene: Scene, name: str, position: float, handle: tuple[str, ...], pushes: bool = False, latch: Latch | None = None
) -> Scene | None:
    """The scene with a handle among its objects, by which something is opened or shut.

    None if they are too many, or if one of them is sunk into the handle.

    Args:
        scene: as it is.
        name: of what opens.
        position: [m] or [rad] to which it is to be moved.
        handle: names of the parts that are the handle, or that are pushed.
        pushes: whether closed fingers push them.
        latch: the lever that is turned first.
    """
    if len(scene.objects) >= MAX_OBJECTS:
        return None
    opening = scene.opening(name)
    pieces = [one for one in scene.static_obstacles if one.name in handle]
    body = Body.of_pieces(f"{HANDLE_OF}{name}", pieces)
    rest = tuple(one for one in scene.static_obstacles if one.name not in handle)
    twin = replace(
        scene,
        objects=(*scene.objects, body),
        static_obstacles=rest,
        supports=tuple(one for one in scene.supports if one not in handle),
        pull=Pull(body.name, name, position, (), pushes, *(latch or ())),
    )
    if any(body.name in pair for pair in overlaps(CollisionWorld.from_scene(not_sunk(twin)))):
        return None  # objects may be sunk into furniture, but not into each other
    assert twin.pull is not None
    swept = tuple(_swept_regions(scene, opening, position))
    return replace(twin, pull=replace(twin.pull, swept=swept))


def handles_of(scene: Scene, name: str) -> Iterator[tuple[str, ...]]:
    """The parts of what opens that are taken by the hand: those whose names say so together, then one by one."""
    opening = scene.opening(name)
    if opening.handles:
        yield opening.handles
    for one in opening.handles if len(opening.handles) > 1 else ():
        yield (one,)


def as_if_opened(scene: Scene, name: str, position: float) -> Scene:
    """The scene with what opens at a position, as if what was in its way were gone: to find out what would be possible.

    A robot that stands where a door will be is farther back.

    Raises:
        UnknownOpening: nothing of that name opens.
    """
    parts, there = scene.opening(name).parts, moved(scene, name, position)
    along = {*carried_by(scene, scene.opening(name))}
    solids: list[Solid] = [one for one in there.static_obstacles if one.name in parts]
    solids += [solid for one in there.objects if one.name in along for solid in one.placed]
    kept = tuple(one for one in there.objects if one.name in along or not are_near(solids, one, 0.0))
    there = replace(there, objects=kept) if len(kept) < len(there.objects) else there
    x, y, yaw = scene.state.base
    for back in _BACK:
        base = np.array([x - back * np.cos(yaw), y - back * np.sin(yaw), yaw])
        farther = there.with_state(replace(scene.state, base=base)) if back else there
        if not is_inside_static(CollisionWorld.from_scene(farther)):
            return farther
    return there


def without_handle(twin: Scene, scene: Scene) -> Scene:
    """The scene at the end of a plan that has taken a handle: what opens as in another scene, objects where they are.

    Args:
        twin: the scene with the handle at the end of the plan.
        scene: the one before the plan, with what opens as it is then.
    """
    assert twin.pull is not None
    objects = tuple(one for one in twin.objects if one.name != twin.pull.handle)
    return replace(scene, objects=objects, state=twin.state, robot=twin.robot, aside=twin.aside, parked=twin.parked)


def _swept_regions(scene: Scene, opening: Opening, position: float) -> Iterator[Region]:
    """Where on the supports what opens passes so low that nothing may be put there meanwhile."""
    parts = [one for one in scene.static_obstacles if one.name in opening.parts]
    faces = [scene.support_named(name) for name in scene.supports if name not in opening.parts]
    steps = 1 if opening.kind == "slide" else STEPS // 2
    stops = [opening.position, *way(opening, position, steps)]
    for face in faces:
        for k, (one, other) in enumerate(itertools.pairwise(stops)):
            low = [part for part in parts if _passes_over(part, face, opening, (one, other))]
            if low:
                corners = [_corners(part, opening, stop) for part in low for stop in (one, (one + other) / 2, other)]
                points = np.concatenate(corners)
                lower, upper = points.min(axis=0) - GAP, points.max(axis=0) + GAP
                centre, half = (lower + upper) / 2, (upper - lower) / 2
                yield Region(f"way of {opening.name} {k} over {face.name}", face.name, tuple(centre), tuple(half))


def _corners(part: StaticObstacle, opening: Opening, position: float) -> Array:
    """(k, 2) [m] corners of a part, seen from above, with the opening at a position."""
    T = opening.motion(position)
    return np.asarray((part.corners @ T[:3, :3].T + T[:3, 3])[:, :2])


def _passes_over(part: StaticObstacle, face: StaticObstacle, opening: Opening, between: tuple[float, float]) -> bool:
    """Whether a part passes over a support, lower than `_OVER`, between two positions."""
    for position in between:
        T = opening.motion(position)
        there = part.moved(T[:3, :3], T[:3, 3])
        is_beside = ((there.upper < face.lower) | (there.lower > face.upper))[:2].any()
        if not is_beside and there.upper[2] > face.top and there.lower[2] < face.top + _OVER:
            return True
    return False
