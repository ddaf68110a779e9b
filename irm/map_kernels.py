"""Best manipulability of every cell of a map, compiled: by the closed form of Fetch's arm, or by sampling for any arm.

Only configurations free of self-collision count. A cell whose centre is reached in others alone has μ = 0.

Closed form: the arm's redundancy is scanned over its pan angle. Pan does not change μ, and the arm is symmetric about
the plane y = 0. So the scan of one voxel gives eight: its images under quarter turns about the pan axis and under the
reflection y → -y. The images differ by the pan limits and by what the arm touches. Of each, the configurations are
tested from the highest μ down, at all heights of the torso at once: only the base changes its place under the arm.

Sampling: random configurations give cells that may be reachable. From each configuration, numerical inverse kinematics
moves the TCP to the cell's centre. Every solution is a seed for the neighbouring cells, in the same layer and in the
one above. A cell counts only if its centre was reached. μ is the best one that was found: a lower bound of the best
possible one. Cells beside these that iteration did not reach, and those reached only in self-collision, are then solved
in closed form, at `FREE_ANGLES` angles of the free joint, if the arm has one.
"""

from __future__ import annotations

from collections.abc import Iterator
from math import atan2, cos, pi, sin, sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from irm.chain import PRISMATIC, ArmChain, ChainArrays, chain_arrays
from irm.compilation import njit
from irm.grid import MapGrid, MapParameters, nearest_orientation, orientation_neighbours
from irm.ik.closed_form import ik_pan
from irm.ik.numerical import approach_pose, random_seeds
from irm.ik.solvers import ITERATIVE, SolverArrays, arm_solutions, free_angles, solver_arrays
from irm.kernel_arguments import pointer_to
from irm.kinematics import arm_jacobian, condition, fk_frames
from irm.rotations import rotation, wrap_to_pi
from irm.self_contact import CLEARANCE
from irm.shapes import Placed, Shapes, any_near, for_every_roll, lower_base, make_placed, place_shapes

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
Integers = NDArray[np.int64]
PAN_SAMPLES = 144
"""Pan angles per turn, 2.5 degrees apart; a multiple of 4, so that quarter turns map samples to samples."""
ATTEMPTS = 4
"""Largest number of seeds per cell."""
FREE_ANGLES = 24
"""Angles of the free joint at which a cell is solved in closed form."""
_BETTER = 1.1
"""Another attempt is made only if μ of a neighbour exceeds that of the cell by this factor."""


class Layer(NamedTuple):
    """One layer: best `mu` (t, o, x, y) of free configurations at each height of the torso, 0 for none, and whether
    the centre is `reached` (o, x, y) by the arm, free or not."""

    mu: Singles
    reached: NDArray[np.bool_]

    @staticmethod
    def empty(grid: MapGrid) -> Layer:
        """With nothing in reach."""
        return Layer(np.zeros((len(grid.torsos), *grid.shape[1:]), np.float32), np.zeros(grid.shape[1:], np.bool_))


class _Scan(NamedTuple):
    """What the closed form is scanned with: the `arm`; its collision `shapes` and memory to place them; cosines and
    sines of the pan angles, `turns` (n, 2), which of them are `allowed`, and the `torsos` (t,) [m]."""

    arm: ChainArrays
    shapes: Shapes
    placed: Placed
    turns: Floats
    allowed: NDArray[np.bool_]
    torsos: Floats


class _Profile(NamedTuple):
    """Solutions of one voxel at all pan angles, two of each: `mu` (2n,), 0 for none, and `joints` (2n, 5) after the
    pan joint."""

    mu: Floats
    joints: Floats


@njit(cache=True)
def _pan_profile(scan: _Scan, approach: Floats, wrist: Floats, profile: _Profile) -> bool:
    """Fill the profile; whether there is a solution at any angle."""
    arm, turns = scan.arm, scan.turns
    n = arm.axes.shape[0]
    R, p = np.empty((n + 1, 3, 3)), np.empty((n + 1, 3))
    J, A = np.empty((6, n - 1)), np.empty((6, 6))
    d, e = np.empty(6), np.empty(6)
    q = np.zeros(n)
    found = False
    for k in range(turns.shape[0]):
        rows = profile.joints[2 * k : 2 * k + 2]
        count = ik_pan(arm, approach, wrist, turns[k, 0], turns[k, 1], rows)
        for i in range(2):
            profile.mu[2 * k + i] = 0.0
            if i < count:
                q[2:7] = rows[i]
                fk_frames(arm.offsets, arm.axes, arm.tip, q, R, p)
                arm_jacobian(arm.axes, R, p, J)
                profile.mu[2 * k + i] = condition(J, A, d, e)
                found = True
    return found


