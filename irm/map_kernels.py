"""Best manipulability of every cell of a map, compiled: by the closed form of Fetch's arm, or by sampling for any arm.

Closed form: the arm's redundancy is scanned over its pan angle. Pan does not change μ, and the arm is symmetric about
the plane y = 0. So the scan of one voxel gives eight: its images under quarter turns about the pan axis and under the
reflection y → -y. The images differ only by the pan limits.

Sampling: random configurations give cells that may be reachable. From each configuration, numerical inverse kinematics
moves the TCP to the cell's centre. Every solution is a seed for the neighbouring cells, in the same layer and in the
one above. A cell counts only if its centre was reached. μ is the best one that was found: a lower bound of the best
possible one.
"""

from __future__ import annotations

from collections.abc import Iterator
from math import cos, pi, sin, sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from irm.chain import ArmChain, ChainArrays, chain_arrays
from irm.compilation import njit
from irm.grid import MapGrid, MapParameters, nearest_orientation, orientation_neighbours
from irm.ik.closed_form import ik_pan
from irm.ik.numerical import approach_pose, random_seeds
from irm.kinematics import arm_jacobian, condition, fk_frames
from irm.rotations import rotation, wrap_to_pi

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
Integers = NDArray[np.int64]
PAN_SAMPLES = 144
"""Pan angles per turn, 2.5 degrees apart; a multiple of 4, so that quarter turns map samples to samples."""
ATTEMPTS = 4
"""Largest number of seeds per cell."""
_BETTER = 1.1
"""Another attempt is made only if μ of a neighbour exceeds that of the cell by this factor."""


@njit(cache=True)
def _pan_profile(arm: ChainArrays, approach: Floats, wrist: Floats, turns: Floats, profile: Floats) -> bool:
    """Best μ at each pan angle into `profile`, 0 without a solution; whether there is a solution at any angle.

    `turns` (n, 2) are the cosines and sines of the pan angles.
    """
    n = arm.axes.shape[0]
    R, p = np.empty((n + 1, 3, 3)), np.empty((n + 1, 3))
    J, A = np.empty((6, n - 1)), np.empty((6, 6))
    d, e = np.empty(6), np.empty(6)
    rows, q = np.empty((2, 5)), np.zeros(n)
    found = False
    for k in range(turns.shape[0]):
        profile[k] = 0.0
        count = ik_pan(arm, approach, wrist, turns[k, 0], turns[k, 1], rows)
        for i in range(count):
            q[2:7] = rows[i]
            fk_frames(arm.offsets, arm.axes, arm.tip, q, R, p)
            arm_jacobian(arm.axes, R, p, J)
            profile[k] = max(profile[k], condition(J, A, d, e))
            found = True
    return found


