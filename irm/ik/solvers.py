"""Solvers of any arm: exact answers whether it reaches a TCP pose, and its configurations for given free parameters.

`ExactSolver` answers each YES with a configuration within the limits and free of self-collision as its proof. An arm
with the structure of Fetch's arm is solved by `irm.ik.closed_form`. With a structure of `irm.ik.structure` the closed
form is scanned over the free joint, and over the lift if there is one. Without such a structure the arm is solved from
random configurations, and NO is a statement about its length alone.

`arm_solutions` is for kernels. The free parameters are the height of the lift and, for seven joints, the angle of one
of them. With these the closed form of the arm has up to eight solutions. An arm without a known closed form is solved
by iteration from one of many stored configurations; the second parameter is then the number of that configuration.
"""

from __future__ import annotations

from functools import lru_cache
from math import ceil
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from irm.answers import NO, UNKNOWN, YES
from irm.chain import ArmChain, ChainArrays, chain_arrays
from irm.compilation import njit
from irm.ik.closed_form import decide_poses, ik_arm
from irm.ik.numerical import random_seeds, refine
from irm.ik.structure import ParallelArm, SphericalArm, find_structure
from irm.ik.structured import parallel_excess, parallel_solutions, scan_free_joint, spherical_solutions
from irm.kernel_arguments import leaf_kernel, pointer_to
from irm.kinematics import arm_jacobian, condition, fk_frames
from irm.shapes import CLEARANCE, Placed, Shapes, any_near, is_free, make_placed, place_shapes

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
_ROUNDING = 1e-9
"""[m] Lengths that differ by less are equal."""
LIFT_STEP = 0.02
"""[m] Largest step between the first heights of the lift that are tried."""
LIFT_HALVINGS = 6
"""How often a step of the lift is halved before it is called open: down to 0.3 mm."""
LIFT_SLOPE = 60.0
"""[rad/m] Largest slope of the excess along the lift that is assumed."""
SEEDS = 60
"""Random configurations per lift height for arms without a closed form, and for poses that it leaves open."""
CLOSED_FORM, SPHERICAL, PARALLEL, ITERATIVE = range(4)
"""How an arm is solved: by `irm.ik.closed_form`, by the two structures of `irm.ik.structure`, or by iteration."""
_UPPER_ARM_ROLL, _ELBOW_FLEX = 3, 4
"""Joints of `irm.ik.closed_form`: the one whose angle is free, and the elbow."""
_SEEDS = 200
"""Configurations from which an arm without a closed form is solved."""
FREE_SEARCHES = ((0.05, 24), (0.015, 144))
"""Steps of the lift [m] and angles of the free joint at which a configuration free of self-collision is looked for."""
IMPROVING_ANGLES = 72
"""Angles of the free joint of which the best one is taken."""
_EXACT = 1e-8
"""[rad] Solutions of an arm with less slack need no refinement."""


