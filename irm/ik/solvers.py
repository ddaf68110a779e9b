"""Solvers of any arm: exact decisions about TCP poses, and configurations for given free parameters.

`ExactSolver` proves each YES by a configuration within the limits and free of self-collision. NO is proved too. An arm
with the structure of Fetch's arm is solved by `irm.ik.closed_form`. With a structure of `irm.ik.structure`, branch and
bound over the free joint and the lift uses the closed form (`irm.ik.search`). Without such a structure, the arm is
solved from random configurations. NO is then proved in the same way with one more joint fixed, or by
`irm.ik.outer_reach` alone.

`arm_solutions` is for kernels. The free parameters are the height of the lift and, for seven joints, the angle of one
joint. With these fixed, the closed form of the arm has up to eight solutions. An arm without a known closed form is
solved by iteration from a stored configuration. The second parameter is then the number of this configuration.
"""

from __future__ import annotations

from functools import cached_property, lru_cache
from math import ceil

import numpy as np
from numpy.typing import ArrayLike, NDArray

from irm.answers import NO, UNKNOWN, YES
from irm.chain import ArmChain, ChainArrays, ChainKey, chain_arrays
from irm.compilation import njit
from irm.errors import QueryError
from irm.ik.arm_solver import SolverArrays
from irm.ik.closed_form import MIRRORED, decide_poses, ik_arm
from irm.ik.numerical import random_seeds, refine, refine_within
from irm.ik.outer_reach import are_out_of_reach
from irm.ik.ranges import TOLERANCE
from irm.ik.search import search
from irm.ik.structure import (
    CLOSED_FORM as CLOSED_FORM,
    ITERATIVE as ITERATIVE,
    PARALLEL as PARALLEL,
    SPHERICAL as SPHERICAL,
    ParallelArm,
    SphericalArm,
    find_bounds,
    find_structure,
)
from irm.ik.structured import parallel_solutions, spherical_solutions
from irm.kernel_arguments import call_at, kernel_address, layout_of, leaf_kernel, packed
from irm.kinematics import arm_jacobian, condition, fk_frames
from irm.rotations import as_poses
from irm.self_contact import CLEARANCE
from irm.shapes import (
    ARM,
    ARM_BASE,
    HAND_BASE,
    HAND_TORSO,
    Placed,
    Shapes,
    any_near,
    is_free,
    make_placed,
    place_shapes,
)

Floats = NDArray[np.float64]
_ROUNDING = 1e-9
"""[m] Lengths that differ by less are equal."""
SEEDS = 60
"""Random configurations for arms without a closed form, and for poses that it leaves UNKNOWN."""
SEEDS_WITH_LIFT = 180
"""The same for arms with a lift."""
SEEDS_BEFORE_PROOF = 20
"""Starting configurations of an arm without a closed form before a proof of NO is tried."""
_UPPER_ARM_ROLL, _ELBOW_FLEX = 3, 4
"""Joints of `irm.ik.closed_form`: the free joint and the elbow."""
_STORED = 200
"""Stored starting configurations of an arm without a closed form."""
FREE_SEARCHES = ((0.05, 24), (0.015, 144))
"""Steps of the lift [m] and numbers of angles of the free joint in the searches for a configuration free of
self-collision."""
_PLACE_ERROR = 1e-4
"""[m] Exceeds the errors of the gripper's place and of a distance between two shapes."""
NARROW = 0.03
"""Share of heights and angles that reach a pose, below which the grid may miss most configurations near limits."""
SEEDS_IF_NARROW = 40
"""Random configurations that such a pose is solved from, too."""
IMPROVING_ANGLES = 72
"""Angles of the free joint compared for the best μ."""
_EXACT = 1e-8
"""[rad] Solutions of an arm with less slack need no refinement."""


