"""Collision shapes of a robot, and the test of a configuration for self-collision, compiled.

`irm.self_contact` selects the tested pairs of shapes once, when a robot is read. A configuration is free if all pairs
keep `CLEARANCE` apart.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from irm.gjk import CYLINDER, Solids, are_any_within, are_within, core_distance
from irm.kernel_arguments import leaf_kernel
from irm.self_contact import BASE, CLEARANCE

Array = NDArray[np.float64]


class Shapes(NamedTuple):
    """Convex solids on the links of a robot, for kernels. Lengths in m, arrays read-only.

    Attributes:
        core, half, radius, bound: (p, …) as in `Solids`.
        link: (p,) BASE, 0 … n, with `position` (p, 3) and `rotation` (p, 3, 3) in that link's frame.
        opened: (p, 3) displacement from closed to open fingers. Zero for all shapes except fingers.
        vertices: (v, 3), `first` (p + 1,): corners of hulls, as in `Solids`.
        pairs: (s, 2) pairs of solids to test, in the order of `groups`.
        groups: (5,) bounds of four groups in `pairs`: last link and torso, other pairs without the base, last link and
            base, other pairs with the base.
    """

    core: NDArray[np.int64]
    half: Array
    radius: Array
    bound: Array
    link: NDArray[np.int64]
    position: Array
    rotation: Array
    opened: Array
    vertices: Array
    first: NDArray[np.int64]
    pairs: NDArray[np.int64]
    groups: NDArray[np.int64]


class Placed(NamedTuple):
    """Memory of one thread: `solids` in the base frame, and `simplex` (4, 3) for GJK."""

    solids: Solids
    simplex: Array


HAND_TORSO, ARM, HAND_BASE, ARM_BASE = range(4)
"""Groups of pairs, see `Shapes.groups`. The hand is the last link."""
NO_SHAPES = Shapes(
    *(np.zeros(0, np.int64), np.zeros((0, 3)), np.zeros(0), np.zeros(0), np.zeros(0, np.int64), np.zeros((0, 3))),
    *(np.zeros((0, 3, 3)), np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(1, np.int64)),
    *(np.zeros((0, 2), np.int64), np.zeros(5, np.int64)),
)
"""Shapes of an arm with known joints alone: every configuration is free."""
for _array in NO_SHAPES:
    _array.setflags(write=False)


def with_pairs(shapes: Shapes, pairs: NDArray[np.int64], last: int) -> Shapes:
    """Set the pairs (s, 2) of shapes, in the order of the groups. `last` is the number of the last link."""
    links = np.sort(shapes.link[pairs], axis=1).reshape(-1, 2)
    group = 2 * (links[:, 0] == BASE) + 1 - ((links[:, 0] <= 0) & (links[:, 1] == last))
    order = np.argsort(group, kind="stable")
    groups = np.searchsorted(group[order], np.arange(5))
    shapes = shapes._replace(pairs=np.ascontiguousarray(pairs[order]), groups=groups)
    for array in shapes:
        array.setflags(write=False)
    return shapes


def for_every_roll(shapes: Shapes, last: int, point: Array, axis: Array) -> Shapes:
    """Replace the shapes of the last link by cylinders that they sweep in a turn about the last joint's axis.

    Args:
        shapes: of the robot.
        last: number of the last link.
        point, axis: (3,) the last joint's axis in the frame of the last link.
    """
    mine = np.flatnonzero(shapes.link == last).tolist()
    core, half, radius, bound = shapes.core.copy(), shapes.half.copy(), shapes.radius.copy(), shapes.bound.copy()
    position, rotation = shapes.position.copy(), shapes.rotation.copy()
    side = np.eye(3)[int(np.argmin(np.abs(axis)))]
    x = np.cross(side, axis) / np.linalg.norm(np.cross(side, axis))
    for k in mine:
        corners = _corners(shapes, k)
        corners = np.concatenate([corners, corners + shapes.opened[k]]) - point
        along = corners @ axis
        widest = float(np.linalg.norm(corners - along[:, None] * axis, axis=1).max()) + radius[k]
        low, high = along.min() - radius[k], along.max() + radius[k]
        core[k], radius[k] = CYLINDER, 0.0
        half[k] = widest, widest, (high - low) / 2
        bound[k] = np.hypot(widest, (high - low) / 2)
        position[k] = point + axis * (low + high) / 2
        rotation[k] = np.column_stack([x, np.cross(axis, x), axis])
    opened = np.where((shapes.link == last)[:, None], 0.0, shapes.opened)
    swept = shapes._replace(
        core=core, half=half, radius=radius, bound=bound, position=position, rotation=rotation, opened=opened
    )
    for array in swept:
        array.setflags(write=False)
    return swept


def _corners(shapes: Shapes, k: int) -> Array:
    """(v, 3) corners, in its link's frame, whose hull contains the core of solid k."""
    local = shapes.vertices[shapes.first[k] : shapes.first[k + 1]] if shapes.first.size > 1 else np.empty((0, 3))
    if not len(local):
        local = np.stack(np.meshgrid((-1, 1), (-1, 1), (-1, 1)), axis=-1).reshape(-1, 3) * shapes.half[k]
    return np.asarray(shapes.position[k] + local @ shapes.rotation[k].T)


