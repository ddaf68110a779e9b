"""Collision checks of configurations, straight motions and whole paths, compiled, callable from other kernels.

    hits = configuration_hits(query, query.active, base, q)

`query` is a `CollisionQuery`, which `CollisionWorld.query` makes and packs. Kernels get its address, from Python and
from each other. A result is a 64-bit mask: bit i for object i, `STATIC_BIT` for static obstacles and the ground,
`SELF_BIT` for the robot itself.
"""

from __future__ import annotations

import math
from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from irm.chain import BASE
from irm.compilation import njit
from irm.gjk import CYLINDER, Solids, are_any_within, are_within, core_distance, height
from irm.kernel_arguments import (
    Layout,
    call_at,
    copy_row,
    copy_rows,
    inlined_kernel,
    kernel_address,
    layout_of,
    leaf_kernel,
    packed,
    with_numbers,
)
from irm.kinematics import fk_frames
from planners.collision.scene_arrays import Obstacles, RobotArrays
from planners.scene import SELF_BIT, STATIC_BIT

Array = NDArray[np.float64]
_ONE = np.uint64(1)
_NONE = np.uint64(0)
_STATIC = np.uint64(1 << STATIC_BIT)
_SELF = np.uint64(1 << SELF_BIT)
_FIRST = np.int64(0)
"""First solid. Typed, so that kernels are not compiled again for the constant."""
_BLOCK = 6
"""Checks along a path that a single check with more padding may replace."""
_AROUND = 4
"""A single check of an edge may replace all checks that are fewer than this number away. A power of two."""


class Attached(NamedTuple):
    """Held object, for kernels: its h solids, then copies of them with raised bottoms.

    The copies are checked against static obstacles, so that an object can be lifted from the table that it stands on.

    Attributes:
        bit: bit of the object, -1 for none.
        solids: 2 h solids in the TCP frame, empty without an object.
        reach: (3 + n,) upper bound of the motion of any point of robot or object, per radian or metre of each joint.
    """

    bit: int
    solids: Solids
    reach: Array


class Scratch(NamedTuple):
    """Memory of one thread, written by every check: the robot with n joints and p primitives, placed in the world.

    Attributes:
        R: (n + 2, 3, 3) orientations of the link frames, then of TCP and base.
        p: (n + 2, 3) their origins [m].
        solids: p + 2 h solids: the robot's primitives, then the held object's solids, as in `Attached`.
        x: (3 + n,) whole-body configuration of the current check along an edge.
        slack: (1 + n,) upper bound of the motion of base and links from there to the last check that it replaces [m].
        simplex: (4, 3) for `are_within`.
    """

    R: Array
    p: Array
    solids: Solids
    x: Array
    slack: Array
    simplex: Array


class CollisionQuery(NamedTuple):
    """Input of a collision check, for kernels.

    Attributes:
        robot: the robot's primitives.
        obstacles: objects and static obstacles.
        attached: the held object, or none. It moves with the TCP and is never an obstacle.
        scratch: memory that every check writes to, made for this robot and held object.
        opening: opening of the gripper [m].
        active: mask of the bits to check. All others stay 0.
        padding: distance below which solids are in collision [m].
        first_only: stop at the first hit. The mask is then 0 only without any hit, but may lack other hits.
        check_configuration, check_edge: addresses of two kernels that most others call, so that each is compiled only
            once.
    """

    robot: RobotArrays
    obstacles: Obstacles
    attached: Attached
    scratch: Scratch
    opening: float
    active: np.uint64
    padding: float
    first_only: bool
    check_configuration: int = 0
    check_edge: int = 0


def packed_query(query: CollisionQuery) -> CollisionQuery:
    """Pack a query for kernels, with the addresses of the kernels that they call."""
    without = packed(query)
    configuration, edge = _addresses(layout_of(without))
    return with_numbers(without, check_configuration=configuration, check_edge=edge)


@cache
def _addresses(query: Layout) -> tuple[int, int]:
    mask, values = np.uint64(0), np.empty(1)
    configuration = kernel_address(_configuration_hits, query, mask, values, values)
    return configuration, kernel_address(_edge_hits, query, values, values, 0.0)


