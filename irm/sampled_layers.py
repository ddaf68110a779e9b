"""Best manipulability of every cell of a map for any arm, by sampling, compiled.

Random configurations give cells that may be reachable. From each configuration, numerical inverse kinematics moves the
TCP to the cell's centre. Every solution is a seed for the neighbouring cells, in the same layer and in the layer above.
A cell is reached only if its centre is reached. μ is the best value found: a lower bound of the best possible value. If
the arm has a closed form, it then solves two kinds of cells, at `FREE_ANGLES` angles of the free joint. These are
neighbours that iteration did not reach, and cells reached only in self-collision.

Each solution serves all images of its cell, see `irm.map_images`. Only one cell of the images is solved.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from math import cos, pi, sin
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from irm.chain import ArmChain, ChainArrays, chain_arrays
from irm.compilation import njit
from irm.grid import MapGrid, MapParameters, nearest_orientation, orientation_neighbours
from irm.ik.arm_solver import SolverArrays
from irm.ik.closed_form import MIRRORED
from irm.ik.numerical import approach_pose, random_seeds
from irm.ik.solvers import ITERATIVE, arm_solutions, free_angles, solver_arrays
from irm.kernel_arguments import pointer_to
from irm.kinematics import arm_jacobian, condition, fk_frames, wrap
from irm.map_images import (
    Images,
    Touching,
    any_pair_near,
    images_of,
    is_within,
    lower_base_of,
    roll_hand,
    touching,
    turn_back,
    without_limits,
)
from irm.map_kernels import Layer, shapes_at_every_roll, tcp_frames
from irm.rotations import rotation, wrap_to_pi
from irm.shapes import Placed, Shapes, make_placed, place_shapes

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
Integers = NDArray[np.int64]
ATTEMPTS = 4
"""Most seeds per cell."""
FREE_ANGLES = 24
"""Angles of the free joint at which a cell is solved in closed form."""
_BETTER = 1.1
"""Another attempt is made only if μ of a neighbour exceeds that of the cell by this factor."""


_OPEN = 2
"""Unknown so far: neither free (1) nor touching (0)."""


class _Growth(NamedTuple):
    """The layer that grows. Every cell has three arrays. `heights` (o, x, y, t): best μ of free configurations at each
    height of the torso. `own` (o, x, y): the largest of these. `reached` (o, x, y): whether the cell is reached. Four
    arrays (o, x, y) belong to the cells that are solved. `best`: smallest `own` of the cell's images. `configuration`
    (o, x, y, n): that of highest `mu`. `mu`: -1 for none. `attempts`: number of attempts."""

    heights: Singles
    own: Singles
    reached: NDArray[np.bool_]
    best: Singles
    mu: Singles
    configuration: Singles
    attempts: NDArray[np.uint8]


class _Arm(NamedTuple):
    """The arm of a layer. `chain`: its joints, without the limits of the joints that make `images`. `free_roll`:
    whether its wrist rolls freely. `shapes`: its collision shapes, with memory `placed` for them and the pairs
    `touching`. `torsos` (t,): heights [m]. `is_free` (quarters, 1 + t): memory for tests against the torso (first
    column) and the base (others).
    """

    chain: ChainArrays
    free_roll: bool
    shapes: Shapes
    placed: Placed
    touching: Touching
    images: Images
    torsos: Floats
    is_free: NDArray[np.int8]


class _Cells(NamedTuple):
    """Centres of a layer's cells: x (2h,), y (2h,), z, rotations (o, 3, 3), neighbours (o, m) padded with -1."""

    x: Floats
    y: Floats
    z: float
    R: Floats
    neighbours: Integers


