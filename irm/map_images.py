"""Images of a map's cell under turns of the first and the last joint, which share one solution.

The first joint turns about the vertical axis in the middle of the grid. A quarter turn moves the TCP from the centre of
one cell to that of another. The last joint of most arms turns the TCP about its approach. A turn by the step between
two rolls of the map changes only the roll. μ stays the same. So inverse kinematics is solved for one cell per group of
images: up to four times the number of rolls. Each image needs only tests of the two joints' limits, and of two kinds of
contact:

- between links of the arm: the same in all images, except for the last link, which depends on the roll.
- between the arm and the base or torso: base and torso are turned back in place of the arm.

An arm whose first axis is not vertical, or whose last axis is not the approach, has no such images.
"""

from __future__ import annotations

from math import pi
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from irm.chain import PRISMATIC, ArmChain
from irm.compilation import njit
from irm.grid import MapGrid
from irm.ik.subproblems import nearest_turn
from irm.kernel_arguments import leaf_kernel
from irm.kinematics import link_frames
from irm.rotations import rotation
from irm.self_contact import BASE, CLEARANCE
from irm.shapes import Placed, Shapes, is_pair_near

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
Integers = NDArray[np.int64]
Bools = NDArray[np.bool_]
_ALIGNED = 1e-6
"""Tolerance of an axis: sine of its angle to the vertical or the approach, and [m] to the grid's middle."""
_LIMIT_ROUNDING = 1e-9
"""[rad]"""


class Images(NamedTuple):
    """Images of the cells of a layer.

    `quarters`: 4 or 1 turns of the first joint. `rolls`: turns of the last joint. `pan_sign`, `roll_sign`: signs of
    their joint angles. `lower`, `upper` (2,): their limits [rad]. `orientation` (o, rolls): images of each orientation
    under the last joint, -1 for none. `root` (o,): orientation whose image it is. `turned` (o,): image under a quarter
    turn.
    """

    quarters: int
    rolls: int
    pan_sign: float
    roll_sign: float
    lower: Floats
    upper: Floats
    orientation: Integers
    root: Integers
    turned: Integers


class Touching(NamedTuple):
    """Shapes that may touch, for the test of images.

    Pairs of solids (s, 2) are grouped by their links. `arm`: two arm links, the last excepted. `hand`: the last link
    and another arm link. `torso` and `base`: torso or base and an arm link. `torso_hand` and `base_hand`: torso or base
    and the last link. `fixed` (f,): solids of base and torso. `is_base` (f,): which of them belong to the base.
    `position` (quarters, f, 3) and `rotation` (quarters, f, 3, 3): their poses turned back by each quarter. `last`
    (l,): solids of the last link.
    """

    arm: Integers
    hand: Integers
    torso: Integers
    torso_hand: Integers
    base: Integers
    base_hand: Integers
    fixed: Integers
    is_base: Bools
    position: Floats
    rotation: Floats
    last: Integers