def make_scratch(robot: RobotArrays, attached: Attached) -> Scratch:
    """Allocate memory for checks of this robot with this held object, or none."""
    n, held, solids = robot.offsets.shape[0], attached.solids, robot.core.shape[0] + attached.solids.core.shape[0]
    return Scratch(
        R=np.empty((n + 2, 3, 3)),
        p=np.empty((n + 2, 3)),
        solids=Solids(
            core=np.concatenate((robot.core, held.core)),
            half=np.concatenate((robot.half, held.half)),
            radius=np.concatenate((robot.radius, held.radius)),
            bound=np.concatenate((robot.bound, held.bound)),
            position=np.empty((solids, 3)),
            rotation=np.empty((solids, 3, 3)),
            vertices=held.vertices,
            first=np.concatenate((np.zeros(len(robot.core), np.int64), held.first)),
        ),
        x=np.empty(3 + n),
        slack=np.empty(1 + n),
        simplex=np.empty((4, 3)),
    )


@inlined_kernel
def _compose(R: Array, p: Array, frame: int, local: Array, turn: Array, row: int, solids: Solids, index: int) -> None:
    """Write the world pose of solid `index`, given by `local[row]`, `turn[row]` in frame `frame` of R, p."""
    position, rotation = solids.position, solids.rotation
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


@leaf_kernel
def _move_frames(R: Array, p: Array, count: int, base: Array) -> None:
    """Transform the first `count` frames from the base frame to the world, and write the base's own frame after
    them."""
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


@inlined_kernel
def _place_solid(robot: RobotArrays, scratch: Scratch, slide: float, i: int) -> None:
    """Write the world pose of the robot's primitive `i`. A finger has moved by `slide` [m]."""
    R, p, link, along, position = scratch.R, scratch.p, robot.link, robot.slide, scratch.solids.position
    frame = robot.offsets.shape[0] + 1 if link[i] == BASE else link[i]
    _compose(R, p, frame, robot.position, robot.rotation, i, scratch.solids, i)
    if robot.slides[i]:
        for axis in range(3):
            moved = R[frame, axis, 0] * along[i, 0]
            moved += R[frame, axis, 1] * along[i, 1] + R[frame, axis, 2] * along[i, 2]
            position[i, axis] += slide * moved


@leaf_kernel
def place_robot(
    robot: RobotArrays, attached: Attached, scratch: Scratch, base: Array, q: Array, opening: float
) -> None:
    """Write the world poses of all primitives, and of the held object, into `scratch`, for an `opening` of the gripper
    [m]."""
    R, p, solids = scratch.R, scratch.p, scratch.solids
    fk_frames(robot.offsets, robot.axes, robot.tip, q, R, p)
    tcp, count = robot.offsets.shape[0], robot.core.shape[0]
    _move_frames(R, p, tcp + 1, base)
    slide = min(max(0.5 * (opening - robot.gap), 0.0), robot.slide_end)
    for i in range(count):
        _place_solid(robot, scratch, slide, i)
    held = attached.solids
    for row in range(held.core.shape[0]):
        _compose(R, p, tcp, held.position, held.rotation, row, solids, count + row)


@njit(cache=True)
def place_along(query: CollisionQuery, X: Array) -> tuple[Array, Array]:
    """World poses of all p primitives, then of the held object's h solids, at n whole-body configurations (n, 3 + j).

    Returns:
        positions (n, p + h, 3) [m] and rotations (n, p + h, 3, 3).
    """
    solids = query.scratch.solids
    count = query.robot.core.shape[0] + query.attached.solids.core.shape[0] // 2
    positions, rotations = np.empty((X.shape[0], count, 3)), np.empty((X.shape[0], count, 3, 3))
    for k in range(X.shape[0]):
        place_robot(query.robot, query.attached, query.scratch, X[k, :3], X[k, 3:], query.opening)
        copy_rows(solids.position[:count], positions[k])
        for i in range(count):
            copy_rows(solids.rotation[i], rotations[k, i])
    return positions, rotations