class ExactSolver:
    """Decides poses of one arm without a map.

    Attributes:
        chain: of an arm of 6 or 7 hinges.
        torso_range: lowest and highest height of its lift [m]; equal if it does not move.

    Example:
        status, q = ExactSolver(chain).solve(T_base_tcp)
    """

    def __init__(self, chain: ArmChain, torso_range: tuple[float, float] | None = None) -> None:
        self.chain = chain
        self.torso_range = torso_range or (float(chain.lower[0]), float(chain.upper[0]))
        self._arrays, self._placed = solver_arrays(chain), make_placed(chain.shapes)

    @property
    def is_iterative(self) -> bool:
        """Whether the arm has none of the structures with closed forms: answers then take milliseconds."""
        return self._arrays.kind == ITERATIVE

    def solve(self, T_base_tcp: Floats) -> tuple[NDArray[np.int8], Floats]:
        """Which poses the arm reaches in a configuration that is free of self-collision.

        NO is proved: the joints do not reach the pose, or the gripper would be inside the base. A pose is UNKNOWN where
        the joints reach it and the gripper is free, but no configuration that was tried is.

        Args:
            T_base_tcp: (n, 4, 4).

        Returns:
            (n,) `Status` values, and (n, 1 + dof) the configuration that reaches each pose; NaN where none is known.
        """
        status, q = self.reach(T_base_tcp)
        rows = np.flatnonzero(status == YES)
        arrays, shapes = self._arrays.chain, self.chain.shapes
        rows = rows[~are_free(arrays, shapes, self._placed, q[rows])]
        if not len(rows):
            return status, q
        status[rows] = UNKNOWN
        low, high = self.torso_range
        for step, count in FREE_SEARCHES:
            torsos = np.linspace(low, high, int(np.ceil((high - low) / step - _ROUNDING)) + 1)
            angles = free_angles(self.chain, count)
            for n in rows[status[rows] == UNKNOWN]:
                R, p = T_base_tcp[n, :3, :3].copy(), T_base_tcp[n, :3, 3].copy()
                nearest = np.argsort(np.abs(torsos - q[n, 0]), kind="stable")
                status[n] = _find_free(self._arrays, shapes, self._placed, R, p, torsos[nearest], angles, q[n])
        q[status != YES] = np.nan
        return status, q

    def improve(self, T_base_tcp: Floats, q: Floats, torsos: Floats) -> tuple[Floats, Floats]:
        """Configurations of higher μ for poses (n, 4, 4), given one for each (n, 1 + dof), NaN for none.

        Of free ones at the `torsos` (n,) [m] that are given, at `IMPROVING_ANGLES` angles of the free joint.

        Returns:
            (n, 1 + dof) the best of these and of those given, and (n,) their μ; NaN where none was given.
        """
        q, mu, angles = q.copy(), np.full(len(q), np.nan), free_angles(self.chain, IMPROVING_ANGLES)
        for n in np.flatnonzero(~np.isnan(q[:, 0])):
            R, p = T_base_tcp[n, :3, :3].copy(), T_base_tcp[n, :3, 3].copy()
            mu[n] = _improve(self._arrays, self.chain.shapes, self._placed, R, p, float(torsos[n]), angles, q[n])
        return q, mu

    def reach(self, T_base_tcp: Floats) -> tuple[NDArray[np.int8], Floats]:
        """The same without regard to self-collision."""
        T = np.ascontiguousarray(T_base_tcp, dtype=float)
        status, q = np.full(len(T), UNKNOWN, dtype=np.int8), np.full((len(T), self.chain.size), np.nan)
        if self._arrays.kind == CLOSED_FORM:
            decide_poses(chain_arrays(self.chain, self.torso_range), T, status, q)
            return status, q
        away = T[:, :3, 3] - self.chain.shoulder  # from the nearest height of the lift
        away[:, 2] -= np.clip(away[:, 2], *self.torso_range)
        status[~(np.linalg.norm(away, axis=1) <= self.chain.reach + _ROUNDING)] = NO
        if self._arrays.kind != ITERATIVE:
            self._solve_by_structure(T, status, q)
        # Random configurations may still reach what is open.
        low, high = self.torso_range
        heights, rng = np.linspace(low, high, 5 if high > low else 1), np.random.default_rng(0)
        seeds = np.concatenate([random_seeds(self.chain, SEEDS, height, rng) for height in heights])
        for n in np.flatnonzero(status == UNKNOWN):
            if _reach_from_seeds(self._arrays.chain, T[n, :3, :3].copy(), T[n, :3, 3].copy(), seeds, q[n]):
                status[n] = YES
        return status, q

    def _solve_by_structure(self, T: Floats, status: NDArray[np.int8], q: Floats) -> None:
        """Scan the lift for every open pose; what cannot be decided stays open.

        Between two heights the excess could reach 0 only if it changes by their sum.
        """
        poses = np.flatnonzero(status == UNKNOWN)
        low, high = self.torso_range
        heights = np.linspace(low, high, int(np.ceil((high - low) / LIFT_STEP - _ROUNDING)) + 1)
        excess = np.empty((len(poses), heights.size))
        undecided = np.zeros(len(T), dtype=bool)
        for k, height in enumerate(heights):
            excess[:, k] = self._try_heights(T, poses, np.full(len(poses), height), status, q, undecided)
        pose, start = poses.repeat(heights.size - 1), np.tile(heights[:-1], len(poses))
        ends = np.column_stack([excess[:, :-1].ravel(), excess[:, 1:].ravel()])
        step = heights[1] - heights[0] if heights.size > 1 else 0.0
        for _ in range(LIFT_HALVINGS):
            may_cross = (ends.sum(axis=1) < LIFT_SLOPE * step) & (status[pose] == UNKNOWN)
            pose, start, ends, step = pose[may_cross], start[may_cross], ends[may_cross], step / 2
            middle = self._try_heights(T, pose, start + step, status, q, undecided)
            ends = np.concatenate([np.column_stack([ends[:, 0], middle]), np.column_stack([middle, ends[:, 1]])])
            pose, start = np.tile(pose, 2), np.concatenate([start, start + step])
        undecided[pose[ends.sum(axis=1) < LIFT_SLOPE * step]] = True
        status[poses[(status[poses] == UNKNOWN) & ~undecided[poses]]] = NO

    def _try_heights(
        self,
        T: Floats,
        poses: Integers,
        heights: Floats,
        status: NDArray[np.int8],
        q: Floats,
        undecided: NDArray[np.bool_],
    ) -> Floats:
        """(m,) excess of some poses, each at one height of the lift; marks those that are reached, or are undecided."""
        excess = np.zeros(len(poses))
        rows = np.flatnonzero(status[poses] == UNKNOWN)
        some = poses[rows]
        R, p = np.ascontiguousarray(T[some, :3, :3]), np.ascontiguousarray(T[some, :3, 3])
        found = np.zeros((len(rows), self.chain.size))
        found[:, 0] = heights[rows]
        answer, excess[rows] = _try_poses(self._arrays, R, p, found)
        status[some[answer == YES]] = YES
        q[some[answer == YES]] = found[answer == YES]
        undecided[some[answer == UNKNOWN]] = True
        return excess


