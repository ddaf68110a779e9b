"""Exact answers whether an arm reaches a TCP pose, each YES with a configuration as its proof.

An arm with the structure of Fetch's arm has a solver of its own (`irm.ik.closed_form_solver`). With a structure of
`irm.ik.structure` the closed form is scanned over the free joint, and over the lift if there is one. Every YES is a
configuration within the limits that forward kinematics takes to the pose. Without such a structure the arm is solved
from random configurations, and NO is a statement about its length alone.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from irm.chain import ArmChain, ChainArrays, chain_arrays
from irm.compilation import njit
from irm.ik.closed_form_solver import ClosedFormSolver
from irm.ik.numerical import random_seeds
from irm.ik.parallel_axes import parallel_excess
from irm.ik.spherical_wrist import refine, scan_free_joint
from irm.ik.structure import ParallelArm, SphericalArm, find_structure
from irm.status import NO, UNKNOWN, YES

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


class GeneralSolver:
    """Exact inverse kinematics of an arm of 6 or 7 hinges.

    Attributes:
        chain: of the arm.
        torso_range: lowest and highest height of its lift [m]; equal if it does not move.
        structure: of its closed form, None if it has none.

    Example:
        status, q = GeneralSolver(chain, (0.0, 0.0)).solve(T_base_tcp)
    """

    def __init__(self, chain: ArmChain, torso_range: tuple[float, float]) -> None:
        self.chain = chain
        self.torso_range = torso_range
        self.structure = find_structure(chain)
        self._arrays = chain_arrays(chain)

    def solve(self, T_base_tcp: Floats) -> tuple[NDArray[np.int8], Floats]:
        """Which poses the arm reaches.

        Args:
            T_base_tcp: (n, 4, 4) poses.

        Returns:
            (n,) 0 = out of reach, 1 = open, 2 = reached; (n, 1 + dof) a configuration that reaches, NaN where none is
            known.
        """
        T = np.ascontiguousarray(T_base_tcp, dtype=float)
        status, q = np.full(len(T), UNKNOWN, dtype=np.int8), np.full((len(T), self.chain.size), np.nan)
        status[~self._within_length(T)] = NO
        if self.structure is not None:
            self._solve_in_closed_form(T, status, q)
        self._solve_from_seeds(T, status, q)
        return status, q

    def _within_length(self, T: Floats) -> NDArray[np.bool_]:
        """(n,) whether the stretched arm is long enough, at some height of its lift."""
        away = T[:, :3, 3] - self.chain.shoulder
        away[:, 2] -= np.clip(away[:, 2], *self.torso_range)
        return np.asarray(np.linalg.norm(away, axis=1) <= self.chain.reach + _ROUNDING)

    def _solve_in_closed_form(self, T: Floats, status: NDArray[np.int8], q: Floats) -> None:
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
        kernel = _try_parallel if isinstance(self.structure, ParallelArm) else _try_spherical
        answer, excess[rows] = kernel(self._arrays, self.structure, R, p, found)
        status[some[answer == YES]] = YES
        q[some[answer == YES]] = found[answer == YES]
        undecided[some[answer == UNKNOWN]] = True
        return excess

    def _solve_from_seeds(self, T: Floats, status: NDArray[np.int8], q: Floats) -> None:
        """Try random configurations for what is open."""
        low, high = self.torso_range
        heights = np.linspace(low, high, 5 if high > low else 1)
        rng = np.random.default_rng(0)
        seeds = np.concatenate([random_seeds(self.chain, SEEDS, height, rng) for height in heights])
        for n in np.flatnonzero(status == UNKNOWN):
            if _reach_from_seeds(self._arrays, T[n, :3, :3].copy(), T[n, :3, 3].copy(), seeds, q[n]):
                status[n] = YES


@njit(cache=True)
def _try_spherical(
    chain: ChainArrays, arm: SphericalArm, R: Floats, p: Floats, q: Floats
) -> tuple[NDArray[np.int8], Floats]:
    """Answers and excesses (m,) for poses `R` (m, 3, 3), `p` (m, 3) at torso heights `q[:, 0]`; solutions into `q`."""
    answers, excesses = np.empty(len(q), np.int8), np.empty(len(q))
    for k in range(len(q)):
        answers[k], excesses[k] = scan_free_joint(chain, arm, R[k], p[k], q[k])
    return answers, excesses


@njit(cache=True)
def _try_parallel(
    chain: ChainArrays, arm: ParallelArm, R: Floats, p: Floats, q: Floats
) -> tuple[NDArray[np.int8], Floats]:
    """The same for an arm with parallel axes."""
    answers, excesses = np.empty(len(q), np.int8), np.empty(len(q))
    lowered, best = np.empty(3), np.empty((1, 6))
    for k in range(len(q)):
        lowered[0], lowered[1], lowered[2] = p[k, 0], p[k, 1], p[k, 2] - q[k, 0]
        excesses[k] = max(0.0, parallel_excess(arm, R[k], lowered, best) - arm.slack)
        q[k, 1:] = best[0]
        answers[k] = NO
        if excesses[k] == 0.0:
            answers[k] = YES if refine(chain, R[k], p[k], q[k]) else UNKNOWN
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


class ExactSolver(Protocol):
    """What decides poses of one arm without a map."""

    def solve(self, T_base_tcp: Floats) -> tuple[NDArray[np.int8], Floats]:
        """Answers for poses (n, 4, 4).

        Returns:
            (n,) 0: certainly out of reach, 1: open, 2: reached, as in `irm.queries.status.Status`; and (n, 1 + dof) the
            configuration that reaches each pose, NaN where there is none.
        """


def exact_solver(chain: ArmChain, torso_range: tuple[float, float] | None = None) -> ExactSolver:
    """The exact solver of an arm.

    Args:
        chain: of the arm.
        torso_range: lowest and highest torso height to use [m]; None for the joint's limits.
    """
    torsos = torso_range or (float(chain.lower[0]), float(chain.upper[0]))
    if chain.has_closed_form:
        return ClosedFormSolver(chain, torsos)
    return GeneralSolver(chain, torsos)