@inlined_kernel
def _touch(a: Solids, i: int, b: Solids, j: int, padding: float, simplex: Array) -> bool:
    """Whether solid i of `a` and j of `b` are at most `padding` [m] apart."""
    if a.core[i] <= CYLINDER and b.core[j] <= CYLINDER:
        return are_within(a, i, b, j, padding, simplex)
    return are_any_within(a, i, b, j, padding, simplex)


@leaf_kernel
def _object_hits(
    solids: Solids,
    begin: int,
    count: int,
    obstacles: Obstacles,
    wanted: np.uint64,
    padding: float,
    first_only: bool,
    simplex: Array,
) -> np.uint64:
    """Mask of the wanted objects that are nearer than `padding` [m] to the solids from `begin` up to `count`."""
    pieces, first, radius = obstacles.pieces, obstacles.first, obstacles.radius
    bottom, top, centre = obstacles.bottom, obstacles.top, obstacles.centre
    lower, upper = obstacles.lower, obstacles.upper
    position, bounds = solids.position, solids.bound
    hits = _NONE
    for i in range(begin, count):
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
            if wanted & bit & ~hits == _NONE:
                continue
            for k in range(first[j], first[j + 1]):
                if _touch(solids, i, pieces, k, padding, simplex):
                    hits |= bit
                    if first_only:
                        return np.uint64(hits)
                    break
    return np.uint64(hits)


@leaf_kernel
def _solid_hits_static(
    solids: Solids, i: int, is_base: bool, obstacles: Obstacles, padding: float, simplex: Array
) -> bool:
    """Whether solid i is nearer than `padding` [m] to a static obstacle or, if it is not the base, the ground."""
    static, extent = obstacles.static, obstacles.extent
    position, centre, core = solids.position, static.position, static.core
    x, y, z = position[i, 0], position[i, 1], position[i, 2]
    bound = solids.bound[i] + padding
    if z < bound and not is_base and z < height(solids, i) + padding:
        return True
    for j in range(core.shape[0]):
        if z - bound >= centre[j, 2] + extent[j, 2]:
            break
        dx = max(abs(x - centre[j, 0]) - extent[j, 0], 0.0)
        dy = max(abs(y - centre[j, 1]) - extent[j, 1], 0.0)
        dz = max(abs(z - centre[j, 2]) - extent[j, 2], 0.0)
        is_near = dx * dx + dy * dy + dz * dz < bound * bound
        if is_near and _touch(solids, i, static, j, padding, simplex):
            return True
    return False


@leaf_kernel
def arm_hits(query: CollisionQuery, active: np.uint64, base: Array, q: Array) -> np.uint64:
    """Mask of the objects and static obstacles that the robot without its gripper hits.

    As most configurations hit something static, this is found out while the primitives are placed, and ends the check.
    """
    robot, obstacles, scratch, padding = query.robot, query.obstacles, query.scratch, query.padding
    solids, simplex, link, count = scratch.solids, scratch.simplex, robot.link, robot.core.shape[0]
    fk_frames(robot.offsets, robot.axes, robot.tip, q, scratch.R, scratch.p)
    _move_frames(scratch.R, scratch.p, robot.offsets.shape[0] + 1, base)
    for i in range(robot.held_from, count):
        _place_solid(robot, scratch, 0.0, i)
        if active & _STATIC == _NONE or (link[i] == BASE and robot.stands):
            continue
        if _solid_hits_static(solids, i, link[i] == BASE, obstacles, padding, simplex):
            return np.uint64(_STATIC)
    wanted = active & ~(_STATIC | _SELF)
    if query.attached.bit >= 0:
        wanted &= ~(_ONE << np.uint64(query.attached.bit))
    return _object_hits(solids, robot.held_from, count, obstacles, wanted, padding, query.first_only, simplex)


