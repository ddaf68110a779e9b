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
"""[m] Distance of the TCP beyond the side of the support at the end of a straight drive out. The gripper, the held
object and the unfolding arm are then clear of the shelves."""
BACK = 0.10
"""[m] Distance by which the gripper backs off before it moves sideways. The fingertips are then clear of the object."""
LEAST_LIFT = 0.03
"""[m] Least lift of an object under a shelf before it is moved."""
HELD_GAP = 0.002
"""[m] Gap between an object that is moved out and other objects."""
_HEADROOM = 0.8
"""[m] Greatest height above the support of a static obstacle that covers it. Below a higher one the arm can unfold."""
_FOOTROOM = 0.015
"""[m] Least height above the support of a static obstacle that covers it. A lower one is a wall, such as that of a
bin."""
_BOARD = 0.05
"""[m] Least half length of a shelf. A gripper can come down beside a smaller static obstacle, such as a piece of a
bowl's rim."""
_REACH = 0.10
"""[m] Distance from a location within which a shelf blocks a gripper from above."""


def is_covered(scene: Scene, point: ArrayLike) -> bool:
    """Whether a static obstacle above a point (3,) [m] on a support blocks a gripper from above."""
    return any(_hangs_over(obstacle, np.asarray(point, dtype=float)) for obstacle in scene.static_obstacles)


def needs_drive(scene: Scene, point: ArrayLike) -> bool:
    """Whether the base drives in and out with a rigid arm for an object at a point: under a shelf, unless the base is
    fixed."""
    return scene.robot.base_drive != "fixed" and is_covered(scene, point)


def _hangs_over(obstacle: StaticObstacle, point: Array) -> bool:
    is_above = point[2] + _FOOTROOM < obstacle.lower[2] < point[2] + _HEADROOM
    is_shelf = is_above and obstacle.extent[:2].max() >= _BOARD
    return bool(is_shelf and (np.abs(obstacle.position[:2] - point[:2]) < obstacle.extent[:2] + _REACH).all())


def driven_out_of(scene: Scene, body: Body) -> StaticObstacle:
    """Static obstacle that the base drives out of with an object: its support or, on the floor, the obstacle above
    it."""
    support = scene.support_under(body)
    if support in scene.static_obstacles:
        return support
    above = [one for one in scene.static_obstacles if _hangs_over(one, body.foot)]
    return max(above, key=lambda one: float(np.prod(one.extent[:2])), default=support)


def direction_out(support: StaticObstacle, bases: ArrayLike) -> Array:
    """Horizontal unit vectors (..., 2) out of a support, across the side in front of which base poses (..., 3)
    stand."""
    axes = support.rotation[:2, np.argsort(np.abs(support.rotation[2]))[:2]]
    half = [support.half_extent_along((*axis, 0.0)) for axis in axes.T]
    away = (np.asarray(bases, dtype=float)[..., :2] - support.position[:2]) @ axes
    side = np.argmax(np.abs(away) - half, axis=-1)
    sign = np.sign(np.take_along_axis(away, side[..., None], axis=-1))
    return np.asarray(axes.T[side] * sign)


def drive_out(support: StaticObstacle, base: ArrayLike, T_world_tcp: Array) -> Array:
    """Base poses (3, 3) of a drive out from under a shelf with a rigid arm: inside, backed off, outside.

    The gripper first moves by `BACK` against its own heading, so that the open fingers leave the object. Then it moves
    straight out of the support. The drive in is the reverse.

    Args:
        support: static obstacle that the base drives out of, see `driven_out_of`.
        base: (3,) x [m], y [m], yaw [rad] inside.
        T_world_tcp: (4, 4) of the gripper inside, with a level y axis.
    """
    poses = np.tile(np.asarray(base, dtype=float), (3, 1))
    direction, back = direction_out(support, poses[0]), -BACK * heading(T_world_tcp)
    poses[1:, :2] += back
    poses[2, :2] += distances_out(support, [T_world_tcp[:2, 3] + back], direction)[0] * direction
    return poses


def heading(T_world_tcp: Array) -> Array:
    """Unit vector (2,) of the heading of a gripper with a level y axis, seen from above."""
    return np.array([T_world_tcp[1, 1], -T_world_tcp[0, 1]])


def distances_out(support: StaticObstacle, tcps: Iterable[Array], direction: Array) -> list[float]:
    """Distances along `direction` (2,) until each TCP at (2,) is `DRIVE_CLEARANCE` beyond the support [m]."""
    edge = float(direction @ support.position[:2]) + support.half_extent_along((*direction, 0.0))
    return [max(edge + DRIVE_CLEARANCE - float(direction @ tcp), 0.0) for tcp in tcps]


def objects_before(scene: Scene, body: Body, shifts: Array, direction: Array) -> NDArray[np.uint64]:
    """Masks (k,) of objects in the swept volume of an object that moves along `direction` (2,), after shifts (k, 2)
    [m]."""
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
