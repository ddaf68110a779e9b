"""Does the arm reach a TCP pose? The map where it is certain, exact inverse kinematics where it is not."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from irm.arm.exact import ExactSolver, exact_solver
from irm.checks.classification import classify
from irm.maps.certificate.table import CertificateTable
from irm.maps.orientation_index import as_poses
from irm.maps.reachability import ReachabilityMap
from irm.queries.status import Status

__all__ = ["decide"]


def decide(rm: ReachabilityMap | CertificateTable, T_base_tcp: ArrayLike) -> NDArray[np.int8]:
    """(n,) `Status` values of TCP poses (n, 4, 4) in the base frame.

    The map answers first, see `irm.checks.classification.classify`. The arm's exact solver decides the poses for which
    the map says UNKNOWN: by arithmetic (the wrist centre farther from the shoulder than upper arm and forearm are
    long), then by inverse kinematics. It also decides those for which a map that was built by sampling says NO: such a
    map may miss narrow parts of the workspace. UNKNOWN is left where even the solver has no answer, or where the map
    is that of somebody else and its arm is not known.

    Args:
        rm: of any pitches and heights: poses that it does not cover are decided by the solver alone. Or a certificate
            table.
        T_base_tcp: the poses.

    Raises:
        QueryError: not an array of poses.

    Example:
        reached = decide(cached_map(FETCH), T_base_tcp) == Status.YES.value
    """
    T = as_poses(T_base_tcp)
    if isinstance(rm, CertificateTable):
        answers = rm.look_up(T)[0]
        is_open = answers == Status.UNKNOWN.value
        answers[is_open] = exact_solver(rm.chain).solve(T[is_open])[0]
        return answers
    is_whole = not (rm.grid.cut_below or rm.grid.cut_above or rm.parameters.pitches)
    answers = classify(rm, T) if is_whole else np.full(len(T), Status.UNKNOWN.value, dtype=np.int8)
    if rm.chain is None:
        return answers
    is_open = answers == Status.UNKNOWN.value if rm.chain.has_closed_form else answers != Status.YES.value
    answers[is_open] = _solver(rm).solve(T[is_open])[0]
    return answers


def _solver(rm: ReachabilityMap) -> ExactSolver:
    """The exact solver of a map's arm, with the torso heights of the map."""
    assert rm.chain is not None
    return exact_solver(rm.chain, rm.grid.torso_range)