@leaf_kernel
def _hits_static(
    solids: Solids,
    count: int,
    held: int,
    obstacles: Obstacles,
    link: NDArray[np.int64],
    stands: bool,
    padding: float,
    simplex: Array,
) -> bool:
    """Whether the robot's `count` solids, or the `held` solids, are nearer than `padding` [m] to a static obstacle.

    Static obstacles include the ground. Solids of the base may be near the ground, and near any static obstacle if the
    base `stands` still.
    """
    for k in range(count + held):
        i = k if k < count else held + k
        if stands and k < count and link[i] == BASE:
            continue
        if _solid_hits_static(solids, i, k < count and link[i] == BASE, obstacles, padding, simplex):
            return True
    return False


@inlined_kernel
def _are_apart(position: Array, i: int, j: int, reach: float) -> bool:
    """Whether two centres are farther apart than `reach` [m], so that the bounding spheres of two solids do not
    meet."""
    x, y, z = position[i, 0] - position[j, 0], position[i, 1] - position[j, 1], position[i, 2] - position[j, 2]
    return bool(x * x + y * y + z * z > reach * reach)


@leaf_kernel
def _hits_itself(
    solids: Solids, pairs: NDArray[np.int64], held: int, held_from: int, count: int, padding: float, simplex: Array
) -> bool:
    """Whether distant links, or the `held` solids and links except the gripper, are nearer than `padding` [m]."""
    position, bounds, radius = solids.position, solids.bound, solids.radius
    for j in range(count, count + held):
        for i in range(held_from, count):
            distance = core_distance(solids, j, position[i, 0], position[i, 1], position[i, 2])
            is_near = distance < bounds[i] + radius[j] + padding
            if is_near and _touch(solids, i, solids, j, padding, simplex):
                return True
    for pair in range(pairs.shape[0]):
        i, j = pairs[pair, 0], pairs[pair, 1]
        if _are_apart(position, i, j, bounds[i] + bounds[j] + padding):
            continue
        distance = core_distance(solids, j, position[i, 0], position[i, 1], position[i, 2])
        is_near = distance < bounds[i] + radius[j] + padding
        if is_near and are_within(solids, i, solids, j, padding, simplex):
            return True
    return False


@inlined_kernel
def configuration_hits(query: CollisionQuery, active: np.uint64, base: Array, q: Array) -> np.uint64:
    """Mask of everything nearer to the robot or the held object than the query's padding.

    `active`: mask of the bits to check, those of the query or some of them.
    """
    return np.uint64(call_at(query.check_configuration, (query, active, base, q)))


@leaf_kernel
def _configuration_hits(query: CollisionQuery, active: np.uint64, base: Array, q: Array) -> np.uint64:
    robot, obstacles, padding = query.robot, query.obstacles, query.padding
    scratch = query.scratch
    place_robot(robot, query.attached, scratch, base, q, query.opening)
    solids, simplex, count = scratch.solids, scratch.simplex, robot.core.shape[0]
    hits, wanted, held = _NONE, active & ~(_STATIC | _SELF), query.attached.solids.core.shape[0] // 2
    if held > 0:
        wanted &= ~(_ONE << np.uint64(query.attached.bit))
    if wanted != _NONE:
        hits = _object_hits(solids, _FIRST, count + held, obstacles, wanted, padding, query.first_only, simplex)
    if query.first_only and hits != _NONE:
        return np.uint64(hits)
    if active & _STATIC != _NONE and _hits_static(
        solids, count, held, obstacles, robot.link, robot.stands, padding, simplex
    ):
        hits |= _STATIC
    if query.first_only and hits != _NONE:
        return np.uint64(hits)
    if active & _SELF != _NONE and _hits_itself(
        solids, robot.self_pairs, held, robot.held_from, count, padding, simplex
    ):
        hits |= _SELF
    return np.uint64(hits)


@njit(cache=True)
def many_hits(query: CollisionQuery, base: Array, Q: Array) -> NDArray[np.uint64]:
    """`configuration_hits` (k,) of each row of `Q` (k, n) at one base pose (3,)."""
    hits = np.empty(Q.shape[0], np.uint64)
    for row in range(Q.shape[0]):
        hits[row] = configuration_hits(query, query.active, base, Q[row])
    return hits


