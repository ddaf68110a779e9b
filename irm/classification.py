"""Does the arm reach a TCP pose from a given base pose? YES, NO, or UNKNOWN, from the cells around the TCP pose.

A pose lies between the centres of neighbouring cells: eight voxels, two rings of pitch, two yaws (and two rolls). The
answer is YES if these and the voxels around them are all in reach: they form the inner map. It is NO if none of them is
in reach: the pose is outside the outer map. Otherwise the cells are too coarse to decide, and `decide` asks exact
inverse kinematics. The values are those of `irm.Status`.
"""

from __future__ import annotations

from math import copysign, floor, pi
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from irm.answers import NO, UNKNOWN, YES
from irm.compilation import njit
from irm.errors import QueryError
from irm.grid import MapGrid
from irm.ik.solvers import ExactSolver
from irm.reachability_map import ReachabilityMap
from irm.rotations import as_poses, yaw_pitch_roll

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Bools = NDArray[np.bool_]
_STEEP = pi / 2.0 - 1e-6
"""[rad] Pitch of a pole, but for rounding."""
_MARGIN = 1
"""Voxels that count beyond the eight nearest, in every direction. Measured on 200,000 random poses with 62 and 266
orientations: no wrong answer with 1; one wrong YES and four wrong NO with 0, which gives a third to a half fewer
UNKNOWN."""
_WHOLE_MAP = "three-valued answers need a map of all pitches and heights: build it without `pitches` and `heights`"


def classify(rm: ReachabilityMap, T_base_tcp: ArrayLike) -> NDArray[np.int8]:
    """(n,) `Status` values of TCP poses (n, 4, 4) in the base frame, by a map of all pitches and heights alone.

    Poses below the floor, which a map of cells does not cover, are UNKNOWN, never NO.

    Raises:
        QueryError: not an array of poses, or the map does not cover all pitches and heights.
    """
    T, grid = as_poses(T_base_tcp), rm.grid
    if grid.cut_below or grid.cut_above or rm.parameters.pitches:
        raise QueryError(_WHOLE_MAP)
    answers = np.empty(len(T), dtype=np.int8)
    _classify(rm.reachable, *_place(grid, T), answers)
    answers[(T[:, 2, 3] < 0.0) & (answers == NO)] = UNKNOWN
    return answers


def _place(grid: MapGrid, T: Floats) -> tuple[Floats, Floats, _Rings]:
    """For kernels: positions (n, 3) of poses in cells from the centre of the first one, their yaw, pitch and roll
    (n, 3) [rad], and the rings of the grid."""
    edge = grid.half * grid.voxel
    corner = np.array([grid.centre[0] - edge, grid.centre[1] - edge, grid.bottom])
    voxels = (T[:, :3, 3] - corner) / (grid.voxel, grid.voxel, grid.thickness) - 0.5
    orientations = grid.orientations
    pitches, first_group, groups = np.unique(orientations.pitch, return_index=True, return_counts=True)
    rings = _Rings(
        np.asarray(pitches, dtype=float),
        1 if orientations.free_roll else int(groups.max()),
        orientations.step,
        orientations.start[first_group],
        orientations.count[first_group],
    )
    return voxels, yaw_pitch_roll(T[:, :3, :3]), rings


class _Rings(NamedTuple):
    """The rings of pitch, from straight up to straight down: their `pitch` [rad], rolls, step [rad], and for each ring
    its first orientation and its number of yaws."""

    pitch: Floats
    rolls: int
    step: float
    start: Integers
    yaws: Integers


@njit(cache=True)
def _orientation(rings: _Rings, ring: int, yaw: float, roll: float, next_yaw: int, next_roll: int) -> int:
    """The orientation sample of a ring at or below a yaw and a roll, or the next one."""
    start, count = rings.start[ring], rings.yaws[ring]
    if abs(rings.pitch[ring]) > _STEEP:
        turn = yaw - copysign(roll, rings.pitch[ring])
        return start + (floor(turn / (2.0 * pi) * count) + next_yaw) % count if count > 1 else start
    group = (floor(roll / (2.0 * pi) * rings.rolls) + next_roll) % rings.rolls if rings.rolls > 1 else 0
    return start + group * count + (floor(yaw / (2.0 * pi) * count) + next_yaw) % count


@njit(cache=True)
def _count_reachable(reachable: Bools, orientation: int, voxel: Floats) -> int:
    """How many of the voxels around a point, in units of voxels from the first centre, are reachable."""
    layers, _, width, depth = reachable.shape
    i, j, k = floor(voxel[0]), floor(voxel[1]), floor(voxel[2])
    count = 0
    for z in range(max(0, k - _MARGIN), min(layers, k + 2 + _MARGIN)):
        for x in range(max(0, i - _MARGIN), min(width, i + 2 + _MARGIN)):
            for y in range(max(0, j - _MARGIN), min(depth, j + 2 + _MARGIN)):
                count += reachable[z, orientation, x, y]
    return count


@njit(cache=True)
def _classify(reachable: Bools, voxels: Floats, angles: Floats, rings: _Rings, answers: NDArray[np.int8]) -> None:
    """Fill `answers` (n,) by the reachable cells around each pose, whose place is as in `_place`."""
    whole = (2 + 2 * _MARGIN) ** 3
    for n in range(voxels.shape[0]):
        ring = floor((angles[n, 1] + pi / 2.0) / rings.step)
        inner, outer = True, False
        for next_ring in range(2):
            on = min(rings.pitch.shape[0] - 1, max(0, ring + next_ring))
            for next_yaw in range(2):
                for next_roll in range(2 if rings.rolls > 1 else 1):
                    orientation = _orientation(rings, on, angles[n, 0], angles[n, 2], next_yaw, next_roll)
                    count = _count_reachable(reachable, orientation, voxels[n])
                    inner = inner and count == whole
                    outer = outer or count > 0
        answers[n] = YES if inner else (UNKNOWN if outer else NO)


def decide(rm: ReachabilityMap, T_base_tcp: ArrayLike) -> NDArray[np.int8]:
    """(n,) `Status` values of TCP poses (n, 4, 4) in the base frame.

    The map answers first, see `classify`. The arm's exact solver decides the poses for which
    the map says UNKNOWN: by arithmetic (the wrist centre farther from the shoulder than upper arm and forearm are
    long), then by inverse kinematics. It also decides those for which a map that was built by sampling says NO: such a
    map may miss narrow parts of the workspace. UNKNOWN is left where even the solver has no answer, or where the map
    is that of somebody else and its arm is not known.

    Args:
        rm: of any pitches and heights: poses that it does not cover are decided by the solver alone.
        T_base_tcp: the poses.

    Raises:
        QueryError: not an array of poses.

    Example:
        reached = decide(cached_map(FETCH), T_base_tcp) == YES
    """
    T = as_poses(T_base_tcp)
    is_whole = not (rm.grid.cut_below or rm.grid.cut_above or rm.parameters.pitches)
    answers = classify(rm, T) if is_whole else np.full(len(T), UNKNOWN, dtype=np.int8)
    if rm.chain is None:
        return answers
    is_open = answers == UNKNOWN if rm.chain.has_closed_form else answers != YES
    answers[is_open] = ExactSolver(rm.chain, rm.grid.torso_range).solve(T[is_open])[0]
    return answers
