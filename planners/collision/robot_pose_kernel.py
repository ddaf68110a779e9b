"""Where are the robot's primitives, and the held object, in the world? Compiled forward kinematics of solids."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from irm.chain import BASE
from irm.kinematics import fk_frames
from planners.collision.gjk import Solids
from planners.collision.leaf_kernels import inlined_kernel, leaf_kernel
from planners.collision.scene_arrays import RobotArrays
from planners.collision.struct_pointers import pointer_to

Array = NDArray[np.float64]


class Attached(NamedTuple):
    """The held object, for kernels, as two solids: the object itself, and a copy with its bottom raised.

    The copy is checked against static obstacles, so that an object that stands on the table can be lifted from it.

    Attributes:
        bit: of the object, -1 for none.
        core: BOX or CYLINDER; `half` (2, 3); `bound` [m] radius of the sphere that contains it.
        position: (2, 3) and `rotation` (2, 3, 3) in the TCP frame.
        reach: (3 + n,) how far each joint moves any point of robot or object at most, per radian or metre.
    """

    bit: int
    core: int
    half: Array
    bound: float
    position: Array
    rotation: Array
    reach: Array


class Scratch(NamedTuple):
    """Memory of one thread, written by every check: the robot with n joints and p primitives, placed in the world.

    Attributes:
        R: (n + 2, 3, 3) orientations of the link frames, then of the TCP's and the base's.
        p: (n + 2, 3) their origins [m].
        solids: p + 2 solids: the robot's primitives, then the two of the held object, as in `Attached`.
        x: (3 + n,) the whole-body configuration that is checked, on the way along an edge.
        simplex: (4, 3) for `are_within`.
    """

    R: Array
    p: Array
    solids: Solids
    x: Array
    simplex: Array


def make_scratch(robot: RobotArrays, attached: Attached) -> Scratch:
    """Memory for checks of this robot with this held object, or none."""
    n, p = robot.offsets.shape[0], robot.core.shape[0]
    solids = Solids(
        core=np.concatenate((robot.core, np.full(2, attached.core))),
        half=np.concatenate((robot.half, attached.half)),
        radius=np.concatenate((robot.radius, np.zeros(2))),
        bound=np.concatenate((robot.bound, np.full(2, attached.bound))),
        position=np.empty((p + 2, 3)),
        rotation=np.empty((p + 2, 3, 3)),
        vertices=np.empty((0, 3)),
        first=np.empty(0, np.int64),
    )
    return Scratch(np.empty((n + 2, 3, 3)), np.empty((n + 2, 3)), solids, np.empty(3 + n), np.empty((4, 3)))


@inlined_kernel
def _compose(R: Array, p: Array, frame: int, local: Array, turn: Array, row: int, solids: Solids, index: int) -> None:
    """Write the world pose of solid `index`, which is at `local[row]`, `turn[row]` in frame `frame` of R, p."""
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
    """Transform the first `count` frames from the base frame to the world; write the base's own frame after them."""
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


@leaf_kernel
def place_robot(
    robot: RobotArrays, attached: Attached, scratch: Scratch, base: Array, q: Array, opening: float
) -> None:
    """Write the world poses of all primitives, and of the held object, into `scratch`.

    Args:
        robot, attached, scratch: see their types.
        base: (3,) x [m], y [m], yaw [rad].
        q: (n,) torso [m] and arm [rad].
        opening: of the gripper [m].
    """
    R, p, solids, position = scratch.R, scratch.p, scratch.solids, scratch.solids.position
    fk_frames(robot.offsets, robot.axes, robot.tip, q, R, p)
    tcp, count = robot.offsets.shape[0], robot.core.shape[0]
    _move_frames(R, p, tcp + 1, base)
    link, slides, along, local, turn = robot.link, robot.slides, robot.slide, robot.position, robot.rotation
    slide = min(max(0.5 * (opening - robot.gap), 0.0), robot.slide_end)
    for i in range(count):
        frame = tcp + 1 if link[i] == BASE else link[i]
        _compose(R, p, frame, local, turn, i, solids, i)
        if slides[i]:
            for axis in range(3):
                moved = R[frame, axis, 0] * along[i, 0]
                moved += R[frame, axis, 1] * along[i, 1] + R[frame, axis, 2] * along[i, 2]
                position[i, axis] += slide * moved
    if attached.bit >= 0:
        for row in range(2):
            _compose(R, p, tcp, attached.position, attached.rotation, row, solids, count + row)


def place_along(robot: RobotArrays, attached: Attached, X: Array, opening: float) -> tuple[Array, Array]:
    """World poses of all p primitives, then of the held object, at each of n configurations.

    Args:
        robot, attached: see their types; without a held object its poses mean nothing.
        X: (n, 3 + j) whole-body configurations.
        opening: of the gripper [m].

    Returns:
        positions (n, p + 1, 3) [m] and rotations (n, p + 1, 3, 3).
    """
    solids = robot.core.shape[0] + 1
    positions, rotations = np.empty((X.shape[0], solids, 3)), np.empty((X.shape[0], solids, 3, 3))
    _place_along(robot, attached, make_scratch(robot, attached), X, opening, positions, rotations)
    return positions, rotations


@leaf_kernel
def _place_along(
    robot: RobotArrays,
    attached: Attached,
    scratch: Scratch,
    X: Array,
    opening: float,
    positions: Array,
    rotations: Array,
) -> None:
    """The loop of `place_along`."""
    solids = scratch.solids
    moving, held, memory = pointer_to(robot), pointer_to(attached), pointer_to(scratch)
    for k in range(X.shape[0]):
        place_robot(moving, held, memory, X[k, :3], X[k, 3:], opening)
        for i in range(positions.shape[1]):
            for row in range(3):
                positions[k, i, row] = solids.position[i, row]
                for column in range(3):
                    rotations[k, i, row, column] = solids.rotation[i, row, column]
