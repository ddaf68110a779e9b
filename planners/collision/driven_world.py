"""Hits of the robot while the base drives straight, the arm rigid: one check of one configuration.

The robot moves along a vector and hits an obstacle if and only if the obstacle moves against it and hits the robot. So
the whole drive is checked at its start, in a world in which every obstacle is the volume that it sweeps.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from irm.gjk import BOX, Solids
from planners.collision.scene_arrays import Obstacles
from planners.collision.world import CollisionWorld
from planners.scene import Body, StaticObstacle

Array = NDArray[np.float64]


class Drive(NamedTuple):
    """A straight drive of the base.

    Attributes:
        offset: (2,) [m] from where the robot is checked to where the drive begins.
        direction: (2,) horizontal unit vector.
        distance: [m].
        rise: [m] that the robot may also move up on the way without touching a static obstacle.
    """

    offset: Array
    direction: Array
    distance: float
    rise: float


@dataclass(frozen=True, eq=False)
class Extents:
    """The boxes along and across a direction that contain the obstacles of a world, for several drives that way.

    Attributes:
        world: the scene, compiled.
        R: (3, 3) axes of the boxes, the first of them the direction.
        static: centres and half extents of the static obstacles' boxes, (m, 3) each [m].
        objects: centres and half extents of the objects' boxes, (n, 3) each [m].
    """

    world: CollisionWorld
    R: Array
    static: tuple[Array, Array]
    objects: tuple[Array, Array]

    @classmethod
    def of(cls, world: CollisionWorld, direction: Array) -> Extents:
        """The boxes for drives along `direction` (2,), a horizontal unit vector."""
        R, scene = np.eye(3), world.scene
        R[:2, 0], R[:2, 1] = direction, (-direction[1], direction[0])
        return cls(world, R, _boxes_around(scene.static_obstacles, R), _boxes_around(scene.objects, R))

    def driven_world(self, drive: Drive, left_standing: Body | None = None) -> CollisionWorld:
        """A world in which a configuration hits what the robot, rigid in it, hits on a drive in this direction.

        Obstacles become boxes along the drive, one for each object however many pieces it has. That of an object begins
        at its axis, so that the half of it on the robot's side is left out: check the configuration in `world` too. For
        static obstacles that are not boxes along or across the drive the answer is conservative; they are checked where
        the robot is, too. So is the object `left_standing`.
        """
        down, along = np.array([0.0, 0.0, 0.5 * drive.rise]), np.array([0.5 * drive.distance, 0.0, 0.0])
        standing, size = self.static
        # Where the robot is and on the drive, the rise included.
        centre = np.concatenate((standing, self._middle_of_drive(standing, drive))) - down
        half = np.concatenate((size, size + along)) + down
        if left_standing is not None:
            more = self._swept(_boxes_around([left_standing], self.R), drive)
            centre, half = np.concatenate((centre, more[0])), np.concatenate((half, more[1]))
        highest_first = np.argsort(-(centre + half)[:, 2], kind="stable")
        solids = _solids(centre[highest_first], half[highest_first], self.R)
        objects = _solids(*self._swept(self.objects, drive), self.R)
        radius, height, half = np.hypot(objects.half[:, 0], objects.half[:, 1]), objects.position[:, 2], objects.half
        upright = objects.position, radius, height - half[:, 2], height + half[:, 2]
        extent, first = solids.half @ np.abs(self.R).T, np.arange(len(half) + 1)
        return self.world.with_obstacles(Obstacles.of(objects, first, upright, solids, extent))

    def _middle_of_drive(self, centre: Array, drive: Drive) -> Array:
        return np.asarray(centre - 0.5 * drive.distance * self.R[:, 0] - [*drive.offset, 0.0])

    def _swept(self, boxes: tuple[Array, Array], drive: Drive) -> tuple[Array, Array]:
        """Boxes that objects sweep from their axes on, against the drive."""
        centre, half = boxes
        along = np.full(len(half), 0.5 * drive.distance)
        return self._middle_of_drive(centre, drive), np.column_stack((along, half[:, 1:]))


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
