"""Solver of one arm as arrays, shared by the solving and searching kernels of `irm.ik`."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from irm.chain import ChainArrays
from irm.ik.structure import ParallelArm, SphericalArm

Floats = NDArray[np.float64]


class SolverArrays(NamedTuple):
    """Solver of one arm, for kernels. All arms have the same type.

    `kind`: CLOSED_FORM, SPHERICAL, PARALLEL or ITERATIVE. `spherical`, `parallel`: structure of the arm, zeros for
    another structure. `bounds`: structure for proofs of NO. It is the spherical structure, or that of `find_bounds` if
    the arm has none or this fits better. Otherwise zeros. `seeds` (m, 1 + n): configurations, m = 0 for arms with a
    closed form. `free`: joint of the chain whose angle is a parameter, -1 for none. `elbow`: joint at the elbow.
    `other_solutions`: address of the kernel for arms that are not CLOSED_FORM, otherwise 0. So a planner for Fetch need
    not compile it.
    """

    kind: int
    chain: ChainArrays
    spherical: SphericalArm
    bounds: SphericalArm
    parallel: ParallelArm
    seeds: Floats
    free: int
    elbow: int
    other_solutions: int = 0