@njit(cache=True)
def _try_poses(arm: SolverArrays, R: Floats, p: Floats, q: Floats) -> tuple[NDArray[np.int8], Floats]:
    """Answers and excesses (m,) for poses `R` (m, 3, 3), `p` (m, 3) at torso heights `q[:, 0]`; solutions into `q`."""
    answers, excesses = np.empty(len(q), np.int8), np.empty(len(q))
    lowered, best = np.empty(3), np.empty((1, 6))
    for k in range(len(q)):
        if arm.kind == SPHERICAL:
            answers[k], excesses[k] = scan_free_joint(arm.chain, arm.spherical, R[k], p[k], q[k])
            continue
        lowered[0], lowered[1], lowered[2] = p[k, 0], p[k, 1], p[k, 2] - q[k, 0]
        excesses[k] = max(0.0, parallel_excess(arm.parallel, R[k], lowered, best) - arm.parallel.slack)
        q[k, 1:] = best[0]
        answers[k] = NO
        if excesses[k] == 0.0:
            answers[k] = YES if refine(arm.chain, R[k], p[k], q[k]) else UNKNOWN
    return answers, excesses


@njit(cache=True)
def _reach_from_seeds(chain: ChainArrays, R: Floats, p: Floats, seeds: Floats, q: Floats) -> bool:
    """Whether a pose is reached from one of the configurations `seeds` (m, n); the solution into `q` (n,)."""
    trial = np.empty(q.size)
    for k in range(len(seeds)):
        trial[:] = seeds[k]
        if refine(chain, R, p, trial):
            q[:] = trial
            return True
    return False


class SolverArrays(NamedTuple):
    """The solver of one arm, for kernels; the same type for all arms.

    `kind`: CLOSED_FORM, SPHERICAL, PARALLEL or ITERATIVE. `spherical`, `parallel`: structure of the arm; zeros where it
    has another one. `seeds` (m, 1 + n) configurations; m = 0 for arms with a closed form. `free`, `elbow`: joint of the
    chain whose angle is a parameter, -1 for none, and joint at the elbow.
    """

    kind: int
    chain: ChainArrays
    spherical: SphericalArm
    parallel: ParallelArm
    seeds: Floats
    free: int
    elbow: int


