"""Best manipulability of every cell of a map by the closed form of Fetch's arm, compiled.

Only configurations free of self-collision are used. A cell whose centre is reached only in self-collision has μ = 0.

The arm's redundancy is scanned over its pan angle. Pan does not change μ, and the arm is symmetric about the plane y =
0. So the scan of one voxel gives eight: its images under quarter turns about the pan axis and under the reflection y →
-y. The images differ in pan limits and collisions. Each image tests its configurations from the highest μ down, at all
heights of the torso at once, because only the base moves relative to the arm.
"""

from __future__ import annotations

from collections.abc import Iterator
from math import atan2, cos, pi, sin, sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from irm.chain import PRISMATIC, ArmChain, ChainArrays, chain_arrays
from irm.compilation import njit
from irm.grid import MapGrid
from irm.ik.closed_form import ik_pan
from irm.kernel_arguments import pointer_to
from irm.kinematics import arm_jacobian, condition, fk_frames
from irm.rotations import wrap_to_pi
from irm.self_contact import CLEARANCE
from irm.shapes import (
    ARM,
    ARM_BASE,
    HAND_BASE,
    HAND_TORSO,
    Placed,
    Shapes,
    any_near,
    for_every_roll,
    lower_base,
    make_placed,
    place_shapes,
)

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
Integers = NDArray[np.int64]
PAN_SAMPLES = 144
"""Pan angles per turn, 2.5 degrees apart. A multiple of 4, so that quarter turns map samples to samples."""


class Layer(NamedTuple):
    """One layer of cells. `mu` (t, o, x, y): best μ of free configurations at each height of the torso, 0 for none.
    `reached` (o, x, y): whether the arm reaches the centre, free or not."""

    mu: Singles
    reached: NDArray[np.bool_]

    @staticmethod
    def empty(grid: MapGrid) -> Layer:
        """A layer with no cell in reach."""
        return Layer(np.zeros((len(grid.torsos), *grid.shape[1:]), np.float32), np.zeros(grid.shape[1:], np.bool_))


class _Scan(NamedTuple):
    """Input of a scan by the closed form: the `arm`, its collision `shapes`, and memory `placed` for them. `turns` (n,
    2): cosines and sines of the pan angles. `allowed` (n,): pan angles within the limits. `torsos` (t,): heights
    [m]."""

    arm: ChainArrays
    shapes: Shapes
    placed: Placed
    turns: Floats
    allowed: NDArray[np.bool_]
    torsos: Floats


class _Profile(NamedTuple):
    """Solutions of one voxel, two per pan angle. `mu` (2n,): 0 for none. `joints` (2n, 5): those after the pan
    joint."""

    mu: Floats
    joints: Floats


@njit(cache=True)
def _pan_profile(scan: _Scan, approach: Floats, wrist: Floats, profile: _Profile) -> bool:
    """Fill the profile. True if any angle has a solution."""
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
    """Write the best μ at each torso height into `best` (t,), for one image of a voxel. True if it is reached.

    `order` (m,): solutions of the profile by decreasing μ.
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
            # The gripper's pose is the same for all remaining solutions.
            reached = True
            if any_near(shapes, placed, HAND_TORSO, CLEARANCE):
                return True
            for t in range(best.shape[0]):
                lower_base(shapes, placed, scan.torsos[t])
                if any_near(shapes, placed, HAND_BASE, CLEARANCE):
                    best[t] = -1.0
                    left -= 1
        if left > 0 and not any_near(shapes, placed, ARM, CLEARANCE):
            for t in range(best.shape[0]):
                if best[t] == 0.0:
                    lower_base(shapes, placed, scan.torsos[t])
                    if not any_near(shapes, placed, ARM_BASE, CLEARANCE):
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
    """Fill in the best μ of every voxel of one layer, `height` above the pan origin [m], for one pitch.

    `plane` (t, yaw, 2h, 2h): μ at each height of the torso. `reached`: (yaw, 2h, 2h).
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
    """Yield the layers of a map in order.

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
    """Shapes of a robot whose map does not distinguish rolls. A cell of it is free only if it is free at all rolls."""
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