@njit(cache=True)
def _fill_images(profile: Floats, allowed: NDArray[np.bool_], x: int, y: int, yaw: int, plane: Singles) -> None:
    """Write the best μ within the pan limits into the eight images of voxel (x, y) ≥ 0 of `plane` (yaw, 2h, 2h)."""
    yaws, half, samples = plane.shape[0], plane.shape[1] // 2, profile.shape[0]
    for mirror in range(2):
        i, j = x, y
        g = yaw
        if mirror == 1:
            j, g = -1 - j, (yaws - g) % yaws
        for turn in range(4):
            best = 0.0
            for k in range(samples):
                m = k if mirror == 0 else samples - 1 - k
                if profile[k] > best and allowed[(m + turn * samples // 4) % samples]:
                    best = profile[k]
            if best > plane[g, half + i, half + j]:
                plane[g, half + i, half + j] = best
            i, j = -1 - j, i
            g = (g + yaws // 4) % yaws


@njit(cache=True)
def _fill_plane(
    arm: ChainArrays,
    voxel: float,
    height: float,
    pitch: float,
    turns: Floats,
    allowed: NDArray[np.bool_],
    plane: Singles,
) -> None:
    """Best μ of every voxel of one layer, `height` above the pan origin [m], for one pitch; `plane` (yaw, 2h, 2h)."""
    yaws, half = plane.shape[0], plane.shape[1] // 2
    links = arm.links
    reach = links[4] + links[5]
    approach, wrist = np.empty(3), np.empty(3)
    profile = np.empty(turns.shape[0])
    for yaw in range(yaws):
        angle = 2.0 * pi * yaw / yaws
        approach[0], approach[1], approach[2] = cos(pitch) * cos(angle), cos(pitch) * sin(angle), -sin(pitch)
        for i in range(half):
            for j in range(i + 1):
                wrist[0] = (i + 0.5) * voxel - links[6] * approach[0]
                wrist[1] = (j + 0.5) * voxel - links[6] * approach[1]
                wrist[2] = height - links[6] * approach[2]
                ahead = sqrt(wrist[0] * wrist[0] + wrist[1] * wrist[1]) - links[2]
                above = wrist[2] - links[3]
                if ahead * ahead + above * above > reach * reach:
                    continue
                if _pan_profile(arm, approach, wrist, turns, profile):
                    _fill_images(profile, allowed, i, j, yaw, plane)


def closed_form_layers(chain: ArmChain, grid: MapGrid, heights: Floats) -> Iterator[Singles]:
    """Best μ in each layer, one layer after the other.

    Args:
        chain: of an arm with a closed form.
        grid: of the map.
        heights: (m,) of the layers' middles above the base frame with the torso at 0 [m].

    Yields:
        (orientation, x, y) manipulability, 0 if the cell's centre is out of reach.
    """
    angle = (np.arange(PAN_SAMPLES) + 0.5) * (2 * np.pi / PAN_SAMPLES)
    turns = np.column_stack([np.cos(angle), np.sin(angle)])
    pan = wrap_to_pi(angle)
    allowed = (pan >= chain.lower[1]) & (pan <= chain.upper[1])
    arm = chain_arrays(chain)
    for height in heights:
        layer = np.zeros(grid.shape[1:], dtype=np.float32)
        for group, pitch in enumerate(grid.orientations.pitch):
            first, last = grid.orientations.start[group : group + 2]
            _fill_plane(arm, grid.voxel, height - chain.links[1], pitch, turns, allowed, layer[first:last])
        yield layer


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


class _Layer(NamedTuple):
    """Results of one layer: `mu` (o, x, y), `configuration` (o, x, y, n), `attempts` (o, x, y)."""

    mu: Singles
    configuration: Singles
    attempts: NDArray[np.uint8]


class _Cells(NamedTuple):
    """Centres of a layer's cells: x (2h,), y (2h,), z, rotations (o, 3, 3), neighbours (o, m) padded with -1."""

    x: Floats
    y: Floats
    z: float
    R: Floats
    neighbours: Integers


def sampled_layers(chain: ArmChain, grid: MapGrid, heights: Floats, parameters: MapParameters) -> Iterator[Singles]:
    """The same for any arm, by sampling as the parameters say; see `closed_form_layers`."""
    rng = np.random.default_rng(parameters.seed)
    configurations = random_seeds(chain, parameters.samples, 0.0, rng)
    configurations, cells = _sorted_by_layer(chain, grid, configurations, heights)
    orientations = grid.orientations
    R = np.array([rotation(*angles) for angles in orientations.angles])
    neighbours = orientation_neighbours(orientations)
    arm = chain_arrays(chain)
    below = np.zeros((*grid.shape[1:], chain.size), dtype=np.float32)
    was_reached = np.zeros(grid.shape[1:], dtype=bool)
    for k, height in enumerate(heights):
        mine = slice(*np.searchsorted(cells[:, 0], [k, k + 1]))
        layer = _Layer(
            np.zeros(grid.shape[1:], dtype=np.float32),
            np.zeros((*grid.shape[1:], chain.size), dtype=np.float32),
            np.zeros(grid.shape[1:], dtype=np.uint8),
        )
        centres = _Cells(grid.axis(0), grid.axis(1), float(height), R, neighbours)
        seeds = np.concatenate([configurations[mine], below[was_reached].astype(float)])
        at = np.concatenate([cells[mine, 1:], np.argwhere(was_reached)])
        _fill_layer(arm, orientations.free_roll, centres, seeds, np.ascontiguousarray(at), layer)
        below, was_reached = layer.configuration, layer.mu > 0
        yield layer.mu


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


@njit(cache=True)
def _fill_layer(arm: ChainArrays, free_roll: bool, centres: _Cells, seeds: Floats, at: Integers, layer: _Layer) -> None:
    """Solve the cells `at` (m, 3) from `seeds` (m, n), then their neighbours from them, until no cell improves."""
    n = arm.axes.shape[0]
    R, p, J = np.empty((n + 1, 3, 3)), np.empty((n + 1, 3)), np.empty((6, n - 1))
    A, d, e = np.empty((6, 6)), np.empty(6), np.empty(6)
    width = centres.x.shape[0]
    stack = [(0, 0, 0)]
    stack.pop()
    q, goal = np.empty(n), np.empty(3)
    pending = 0
    while True:
        if len(stack) > 0:
            o, x, y = stack.pop()
            source = layer.configuration[o, x, y]
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
            own = layer.mu[to, i, j]
            promising = own == 0.0 or (not from_seed and layer.mu[o, x, y] > _BETTER * own)
            if layer.attempts[to, i, j] >= ATTEMPTS or not promising:
                continue
            layer.attempts[to, i, j] += 1
            goal[0], goal[1], goal[2] = centres.x[i], centres.y[j], centres.z
            q[:] = source
            if not approach_pose(arm, centres.R[to], goal, free_roll, q, R, p, J):
                continue
            mu = np.float32(condition(J, A, d, e))
            if mu > own:
                layer.mu[to, i, j] = mu
                layer.configuration[to, i, j] = q.astype(np.float32)
                stack.append((to, i, j))