class ExactSolver:
    """Exact decisions about TCP poses of one arm, without a map.

    Attributes:
        chain: chain of an arm of 6 or 7 hinges.
        torso_range: lowest and highest height of its lift [m]. Equal for a fixed lift.

    Raises:
        QueryError: the heights are not finite numbers in increasing order. `solve` and `reach` raise it if the poses
            are not an array (n, 4, 4) of rotations and translations.

    Example:
        status, q = ExactSolver(chain).solve(T_base_tcp)
    """

    def __init__(self, chain: ArmChain, torso_range: tuple[float, float] | None = None) -> None:
        if torso_range is not None and not -np.inf < torso_range[0] <= torso_range[1] < np.inf:
            raise QueryError(f"torso_range is the lowest and the highest height of the lift [m], not {torso_range}")
        self.chain = chain
        self.torso_range = torso_range or (float(chain.lower[0]), float(chain.upper[0]))
        # Numba takes a third of a millisecond to inspect such a tuple. A pointer costs nothing.
        self._arrays, self._is_free = packed(solver_arrays(chain)), SelfCollision(chain)

    @property
    def is_iterative(self) -> bool:
        """Whether the arm has no structure with a closed form. A decision then takes milliseconds."""
        return self._arrays.kind == ITERATIVE

    def solve(self, T_base_tcp: ArrayLike) -> tuple[NDArray[np.int8], Floats]:
        """Decide which poses the arm reaches in a configuration free of self-collision.

        NO is proved, with a tolerance for rounding in the pose, the limits and the arm's file. Either the joints do not
        reach the pose, or the gripper would be in collision with the base or the torso. A pose is UNKNOWN if the joints
        reach it and the gripper is free, but every tried configuration is in self-collision. Rarely, it is UNKNOWN
        because the proof is incomplete.

        Args:
            T_base_tcp: (n, 4, 4).

        Returns:
            (n,) `Status` values, and (n, 1 + dof) a configuration that reaches each pose, NaN where none is known.
        """
        T = as_poses(T_base_tcp)
        status, q = self._reach(T)
        rows = np.flatnonzero(status == YES)
        rows = rows[~self._is_free.of(q[rows])]
        if not len(rows):
            return status, q
        status[rows] = UNKNOWN
        share_reached = np.ones(len(status))
        low, high = self.torso_range
        for step, count in FREE_SEARCHES:
            torsos = np.linspace(low, high, int(np.ceil((high - low) / step - _ROUNDING)) + 1)
            angles = free_angles(self.chain, count)
            for n in rows[status[rows] == UNKNOWN]:
                R, p = T[n, :3, :3].copy(), T[n, :3, 3].copy()
                nearest = np.argsort(np.abs(torsos - q[n, 0]), kind="stable")
                status[n], count_reached = _find_free(
                    self._arrays, *self._is_free.memory, R, p, torsos[nearest], angles, q[n]
                )
                share_reached[n] = count_reached / (len(torsos) * len(angles))
        for n in rows[(status[rows] == UNKNOWN) & (share_reached[rows] < NARROW)]:
            R, p = T[n, :3, :3].copy(), T[n, :3, 3].copy()
            seeds = self._seeds[:SEEDS_IF_NARROW]
            if _find_free_from(self._arrays.chain, *self._is_free.memory, R, p, low, high, seeds, q[n]):
                status[n] = YES
        q[status != YES] = np.nan
        return status, q

    def improve(self, T_base_tcp: Floats, q: Floats, torsos: Floats) -> tuple[Floats, Floats]:
        """Find configurations of higher μ for poses (n, 4, 4), from one configuration each (n, 1 + dof), NaN for none.

        Candidates are the free configurations at given torso heights `torsos` (n,) [m], at `IMPROVING_ANGLES` angles of
        the free joint.

        Returns:
            (n, 1 + dof) the best of the candidates and the given configurations, and (n,) their μ, NaN where none was
            given.
        """
        q, mu, angles = q.copy(), np.full(len(q), np.nan), free_angles(self.chain, IMPROVING_ANGLES)
        for n in np.flatnonzero(~np.isnan(q[:, 0])):
            R, p = T_base_tcp[n, :3, :3].copy(), T_base_tcp[n, :3, 3].copy()
            mu[n] = _improve(self._arrays, *self._is_free.memory, R, p, float(torsos[n]), angles, q[n])
        return q, mu

    def reach(self, T_base_tcp: ArrayLike) -> tuple[NDArray[np.int8], Floats]:
        """`solve` without regard to self-collision."""
        return self._reach(as_poses(T_base_tcp))

    def _reach(self, T_base_tcp: Floats) -> tuple[NDArray[np.int8], Floats]:
        T = np.ascontiguousarray(T_base_tcp)
        status, q = np.full(len(T), UNKNOWN, dtype=np.int8), np.full((len(T), self.chain.size), np.nan)
        low, high = self.torso_range
        if self._arrays.kind == CLOSED_FORM:
            decide_poses(chain_arrays(self.chain, self.torso_range), T, status, q)
            if np.any(status == UNKNOWN):
                _solve_from_seeds(self._arrays.chain, T, self._seeds, low, high, status, q)
            return status, q
        status[are_out_of_reach(self.chain, self.torso_range, T)] = NO
        seeds = self._seeds
        if self.is_iterative:  # the first seeds reach most poses, faster than the search
            _solve_from_seeds(self._arrays.chain, T, seeds[:SEEDS_BEFORE_PROOF], low, high, status, q)
            seeds = seeds[SEEDS_BEFORE_PROOF:]
        if self._arrays.bounds.axes.any() or self._arrays.parallel.axes.any():
            _search_poses(self._arrays, T, low, high, status, q)
        if np.any(status == UNKNOWN):
            _solve_from_seeds(self._arrays.chain, T, seeds, low, high, status, q)
        return status, q

    @cached_property
    def _seeds(self) -> Floats:
        """(m, 1 + n) random starting configurations for poses that are still UNKNOWN."""
        (low, high), rng = self.torso_range, np.random.default_rng(0)
        seeds = random_seeds(self.chain, SEEDS if low == high else SEEDS_WITH_LIFT, low, rng)
        seeds[:, 0] = rng.uniform(low, high, len(seeds))
        return seeds