_NO_SPHERE = SphericalArm(
    *(np.zeros((7, 3)), np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(3), np.zeros((3, 3)), np.zeros(3)),
    *(np.zeros(7), np.zeros(7), np.zeros(7, dtype=np.int64), False, 0.0, 0.0),
)
_NO_PARALLELS = ParallelArm(
    np.zeros((6, 3)), np.zeros((5, 3)), np.zeros((3, 3)), np.zeros(3), np.zeros(6), np.zeros(6), 0.0
)


def solver_arrays(chain: ArmChain) -> SolverArrays:
    """The solver of an arm; made once for all chains with the same arrays."""
    return _solver_of(_Key(chain))


def free_angles(chain: ArmChain, count: int) -> Floats:
    """(count,) values of the second free parameter, evenly over its range; one value if the arm has none."""
    solver = solver_arrays(chain)
    if solver.kind == ITERATIVE:
        return np.arange(float(min(count, len(solver.seeds))))
    if solver.free < 0:
        return np.zeros(1)
    lower, upper = float(chain.lower[solver.free]), float(chain.upper[solver.free])
    width = min(2 * np.pi, upper - lower)
    return np.asarray(0.5 * (lower + upper) - 0.5 * width + (np.arange(count) + 0.5) * (width / count))


class _Key:
    """A chain that equals others with the same arrays, for `lru_cache`."""

    def __init__(self, chain: ArmChain) -> None:
        self.chain = chain
        arrays = (chain.offsets, chain.axes, chain.lower, chain.upper, chain.tip, chain.links)
        self._content = tuple(array.tobytes() for array in arrays)

    def __hash__(self) -> int:
        return hash(self._content)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Key) and self._content == other._content


