"""Is a TCP pose in reach? Exact answers for one arm, each YES with a configuration as its proof."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from irm.arm.closed_form_solver import ClosedFormSolver
from irm.arm.general.solver import GeneralSolver
from irm.arm.kinematics import ArmChain

__all__ = ["ExactSolver", "exact_solver"]

Floats = NDArray[np.float64]


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