def make_placed(shapes: Shapes) -> Placed:
    """Memory for the checks of one thread."""
    position, rotation = np.empty_like(shapes.position), np.empty_like(shapes.rotation)
    solids = Solids(
        *(shapes.core, shapes.half, shapes.radius, shapes.bound, position, rotation, shapes.vertices, shapes.first)
    )
    return Placed(solids, np.empty((4, 3)))


@leaf_kernel
def place_shapes(shapes: Shapes, placed: Placed, R: Array, p: Array) -> None:
    """Write the solids' poses for frames `R` (n + 1, 3, 3), `p` (n + 1, 3) of the links in the base frame."""
    link, local, turn, opened = shapes.link, shapes.position, shapes.rotation, shapes.opened
    position, rotation = placed.solids.position, placed.solids.rotation
    for k in range(link.shape[0]):
        frame = link[k]
        for i in range(3):
            if frame == BASE:
                position[k, i] = local[k, i]
                for j in range(3):
                    rotation[k, i, j] = turn[k, i, j]
                continue
            position[k, i] = p[frame, i]
            for j in range(3):
                position[k, i] += R[frame, i, j] * (local[k, j] + opened[k, j])
                rotation[k, i, j] = (
                    R[frame, i, 0] * turn[k, 0, j] + R[frame, i, 1] * turn[k, 1, j] + R[frame, i, 2] * turn[k, 2, j]
                )


@leaf_kernel
def lower_base(shapes: Shapes, placed: Placed, by: float) -> None:
    """Lower the shapes fixed to the base [m], which equals a lift of the torso with everything that it carries."""
    for k in range(shapes.link.shape[0]):
        if shapes.link[k] == BASE:
            placed.solids.position[k, 2] = shapes.position[k, 2] - by


@leaf_kernel
def is_pair_near(solids: Solids, i: int, j: int, clearance: float, simplex: Array) -> bool:
    """Whether two solids come nearer than a clearance [m]."""
    position = solids.position
    distance = core_distance(solids, j, position[i, 0], position[i, 1], position[i, 2])
    if distance >= solids.bound[i] + solids.radius[j] + clearance:
        return False
    if solids.core[i] <= CYLINDER and solids.core[j] <= CYLINDER:
        return are_within(solids, i, solids, j, clearance, simplex)
    return are_any_within(solids, i, solids, j, clearance, simplex)


@leaf_kernel
def any_near(shapes: Shapes, placed: Placed, group: int, clearance: float) -> bool:
    """Whether a placed pair in one of the four groups of `Shapes.groups` comes nearer than a clearance [m]."""
    for pair in range(shapes.groups[group], shapes.groups[group + 1]):
        if is_pair_near(placed.solids, shapes.pairs[pair, 0], shapes.pairs[pair, 1], clearance, placed.simplex):
            return True
    return False


@leaf_kernel
def is_free(shapes: Shapes, placed: Placed, R: Array, p: Array) -> bool:
    """Whether a configuration with these frames of the links, as in `place_shapes`, is free of self-collision."""
    place_shapes(shapes, placed, R, p)
    touches = False
    for group in (HAND_TORSO, ARM, HAND_BASE, ARM_BASE):
        touches = touches or any_near(shapes, placed, group, CLEARANCE)
    return not touches