def sampled_layers(chain: ArmChain, grid: MapGrid, heights: Floats, parameters: MapParameters) -> Iterator[Layer]:
    """Yield the layers of a map in order.

    Args:
        chain: of any arm.
        grid: of the map.
        heights: (m,) of the layers' middles above the base frame with the torso at 0 [m].
        parameters: number of samples, and their seed.
    """
    images, orientations = images_of(chain, grid), grid.orientations
    rng = np.random.default_rng(parameters.seed)
    configurations = random_seeds(chain, parameters.samples, 0.0, rng)
    configurations, cells = _sorted_by_layer(chain, grid, images, configurations, heights)
    R = np.array([rotation(*angles) for angles in orientations.angles])
    neighbours = orientation_neighbours(orientations)
    neighbours = np.where(neighbours < 0, -1, images.root[neighbours])
    shapes = shapes_at_every_roll(chain) if orientations.free_roll else chain.shapes
    lower, upper = without_limits(chain, images)
    free = replace(chain, lower=lower, upper=upper)
    solver, angles = solver_arrays(free), free_angles(free, FREE_ANGLES)
    fixed = make_placed(shapes), touching(chain, shapes, images), images, np.array(grid.torsos)
    known = np.empty((images.quarters, 1 + len(grid.torsos)), np.int8)
    arm = _Arm(chain_arrays(free), orientations.free_roll, shapes, *fixed, known)
    shape = grid.shape[1:]
    below, was_reached = np.zeros((*shape, chain.size), dtype=np.float32), np.zeros(shape, dtype=bool)
    for k, height in enumerate(heights):
        mine = slice(*np.searchsorted(cells[:, 0], [k, k + 1]))
        growth = _Growth(
            np.zeros((*shape, len(grid.torsos)), dtype=np.float32),
            np.zeros(shape, dtype=np.float32),
            np.zeros(shape, dtype=bool),
            np.zeros(shape, dtype=np.float32),
            np.full(shape, -1.0, dtype=np.float32),
            np.zeros((*shape, chain.size), dtype=np.float32),
            np.zeros(shape, dtype=np.uint8),
        )
        centres = _Cells(grid.axis(0), grid.axis(1), float(height), R, neighbours)
        seeds = np.concatenate([configurations[mine], below[was_reached].astype(float)])
        at = np.concatenate([cells[mine, 1:], np.argwhere(was_reached)])
        _fill_layer(arm, centres, seeds, np.ascontiguousarray(at), growth)
        if solver.kind != ITERATIVE:
            _complete_layer(arm, solver, angles, centres, growth)
        below, was_reached = growth.configuration, growth.mu >= 0.0
        yield Layer(np.moveaxis(growth.heights, 3, 0), growth.reached)


def _sorted_by_layer(
    chain: ArmChain, grid: MapGrid, images: Images, configurations: Floats, heights: Floats
) -> tuple[Floats, Integers]:
    """Select the configurations whose TCP is inside a cell, and turn each to the image that is solved. Returns them and
    their cells (layer, orientation, x, y), lowest layer first."""
    R, p = tcp_frames(chain_arrays(chain), configurations)
    half = 2 * grid.half
    layer = np.floor((p[:, 2] - heights[0]) / grid.thickness + 0.5).astype(np.int64)
    x, y = (np.floor((p[:, k] - grid.centre[k]) / grid.voxel).astype(np.int64) + grid.half for k in (0, 1))
    orientation = nearest_orientation(grid.orientations, R)
    inside = (layer >= 0) & (layer < heights.size) & (x >= 0) & (x < half) & (y >= 0) & (y < half) & (orientation >= 0)
    cells = np.column_stack([layer, orientation, x, y])[inside]
    q = configurations[inside]
    angles = grid.orientations.angles[:, 2]
    root = images.root[cells[:, 1]]
    if images.rolls > 1:
        q[:, -1] = wrap_to_pi(q[:, -1] + images.roll_sign * (angles[root] - angles[cells[:, 1]]))
    cells[:, 1] = root
    for _ in range(images.quarters - 1):
        away = (cells[:, 2] < grid.half) | (cells[:, 3] < grid.half)
        cells[away] = np.column_stack(
            [cells[away, 0], images.turned[cells[away, 1]], half - 1 - cells[away, 3], cells[away, 2]]
        )
        q[away, 1] = wrap_to_pi(q[away, 1] + images.pan_sign * pi / 2)
    order = np.argsort(cells[:, 0], kind="stable")
    return q[order], cells[order]


class _Frames(NamedTuple):
    """Memory for the frames of the links and the Jacobian of a configuration, and for `condition`."""

    R: Floats
    p: Floats
    J: Floats
    A: Floats
    d: Floats
    e: Floats


@njit(cache=True)
def _make_frames(n: int) -> _Frames:
    return _Frames(
        np.empty((n + 1, 3, 3)), np.empty((n + 1, 3)), np.empty((6, n - 1)), np.empty((6, 6)), np.empty(6), np.empty(6)
    )