@njit(cache=True)
def _fill_cell(scan: _Scan, profile: _Profile, order: Integers, mirror: int, turn: int, best: Singles) -> bool:
    """Write the best μ at each height of the torso into `best` (t,), for one image of a voxel; whether it is reached.

    `order` (m,) are the solutions of the profile, those of highest μ first.
    """
    arm, samples = scan.arm, scan.turns.shape[0]
    shapes, placed = pointer_to(scan.shapes), pointer_to(scan.placed)
    n = arm.axes.shape[0]
    R, p, q = np.empty((n + 1, 3, 3)), np.empty((n + 1, 3)), np.zeros(n)
    left = best.shape[0]
    reached = False
    sign = -1.0 if mirror == 1 else 1.0
    for k in order:
        pan = k // 2 if mirror == 0 else samples - 1 - k // 2
        pan = (pan + turn * samples // 4) % samples
        if not scan.allowed[pan]:
            continue
        if shapes.pairs.shape[0] == 0:
            best[:] = profile.mu[k]
            return True
        q[1], q[2:7] = atan2(scan.turns[pan, 1], scan.turns[pan, 0]), profile.joints[k]
        q[3], q[5] = sign * q[3], sign * q[5]
        fk_frames(arm.offsets, arm.axes, arm.tip, q, R, p)
        place_shapes(shapes, placed, R, p)
        if not reached:
            # The gripper is where it is, whatever the rest of the arm does.
            reached = True
            if any_near(shapes, placed, 0, CLEARANCE):
                return True
            for t in range(best.shape[0]):
                lower_base(shapes, placed, scan.torsos[t])
                if any_near(shapes, placed, 2, CLEARANCE):
                    best[t] = -1.0
                    left -= 1
        if left > 0 and not any_near(shapes, placed, 1, CLEARANCE):
            for t in range(best.shape[0]):
                if best[t] == 0.0:
                    lower_base(shapes, placed, scan.torsos[t])
                    if not any_near(shapes, placed, 3, CLEARANCE):
                        best[t] = profile.mu[k]
                        left -= 1
        if left == 0:
            break
    for t in range(best.shape[0]):
        best[t] = max(best[t], np.float32(0.0))
    return reached


@njit(cache=True)
def _fill_plane(
    scan: _Scan, voxel: float, height: float, pitch: float, plane: Singles, reached: NDArray[np.bool_]
) -> None:
    """Best μ of every voxel of one layer, `height` above the pan origin [m], for one pitch.

    `plane` (t, yaw, 2h, 2h) at each height of the torso; `reached` (yaw, 2h, 2h).
    """
    yaws, half = reached.shape[0], reached.shape[1] // 2
    links, samples = scan.arm.links, scan.turns.shape[0]
    reach = links[4] + links[5]
    approach, wrist, best = np.empty(3), np.empty(3), np.empty(plane.shape[0], np.float32)
    profile = _Profile(np.empty(2 * samples), np.empty((2 * samples, 5)))
    for yaw in range(yaws):
        angle = 2.0 * pi * yaw / yaws
        approach[0], approach[1], approach[2] = cos(pitch) * cos(angle), cos(pitch) * sin(angle), -sin(pitch)
        for x in range(half):
            for y in range(x + 1):
                wrist[0] = (x + 0.5) * voxel - links[6] * approach[0]
                wrist[1] = (y + 0.5) * voxel - links[6] * approach[1]
                wrist[2] = height - links[6] * approach[2]
                ahead = sqrt(wrist[0] * wrist[0] + wrist[1] * wrist[1]) - links[2]
                above = wrist[2] - links[3]
                if ahead * ahead + above * above > reach * reach or not _pan_profile(scan, approach, wrist, profile):
                    continue
                order = np.argsort(-profile.mu)[: np.count_nonzero(profile.mu)]
                for mirror in range(2):
                    i, j, g = x, (y if mirror == 0 else -1 - y), (yaw if mirror == 0 else (yaws - yaw) % yaws)
                    for turn in range(4):
                        if not reached[g, half + i, half + j]:
                            best[:] = 0.0
                            reached[g, half + i, half + j] = _fill_cell(scan, profile, order, mirror, turn, best)
                            plane[:, g, half + i, half + j] = best
                        i, j = -1 - j, i
                        g = (g + yaws // 4) % yaws


def closed_form_layers(chain: ArmChain, grid: MapGrid, heights: Floats) -> Iterator[Layer]:
    """One layer after the other.

    Args:
        chain: of an arm with a closed form.
        grid: of the map.
        heights: (m,) of the layers' middles above the base frame with the torso at 0 [m].
    """
    angle = (np.arange(PAN_SAMPLES) + 0.5) * (2 * np.pi / PAN_SAMPLES)
    turns = np.column_stack([np.cos(angle), np.sin(angle)])
    pan = wrap_to_pi(angle)
    allowed = (pan >= chain.lower[1]) & (pan <= chain.upper[1])
    shapes = shapes_at_every_roll(chain) if grid.orientations.free_roll else chain.shapes
    scan = _Scan(chain_arrays(chain), shapes, make_placed(shapes), turns, allowed, np.array(grid.torsos))
    for height in heights:
        layer = Layer.empty(grid)
        for group, pitch in enumerate(grid.orientations.pitch):
            mine = slice(*grid.orientations.start[group : group + 2])
            plane, reached = layer.mu[:, mine], layer.reached[mine]
            _fill_plane(scan, grid.voxel, height - chain.links[1], pitch, plane, reached)
        yield layer


def shapes_at_every_roll(chain: ArmChain) -> Shapes:
    """The shapes of a robot whose map does not distinguish rolls: its cells are free at all of them."""
    last = chain.size - 1
    return for_every_roll(chain.shapes, last, np.zeros(3), np.eye(3)[chain.axes[-1] % PRISMATIC])


@njit(cache=True)
def tcp_frames(arm: ChainArrays, configurations: Floats) -> tuple[Floats, Floats]:
    """Orientations (m, 3, 3) and positions (m, 3) of the TCP at many configurations."""
    m, n = configurations.shape
    out_R, out_p = np.empty((m, 3, 3)), np.empty((m, 3))
    R, p = np.empty((n + 1, 3, 3)), np.empty((n + 1, 3))
    for k in range(m):
        fk_frames(arm.offsets, arm.axes, arm.tip, configurations[k], R, p)
        out_R[k], out_p[k] = R[n], p[n]
    return out_R, out_p


class _Growth(NamedTuple):
    """The `layer` that grows: best μ of each cell over the heights of the torso, `best` (o, x, y), its `configuration`
    (o, x, y, n), and how many `attempts` (o, x, y) were made."""

    layer: Layer
    best: Singles
    configuration: Singles
    attempts: NDArray[np.uint8]


class _Arm(NamedTuple):
    """The arm that a layer is filled for: its `chain`, whether its wrist has a `free_roll`, its collision `shapes`,
    memory to place them, and the `torsos` (t,) [m]."""

    chain: ChainArrays
    free_roll: bool
    shapes: Shapes
    placed: Placed
    torsos: Floats


class _Cells(NamedTuple):
    """Centres of a layer's cells: x (2h,), y (2h,), z, rotations (o, 3, 3), neighbours (o, m) padded with -1."""

    x: Floats
    y: Floats
    z: float
    R: Floats
    neighbours: Integers


def sampled_layers(chain: ArmChain, grid: MapGrid, heights: Floats, parameters: MapParameters) -> Iterator[Layer]:
    """The same for any arm, by sampling as the parameters say; see `closed_form_layers`."""
    rng = np.random.default_rng(parameters.seed)
    configurations = random_seeds(chain, parameters.samples, 0.0, rng)
    configurations, cells = _sorted_by_layer(chain, grid, configurations, heights)
    orientations = grid.orientations
    R = np.array([rotation(*angles) for angles in orientations.angles])
    neighbours = orientation_neighbours(orientations)
    shapes, solver, angles = chain.shapes, solver_arrays(chain), free_angles(chain, FREE_ANGLES)
    if orientations.free_roll:
        shapes = shapes_at_every_roll(chain)
    arm = _Arm(chain_arrays(chain), orientations.free_roll, shapes, make_placed(shapes), np.array(grid.torsos))
    below = np.zeros((*grid.shape[1:], chain.size), dtype=np.float32)
    was_reached = np.zeros(grid.shape[1:], dtype=bool)
    for k, height in enumerate(heights):
        mine = slice(*np.searchsorted(cells[:, 0], [k, k + 1]))
        layer = Layer.empty(grid)
        growth = _Growth(
            layer,
            np.zeros(grid.shape[1:], dtype=np.float32),
            np.zeros((*grid.shape[1:], chain.size), dtype=np.float32),
            np.zeros(grid.shape[1:], dtype=np.uint8),
        )
        centres = _Cells(grid.axis(0), grid.axis(1), float(height), R, neighbours)
        seeds = np.concatenate([configurations[mine], below[was_reached].astype(float)])
        at = np.concatenate([cells[mine, 1:], np.argwhere(was_reached)])
        _fill_layer(arm, centres, seeds, np.ascontiguousarray(at), growth)
        if solver.kind != ITERATIVE:
            _complete_layer(arm, solver, angles, centres, growth)
        below, was_reached = growth.configuration, layer.reached
        yield layer


def _sorted_by_layer(
    chain: ArmChain, grid: MapGrid, configurations: Floats, heights: Floats
) -> tuple[Floats, Integers]:
    """The configurations whose TCP is inside a cell, and that cell (layer, orientation, x, y), lowest layer first."""
    R, p = tcp_frames(chain_arrays(chain), configurations)
    half = 2 * grid.half
    layer = np.floor((p[:, 2] - heights[0]) / grid.thickness + 0.5).astype(np.int64)
    x, y = (np.floor((p[:, k] - grid.centre[k]) / grid.voxel).astype(np.int64) + grid.half for k in (0, 1))
    orientation = nearest_orientation(grid.orientations, R)
    inside = (layer >= 0) & (layer < heights.size) & (x >= 0) & (x < half) & (y >= 0) & (y < half) & (orientation >= 0)
    cells = np.column_stack([layer, orientation, x, y])[inside]
    order = np.argsort(cells[:, 0], kind="stable")
    return configurations[inside][order], cells[order]


class _Frames(NamedTuple):
    """Memory: frames of the links and Jacobian of a configuration, and that of `condition`."""

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
def _take(arm: _Arm, growth: _Growth, at: tuple[int, int, int], q: Floats, frames: _Frames) -> bool:
    """Whether a configuration that reaches a cell is better than what the cell has; it is then the cell's.

    `frames` are those at the configuration. Of one that touches the robot itself at every height of the torso, μ is 0.
    """
    shapes, placed = pointer_to(arm.shapes), pointer_to(arm.placed)
    layer, (o, x, y) = growth.layer, at
    mu, best = np.float32(condition(frames.J, frames.A, frames.d, frames.e)), np.float32(0.0)
    place_shapes(shapes, placed, frames.R, frames.p)
    if not (any_near(shapes, placed, 0, CLEARANCE) or any_near(shapes, placed, 1, CLEARANCE)):
        for t in range(arm.torsos.shape[0]):
            lower_base(shapes, placed, arm.torsos[t])
            if not (any_near(shapes, placed, 2, CLEARANCE) or any_near(shapes, placed, 3, CLEARANCE)):
                layer.mu[t, o, x, y] = max(layer.mu[t, o, x, y], mu)
                best = mu
    if best <= growth.best[o, x, y] and layer.reached[o, x, y]:
        return False
    layer.reached[o, x, y] = True
    growth.best[o, x, y] = best
    growth.configuration[o, x, y] = q.astype(np.float32)
    return True


@njit(cache=True)
def _fill_layer(arm: _Arm, centres: _Cells, seeds: Floats, at: Integers, growth: _Growth) -> None:
    """Solve the cells `at` (m, 3) from `seeds` (m, n), then their neighbours from them, until no cell improves."""
    n = arm.chain.axes.shape[0]
    frames = _make_frames(n)
    width = centres.x.shape[0]
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
            own = growth.best[to, i, j]
            promising = own == 0.0 or (not from_seed and growth.best[o, x, y] > _BETTER * own)
            if growth.attempts[to, i, j] >= ATTEMPTS or not promising:
                continue
            growth.attempts[to, i, j] += 1
            goal[0], goal[1], goal[2] = centres.x[i], centres.y[j], centres.z
            q[:] = source
            R = centres.R[to]
            if approach_pose(arm.chain, R, goal, arm.free_roll, q, frames.R, frames.p, frames.J) and _take(
                arm, growth, (to, i, j), q, frames
            ):
                stack.append((to, i, j))


@njit(cache=True)
def _complete_layer(arm: _Arm, solver: SolverArrays, angles: Floats, centres: _Cells, growth: _Growth) -> None:
    """Solve in closed form the cells without a free configuration that are reached, or beside one that is."""
    n = arm.chain.axes.shape[0]
    frames, found, goal = _make_frames(n), np.empty((8, n)), np.empty(3)
    reached, width = growth.layer.reached, centres.x.shape[0]
    for o in range(reached.shape[0]):
        for x in range(width):
            for y in range(width):
                if growth.best[o, x, y] > 0.0:
                    continue
                near = reached[o, x, y] or (x > 0 and reached[o, x - 1, y]) or (y > 0 and reached[o, x, y - 1])
                near = near or (x + 1 < width and reached[o, x + 1, y]) or (y + 1 < width and reached[o, x, y + 1])
                if not near:
                    continue
                goal[0], goal[1], goal[2] = centres.x[x], centres.y[y], centres.z
                for angle in angles:
                    for k in range(arm_solutions(solver, centres.R[o], goal, 0.0, angle, found)):
                        fk_frames(arm.chain.offsets, arm.chain.axes, arm.chain.tip, found[k], frames.R, frames.p)
                        arm_jacobian(arm.chain.axes, frames.R, frames.p, frames.J)
                        _take(arm, growth, (o, x, y), found[k], frames)
                    if growth.best[o, x, y] > 0.0:
                        break
