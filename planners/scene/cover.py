"""Shelves above a support, and the drive out from under them: straight across the side next to the base."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planners.scene.bodies import Body
from planners.scene.scene import Scene
from planners.scene.solid import StaticObstacle

Array = NDArray[np.float64]

DRIVE_CLEARANCE = 0.25
"""[m] beyond the side of the support at which the TCP ends a straight drive out: the gripper, what it holds and the arm
that unfolds are then clear of the shelves."""
BACK = 0.10
"""[m] that the gripper backs off before it moves sideways: the fingertips are then clear of the object."""
LEAST_LIFT = 0.03
"""[m] that an object is lifted under a shelf at least before it is moved."""
HELD_GAP = 0.002
"""[m] that an object keeps from others while it is moved out."""
_HEADROOM = 0.8
"""[m] A static obstacle higher above the support does not matter: the arm unfolds below it."""
_FOOTROOM = 0.015
"""[m] Nothing stands below a static obstacle that is lower above the support: it is a wall, as that of a bin."""
_BOARD = 0.05
"""[m] A static obstacle that measures less each way from its middle is no shelf: a gripper comes down beside it, as
beside a piece of the rim of a bowl."""
_REACH = 0.10
"""[m] around a location within which a shelf is in the way of a gripper that comes from above."""


def is_covered(scene: Scene, point: ArrayLike) -> bool:
    """Whether a static obstacle hangs over a point (3,) [m] on a support, in the way of a gripper from above."""
    return any(_hangs_over(obstacle, np.asarray(point, dtype=float)) for obstacle in scene.static_obstacles)


def needs_drive(scene: Scene, point: ArrayLike) -> bool:
    """Whether the base drives in and out, the arm rigid, with what stands at a point: under a shelf, if it moves."""
    return scene.robot.base_drive != "fixed" and is_covered(scene, point)


def _hangs_over(obstacle: StaticObstacle, point: Array) -> bool:
    is_above = point[2] + _FOOTROOM < obstacle.lower[2] < point[2] + _HEADROOM
    is_shelf = is_above and obstacle.extent[:2].max() >= _BOARD
    return bool(is_shelf and (np.abs(obstacle.position[:2] - point[:2]) < obstacle.extent[:2] + _REACH).all())


def driven_out_of(scene: Scene, body: Body) -> StaticObstacle:
    """What the base drives out of with an object under a shelf: its support, or, on the floor, what hangs over it."""
    support = scene.support_under(body)
    if support in scene.static_obstacles:
        return support
    above = [one for one in scene.static_obstacles if _hangs_over(one, body.foot)]
    return max(above, key=lambda one: float(np.prod(one.extent[:2])), default=support)


def direction_out(support: StaticObstacle, bases: ArrayLike) -> Array:
    """Horizontal unit vectors (..., 2) out from a support, across the side before which base poses (..., 3) stand."""
    axes = support.rotation[:2, np.argsort(np.abs(support.rotation[2]))[:2]]
    half = [support.half_extent_along((*axis, 0.0)) for axis in axes.T]
    away = (np.asarray(bases, dtype=float)[..., :2] - support.position[:2]) @ axes
    side = np.argmax(np.abs(away) - half, axis=-1)
    sign = np.sign(np.take_along_axis(away, side[..., None], axis=-1))
    return np.asarray(axes.T[side] * sign)


def drive_out(support: StaticObstacle, base: ArrayLike, T_world_tcp: Array) -> Array:
    """Base poses (3, 3) of a drive out from under a shelf, the arm rigid: inside, backed off, outside.

    The gripper first moves `BACK` against its own heading, so that the open fingers let go of the object, then straight
    out of the support. The drive in is the same in reverse.

    Args:
        support: what the base drives out of; see `driven_out_of`.
        base: (3,) x [m], y [m], yaw [rad] inside.
        T_world_tcp: (4, 4) of the gripper then; its y axis is level.
    """
    poses = np.tile(np.asarray(base, dtype=float), (3, 1))
    direction, back = direction_out(support, poses[0]), -BACK * heading(T_world_tcp)
    poses[1:, :2] += back
    poses[2, :2] += distances_out(support, [T_world_tcp[:2, 3] + back], direction)[0] * direction
    return poses


def heading(T_world_tcp: Array) -> Array:
    """Unit vector (2,) in which a gripper whose y axis is level points, seen from above."""
    return np.array([T_world_tcp[1, 1], -T_world_tcp[0, 1]])


def distances_out(support: StaticObstacle, tcps: Iterable[Array], direction: Array) -> list[float]:
    """[m] along `direction` (2,) until each TCP at (2,) is `DRIVE_CLEARANCE` beyond the support."""
    edge = float(direction @ support.position[:2]) + support.half_extent_along((*direction, 0.0))
    return [max(edge + DRIVE_CLEARANCE - float(direction @ tcp), 0.0) for tcp in tcps]


def objects_before(scene: Scene, body: Body, shifts: Array, direction: Array) -> NDArray[np.uint64]:
    """What an object touches when it is moved along `direction` (2,), shifted by (k, 2) [m] before: masks (k,)."""
    across = np.array([-direction[1], direction[0], 0.0])
    half, starts, masks = (
        body.half_extent_along(across) + HELD_GAP,
        body.position[:2] + shifts,
        np.zeros(len(shifts), np.uint64),
    )
    for index, other in enumerate(scene.objects):
        if other.bottom < body.top and body.bottom < other.top:
            away, apart = other.position[:2] - starts, half + other.half_extent_along(across)
            touched = (away @ direction > 0.0) & (np.abs(away @ across[:2]) < apart)
            masks |= touched.astype(np.uint64) << np.uint64(index)
    return masks
