"""Hits of the robot while the base drives straight, the arm rigid: one check of one configuration.

The robot moves along a vector and hits an obstacle if and only if the obstacle moves against it and hits the robot. So
the whole drive is checked at its start, in a world in which every obstacle is the volume that it sweeps.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from irm.gjk import BOX, Solids
from planners.collision.scene_arrays import Obstacles
from planners.collision.world import CollisionWorld
from planners.scene import Body, StaticObstacle

Array = NDArray[np.float64]


class DriveWorlds(NamedTuple):
    """The two worlds in which a configuration hits what the robot hits on a drive out, the arm rigid in it.

    Attributes:
        inside: to be checked where the robot is before it moves; static obstacles reach down by the rise.
        driven: to be checked where the straight drive begins. Obstacles are boxes along the drive, one for each object
            however many pieces it has. That of an object begins at its axis, so that the half of it on the robot's side
            is left out.
    """

    inside: CollisionWorld
    driven: CollisionWorld


def drive_worlds(
    world: CollisionWorld, direction: Array, distance: float, rise: float, left_standing: Body | None = None
) -> DriveWorlds:
    """The worlds for a drive along a horizontal unit vector (2,) over a distance [m].

    On the way the robot may also move up by `rise` [m] without touching a static obstacle. For static obstacles that
    are not boxes along or across the drive the answer is conservative, as it is for the object `left_standing`.
    """
    R, scene, obstacles = np.eye(3), world.scene, world.obstacles
    R[:2, 0], R[:2, 1] = direction, (-direction[1], direction[0])
    half_way, down = 0.5 * distance * R[:, 0], np.array([0.0, 0.0, 0.5 * rise])

    def swept(bodies: Sequence[Body]) -> tuple[Array, Array]:
        """Boxes that objects sweep from their axes on, against the drive."""
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
    half = [[solid.half_extent_along(axis) for axis in R.T] for solid in solids]
    return np.array([solid.position for solid in solids]).reshape(-1, 3), np.array(half).reshape(-1, 3)


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
