"""Collisions of the robot while the base drives straight with a rigid arm, by one check of one configuration.

A robot that moves along a vector hits an obstacle exactly if the obstacle, moved the opposite way, hits the resting
robot. So the whole drive is checked at its start, in a world in which every obstacle is its swept volume.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from irm.gjk import BOX, Solids
from planners.collision.scene_arrays import Obstacles
from planners.collision.world import CollisionWorld
from planners.scene import Body, StaticObstacle

Array = NDArray[np.float64]


class DriveWorlds(NamedTuple):
    """Two worlds in which a configuration hits the same objects as the robot on a drive out with a rigid arm.

    Attributes:
        inside: for a check at the robot's pose before it moves. Static obstacles are extended downward by the rise.
        driven: for a check at the start of the straight drive. Obstacles are boxes along the drive, a single box for
            each object however many pieces it has. An object's box begins at its axis, so that its half on the robot's
            side is left out.
    """

    inside: CollisionWorld
    driven: CollisionWorld


def drive_worlds(
    world: CollisionWorld, direction: Array, distance: float, rise: float, left_standing: Body | None = None
) -> DriveWorlds:
    """Make the worlds for a drive along a horizontal unit vector (2,) over a distance [m].

    During the drive the robot may also rise by `rise` [m] without contact with static obstacles. The answer is
    conservative for static obstacles other than boxes along or across the drive, and for the object `left_standing`.
    """
    R, scene, obstacles = np.eye(3), world.scene, world.obstacles
    R[:2, 0], R[:2, 1] = direction, (-direction[1], direction[0])
    half_way, down = 0.5 * distance * R[:, 0], np.array([0.0, 0.0, 0.5 * rise])

    def swept(bodies: Sequence[Body]) -> tuple[Array, Array]:
        """Boxes that objects sweep, beginning at their axes, against the drive."""
        centre, half = _boxes_around(bodies, R)
        return centre - half_way, np.column_stack((np.full(len(half), 0.5 * distance), half[:, 1:]))

    centre, half = _boxes_around(scene.static_obstacles, R)
    standing = _highest_first(centre - down, half + down, R)
    left, size = swept(() if left_standing is None else (left_standing,))
    driven_static = _highest_first(
        np.concatenate((centre - half_way - down, left)),
        np.concatenate((half + down + [0.5 * distance, 0.0, 0.0], size)),
        R,
    )
    objects = _solids(*swept(scene.objects), R)
    radius, height, half = np.hypot(objects.half[:, 0], objects.half[:, 1]), objects.position[:, 2], objects.half
    upright = objects.position, radius, height - half[:, 2], height + half[:, 2]
    driven = Obstacles.of(objects, np.arange(len(half) + 1), upright, *driven_static)
    exact = obstacles.centre, obstacles.radius, obstacles.bottom, obstacles.top
    inside = Obstacles.of(obstacles.pieces, obstacles.first, exact, *standing)
    return DriveWorlds(world.with_obstacles(inside), world.with_obstacles(driven))


def _highest_first(centre: Array, half: Array, R: Array) -> tuple[Solids, Array]:
    """Static boxes along the axes of a rotation, and the half extents (m, 3) [m] of each along the world's axes."""
    order = np.argsort(-(centre + half)[:, 2], kind="stable")
    solids = _solids(centre[order], half[order], R)
    return solids, solids.half @ np.abs(R).T


def _boxes_around(solids: Sequence[Body] | Sequence[StaticObstacle], R: Array) -> tuple[Array, Array]:
    """Centres (k, 3) and half extents (k, 3) [m] of boxes along the axes of a rotation that contain the solids."""
    half = [[_half_along(solid, tuple(axis)) for axis in R.T] for solid in solids]
    return np.array([solid.position for solid in solids]).reshape(-1, 3), np.array(half).reshape(-1, 3)


@lru_cache(maxsize=16384)
def _half_along(solid: Body | StaticObstacle, axis: tuple[float, ...]) -> float:
    """Half extent [m] of a solid along an axis: the few directions out of a support are asked for again and again."""
    return solid.half_extent_along(axis)


def _solids(centre: Array, half: Array, R: Array) -> Solids:
    """Boxes along the axes of a rotation (3, 3)."""
    count = len(half)
    return Solids(
        core=np.full(count, BOX, dtype=np.int64),
        half=half,
        radius=np.zeros(count),
        bound=np.linalg.norm(half, axis=1),
        position=centre,
        rotation=np.tile(R, (count, 1, 1)),
        first=np.zeros(count + 1, np.int64),
    )
