"""Scenes after a drawer or door has moved, and the objects that move with it."""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import fields, replace

import numpy as np
from numpy.typing import NDArray

from planners.regions import RESTING, Region, with_those_on
from planners.scene.bodies import Body
from planners.scene.openings import Opening
from planners.scene.scene import Scene
from planners.scene.solid import Solid, StaticObstacle

Array = NDArray[np.float64]


def carried_by(scene: Scene, opening: Opening) -> tuple[str, ...]:
    """Names of the objects on a drawer or door, directly or on each other, which move with it."""
    faces = [one for one in scene.static_obstacles if one.name in opening.parts]
    standing = [body for body in scene.objects if body.name not in scene.held_names]
    found = [body for body in standing if any(_stands_on(body, face) for face in faces)]
    return tuple(body.name for body in with_those_on(found, standing))


def _stands_on(body: Body, face: StaticObstacle) -> bool:
    return abs(body.bottom - face.top) <= RESTING and bool(face.is_under(body.position[:2]))


def moved(scene: Scene, name: str, position: float, besides: Collection[str] = ()) -> Scene:
    """Move an opening to a position, and the objects in it along with it. Returns the new scene.

    A support that is tilted there, such as the top of a lid, is none any more, nor are the regions on it.

    Args:
        scene: the world.
        name: name of the opening.
        position: [m] or [rad].
        besides: names of further objects that move with it.

    Raises:
        UnknownOpening: no opening of that name.
    """
    opening = scene.opening(name)
    T = opening.motion(position)
    R, p = T[:3, :3], T[:3, 3]
    along = {*carried_by(scene, opening), *besides}
    parts = frozenset(opening.parts)
    obstacles = tuple(one.moved(R, p) if one.name in parts else one for one in scene.static_obstacles)
    tilted = {one.name for one in obstacles if one.name in parts and not one.has_level_top}
    return replace(
        scene,
        static_obstacles=obstacles,
        supports=tuple(one for one in scene.supports if one not in tilted),
        support_bodies=tuple(pair for pair in scene.support_bodies if pair[1] not in tilted),
        objects=tuple(one.at_pose(T @ one.pose) if one.name in along else one for one in scene.objects),
        openings=tuple(_opening_in(one, opening, position, R, p) for one in scene.openings),
        regions=tuple(
            _region_in(one, R, p) if one.support in parts else one for one in scene.regions if one.support not in tilted
        ),
    )


def without_pull(scene: Scene) -> Scene:
    """Put the handle back among the static obstacles of the scene. Returns the new scene."""
    if scene.pull is None:
        return scene
    handle = scene.body(scene.pull.handle)
    parts = [
        StaticObstacle(**{field.name: getattr(solid, field.name) for field in fields(Solid)}) for solid in handle.placed
    ]
    return replace(
        scene,
        objects=tuple(one for one in scene.objects if one is not handle),
        static_obstacles=(*scene.static_obstacles, *parts),
        pull=None,
    )


def _opening_in(one: Opening, moving: Opening, position: float, R: Array, p: Array) -> Opening:
    """An opening after another has moved: the moved opening at its new position, or a lever moved along with it."""
    if one.name == moving.name:
        return replace(one, position=position)
    if {*one.parts} <= {*moving.parts}:
        return replace(one, axis=R @ one.axis, point=p + R @ one.point)
    return one


def _region_in(region: Region, R: Array, p: Array) -> Region:
    """A region on an obstacle that has moved, by a turn about the vertical or without a turn."""
    x, y = p[:2] + R[:2, :2] @ np.array(region.centre)
    return replace(region, centre=(float(x), float(y)), yaw=region.yaw + math.atan2(R[1, 0], R[0, 0]))