def images_of(chain: ArmChain, grid: MapGrid) -> Images:
    """Find the images of the cells of an arm's map."""
    n, orientations = chain.size, grid.orientations
    R, p = link_frames(chain, np.zeros(n))
    first, last = (R[joint][:, chain.axes[joint] % PRISMATIC] for joint in (1, n - 1))
    are_hinges = bool(np.all(chain.axes[[1, n - 1]] < PRISMATIC))
    off_centre = max(np.abs(first[:2]).max(), np.abs(p[1, :2] - grid.centre).max())
    approach, arm = R[n][:, 0], p[n] - p[n - 1]
    off_approach = max(np.linalg.norm(np.cross(last, approach)), np.linalg.norm(np.cross(last, arm)))
    counts, groups = orientations.count, range(len(orientations.pitch))
    has_quarters = are_hinges and off_centre < _ALIGNED and all(count == 1 or count % 4 == 0 for count in counts)
    rolls = len(np.unique(orientations.roll))
    rolls = rolls if are_hinges and off_approach < _ALIGNED and not orientations.free_roll else 1
    image = np.full((orientations.size, rolls), -1)
    root, turned = np.arange(orientations.size), np.empty(orientations.size, np.int64)
    for group in groups:
        start, count = int(orientations.start[group]), int(counts[group])
        turned[start : start + count] = start + (np.arange(count) + count // 4) % count
        image[start : start + count, 0] = np.arange(start, start + count)
        if rolls == 1 or orientations.is_pole(group):
            continue
        # Groups of one ring are consecutive, by increasing roll from 0.
        number = round(float(orientations.roll[group]) % (2 * pi) / (2 * pi) * rolls)
        own = int(orientations.start[group - number])
        root[start : start + count] = own + np.arange(count)
        image[own : own + count, number] = start + np.arange(count)
    image[root != np.arange(len(root))] = -1
    limits = [(chain.lower[joint], chain.upper[joint]) for joint in (1, n - 1)]
    lower, upper = (np.array(side, dtype=float) for side in zip(*limits, strict=True))
    signs = float(np.sign(first[2])) or 1.0, float(np.sign(last @ approach)) or 1.0
    return Images(4 if has_quarters else 1, rolls, *signs, lower, upper, image, root, turned)


def without_limits(chain: ArmChain, images: Images) -> tuple[Floats, Floats]:
    """Joint limits (1 + n,) of an arm, lifted for the joints that make images: their limits are tested per image."""
    lower, upper = chain.lower.copy(), chain.upper.copy()
    for joint, count in ((1, images.quarters), (chain.size - 1, images.rolls)):
        if count > 1:
            lower[joint], upper[joint] = -2 * pi, 2 * pi
    return lower, upper


def touching(chain: ArmChain, shapes: Shapes, images: Images) -> Touching:
    """Group the pairs of an arm's shapes that may touch, by the joints that turn them."""
    last, link = chain.size - 1, shapes.link
    pairs = shapes.pairs.reshape(-1, 2)
    pairs = np.where((link[pairs[:, 0]] > link[pairs[:, 1]])[:, None], pairs[:, ::-1], pairs)
    lower_link, on_hand = link[pairs[:, 0]], link[pairs[:, 1]] == last
    fixed = np.flatnonzero(link <= 0)
    position, turn = shapes.position[fixed].copy(), shapes.rotation[fixed].copy()
    R, p = link_frames(chain, np.zeros(chain.size))
    on_torso = link[fixed] == 0
    position[on_torso] = p[0] + (position[on_torso] + shapes.opened[fixed[on_torso]]) @ R[0].T
    turn[on_torso] = R[0] @ turn[on_torso]
    axis = np.array([*p[1, :2], 0.0])
    back = [rotation(-k * pi / 2, 0.0, 0.0) for k in range(images.quarters)]

    def chosen(are_meant: Bools) -> Integers:
        return np.ascontiguousarray(pairs[are_meant])

    places = np.array([axis + (position - axis) @ R_back.T for R_back in back]).reshape(images.quarters, -1, 3)
    turns = np.array([R_back @ turn for R_back in back]).reshape(images.quarters, -1, 3, 3)
    return Touching(
        arm=chosen((lower_link > 0) & ~on_hand),
        hand=chosen((lower_link > 0) & on_hand),
        torso=chosen((lower_link == 0) & ~on_hand),
        torso_hand=chosen((lower_link == 0) & on_hand),
        base=chosen((lower_link == BASE) & ~on_hand),
        base_hand=chosen((lower_link == BASE) & on_hand),
        fixed=fixed,
        is_base=link[fixed] == BASE,
        position=places,
        rotation=turns,
        last=np.flatnonzero(link == last),
    )


@njit(cache=True, inline="always")
def is_within(images: Images, joint: int, angle: float) -> bool:
    """Whether the first (0) or the last (1) joint may have an angle [rad]."""
    return nearest_turn(angle, images.lower[joint], images.upper[joint])[1] <= _LIMIT_ROUNDING


@leaf_kernel
def any_pair_near(placed: Placed, pairs: Integers) -> bool:
    """Whether any pair (s, 2) of placed solids comes nearer than the clearance.

    The pair found moves to the front, because it is probably near in the next, neighbouring configuration too.
    """
    for k in range(pairs.shape[0]):
        i, j = pairs[k, 0], pairs[k, 1]
        if is_pair_near(placed.solids, i, j, CLEARANCE, placed.simplex):
            pairs[k, 0], pairs[k, 1] = pairs[0, 0], pairs[0, 1]
            pairs[0, 0], pairs[0, 1] = i, j
            return True
    return False


@leaf_kernel
def turn_back(some: Touching, placed: Placed, quarter: int) -> None:
    """Turn base and torso back by quarter turns, with the torso at 0."""
    position, rotation = placed.solids.position, placed.solids.rotation
    for f in range(some.fixed.shape[0]):
        k = some.fixed[f]
        for i in range(3):
            position[k, i] = some.position[quarter, f, i]
            for j in range(3):
                rotation[k, i, j] = some.rotation[quarter, f, i, j]


@leaf_kernel
def lower_base_of(some: Touching, placed: Placed, torso: float) -> None:
    """Lower the base by the height of the torso [m]."""
    for f in range(some.fixed.shape[0]):
        if some.is_base[f]:
            placed.solids.position[some.fixed[f], 2] = some.position[0, f, 2] - torso


@leaf_kernel
def roll_hand(
    shapes: Shapes, some: Touching, placed: Placed, R: Floats, p: Floats, axis: int, cosine: float, sine: float
) -> None:
    """Place the shapes of the last link, with frame `R` (3, 3), `p` (3,), turned about an axis of its frame."""
    position, rotation = placed.solids.position, placed.solids.rotation
    u, v = (axis + 1) % 3, (axis + 2) % 3
    for k in some.last:
        x = shapes.position[k, axis] + shapes.opened[k, axis]
        a, b = shapes.position[k, u] + shapes.opened[k, u], shapes.position[k, v] + shapes.opened[k, v]
        y, z = cosine * a - sine * b, sine * a + cosine * b
        for i in range(3):
            position[k, i] = p[i] + R[i, axis] * x + R[i, u] * y + R[i, v] * z
        for j in range(3):
            x, a, b = shapes.rotation[k, axis, j], shapes.rotation[k, u, j], shapes.rotation[k, v, j]
            y, z = cosine * a - sine * b, sine * a + cosine * b
            for i in range(3):
                rotation[k, i, j] = R[i, axis] * x + R[i, u] * y + R[i, v] * z
