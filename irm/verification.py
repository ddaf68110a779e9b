"""Tests of base poses: by the map (`classify`), by exact inverse kinematics (`decide`), and along a path (`verify`).

A pose lies between the centres of neighbouring cells: eight voxels, two rings of pitch, two yaws (and two rolls). The
answer is YES if these and the voxels around them are all in reach: they form the inner map. It is NO if none of them is
in reach: the pose is outside the outer map. Otherwise the cells are too coarse to decide. `decide` solves exact inverse
kinematics for every pose. The values are those of `irm.Status`.

A map contains no configurations, and no obstacles except the robot itself. `verify` takes the bases of a placement in
order and returns the first valid base. There the arm reaches every TCP pose exactly, free of self-collision, in a
configuration that the caller accepts. Consecutive configurations are close to each other.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import copysign, floor, pi
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from irm.answers import NO, UNKNOWN, YES, BasePlacement
from irm.chain import PRISMATIC, ArmChain
from irm.compilation import njit
from irm.errors import ChainError, QueryError
from irm.grid import MapGrid
from irm.ik.outer_reach import are_out_of_reach
from irm.ik.solvers import ExactSolver, SelfCollision, all_solutions, free_angles
from irm.kinematics import forward
from irm.query_keys import as_positions
from irm.reachability_map import ReachabilityMap
from irm.rotations import as_poses, rotation, world_to_base, yaw_pitch_roll

if TYPE_CHECKING:
    import mujoco

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Bools = NDArray[np.bool_]
_ANGLE_ROUNDING = 1e-6
"""[rad]"""
_STEEP = pi / 2.0 - _ANGLE_ROUNDING
"""[rad] Pitch of a pole, reduced by rounding."""
_MARGIN = 1
"""Voxels tested beyond the eight nearest, in every direction. Measured on 200,000 random poses with 62 and 266
orientations: no wrong answer with 1. With 0, one wrong YES and four wrong NO, but a third to a half fewer UNKNOWN."""
_WHOLE_MAP = "three-valued answers need a map of all pitches and heights: build it without `pitches` and `heights`"
_COMPARED = 200
"""Random configurations of `compare_with_model`."""

_TORSOS = 8
"""Torso heights tried, evenly over the range."""
_ANGLES = 36
"""Angles of the free joint tried at each height. For arms solved numerically, starting configurations."""
LARGEST_STEP, LARGEST_LIFT = 0.35, 0.06
"""Largest motion of an arm joint [rad] and of the torso [m] between consecutive TCP poses."""
_SAME = 1e-6
"""[m], and for entries of rotation matrices: two correct chains differ only by rounding."""


def decide(rm: ReachabilityMap, T_base_tcp: ArrayLike) -> NDArray[np.int8]:
    """(n,) `Status` values of TCP poses (n, 4, 4) in the base frame.

    The exact solver of the map's arm decides, see `ExactSolver.solve`. YES has a configuration that reaches, NO is
    proved. UNKNOWN means that the solver has no answer. For a map without an arm, the map decides, see `classify`. If
    it does not cover all pitches and heights, all answers are UNKNOWN.

    Args:
        rm: of any pitches and heights.
        T_base_tcp: the poses.

    Raises:
        QueryError: not an array of poses.

    Example:
        reached = decide(cached_map(FETCH), T_base_tcp) == YES
    """
    T = as_poses(T_base_tcp)
    if rm.chain is not None:
        return ExactSolver(rm.chain, rm.grid.torso_range).solve(T)[0]
    is_whole = not (rm.grid.cut_below or rm.grid.cut_above or rm.parameters.pitches)
    return classify(rm, T) if is_whole else np.full(len(T), UNKNOWN, dtype=np.int8)


def classify(rm: ReachabilityMap, T_base_tcp: ArrayLike) -> NDArray[np.int8]:
    """(n,) `Status` values of TCP poses (n, 4, 4) in the base frame, by a map of all pitches and heights alone.

    NO is certain. A map filled by samples may miss cells that are rarely reached. There the link lengths must prove the
    NO. Without this proof, the answer is UNKNOWN.

    Raises:
        QueryError: not an array of poses, or the map does not cover all pitches and heights.
    """
    T, grid = as_poses(T_base_tcp), rm.grid
    if grid.cut_below or grid.cut_above or rm.parameters.pitches:
        raise QueryError(_WHOLE_MAP)
    answers = np.empty(len(T), dtype=np.int8)
    _classify(rm.reachable, rm.reached, *_place(grid, T), answers)
    if rm.chain is not None and not rm.chain.has_closed_form:
        outside = answers == NO
        answers[outside] = np.where(are_out_of_reach(rm.chain, grid.torso_range, T[outside]), NO, UNKNOWN)
    return answers


def _place(grid: MapGrid, T: Floats) -> tuple[Floats, Floats, _Rings]:
    """Arguments for kernels: positions (n, 3) of poses in cells from the first cell's centre, their yaw, pitch and roll
    (n, 3) [rad], and the rings of the grid."""
    edge = grid.half * grid.voxel
    corner = np.array([grid.centre[0] - edge, grid.centre[1] - edge, grid.bottom])
    voxels = (T[:, :3, 3] - corner) / (grid.voxel, grid.voxel, grid.thickness) - 0.5
    orientations = grid.orientations
    pitches, first_group, groups = np.unique(orientations.pitch, return_index=True, return_counts=True)
    rings = _Rings(
        np.asarray(pitches, dtype=float),
        1 if orientations.free_roll else int(groups.max()),
        orientations.free_roll or orientations.step * int(groups.max()) > 2 * pi - _ANGLE_ROUNDING,
        orientations.step,
        orientations.start[first_group],
        orientations.count[first_group],
    )
    return voxels, yaw_pitch_roll(T[:, :3, :3]), rings


class _Rings(NamedTuple):
    """Rings of pitch, from straight up to straight down. `pitch`: pitch of each ring [rad]. `rolls`: number of rolls.
    `has_close_rolls`: whether these are as close as the rings. `step`: between rings [rad]. `start`: each ring's first
    orientation. `yaws`: its number of yaws."""

    pitch: Floats
    rolls: int
    has_close_rolls: bool
    step: float
    start: Integers
    yaws: Integers


@njit(cache=True)
def _orientation(rings: _Rings, ring: int, yaw: float, roll: float, next_yaw: int, next_roll: int) -> int:
    """The orientation sample of a ring at or below a yaw and a roll, or the next sample."""
    start, count = rings.start[ring], rings.yaws[ring]
    if abs(rings.pitch[ring]) > _STEEP:
        turn = yaw - copysign(roll, rings.pitch[ring])
        return start + (floor(turn / (2.0 * pi) * count) + next_yaw) % count if count > 1 else start
    group = (floor(roll / (2.0 * pi) * rings.rolls) + next_roll) % rings.rolls if rings.rolls > 1 else 0
    return start + group * count + (floor(yaw / (2.0 * pi) * count) + next_yaw) % count


@njit(cache=True)
def _count_cells(cells: Bools, orientation: int, voxel: Floats) -> int:
    """Number of true voxels around a point, given in units of voxels from the first centre."""
    layers, _, width, depth = cells.shape
    i, j, k = floor(voxel[0]), floor(voxel[1]), floor(voxel[2])
    count = 0
    for z in range(max(0, k - _MARGIN), min(layers, k + 2 + _MARGIN)):
        for x in range(max(0, i - _MARGIN), min(width, i + 2 + _MARGIN)):
            for y in range(max(0, j - _MARGIN), min(depth, j + 2 + _MARGIN)):
                count += cells[z, orientation, x, y]
    return count


@njit(cache=True)
def _classify(
    reachable: Bools, reached: Bools, voxels: Floats, angles: Floats, rings: _Rings, answers: NDArray[np.int8]
) -> None:
    """Fill `answers` (n,) by the cells around each pose, with arguments of `_place`: YES if all are `reachable`, NO if
    none is `reached`."""
    whole = (2 + 2 * _MARGIN) ** 3
    for n in range(voxels.shape[0]):
        ring = floor((angles[n, 1] + pi / 2.0) / rings.step)
        inner, outer = rings.has_close_rolls, False
        for next_ring in range(2):
            on = min(rings.pitch.shape[0] - 1, max(0, ring + next_ring))
            for next_yaw in range(2):
                for next_roll in range(2 if rings.rolls > 1 else 1):
                    orientation = _orientation(rings, on, angles[n, 0], angles[n, 2], next_yaw, next_roll)
                    inner = inner and _count_cells(reachable, orientation, voxels[n]) == whole
                    outer = outer or _count_cells(reached, orientation, voxels[n]) > 0
        answers[n] = YES if inner else (UNKNOWN if outer else NO)


IsFree = Callable[[Floats, Floats], bool]
"""Whether a base pose (3,) with a configuration (1 + n,) is free of collisions."""


@dataclass(frozen=True)
class Verified:
    """A base from which every TCP pose is reached.

    Attributes:
        rank: its index in the placement, 0 for the best.
        base: (3,) x, y [m], yaw [rad].
        configurations: (m, 1 + n) one configuration per TCP pose, each close to the one before.
    """

    rank: int
    base: Floats
    configurations: Floats


@dataclass(frozen=True)
class NotVerified:
    """Result without a valid base.

    Attributes:
        reached: (k,) number of TCP poses reached from each base, from the first pose on.
    """

    reached: tuple[int, ...]


def tcp_poses(positions: ArrayLike, yaw: float, pitch: float = 0.0, roll: float = 0.0) -> Floats:
    """Make T_world_tcp of one orientation at several positions.

    Args:
        positions: (m, 3), or (3,) for m = 1 [m].
        yaw, pitch, roll: ZYX angles of the orientation [rad].

    Returns:
        (m, 4, 4).

    Raises:
        QueryError: the positions are not an array of finite numbers, or an angle is not finite.
    """
    if not np.isfinite((yaw, pitch, roll)).all():
        raise QueryError(f"yaw, pitch and roll are finite numbers [rad], not {yaw}, {pitch}, {roll}")
    points = as_positions(positions)
    T = np.tile(np.eye(4), (len(points), 1, 1))
    T[:, :3, :3], T[:, :3, 3] = rotation(yaw, pitch, roll), points
    return T


def configurations(chain: ArmChain, T_base_tcp: ArrayLike, torso_range: tuple[float, float] | None = None) -> Floats:
    """Find configurations (k, 1 + n) free of self-collision that reach a pose (4, 4), over the arm's free parameters.

    `torso_range`: lowest and highest height of the lift [m], by default its limits.
    """
    low, high = torso_range or (float(chain.lower[0]), float(chain.upper[0]))
    torsos = np.linspace(low, high, _TORSOS if high > low else 1)
    angles = free_angles(chain, _ANGLES)
    if chain.has_closed_form:
        angles = np.linspace(-np.pi, np.pi, _ANGLES, endpoint=False)
    found = all_solutions(chain, np.asarray(T_base_tcp, dtype=float), torsos, angles)
    return found[SelfCollision(chain).of(found)]


def verify(
    arm: ReachabilityMap | ArmChain,
    placement: BasePlacement,
    poses_of: Callable[[int], ArrayLike],
    is_free: IsFree | None = None,
    *,
    limit: int = 5,
) -> Verified | NotVerified:
    """Find the first base of a placement from which the arm reaches every TCP pose free of collisions.

    Args:
        arm: the robot's map, with its range of torso heights, or a chain, with the whole range of its lift.
        placement: bases to verify.
        poses_of: function from the rank of a base to its T_world_tcp (m, 4, 4). Bases may differ in their approach yaw.
        is_free: whether a configuration free of self-collision is free of other collisions too. None accepts every
            configuration.
        limit: most bases to test.

    Raises:
        QueryError: `poses_of` does not return poses (m, 4, 4) with m ≥ 1, or the map has no arm.

    Example:
        placement = inverse_map.query_path(offsets, target=cup, free_space=floor, k=5)
        path = lambda rank: tcp_poses(waypoints(placement.approach_yaw[rank]), placement.approach_yaw[rank])
        match verify(rm, placement, path, is_free):
            case Verified(base=base, configurations=q): ...
    """
    chain = arm.chain if isinstance(arm, ReachabilityMap) else arm
    if chain is None:
        raise QueryError("verify needs the arm of the map; this map was made from poses")
    torso_range = arm.grid.torso_range if isinstance(arm, ReachabilityMap) else None
    reached = []
    for rank in range(min(limit, len(placement))):
        T_world_tcp = np.asarray(poses_of(rank), dtype=float)
        if T_world_tcp.ndim != 3 or T_world_tcp.shape[1:] != (4, 4) or len(T_world_tcp) == 0:
            raise QueryError(f"TCP poses of one base are an array (m, 4, 4) with m ≥ 1, not {T_world_tcp.shape}")
        T_world_tcp, base = as_poses(T_world_tcp), placement.poses[rank]
        candidates = [configurations(chain, T, torso_range) for T in world_to_base(base) @ T_world_tcp]
        path = _configuration_path(chain, base, candidates, is_free)
        if len(path) == len(T_world_tcp):
            return Verified(rank, base, path)
        reached.append(len(path))
    return NotVerified(tuple(reached))


def _configuration_path(chain: ArmChain, base: Floats, candidates: list[Floats], is_free: IsFree | None) -> Floats:
    """Choose one configuration (k, 1 + n) per TCP pose, each within a step of the previous one, up to the last pose
    with such a configuration."""
    limits = np.full(chain.size, LARGEST_STEP)
    limits[0] = LARGEST_LIFT
    # Angles of joints without limits are compared modulo a turn.
    turning = (chain.axes < PRISMATIC) & (chain.upper - chain.lower >= 2 * np.pi)
    layers: list[Floats] = []
    parents: list[NDArray[np.int64]] = []
    for found in candidates:
        parent = np.zeros(len(found), dtype=np.int64)
        if layers and len(found):
            parent = _nearest_parents(found, layers[-1], limits, turning)
            found, parent = found[parent >= 0], parent[parent >= 0]
        if is_free is not None:
            free = np.array([is_free(base, q) for q in found], dtype=bool)
            found, parent = found[free], parent[free]
        if not len(found):
            break
        layers.append(found)
        parents.append(parent)
    path: list[Floats] = []
    index = 0
    for found, parent in zip(reversed(layers), reversed(parents), strict=True):
        path.append(found[index])
        index = int(parent[index])
    return np.array(path[::-1]).reshape(-1, chain.size)


def _nearest_parents(found: Floats, before: Floats, limits: Floats, turning: NDArray[np.bool_]) -> NDArray[np.int64]:
    """For each configuration (k, n) the nearest of the previous ones (m, n), measured in steps. -1 if none is within
    one step."""
    from scipy.spatial import KDTree  # an import of a tenth of a second, for this function alone

    turn = np.where(turning, 2 * np.pi / limits, 0.0)  # of joints without limits, 0 for the others
    some, others = (np.where(turning, np.mod(q, 2 * np.pi), q) / limits for q in (found, before))
    distance, nearest = KDTree(others, boxsize=turn).query(some, p=np.inf)
    return np.where(distance <= 1.0, nearest, -1)


def compare_with_model(chain: ArmChain, model: mujoco.MjModel, base: str, tip: str, approach: str = "x") -> None:
    """Compare the TCP poses of a chain with those of MuJoCo in random configurations. Arguments as in `from_mjcf`.

    Raises:
        ChainError: they differ by more than rounding.
    """
    from irm.model_reading import tcp_pose_of_model  # needs the simulator

    rng = np.random.default_rng(0)
    low, high = np.maximum(chain.lower, -np.pi), np.minimum(chain.upper, np.pi)
    worst = 0.0
    for q in rng.uniform(low, high, (_COMPARED, chain.size)):
        T = tcp_pose_of_model(model, dict(zip(chain.joints, q.tolist(), strict=True)), base, tip, approach)
        worst = max(worst, float(np.abs(T - forward(chain, q)).max()))
    if worst > _SAME:
        raise ChainError(
            f"the chain of {chain.robot} does not agree with its model: TCP poses differ by {worst:.3g} (m, or entries "
            "of rotation matrices)"
        )
