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
_WHOLE_MAP = "three-valued answers need a map of all pitches and heights: build it without `pitches` and `heights`"


def classify(rm: ReachabilityMap, T_base_tcp: ArrayLike, margin: int = 1) -> NDArray[np.int8]:
    """(n,) `Status` values of TCP poses (n, 4, 4) in the base frame.

    Args:
        rm: of all pitches and heights.
        T_base_tcp: the poses.
        margin: voxels that count beyond the eight nearest, in every direction, ≥ 0. Measured on 200,000 random poses
            with 62 and 266 orientations: no wrong answer with margin 1; one wrong YES and four wrong NO with margin 0,
            which gives a third to a half fewer UNKNOWN.

    Returns:
        The answers; UNKNOWN, never NO, for poses below the floor, which a map of cells does not cover.

    Raises:
        QueryError: not an array of poses, a negative margin, or the map does not cover all pitches and heights.
    """
    T = as_poses(T_base_tcp)
    if isinstance(margin, bool) or not isinstance(margin, int | np.integer) or margin < 0:
        raise QueryError(f"margin is a number of voxels ≥ 0, not {margin!r}")
    grid = rm.grid
    if grid.cut_below or grid.cut_above or rm.parameters.pitches:
        raise QueryError(_WHOLE_MAP)
    answers = np.empty(len(T), dtype=np.int8)
    _classify(rm.reachable, *_place(grid, T), int(margin), answers)
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
def _count_reachable(reachable: Bools, orientation: int, voxel: Floats, margin: int) -> int:
    """How many of the voxels around a point, in units of voxels from the first centre, are reachable."""
    layers, _, width, depth = reachable.shape
    i, j, k = floor(voxel[0]), floor(voxel[1]), floor(voxel[2])
    count = 0
    for z in range(max(0, k - margin), min(layers, k + 2 + margin)):
        for x in range(max(0, i - margin), min(width, i + 2 + margin)):
            for y in range(max(0, j - margin), min(depth, j + 2 + margin)):
                count += reachable[z, orientation, x, y]
    return count


@njit(cache=True)
def _classify(
    reachable: Bools, voxels: Floats, angles: Floats, rings: _Rings, margin: int, answers: NDArray[np.int8]
) -> None:
    """Count the reachable cells around each pose.

    `voxels` (n, 3): position in voxels from the first centre; `angles` (n, 3): yaw, pitch, roll [rad]; `answers` (n,)
    filled with `Status` values.
    """
    whole = (2 + 2 * margin) ** 3
    for n in range(voxels.shape[0]):
        ring = floor((angles[n, 1] + pi / 2.0) / rings.step)
        inner, outer = True, False
        for next_ring in range(2):
            on = min(rings.pitch.shape[0] - 1, max(0, ring + next_ring))
            for next_yaw in range(2):
                for next_roll in range(2 if rings.rolls > 1 else 1):
                    orientation = _orientation(rings, on, angles[n, 0], angles[n, 2], next_yaw, next_roll)
                    count = _count_reachable(reachable, orientation, voxels[n], margin)
                    inner = inner and count == whole
                    outer = outer or count > 0
        answers[n] = 2 if inner else (1 if outer else 0)


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
