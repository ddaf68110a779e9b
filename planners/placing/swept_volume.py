"""Volume(robot, τ) and Volume(object, v) of eq. 1 and 2: shapes that cover the robot and its load on a path.

For what a drawer or a door sweeps see `planners.collision.opened`.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from irm.chain import BASE
from planners.collision.hit_kernels import place_along
from planners.collision.world import CollisionWorld
from planners.grasping.candidates import GraspCandidate
from planners.motion.approaches import Approach, ContactQuery
from planners.motion.path import on_base
from planners.placing.negative_goal_region import SweptVolume, join_volumes
from planners.scene import HeldObject, Solid
from planners.scene.bodies import UPRIGHT_TILT

Array = NDArray[np.float64]

_SPACING = 0.02
"""Spacing [m] of spheres along a capsule. Each is grown so that together they cover it."""
_STEP = 0.01
"""Largest base motion [m] between two configurations of a covered path."""


def grasp_volume(
    world: CollisionWorld, grasp: GraspCandidate, planned: tuple[ContactQuery, Approach] | None
) -> SweptVolume:
    """Compute the swept volume of a grasp: Volume(robot, τ) + Volume(object, v) of eq. 1 and 2.

    τ is the path of the open gripper to the grasp along the `planned` approach (see `planned_approach`). Lift and
    retreat with the object in hand follow. v is the object's own path. The free motions before and after are left out,
    since they may go anywhere. For a grasp without an approach, it is the volume of the robot at the grasp.
    """
    world = world.for_arm(grasp.arm)
    if planned is None:
        return standing_volume(world, grasp)
    query, approach = planned
    empty = path_volume(world, approach.empty, query.empty.opening)
    loaded = path_volume(world, approach.loaded, query.loaded.opening, query.held)
    return join_volumes((empty, loaded))


def standing_volume(world: CollisionWorld, grasp: GraspCandidate) -> SweptVolume:
    """Volume of the robot when the fingers close: part of the grasp's swept volume, and quicker to compute."""
    return path_volume(world.for_arm(grasp.arm), on_base(grasp.base, grasp.q[None]), grasp.opening)


def path_volume(world: CollisionWorld, X: Array, opening: float, held: HeldObject | None = None) -> SweptVolume:
    """Cover torso, arm and held object with shapes, in each configuration of a path.

    The shapes are grown by the padding of the collision world. The base is left out: it stays below the supports.

    Args:
        world: the collision world with the robot.
        X: (n, 11) whole-body configurations. More are inserted where the base moves.
        opening: gripper opening [m].
        held: the held object.
    """
    robot = world.robot
    assert X.shape[1] == 3 + len(robot.lower)
    position, rotation = place_along(world.query(opening, held), _densified(X))
    moving, round_ = robot.link != BASE, robot.radius > 0
    spheres = [
        _along_capsule(position[:, i], rotation[:, i, :, 2], float(robot.half[i, 2]), robot.radius[i] + world.padding)
        for i in np.flatnonzero(moving & round_)
    ]
    boxes = np.flatnonzero(moving & ~round_)
    half_extents = np.tile(robot.half[boxes] + world.padding, (len(position), 1))
    of_robot = SweptVolume(
        spheres=np.concatenate(spheres) if spheres else np.zeros((0, 4)),
        box_centres=position[:, boxes].reshape(-1, 3),
        box_axes=rotation[:, boxes].reshape(-1, 3, 3),
        box_half_extents=half_extents,
    )
    if held is None:
        return of_robot
    shapes, count = world.scene.body(held.name).solids, len(robot.core)
    pieces = [
        _solid_volume(solid, world.padding, position[:, count + k], rotation[:, count + k])
        for k, solid in enumerate(shapes)
    ]
    return join_volumes((of_robot, *pieces))


def _solid_volume(solid: Solid, padding: float, positions: Array, rotations: Array) -> SweptVolume:
    """A solid of the held object at poses (n, 3), (n, 3, 3). All but upright cylinders become boxes around them."""
    half = solid.half_extents + padding
    if solid.shape == "cylinder" and (np.abs(rotations[:, 2, 2]) > np.cos(UPRIGHT_TILT)).all():
        z = positions[:, 2]
        reach = np.abs(rotations[:, 2, 2]) * half[2] + np.sqrt(1 - rotations[:, 2, 2].clip(-1, 1) ** 2) * half[0]
        radius = half[0] + np.hypot(rotations[:, 0, 2], rotations[:, 1, 2]) * half[2]
        return SweptVolume(cylinders=np.column_stack((positions[:, :2], radius, z - reach, z + reach)))
    return SweptVolume(box_centres=positions, box_axes=rotations, box_half_extents=np.tile(half, (len(positions), 1)))


def _densified(X: Array) -> Array:
    """The same path (m, 11) with more configurations where the base moves."""
    counts = np.ceil(np.linalg.norm(np.diff(X[:, :2], axis=0), axis=1) / _STEP).astype(int).clip(min=1)
    if (counts == 1).all():
        return np.ascontiguousarray(X)
    pieces = [
        start + (end - start) * np.arange(n)[:, None] / n for start, end, n in zip(X, X[1:], counts, strict=False)
    ]
    return np.vstack([*pieces, X[-1:]])


def _along_capsule(centres: Array, axes: Array, half: float, radius: float) -> Array:
    """Spheres (k, 4) that cover capsules at centres (n, 3) along axes (n, 3), `half` [m] long to each side."""
    count = 1 + int(np.ceil(2 * half / _SPACING))
    along = np.linspace(-half, half, count)
    points = centres[:, None] + along[:, None] * axes[:, None]
    grown = np.hypot(radius, half / max(count - 1, 1))
    return np.column_stack((points.reshape(-1, 3), np.full(points.size // 3, grown)))
