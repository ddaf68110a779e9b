"""Which obstacles does a configuration hit? The compiled core, callable from other kernels.

    work = make_workspace(world.robot, attached)              # once, outside the loop
    hits = configuration_hits(world.robot, world.obstacles, work, base, q, opening, active, padding, False)

`world` is a `CollisionWorld`; `attached = world.attached(held)`, `active = world.active(ignore)`.
A result is a 64-bit word: bit i for object i, `STATIC_BIT` for static obstacles and the floor, `SELF_BIT` for the robot
itself.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from irm.arm.kinematics import fk_frames
from planners.collision.geometry import CYLINDER, Solids, are_any_within, are_within, core_distance, height
from planners.collision.robot_model import BASE, RobotArrays
from planners.scene import SELF_BIT, STATIC_BIT

__all__ = [
    "Attached",
    "Obstacles",
    "Workspace",
    "configuration_hits",
    "make_workspace",
    "place_robot",
]

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


class Attached(NamedTuple):
    """What is in hand, for kernels: a solid twice, the second time with its bottom raised, for checks with static
    obstacles.

    Attributes:
        bit: of the object, -1 for none.
        core: BOX or CYLINDER; `half` (2, 3), `bound` [m] radius of the sphere that contains it.
        position: (2, 3) and `rotation` (3, 3) in the TCP frame.
        reach: (3 + n,) how far each joint moves any point of robot or object at most, per radian or metre.
    """

    bit: int
    core: int
    half: Array
    bound: float
    position: Array
    rotation: Array
    reach: Array


class Workspace(NamedTuple):
    """One thread's memory: n link frames, then the TCP's and the base's, and all that moves, placed in the world.

    The first p `solids` are the robot's primitives; the object in hand follows twice, as in `Attached`. `held` (1,) is
    its bit, -1 for none.
    """

    R: Array
    p: Array
    solids: Solids
    held: NDArray[np.int64]
    held_position: Array
    held_rotation: Array
    reach: Array
    simplex: Array


@njit(cache=True)
def make_workspace(robot: RobotArrays, attached: Attached) -> Workspace:
    """Memory for checks of this robot with this object, or none, in hand."""
    n, p = robot.offsets.shape[0], robot.core.shape[0]
    core, half = np.empty(p + 2, np.int64), np.empty((p + 2, 3))
    radius, bound = np.zeros(p + 2), np.empty(p + 2)
    core[:p], half[:p], radius[:p], bound[:p] = robot.core, robot.half, robot.radius, robot.bound
    core[p:], half[p:], bound[p:] = attached.core, attached.half, attached.bound
    return Workspace(
        np.empty((n + 2, 3, 3)),
        np.empty((n + 2, 3)),
        Solids(
            core,
            half,
            radius,
            bound,
            np.empty((p + 2, 3)),
            np.empty((p + 2, 3, 3)),
            np.empty((0, 3)),
            np.empty(0, np.int64),
        ),
        np.array([attached.bit]),
        attached.position.copy(),
        np.stack((attached.rotation, attached.rotation)),
        attached.reach.copy(),
        np.empty((4, 3)),
    )


@njit(cache=True)
def _compose(
    R: Array, p: Array, frame: int, local: Array, turn: Array, row: int, position: Array, rotation: Array, index: int
) -> None:
    """Write to `index` the world pose of what stands at `local[row]`, `turn[row]` in frame `frame` of R, p."""
    ax, ay, az = R[frame, 0, 0], R[frame, 0, 1], R[frame, 0, 2]
    bx, by, bz = R[frame, 1, 0], R[frame, 1, 1], R[frame, 1, 2]
    cx, cy, cz = R[frame, 2, 0], R[frame, 2, 1], R[frame, 2, 2]
    x, y, z = local[row, 0], local[row, 1], local[row, 2]
    position[index, 0] = p[frame, 0] + ax * x + ay * y + az * z
    position[index, 1] = p[frame, 1] + bx * x + by * y + bz * z
    position[index, 2] = p[frame, 2] + cx * x + cy * y + cz * z
    for j in range(3):
        x, y, z = turn[row, 0, j], turn[row, 1, j], turn[row, 2, j]
        rotation[index, 0, j] = ax * x + ay * y + az * z
        rotation[index, 1, j] = bx * x + by * y + bz * z
        rotation[index, 2, j] = cx * x + cy * y + cz * z


@njit(cache=True)
def _move_frames(R: Array, p: Array, count: int, base: Array) -> None:
    """Move the first `count` frames from the base frame to the world and write the base's own behind them."""
    c, s = math.cos(base[2]), math.sin(base[2])
    for k in range(count):
        x, y = p[k, 0], p[k, 1]
        p[k, 0], p[k, 1] = base[0] + c * x - s * y, base[1] + s * x + c * y
        for j in range(3):
            x, y = R[k, 0, j], R[k, 1, j]
            R[k, 0, j], R[k, 1, j] = c * x - s * y, s * x + c * y
    p[count, 0], p[count, 1], p[count, 2] = base[0], base[1], 0.0
    for i in range(3):
        for j in range(3):
            R[count, i, j] = 1.0 if i == j else 0.0
    R[count, 0, 0], R[count, 0, 1], R[count, 1, 0], R[count, 1, 1] = c, -s, s, c