@lru_cache(maxsize=64)
def _solver_of(key: _Key) -> SolverArrays:
    chain = key.chain
    arrays, none = chain_arrays(chain), np.zeros((0, chain.size))
    if chain.has_closed_form:
        return SolverArrays(CLOSED_FORM, arrays, _NO_SPHERE, _NO_PARALLELS, none, _UPPER_ARM_ROLL, _ELBOW_FLEX)
    structure = find_structure(chain)
    if isinstance(structure, SphericalArm):
        free, elbow = int(structure.columns[0]), int(structure.columns[3])
        return SolverArrays(SPHERICAL, arrays, structure, _NO_PARALLELS, none, free, elbow)
    if structure is not None:
        return SolverArrays(PARALLEL, arrays, _NO_SPHERE, structure, none, -1, 3)
    seeds = random_seeds(chain, _SEEDS, 0.0, np.random.default_rng(0))
    return SolverArrays(ITERATIVE, arrays, _NO_SPHERE, _NO_PARALLELS, seeds, -1, chain.size // 2)


@njit(cache=True)
def arm_solutions(arm: SolverArrays, R: Floats, p: Floats, torso: float, free: float, found: Floats) -> int:
    """Every configuration within the limits that reaches a TCP pose.

    Args:
        arm: its solver.
        R, p: (3, 3), (3,) orientation and position [m] of the TCP in the base frame.
        torso: height of the lift [m].
        free: value of the second free parameter, see `free_angles`.
        found: (8, 1 + n) filled with rows of (torso, arm).

    Returns:
        The number of rows.
    """
    if arm.kind == CLOSED_FORM:
        return ik_arm(arm.chain, R, p, torso, free, found)
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
        if slack < _EXACT or refine(arm.chain, R, p, found[k]):
            found[kept] = found[k]
            kept += 1
    return kept


@njit(cache=True)
def are_free(chain: ChainArrays, shapes: Shapes, placed: Placed, Q: Floats) -> NDArray[np.bool_]:
    """(k,) whether configurations (k, 1 + n) are free of self-collision; `placed` is memory for the shapes."""
    free, n = np.empty(len(Q), np.bool_), chain.axes.shape[0]
    some, memory = pointer_to(shapes), pointer_to(placed)
    R, p = np.empty((n + 1, 3, 3)), np.empty((n + 1, 3))
    for k in range(len(Q)):
        fk_frames(chain.offsets, chain.axes, chain.tip, Q[k], R, p)
        free[k] = is_free(some, memory, R, p)
    return free


@njit(cache=True)
def _find_free(
    arm: SolverArrays, shapes: Shapes, placed: Placed, R: Floats, p: Floats, torsos: Floats, angles: Floats, q: Floats
) -> int:
    """YES with a free configuration for a TCP pose in `q`, which reaches it; NO if the gripper is in no place that is
    free, else UNKNOWN."""
    some, memory, n = pointer_to(shapes), pointer_to(placed), q.shape[0]
    frames, origins, found = np.empty((n + 1, 3, 3)), np.empty((n + 1, 3)), np.empty((8, n))
    fk_frames(arm.chain.offsets, arm.chain.axes, arm.chain.tip, q, frames, origins)
    if _is_gripper_blocked(some, memory, frames, origins, torsos.min() - q[0], torsos.max() - q[0]):
        return NO
    for torso in torsos:
        gripper_is_free = False
        for angle in angles:
            for k in range(arm_solutions(arm, R, p, torso, angle, found)):
                fk_frames(arm.chain.offsets, arm.chain.axes, arm.chain.tip, found[k], frames, origins)
                place_shapes(some, memory, frames, origins)
                gripper_is_free = gripper_is_free or not any_near(some, memory, 0, CLEARANCE)
                if not gripper_is_free:
                    break
                if not (any_near(some, memory, 1, CLEARANCE) or any_near(some, memory, 3, CLEARANCE)):
                    q[:] = found[k]
                    return YES
            else:
                continue
            break
    return UNKNOWN


@njit(cache=True)
def _improve(
    arm: SolverArrays, shapes: Shapes, placed: Placed, R: Floats, p: Floats, torso: float, angles: Floats, q: Floats
) -> float:
    """μ of the best free configuration for a TCP pose at a torso height, or of `q` if it is better; it is then `q`."""
    some, memory, n, chain = pointer_to(shapes), pointer_to(placed), q.shape[0], arm.chain
    frames, origins, found = np.empty((n + 1, 3, 3)), np.empty((n + 1, 3)), np.empty((8, n))
    J, A, d, e = np.empty((6, n - 1)), np.empty((6, 6)), np.empty(6), np.empty(6)
    fk_frames(chain.offsets, chain.axes, chain.tip, q, frames, origins)
    arm_jacobian(chain.axes, frames, origins, J)
    best = condition(J, A, d, e)
    for angle in angles:
        for k in range(arm_solutions(arm, R, p, torso, angle, found)):
            fk_frames(chain.offsets, chain.axes, chain.tip, found[k], frames, origins)
            arm_jacobian(chain.axes, frames, origins, J)
            mu = condition(J, A, d, e)
            if mu > best and is_free(some, memory, frames, origins):
                best = mu
                q[:] = found[k]
    return best


@leaf_kernel
def _is_gripper_blocked(shapes: Shapes, placed: Placed, R: Floats, p: Floats, low: float, high: float) -> bool:
    """Whether the gripper at this place touches the base, or the torso at every height from `low` to `high` [m].

    The heights are relative to that of the frames, which are changed. Between two heights at which both touch, they
    are nearer than half the step.
    """
    place_shapes(shapes, placed, R, p)
    if any_near(shapes, placed, 2, CLEARANCE):
        return True
    steps = ceil((high - low) / (2.0 * CLEARANCE))
    start = p[0, 2] + low
    for k in range(steps + 1):
        p[0, 2] = start + (high - low) * k / max(1, steps)
        place_shapes(shapes, placed, R, p)
        if not any_near(shapes, placed, 0, 0.0):
            return False
    return True