@njit(cache=True)
def _take(arm: _Arm, growth: _Growth, at: tuple[int, int, int], q: Floats, frames: _Frames, only_lacking: bool) -> bool:  # noqa: C901  compiled: one loop over one state
    """Give a configuration that reaches a cell to every image that it improves. True if it improves any image.

    `frames`: frames of the links at the configuration. `only_lacking`: whether only images without a free configuration
    are considered. A configuration in self-collision at every height of the torso has μ = 0.
    """
    shapes, placed, some = pointer_to(arm.shapes), pointer_to(arm.placed), pointer_to(arm.touching)
    images, (o, x, y), n = arm.images, at, arm.chain.axes.shape[0]
    last, side, torsos = n - 1, growth.best.shape[1], arm.torsos.shape[0]
    best_of, own_of, reached_of = growth.heights, growth.own, growth.reached
    mu = np.float32(0.0) if only_lacking else _mu(arm, frames)
    place_shapes(shapes, placed, frames.R, frames.p)
    is_arm_free = not any_pair_near(placed, some.arm)
    is_new, worst = growth.mu[at] < 0.0, np.float32(2.0)
    improved = is_new
    axis, is_free = arm.chain.axes[last] % 3, arm.is_free
    is_free[:] = _OPEN
    for roll in range(images.rolls):
        to = images.orientation[o, roll]
        if to < 0:
            continue
        turn = images.roll_sign * roll * 2.0 * pi / images.rolls
        is_hand_free, is_rolled = is_arm_free, False
        is_roll_within = images.rolls == 1 or is_within(images, 1, q[last] + turn)
        i, j = x, y
        for quarter in range(images.quarters):
            if quarter > 0:
                i, j, to = side - 1 - j, i, images.turned[to]
            pan = q[1] + images.pan_sign * quarter * 0.5 * pi
            if is_roll_within and (images.quarters == 1 or is_within(images, 0, pan)):
                if not reached_of[to, i, j]:
                    reached_of[to, i, j] = improved = True
                is_turned, is_torso_free = False, True
                is_lacking = own_of[to, i, j] == 0.0
                for t in range(torsos):
                    if not (is_hand_free and is_torso_free) or (only_lacking and not is_lacking):
                        break
                    if not only_lacking and best_of[to, i, j, t] >= mu:
                        continue
                    if not is_rolled:
                        is_rolled = True
                        if roll > 0:
                            roll_hand(shapes, some, placed, frames.R[last], frames.p[last], axis, cos(turn), sin(turn))
                        is_hand_free = not any_pair_near(placed, some.hand)
                        if not is_hand_free:
                            break
                    if not is_turned:
                        is_turned = True
                        turn_back(some, placed, quarter)
                        if is_free[quarter, 0] == _OPEN:
                            is_free[quarter, 0] = not any_pair_near(placed, some.torso)
                        is_torso_free = is_free[quarter, 0] == 1 and not any_pair_near(placed, some.torso_hand)
                        if not is_torso_free:
                            break
                    if is_free[quarter, 1 + t] == 0:
                        continue
                    lower_base_of(some, placed, arm.torsos[t])
                    if is_free[quarter, 1 + t] == _OPEN:
                        is_free[quarter, 1 + t] = not any_pair_near(placed, some.base)
                    if is_free[quarter, 1 + t] == 1 and not any_pair_near(placed, some.base_hand):
                        mu = mu if mu > 0.0 else _mu(arm, frames)
                        best_of[to, i, j, t] = mu
                        own_of[to, i, j] = max(own_of[to, i, j], mu)
                        improved = True
            worst = min(worst, own_of[to, i, j])
    growth.best[at] = worst
    if mu > growth.mu[at]:
        growth.mu[at] = mu
        growth.configuration[at] = q.astype(np.float32)
    return improved


@njit(cache=True)
def _mu(arm: _Arm, frames: _Frames) -> np.float32:
    """μ at the frames of a configuration."""
    arm_jacobian(arm.chain.axes, frames.R, frames.p, frames.J)
    return np.float32(condition(frames.J, frames.A, frames.d, frames.e))


@njit(cache=True)
def _is_wanted(growth: _Growth, images: Images, at: tuple[int, int, int], q: Floats) -> bool:
    """Whether a configuration may serve an image without a free configuration, or is the first of the cell."""
    if growth.mu[at] < 0.0:
        return True
    (o, x, y), side, last = at, growth.best.shape[1], q.shape[0] - 1
    for roll in range(images.rolls):
        to = images.orientation[o, roll]
        turn = images.roll_sign * roll * 2.0 * pi / images.rolls
        if to < 0 or not (images.rolls == 1 or is_within(images, 1, q[last] + turn)):
            continue
        i, j = x, y
        for quarter in range(images.quarters):
            if quarter > 0:
                i, j, to = side - 1 - j, i, images.turned[to]
            pan = q[1] + images.pan_sign * quarter * 0.5 * pi
            if growth.own[to, i, j] == 0.0 and (images.quarters == 1 or is_within(images, 0, pan)):
                return True
    return False