@leaf_kernel
def edge_samples(reach: Array, start: Array, end: Array, step: float) -> int:
    """Number of parts of a straight motion, so that no point moves more than `step` [m] in any part.

    `reach` (3 + n,): as in `Attached`. `start` and `end` (3 + n,): whole-body configurations.
    """
    length = math.hypot(end[0] - start[0], end[1] - start[1])
    for joint in range(2, start.shape[0]):
        length += abs(end[joint] - start[joint]) * reach[joint]
    return max(1, math.ceil(length / step))


@leaf_kernel
def motion_on_edge(reach: Array, start: Array, end: Array, share: float, slack: Array) -> None:
    """Write upper bounds (1 + n,) [m] of the motion of base and links on a share of a straight motion."""
    far = math.hypot(end[0] - start[0], end[1] - start[1]) + abs(end[2] - start[2]) * reach[2]
    for link in range(slack.shape[0]):
        far += abs(end[2 + link] - start[2 + link]) * reach[2 + link] if link > 0 else 0.0
        slack[link] = far * share


@leaf_kernel
def is_clear_around(query: CollisionQuery, x: Array, opening: float, slack: Array) -> bool:
    """Whether a configuration (3 + n,) is collision-free for the active bits, even after each link moves by its slack.

    `slack` (1 + n,): sum of the motions by all joints up to the base or each link [m]. `opening`: of the gripper [m].
    """
    robot, obstacles, attached, padding = query.robot, query.obstacles, query.attached, query.padding
    scratch, active, link = query.scratch, query.active, query.robot.link
    place_robot(robot, attached, scratch, x[:3], x[3:], opening)
    solids, simplex, count = scratch.solids, scratch.simplex, robot.core.shape[0]
    held, last = attached.solids.core.shape[0] // 2, slack.shape[0] - 1
    if active & _SELF != _NONE:
        # Only the joints between two links move these links relative to each other.
        for i in range(robot.held_from, count if held > 0 else 0):
            wide = padding + slack[last] - slack[link[i] + 1]
            for j in range(count, count + held):
                if _touch(solids, i, solids, j, wide, simplex):
                    return False
        for pair in range(robot.self_pairs.shape[0]):
            i, j = robot.self_pairs[pair, 0], robot.self_pairs[pair, 1]
            wide = padding + abs(slack[link[i] + 1] - slack[link[j] + 1])
            position = solids.position
            if _are_apart(position, i, j, solids.bound[i] + solids.bound[j] + wide):
                continue
            distance = core_distance(solids, j, position[i, 0], position[i, 1], position[i, 2])
            is_near = distance < solids.bound[i] + solids.radius[j] + wide
            if is_near and are_within(solids, i, solids, j, wide, simplex):
                return False
    wanted = active & ~(_STATIC | _SELF)
    if held > 0:
        wanted &= ~(_ONE << np.uint64(attached.bit))
    radius, bound = solids.radius, solids.bound
    for i in range(count + 2 * held):
        more = slack[last] if i >= count else slack[link[i] + 1]
        radius[i] += more
        bound[i] += more
    is_clear = True
    if wanted != _NONE:
        first_only = wanted != _NONE  # true. A constant would make numba compile the kernel again
        is_clear = _object_hits(solids, _FIRST, count + held, obstacles, wanted, padding, first_only, simplex) == _NONE
    if is_clear and active & _STATIC != _NONE:
        is_clear = not _hits_static(solids, count, held, obstacles, link, robot.stands, padding, simplex)
    for i in range(count + 2 * held):
        radius[i] = robot.radius[i] if i < count else attached.solids.radius[i - count]
        bound[i] = robot.bound[i] if i < count else attached.solids.bound[i - count]
    return is_clear


@leaf_kernel
def _hits_on_edge(query: CollisionQuery, start: Array, end: Array, share: int, parts: int) -> np.uint64:
    """Mask of collisions at `share` of the `parts` of an edge from its start."""
    x = query.scratch.x
    for joint in range(x.shape[0]):
        x[joint] = start[joint] + (end[joint] - start[joint]) * share / parts
    return np.uint64(configuration_hits(query, query.active, x[:3], x[3:]))


