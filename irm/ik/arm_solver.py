"""The solver of one arm as arrays: what the kernels of `irm.ik` that solve and search share."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from irm.chain import ChainArrays
from irm.ik.structure import ParallelArm, SphericalArm

Floats = NDArray[np.float64]


class SolverArrays(NamedTuple):
    """The solver of one arm, for kernels; the same type for all arms.

    `kind`: CLOSED_FORM, SPHERICAL, PARALLEL or ITERATIVE. `spherical`, `parallel`: structure of the arm; zeros where it
    has another one. `bounds`: for proofs of NO, the spherical structure, or that of `find_bounds` if the arm has none
    or another fits it better; zeros for others. `seeds` (m, 1 + n) configurations; m = 0 for arms with a closed form.
    `free`, `elbow`: joint of the chain whose angle is a parameter, -1 for none, and joint at the elbow.
    `other_solutions`: address of the kernel for arms that are not CLOSED_FORM, so that a planner for Fetch need not
    compile it; 0 for those that are.
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