@njit(cache=True)
def _fill_layer(arm: _Arm, centres: _Cells, seeds: Floats, at: Integers, growth: _Growth) -> None:
    """Solve the cells `at` (m, 3) from `seeds` (m, n), then their neighbours from these solutions, until no cell
    improves."""
    n = arm.chain.axes.shape[0]
    frames = _make_frames(n)
    width, images = centres.x.shape[0], arm.images
    stack = [(0, 0, 0)]
    stack.pop()
    q, goal = np.empty(n), np.empty(3)
    pending = 0
    while True:
        if len(stack) > 0:
            o, x, y = stack.pop()
            source = growth.configuration[o, x, y]
            moves = 4 + centres.neighbours.shape[1]
        elif pending < at.shape[0]:
            o, x, y = at[pending, 0], at[pending, 1], at[pending, 2]
            source = seeds[pending].astype(np.float32)
            moves = 1
            pending += 1
        else:
            return
        from_seed = moves == 1
        for move in range(moves):
            to, i, j = o, x, y
            if not from_seed:
                if move < 4:
                    i, j = x + (move == 0) - (move == 1), y + (move == 2) - (move == 3)
                else:
                    to = centres.neighbours[o, move - 4]
                if to < 0 or i < 0 or j < 0 or i >= width or j >= width:
                    continue
            pan = 0.0
            for _ in range(images.quarters - 1):
                if i < width // 2 or j < width // 2:
                    i, j, to = width - 1 - j, i, images.turned[to]
                    pan += images.pan_sign * 0.5 * pi
            own = growth.best[to, i, j]
            promising = own == 0.0 or (not from_seed and growth.best[o, x, y] > _BETTER * own)
            if growth.attempts[to, i, j] >= (2 * ATTEMPTS if own == 0.0 else ATTEMPTS) or not promising:
                continue
            growth.attempts[to, i, j] += 1
            goal[0], goal[1], goal[2] = centres.x[i], centres.y[j], centres.z
            q[:] = source
            q[1] += pan
            R = centres.R[to]
            if approach_pose(arm.chain, R, goal, arm.free_roll, q, frames.R, frames.p, frames.J):
                if images.quarters > 1:
                    q[1] = wrap(q[1])
                if images.rolls > 1:
                    q[n - 1] = wrap(q[n - 1])
                if _take(arm, growth, (to, i, j), q, frames, False):
                    stack.append((to, i, j))


@njit(cache=True)
def _complete_layer(arm: _Arm, solver: SolverArrays, angles: Floats, centres: _Cells, growth: _Growth) -> None:
    """Solve in closed form the cells with an image without a free configuration, if they or a neighbour are reached."""
    n = arm.chain.axes.shape[0]
    frames, found, goal = _make_frames(n), np.empty((8, n)), np.empty(3)
    reached, width, images = growth.reached, centres.x.shape[0], arm.images
    first = width // 2 if images.quarters > 1 else 0
    for o in range(reached.shape[0]):
        for x in range(first, width):
            for y in range(first, width):
                if images.orientation[o, 0] < 0 or growth.best[o, x, y] > 0.0:
                    continue
                near = reached[o, x, y] or (x > 0 and reached[o, x - 1, y]) or (y > 0 and reached[o, x, y - 1])
                near = near or (x + 1 < width and reached[o, x + 1, y]) or (y + 1 < width and reached[o, x, y + 1])
                if not (near or growth.mu[o, x, y] >= 0.0):
                    continue
                goal[0], goal[1], goal[2] = centres.x[x], centres.y[y], centres.z
                for angle in angles:
                    for k in range(arm_solutions(solver, centres.R[o], goal, 0.0, angle, found, MIRRORED)):
                        if not _is_wanted(growth, images, (o, x, y), found[k]):
                            continue
                        fk_frames(arm.chain.offsets, arm.chain.axes, arm.chain.tip, found[k], frames.R, frames.p)
                        _take(arm, growth, (o, x, y), found[k], frames, True)
                    if growth.best[o, x, y] > 0.0:
                        break