@njit(cache=True)
def _search_poses(arm: SolverArrays, T: Floats, low: float, high: float, status: NDArray[np.int8], q: Floats) -> None:
    """Search boxes of lift and free joint for every UNKNOWN pose (n, 4, 4). Undecided poses stay UNKNOWN."""
    for n in range(len(T)):
        if status[n] == UNKNOWN:
            status[n] = search(arm, T[n, :3, :3].copy(), T[n, :3, 3].copy(), low, high, q[n])
            if status[n] != YES:
                q[n] = np.nan


@njit(cache=True)
def _solve_from_seeds(
    chain: ChainArrays, T: Floats, seeds: Floats, low: float, high: float, status: NDArray[np.int8], q: Floats
) -> None:
    """Solve the UNKNOWN poses (n, 4, 4) from configurations `seeds` (m, 1 + dof)."""
    trial = np.empty(seeds.shape[1])
    for n in np.flatnonzero(status == UNKNOWN):
        R, p = T[n, :3, :3].copy(), T[n, :3, 3].copy()
        for k in range(len(seeds)):
            trial[:] = seeds[k]
            if refine_within(chain, R, p, low, high, trial):
                q[n], status[n] = trial, YES
                break


_NO_SPHERE = SphericalArm(
    *(np.zeros((7, 3)), np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(3), np.zeros((3, 3))),
    *(np.zeros(3), np.zeros(7), np.zeros(7), np.zeros(7, dtype=np.int64), False, 0.0, 0.0),
)
_NO_PARALLELS = ParallelArm(
    np.zeros((6, 3)), np.zeros((5, 3)), np.zeros((3, 3)), np.zeros(3), np.zeros(6), np.zeros(6), 0.0, 0.0, 0.0
)


def solver_arrays(chain: ArmChain) -> SolverArrays:
    """The solver of an arm, made once for all chains with the same arrays."""
    return _solver_of(ChainKey(chain))