@njit(cache=True)
def place_robot(robot: RobotArrays, work: Workspace, base: Array, q: Array, opening: float) -> None:
    """Write the world poses of all primitives, and of the object in hand, into the workspace."""
    R, p, position, rotation = work.R, work.p, work.solids.position, work.solids.rotation
    fk_frames(robot.offsets, robot.axes, robot.tip, q, R, p)
    tcp, count = robot.offsets.shape[0], robot.core.shape[0]
    _move_frames(R, p, tcp + 1, base)
    slide = min(max(0.5 * (opening - robot.gap), 0.0), robot.slide_end)
    for i in range(count):
        frame = tcp + 1 if robot.link[i] == BASE else robot.link[i]
        _compose(R, p, frame, robot.position, robot.rotation, i, position, rotation, i)
        if robot.slides[i]:
            for axis in range(3):
                along = R[frame, axis, 0] * robot.slide[i, 0]
                along += R[frame, axis, 1] * robot.slide[i, 1] + R[frame, axis, 2] * robot.slide[i, 2]
                position[i, axis] += slide * along
    if work.held[0] >= 0:
        for row in range(2):
            _compose(R, p, tcp, work.held_position, work.held_rotation, row, position, rotation, count + row)


@njit(cache=True)
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
    hits = _NONE
    for i in range(count):
        x, y, z = solids.position[i, 0], solids.position[i, 1], solids.position[i, 2]
        bound = solids.bound[i] + padding
        if z - bound >= upper[2] or z + bound <= lower[2] or x - bound >= upper[0] or x + bound <= lower[0]:
            continue
        if y - bound >= upper[1] or y + bound <= lower[1]:
            continue
        for j in range(radius.shape[0]):
            dx, dy = x - objects.position[j, 0], y - objects.position[j, 1]
            reach = bound + radius[j]
            if dx * dx + dy * dy >= reach * reach or z - bound >= top[j] or z + bound <= bottom[j]:
                continue
            bit = _ONE << np.uint64(j)
            if wanted & bit & ~hits != _NONE and are_within(solids, i, objects, j, padding, simplex):
                hits |= bit
                if first_only:
                    return np.uint64(hits)
    return np.uint64(hits)


@njit(cache=True)
def _hits_static(
    solids: Solids,
    count: int,
    held: int,
    obstacles: Obstacles,
    link: NDArray[np.int64],
    padding: float,
    simplex: Array,
) -> bool:
    """Whether the robot's `count` solids, or the object in the gripper, come nearer than `padding` [m] to an obstacle.

    These are the static obstacles and the floor; what is fixed to the base may be near the floor.
    """
    static, extent = obstacles.static, obstacles.extent
    for k in range(count + 1):
        if k == count and held < 0:
            break
        i = k if k < count else count + 1
        x, y, z = solids.position[i, 0], solids.position[i, 1], solids.position[i, 2]
        bound = solids.bound[i] + padding
        if z < bound and (k == count or link[i] != BASE) and z < height(solids, i) + padding:
            return True
        for j in range(static.core.shape[0]):
            if z - bound >= static.position[j, 2] + extent[j, 2]:
                break
            dx = max(abs(x - static.position[j, 0]) - extent[j, 0], 0.0)
            dy = max(abs(y - static.position[j, 1]) - extent[j, 1], 0.0)
            dz = max(abs(z - static.position[j, 2]) - extent[j, 2], 0.0)
            is_near = dx * dx + dy * dy + dz * dz < bound * bound
            if not is_near:
                continue
            if static.core[j] <= CYLINDER:
                if are_within(solids, i, static, j, padding, simplex):
                    return True
            elif are_any_within(solids, i, static, j, padding, simplex):
                return True
    return False


@njit(cache=True)
def _hits_itself(
    solids: Solids, pairs: NDArray[np.int64], held: int, held_from: int, count: int, padding: float, simplex: Array
) -> bool:
    """Whether distant links, or the object in hand and the robot beyond the hand, come nearer than `padding` [m]."""
    position = solids.position
    if held >= 0:
        for i in range(held_from, count):
            distance = core_distance(solids, count, position[i, 0], position[i, 1], position[i, 2])
            if distance < solids.bound[i] + padding and are_within(solids, i, solids, count, padding, simplex):
                return True
    for pair in range(pairs.shape[0]):
        i, j = pairs[pair, 0], pairs[pair, 1]
        distance = core_distance(solids, j, position[i, 0], position[i, 1], position[i, 2])
        is_near = distance < solids.bound[i] + solids.radius[j] + padding
        if is_near and are_within(solids, i, solids, j, padding, simplex):
            return True
    return False


@njit(cache=True)
def configuration_hits(
    robot: RobotArrays,
    obstacles: Obstacles,
    work: Workspace,
    base: Array,
    q: Array,
    opening: float,
    active: np.uint64,
    padding: float,
    first_only: bool,
) -> np.uint64:
    """What the robot, and the object in hand, come nearer to than `padding` [m].

    Args:
        robot, obstacles: see their types.
        work: memory from `make_workspace`; it also says what is in hand.
        base: (3,) x [m], y [m], yaw [rad].
        q: (n,) torso [m] and arm [rad].
        opening: of the gripper [m].
        active: bits to look for; all others stay 0. The object in hand never counts.
        padding: [m].
        first_only: stop at the first hit.
    """
    place_robot(robot, work, base, q, opening)
    solids, simplex, held, count = work.solids, work.simplex, work.held[0], robot.core.shape[0]
    hits, wanted = _NONE, active & ~(_STATIC | _SELF)
    if held >= 0:
        wanted &= ~(_ONE << np.uint64(held))
    if wanted != _NONE:
        hits = _object_hits(solids, count + (held >= 0), obstacles, wanted, padding, first_only, simplex)
    if first_only and hits != _NONE:
        return np.uint64(hits)
    if active & _STATIC != _NONE and _hits_static(solids, count, held, obstacles, robot.link, padding, simplex):
        hits |= _STATIC
    if first_only and hits != _NONE:
        return np.uint64(hits)
    if active & _SELF != _NONE and _hits_itself(
        solids, robot.self_pairs, held, robot.held_from, count, padding, simplex
    ):
        hits |= _SELF
    return np.uint64(hits)
