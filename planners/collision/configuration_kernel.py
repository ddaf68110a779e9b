"""Which obstacles does a configuration hit? The compiled core, callable from other kernels.

    checks = by_reference(query)                              # once, outside the loop
    hits = configuration_hits(checks, query.active, base, q)

`query` is a `CollisionQuery`; `CollisionWorld.query` makes it. A result is a 64-bit mask: bit i for object i,
`STATIC_BIT` for static obstacles and the ground, `SELF_BIT` for the robot itself.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from planners.collision.compilation import leaf_kernel
from planners.collision.geometry import CYLINDER, Solids, are_any_within, are_within, core_distance, height
from planners.collision.robot_model import BASE, RobotArrays
from planners.collision.robot_pose_kernel import Attached, Scratch, place_robot
from planners.scene import SELF_BIT, STATIC_BIT

Array = NDArray[np.float64]

_ONE = np.uint64(1)
_NONE = np.uint64(0)
_STATIC = np.uint64(1 << STATIC_BIT)
_SELF = np.uint64(1 << SELF_BIT)


class Obstacles(NamedTuple):
    """n objects and m static obstacles for kernels. Lengths in metres, in the world.

    Attributes:
        objects: n solids.
        radius, bottom, top: (n,) the upright cylinder about its position that contains each object.
        lower, upper: (3,) corners of a box that contains all objects.
        static: m solids, the one with the highest top first.
        extent: (m, 3) half extents of the box about the centre of each, along the world's axes, that contains it.
    """

    objects: Solids
    radius: Array
    bottom: Array
    top: Array
    lower: Array
    upper: Array
    static: Solids
    extent: Array


class CollisionQuery(NamedTuple):
    """What is checked against what, for kernels.

    Attributes:
        robot: the robot's primitives.
        obstacles: objects and static obstacles.
        attached: the held object, or none; it moves with the TCP and is never an obstacle.
        scratch: memory that every check writes to, made for this robot and held object.
        opening: of the gripper [m].
        active: mask of the bits to look for; all others stay 0.
        padding: [m] Nearer counts as a hit.
        first_only: stop at the first hit: the mask is then 0 only if nothing is hit, but may lack other hits.
    """

    robot: RobotArrays
    obstacles: Obstacles
    attached: Attached
    scratch: Scratch
    opening: float
    active: np.uint64
    padding: float
    first_only: bool


@leaf_kernel
def _object_hits(
    solids: Solids,
    count: int,
    obstacles: Obstacles,
    wanted: np.uint64,
    padding: float,
    first_only: bool,
    simplex: Array,
) -> np.uint64:
    """The wanted objects that the first `count` solids come nearer to than `padding` [m]."""
    objects, radius, bottom, top = obstacles.objects, obstacles.radius, obstacles.bottom, obstacles.top
    lower, upper = obstacles.lower, obstacles.upper
    position, bounds, centre = solids.position, solids.bound, objects.position
    hits = _NONE
    for i in range(count):
        x, y, z = position[i, 0], position[i, 1], position[i, 2]
        bound = bounds[i] + padding
        if z - bound >= upper[2] or z + bound <= lower[2] or x - bound >= upper[0] or x + bound <= lower[0]:
            continue
        if y - bound >= upper[1] or y + bound <= lower[1]:
            continue
        for j in range(radius.shape[0]):
            dx, dy = x - centre[j, 0], y - centre[j, 1]
            reach = bound + radius[j]
            if dx * dx + dy * dy >= reach * reach or z - bound >= top[j] or z + bound <= bottom[j]:
                continue
            bit = _ONE << np.uint64(j)
            if wanted & bit & ~hits != _NONE and are_within(solids, i, objects, j, padding, simplex):
                hits |= bit
                if first_only:
                    return np.uint64(hits)
    return np.uint64(hits)


@leaf_kernel
def _hits_static(
    solids: Solids,
    count: int,
    held: int,
    obstacles: Obstacles,
    link: NDArray[np.int64],
    padding: float,
    simplex: Array,
) -> bool:
    """Whether the robot's `count` solids, or the held object, come nearer than `padding` [m] to an obstacle.

    These are the static obstacles and the ground; what is fixed to the base may be near the ground.
    """
    static, extent = obstacles.static, obstacles.extent
    position, bounds, centre, core = solids.position, solids.bound, static.position, static.core
    for k in range(count + 1):
        if k == count and held < 0:
            break
        i = k if k < count else count + 1
        x, y, z = position[i, 0], position[i, 1], position[i, 2]
        bound = bounds[i] + padding
        if z < bound and (k == count or link[i] != BASE) and z < height(solids, i) + padding:
            return True
        for j in range(core.shape[0]):
            if z - bound >= centre[j, 2] + extent[j, 2]:
                break
            dx = max(abs(x - centre[j, 0]) - extent[j, 0], 0.0)
            dy = max(abs(y - centre[j, 1]) - extent[j, 1], 0.0)
            dz = max(abs(z - centre[j, 2]) - extent[j, 2], 0.0)
            is_near = dx * dx + dy * dy + dz * dz < bound * bound
            if not is_near:
                continue
            if core[j] <= CYLINDER:
                if are_within(solids, i, static, j, padding, simplex):
                    return True
            elif are_any_within(solids, i, static, j, padding, simplex):
                return True
    return False


@leaf_kernel
def _hits_itself(
    solids: Solids, pairs: NDArray[np.int64], held: int, held_from: int, count: int, padding: float, simplex: Array
) -> bool:
    """Whether distant links, or the held object and links other than the gripper, come nearer than `padding` [m]."""
    position, bounds, radius = solids.position, solids.bound, solids.radius
    if held >= 0:
        for i in range(held_from, count):
            distance = core_distance(solids, count, position[i, 0], position[i, 1], position[i, 2])
            if distance < bounds[i] + padding and are_within(solids, i, solids, count, padding, simplex):
                return True
    for pair in range(pairs.shape[0]):
        i, j = pairs[pair, 0], pairs[pair, 1]
        distance = core_distance(solids, j, position[i, 0], position[i, 1], position[i, 2])
        is_near = distance < bounds[i] + radius[j] + padding
        if is_near and are_within(solids, i, solids, j, padding, simplex):
            return True
    return False


@leaf_kernel
def configuration_hits(query: CollisionQuery, active: np.uint64, base: Array, q: Array) -> np.uint64:
    """What the robot and the held object come nearer to than the query's padding, as a mask.

    Args:
        query: see its type; by reference.
        active: mask of the bits to look for; the query's, or some of them.
        base: (3,) x [m], y [m], yaw [rad].
        q: (n,) torso [m] and arm [rad].
    """
    robot, obstacles, padding = query.robot, query.obstacles, query.padding
    scratch = query.scratch
    place_robot(robot, query.attached, scratch, base, q, query.opening)
    solids, simplex, held, count = scratch.solids, scratch.simplex, query.attached.bit, robot.core.shape[0]
    hits, wanted = _NONE, active & ~(_STATIC | _SELF)
    if held >= 0:
        wanted &= ~(_ONE << np.uint64(held))
    if wanted != _NONE:
        hits = _object_hits(solids, count + (held >= 0), obstacles, wanted, padding, query.first_only, simplex)
    if query.first_only and hits != _NONE:
        return np.uint64(hits)
    if active & _STATIC != _NONE and _hits_static(solids, count, held, obstacles, robot.link, padding, simplex):
        hits |= _STATIC
    if query.first_only and hits != _NONE:
        return np.uint64(hits)
    if active & _SELF != _NONE and _hits_itself(
        solids, robot.self_pairs, held, robot.held_from, count, padding, simplex
    ):
        hits |= _SELF
    return np.uint64(hits)