def free_angles(chain: ArmChain, count: int) -> Floats:
    """(count,) values of the second free parameter, evenly over its range. A single value if the arm has none."""
    solver = solver_arrays(chain)
    if solver.kind == ITERATIVE:
        return np.arange(float(min(count, len(solver.seeds))))
    if solver.free < 0:
        return np.zeros(1)
    lower, upper = float(chain.lower[solver.free]), float(chain.upper[solver.free])
    width = min(2 * np.pi, upper - lower)
    return np.asarray(0.5 * (lower + upper) - 0.5 * width + (np.arange(count) + 0.5) * (width / count))


@lru_cache(maxsize=64)
def _solver_of(key: ChainKey) -> SolverArrays:
    solver = _solver_without_address(key.chain)
    if solver.kind == CLOSED_FORM:
        return solver
    others = np.empty((3, 3)), np.empty(3), 0.0, 0.0, np.empty((8, key.chain.size))
    return solver._replace(other_solutions=kernel_address(_other_solutions, layout_of(solver), *others))


def _solver_without_address(chain: ArmChain) -> SolverArrays:
    arrays, none = chain_arrays(chain), np.zeros((0, chain.size))
    if chain.has_closed_form:
        return SolverArrays(
            CLOSED_FORM, arrays, _NO_SPHERE, _NO_SPHERE, _NO_PARALLELS, none, _UPPER_ARM_ROLL, _ELBOW_FLEX
        )
    structure = find_structure(chain)
    if isinstance(structure, SphericalArm):
        free, elbow = int(structure.columns[0]), int(structure.columns[3])
        others = find_bounds(chain) if structure.error > TOLERANCE else None
        bounds = (
            others
            if others and others.error < structure.error and others.columns[0] == structure.columns[0]
            else structure
        )
        return SolverArrays(SPHERICAL, arrays, structure, bounds, _NO_PARALLELS, none, free, elbow)
    if structure is not None:
        return SolverArrays(PARALLEL, arrays, _NO_SPHERE, _NO_SPHERE, structure, none, -1, 3)
    seeds, bounds = random_seeds(chain, _STORED, 0.0, np.random.default_rng(0)), find_bounds(chain) or _NO_SPHERE
    return SolverArrays(ITERATIVE, arrays, _NO_SPHERE, bounds, _NO_PARALLELS, seeds, -1, chain.size // 2)


@njit(cache=True)
def arm_solutions(
    arm: SolverArrays, R: Floats, p: Floats, torso: float, free: float, found: Floats, mirrored: bool
) -> int:
    """Find every configuration within the limits that reaches a TCP pose, for given free parameters.

    Args:
        arm: its solver.
        R, p: (3, 3), (3,) orientation and position [m] of the TCP in the base frame.
        torso: height of the lift [m].
        free: value of the second free parameter, see `free_angles`.
        found: (8, 1 + n) filled with rows of (torso, arm).
        mirrored: MIRRORED or, of Fetch's closed form, only solutions with a positive elbow. The others have the links
            of a solution for the free joint half a turn on at the same places.

    Returns:
        The number of rows.
    """
    if arm.kind == CLOSED_FORM:
        return ik_arm(arm.chain, R, p, torso, free, found, mirrored)
    return call_at(arm.other_solutions, (arm, R, p, torso, free, found))


@njit(cache=True)
def _other_solutions(arm: SolverArrays, R: Floats, p: Floats, torso: float, free: float, found: Floats) -> int:
    """`arm_solutions` of arms without the closed form of `irm.ik.closed_form`."""
    count, slack = 0, 1.0
    if arm.kind == ITERATIVE:
        found[0] = arm.seeds[int(free)]
        count = 1
    else:
        lowered = np.empty(3)
        lowered[0], lowered[1], lowered[2] = p[0], p[1], p[2] - torso
        if arm.kind == SPHERICAL:
            count, slack = spherical_solutions(arm.spherical, R, lowered, free, found), arm.spherical.slack
        else:
            count, slack = parallel_solutions(arm.parallel, R, lowered, found), arm.parallel.slack
    kept = 0
    for k in range(count):
        found[k, 0] = torso
        # A UR arm whose last axis lies along the parallel axes has solutions that miss the pose.
        is_exact = arm.kind == SPHERICAL and slack < _EXACT
        if is_exact or refine(arm.chain, R, p, found[k]):
            found[kept, 0] = torso
            for joint in range(1, found.shape[1]):
                found[kept, joint] = min(arm.chain.upper[joint], max(arm.chain.lower[joint], found[k, joint]))
            kept += 1
    return kept


def all_solutions(chain: ArmChain, T_base_tcp: Floats, torsos: Floats, angles: Floats) -> Floats:
    """Find all configurations (k, 1 + n) that reach a pose (4, 4), on a grid of the two free parameters."""
    R, p = np.ascontiguousarray(T_base_tcp[:3, :3]), np.ascontiguousarray(T_base_tcp[:3, 3])
    return np.asarray(_solutions_on_grid(packed(solver_arrays(chain)), R, p, torsos, angles))


@njit(cache=True)
def _solutions_on_grid(arm: SolverArrays, R: Floats, p: Floats, torsos: Floats, angles: Floats) -> Floats:
    n = arm.chain.axes.shape[0]
    rows, found, total = np.empty((8 * torsos.size * angles.size, n)), np.empty((8, n)), 0
    for torso in torsos:
        for angle in angles:
            count = arm_solutions(arm, R, p, torso, angle, found, MIRRORED)
            rows[total : total + count] = found[:count]
            total += count
    return rows[:total].copy()


class SelfCollision:
    """Test of configurations for self-collision by the chain's shapes: an `is_free` for `verify`.

    Example:
        is_free = SelfCollision(chain)
        is_free(base, q)
    """

    def __init__(self, chain: ArmChain) -> None:
        self._chain = packed(chain_arrays(chain))
        self.memory = packed(chain.shapes), packed(make_placed(chain.shapes))

    def __call__(self, _base: Floats | None, q: ArrayLike) -> bool:
        """Whether the configuration `q` (1 + n,) is free of self-collision. The base pose is ignored."""
        return bool(self.of(np.asarray(q, dtype=float)[None])[0])

    def of(self, Q: Floats) -> NDArray[np.bool_]:
        """(k,) whether configurations (k, 1 + n) are free of self-collision."""
        return np.asarray(_are_free(self._chain, *self.memory, Q))


@njit(cache=True)
def _are_free(chain: ChainArrays, shapes: Shapes, placed: Placed, Q: Floats) -> NDArray[np.bool_]:
    free, n = np.empty(len(Q), np.bool_), chain.axes.shape[0]
    R, p = np.empty((n + 1, 3, 3)), np.empty((n + 1, 3))
    for k in range(len(Q)):
        fk_frames(chain.offsets, chain.axes, chain.tip, Q[k], R, p)
        free[k] = is_free(shapes, placed, R, p)
    return free


@njit(cache=True)
def _find_free(
    arm: SolverArrays, shapes: Shapes, placed: Placed, R: Floats, p: Floats, torsos: Floats, angles: Floats, q: Floats
) -> tuple[int, int]:
    """Search for a free configuration for the TCP pose that `q` reaches. Returns YES with this configuration in `q`, NO
    if the gripper is in collision at every height, or UNKNOWN. Also returns the number of heights and angles at which
    the pose is reached, where a height with the gripper in collision adds all its angles. This number is meaningless
    after YES or NO."""
    n, reached = q.shape[0], 0
    frames, origins, found = np.empty((n + 1, 3, 3)), np.empty((n + 1, 3)), np.empty((8, n))
    fk_frames(arm.chain.offsets, arm.chain.axes, arm.chain.tip, q, frames, origins)
    if _is_gripper_blocked(shapes, placed, frames, origins, torsos.min() - q[0], torsos.max() - q[0]):
        return NO, reached
    for torso in torsos:
        gripper_is_free = False
        for angle in angles:
            count = arm_solutions(arm, R, p, torso, angle, found, MIRRORED)
            reached += count > 0
            for k in range(count):
                fk_frames(arm.chain.offsets, arm.chain.axes, arm.chain.tip, found[k], frames, origins)
                place_shapes(shapes, placed, frames, origins)
                # The gripper's place relative to the torso is the same for all solutions at this height.
                gripper_is_free = gripper_is_free or not any_near(shapes, placed, HAND_TORSO, CLEARANCE)
                if not gripper_is_free:
                    reached += angles.size
                    break
                if not (any_near(shapes, placed, ARM, CLEARANCE) or any_near(shapes, placed, ARM_BASE, CLEARANCE)):
                    q[:] = found[k]
                    return YES, reached
            else:
                continue
            break
    return UNKNOWN, reached


@njit(cache=True)
def _find_free_from(
    chain: ChainArrays,
    shapes: Shapes,
    placed: Placed,
    R: Floats,
    p: Floats,
    low: float,
    high: float,
    seeds: Floats,
    q: Floats,
) -> bool:
    """Search for a free configuration from seeds (m, 1 + n). True if it is found, in `q`."""
    n, trial = q.shape[0], q.copy()
    frames, origins = np.empty((n + 1, 3, 3)), np.empty((n + 1, 3))
    for k in range(len(seeds)):
        trial[:] = seeds[k]
        if refine_within(chain, R, p, low, high, trial):
            fk_frames(chain.offsets, chain.axes, chain.tip, trial, frames, origins)
            if is_free(shapes, placed, frames, origins):
                q[:] = trial
                return True
    return False


@njit(cache=True)
def _improve(
    arm: SolverArrays, shapes: Shapes, placed: Placed, R: Floats, p: Floats, torso: float, angles: Floats, q: Floats
) -> float:
    """Write the best free configuration for a TCP pose at a torso height into `q`, unless `q` is better. Returns its
    μ."""
    n, chain = q.shape[0], arm.chain
    frames, origins, found = np.empty((n + 1, 3, 3)), np.empty((n + 1, 3)), np.empty((8, n))
    J, A, d, e = np.empty((6, n - 1)), np.empty((6, 6)), np.empty(6), np.empty(6)
    fk_frames(chain.offsets, chain.axes, chain.tip, q, frames, origins)
    arm_jacobian(chain.axes, frames, origins, J)
    best = condition(J, A, d, e)
    for angle in angles:
        for k in range(arm_solutions(arm, R, p, torso, angle, found, MIRRORED)):
            fk_frames(chain.offsets, chain.axes, chain.tip, found[k], frames, origins)
            arm_jacobian(chain.axes, frames, origins, J)
            mu = condition(J, A, d, e)
            if mu > best and is_free(shapes, placed, frames, origins):
                best = mu
                q[:] = found[k]
    return best


@leaf_kernel
def _is_gripper_blocked(shapes: Shapes, placed: Placed, R: Floats, p: Floats, low: float, high: float) -> bool:
    """Whether the gripper at its place touches the base, or the torso at every height from `low` to `high` [m].

    The heights are relative to that of the frames, which are changed. Between two tested heights with contact, gripper
    and torso stay closer than half the step. The frames belong to a configuration that reaches the pose up to an error.
    """
    place_shapes(shapes, placed, R, p)
    if any_near(shapes, placed, HAND_BASE, CLEARANCE - _PLACE_ERROR):
        return True
    steps = ceil((high - low) / (2.0 * (CLEARANCE - _PLACE_ERROR)))
    start = p[0, 2] + low
    for k in range(steps + 1):
        p[0, 2] = start + (high - low) * k / max(1, steps)
        place_shapes(shapes, placed, R, p)
        if not any_near(shapes, placed, HAND_TORSO, 0.0):
            return False
    return True