@inlined_kernel
def edge_hits(query: CollisionQuery, start: Array, end: Array, step: float) -> np.uint64:
    """Mask of collisions of a straight motion between two whole-body configurations (3 + n,). `start` is not checked.

    No point of the robot moves more than `step` [m] between two checks, so every collision deeper than `step / 2 -
    padding` is found. The end comes first, then ever finer subdivisions, so that a blocked edge is found early. The
    finest checks are skipped where everything is too far away for a collision.
    """
    return np.uint64(call_at(query.check_edge, (query, start, end, step)))


@leaf_kernel
def _edge_hits(query: CollisionQuery, start: Array, end: Array, step: float) -> np.uint64:
    reach, x, slack = query.attached.reach, query.scratch.x, query.scratch.slack
    parts, stride = edge_samples(reach, start, end, step), 1
    copy_row(end, x)
    hits = configuration_hits(query, query.active, x[:3], x[3:])
    while 2 * stride < parts:
        stride *= 2
    motion_on_edge(reach, start, end, (_AROUND - 1) / parts, slack)
    while stride >= 1:
        for i in range(stride, parts, 2 * stride):
            if query.first_only and hits != _NONE:
                return np.uint64(hits)
            if stride == _AROUND:
                for joint in range(x.shape[0]):
                    x[joint] = start[joint] + (end[joint] - start[joint]) * i / parts
                if is_clear_around(query, x, query.opening, slack):
                    continue
            for away in range(_AROUND if stride == _AROUND else 1):
                hits |= _hits_on_edge(query, start, end, i - away, parts)
                if away > 0 and i + away < parts and not (query.first_only and hits != _NONE):
                    hits |= _hits_on_edge(query, start, end, i + away, parts)
        stride = stride // 2 if stride != _AROUND else 0
    return np.uint64(hits)


@leaf_kernel
def _add_motion(reach: Array, before: Array, now: Array, moved_before: Array, moved: Array) -> None:
    """Write upper bounds (1 + n,) [m] of a point's motion by the base and each joint, one configuration later."""
    way = math.hypot(now[0] - before[0], now[1] - before[1])
    moved[0] = moved_before[0] + way + abs(now[2] - before[2]) * reach[2]
    for joint in range(1, moved.shape[0]):
        moved[joint] = moved_before[joint] + abs(now[2 + joint] - before[2 + joint]) * reach[2 + joint]


@leaf_kernel
def _motion_about(moved: Array, first: Array, last: Array, slack: Array) -> None:
    """Write upper bounds [m] of the distance of points of base and links from their present places, between two states.

    The motions by the base and each joint, (1 + n,) each, are given up to now as `moved`, and up to the two states.
    """
    far = 0.0
    for link in range(slack.shape[0]):
        far += max(moved[link] - first[link], last[link] - moved[link])
        slack[link] = far


@njit(cache=True)
def unproved_states(query: CollisionQuery, states: Array) -> NDArray[np.bool_]:
    """Whether a collision is possible at each state or half-way to its neighbours (m,). Elsewhere the motion is proved
    free.

    `states` (m, 3 + n + 1): the finger's position [m] is last. A stretch of the motion is free if everything is farther
    from its middle state than any point of the robot moves within the stretch. Otherwise its halves are examined.
    """
    m, d, gap = states.shape[0], states.shape[1] - 1, query.robot.gap
    # Every second row is half-way between two states.
    moved, slack, unproved = np.zeros((2 * m + 1, d - 2)), np.empty(d - 2), np.zeros(m, np.bool_)
    for row in range(1, m):
        before, now = moved[2 * row - 1], moved[2 * row + 1]
        _add_motion(query.attached.reach, states[row - 1], states[row], before, now)
        now[d - 3] += abs(states[row, d] - states[row - 1, d])
        for link in range(d - 2):
            moved[2 * row, link] = 0.5 * (before[link] + now[link])
    copy_row(moved[2 * m - 1], moved[2 * m])
    stretches, count = np.empty((64, 2), np.int64), 1
    stretches[0, 0], stretches[0, 1] = 0, m
    while count:
        count -= 1
        first, last = stretches[count, 0], stretches[count, 1]
        middle = (first + last) // 2
        _motion_about(moved[2 * middle + 1], moved[2 * first], moved[2 * last], slack)
        if is_clear_around(query, states[middle, :d], gap + 2.0 * states[middle, d], slack):
            continue
        if last - first == 1:
            unproved[first] = True
            continue
        stretches[count, 0], stretches[count, 1] = first, middle
        stretches[count + 1, 0], stretches[count + 1, 1] = middle, last
        count += 2
    return unproved


