"""All configurations of any arm for a TCP pose, given the values of its free parameters, compiled.

The free parameters are the height of the lift and, for seven joints, the angle of one of them. With these the closed
form of the arm has up to eight solutions. An arm without a known closed form is solved by iteration from one of many
stored configurations; the second parameter is then the number of that configuration.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from irm.chain import ArmChain, ChainArrays, chain_arrays
from irm.compilation import njit
from irm.ik.closed_form import ik_arm
from irm.ik.numerical import random_seeds
from irm.ik.parallel_axes import parallel_solutions
from irm.ik.spherical_wrist import refine, spherical_solutions
from irm.ik.structure import ParallelArm, SphericalArm, find_structure

Floats = NDArray[np.float64]
CLOSED_FORM, SPHERICAL, PARALLEL, ITERATIVE = range(4)
"""How an arm is solved: by `irm.arm.closed_form`, by the two structures of `irm.arm.general`, or by iteration."""
_UPPER_ARM_ROLL, _ELBOW_FLEX = 3, 4
"""Joints of `irm.arm.closed_form`: the one whose angle is free, and the elbow."""
_SEEDS = 200
"""Configurations from which an arm without a closed form is solved."""
_EXACT = 1e-8
"""[rad] Solutions of an arm with less slack need no refinement."""


class SolverArrays(NamedTuple):
    """What solves one arm, for kernels; the same type for all arms.

    Attributes:
        kind: CLOSED_FORM, SPHERICAL, PARALLEL or ITERATIVE.
        chain: of the arm.
        spherical, parallel: its structure; zeros where it has another one.
        seeds: (m, 1 + n) configurations; m = 0 for arms with a closed form.
        free: joint of the chain whose angle is a parameter; -1 for none.
        elbow: joint of the chain at the elbow.
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
    """What solves an arm."""
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
    """A chain that equals others with the same arrays."""

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
        arm: what solves it.
        R, p: (3, 3), (3,) orientation and position [m] of the TCP in the base frame.
        torso: height of the lift [m].
        free: value of the second free parameter, see `free_angles`.
        found: (8, 1 + n) filled with rows of (torso, arm).

    Returns:
        The number of rows.
    """
    if arm.kind == CLOSED_FORM:
        return ik_arm(arm.chain.links, R, p, torso, free, arm.chain.lower, arm.chain.upper, found)
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
    for k in range(count):
        found[k, 0] = torso
    return count if slack < _EXACT else _refined(arm.chain, R, p, found, count)


@njit(cache=True)
def _refined(chain: ChainArrays, R: Floats, p: Floats, found: Floats, count: int) -> int:
    """Keep the rows of `found` that iteration takes to the pose within the limits; how many."""
    kept = 0
    for k in range(count):
        if refine(chain, R, p, found[k]):
            found[kept] = found[k]
            kept += 1
    return kept
