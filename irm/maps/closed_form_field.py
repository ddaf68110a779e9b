"""Best manipulability of every cell of a map, by closed-form inverse kinematics at the cell's centre.

The arm's redundancy is scanned over its pan angle. Pan does not change μ, and the arm is symmetric about the plane
y = 0. So the scan of one voxel gives eight: its images under quarter turns about the pan axis and under the reflection
y → -y. The images differ only by the pan limits.
"""

from __future__ import annotations

from collections.abc import Iterator
from math import cos, pi, sin, sqrt

import numpy as np
from numpy.typing import NDArray

from irm.arm.angles import signed
from irm.arm.chain_arrays import ChainArrays, chain_arrays
from irm.arm.closed_form import ik_pan
from irm.arm.kinematics import ArmChain, arm_jacobian, fk_frames
from irm.arm.manipulability import condition
from irm.compilation import njit
from irm.maps.grid import MapGrid

__all__ = ["PAN_SAMPLES", "closed_form_layers"]

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]

PAN_SAMPLES = 144
"""Pan angles per turn, 2.5 degrees apart; a multiple of 4, so that quarter turns map samples to samples."""


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
        count = ik_pan(arm.links, approach, wrist, turns[k, 0], turns[k, 1], arm.lower, arm.upper, rows)
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
    pan = signed(angle)
    allowed = (pan >= chain.lower[1]) & (pan <= chain.upper[1])
    arm = chain_arrays(chain)
    for height in heights:
        layer = np.zeros(grid.shape[1:], dtype=np.float32)
        for group, pitch in enumerate(grid.orientations.pitch):
            first, last = grid.orientations.start[group : group + 2]
            _fill_plane(arm, grid.voxel, height - chain.links[1], pitch, turns, allowed, layer[first:last])
        yield layer