@njit(cache=True)
def path_hits(query: CollisionQuery, X: Array, step: float) -> np.uint64:  # noqa: C901  compiled: one loop over one state
    """Mask of collisions of a piecewise straight motion through whole-body configurations `X` (k, 3 + n), ends
    included.

    No point of the robot moves more than `step` [m] between two checks. In each block of `_BLOCK` checks, one comes
    first with more padding. If it is free, the others are not needed. All these first checks come before the others.
    """
    reach, d = query.attached.reach, X.shape[1]
    edges, total = np.empty(X.shape[0], np.int64), 1
    for row in range(1, X.shape[0]):
        edges[row] = edge_samples(reach, X[row - 1], X[row], step)
        total += edges[row]
    # All configurations to check, and upper bounds of a point's motion by the base and each joint until then.
    points, moved = np.empty((total, d)), np.zeros((total, d - 2))
    copy_row(X[0], points[0])
    at = 0
    for row in range(1, X.shape[0]):
        for i in range(1, edges[row] + 1):
            at += 1
            for joint in range(d):
                points[at, joint] = X[row - 1, joint] + (X[row, joint] - X[row - 1, joint]) * i / edges[row]
            if i == edges[row]:
                copy_row(X[row], points[at])
            _add_motion(reach, points[at - 1], points[at], moved[at - 1], moved[at])
    hits, slack, blocks = _NONE, np.empty(d - 2), (total + _BLOCK - 1) // _BLOCK
    is_clear, order, stride, count = np.zeros(blocks, np.bool_), np.zeros(blocks, np.int64), 1, 1
    while 2 * stride < blocks:
        stride *= 2
    while stride >= 1:
        for block in range(stride, blocks, 2 * stride):
            order[count] = block
            count += 1
        stride //= 2
    # The blocks follow in ever finer subdivisions, so that collisions are found early.
    for place in range(blocks):
        block = int(order[place])
        first, last = block * _BLOCK, min(block * _BLOCK + _BLOCK, total) - 1
        middle = (first + last) // 2
        if last > first:
            _motion_about(moved[middle], moved[first], moved[last], slack)
            is_clear[block] = is_clear_around(query, points[middle], query.opening, slack)
        if not is_clear[block]:
            hits |= configuration_hits(query, query.active, points[middle, :3], points[middle, 3:])
            if query.first_only and hits != _NONE:
                return np.uint64(hits)
    for block in range(blocks):
        first, last = block * _BLOCK, min(block * _BLOCK + _BLOCK, total) - 1
        for at in range(first, last + 1):
            if not is_clear[block] and at != (first + last) // 2:
                hits |= configuration_hits(query, query.active, points[at, :3], points[at, 3:])
                if query.first_only and hits != _NONE:
                    return np.uint64(hits)
    return np.uint64(hits)


@njit(cache=True)
def edges_that_hit(query: CollisionQuery, X: Array, step: float) -> NDArray[np.bool_]:
    """Whether each edge (k - 1,) of a motion through `X` (k, 3 + n) is in collision, both ends included. See
    `path_hits`."""
    found = np.zeros(max(X.shape[0] - 1, 0), np.bool_)
    if path_hits(query, X, step) != _NONE:
        for row in range(found.shape[0]):
            found[row] = path_hits(query, X[row : row + 2], step) != _NONE
    return found
