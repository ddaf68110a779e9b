"""Bases of an answer decided by exact inverse kinematics: those that certainly do not reach are dropped."""

from __future__ import annotations

from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from irm.arm.exact import ExactSolver, exact_solver
from irm.errors import QueryError
from irm.maps.orientation_index import rotation
from irm.maps.reachability import ReachabilityMap
from irm.queries.arguments import QueryOptions
from irm.queries.status import Status

__all__ = ["SPARE_BASES", "DecidedBases", "ExactBases"]

Floats = NDArray[np.float64]

SPARE_BASES = 8
"""Bases that are decided beyond the number wanted, in place of those that are dropped."""


class DecidedBases(NamedTuple):
    """What exact inverse kinematics says of k bases and m TCP poses of each.

    `may_reach` (k,): false where a pose is certainly out of reach; `certain` (k,): all poses are reached; `torso`
    (k, m): torso height of a configuration that reaches, NaN where there is none [m].
    """

    may_reach: NDArray[np.bool_]
    certain: NDArray[np.bool_]
    torso: Floats


class ExactBases:
    """The exact solver of a map's arm, for bases in the world."""

    def __init__(self, reachability_map: ReachabilityMap) -> None:
        self._map = reachability_map

    def is_wanted(self, options: QueryOptions, by_default: bool) -> bool:
        """Whether the bases of a query are to be decided exactly.

        Args:
            options: of the query.
            by_default: whether this query does so for an arm with a closed form if the caller does not say.

        Raises:
            QueryError: the caller wants it, and the map does not know its arm.
        """
        chain = self._map.chain
        if options.exact and chain is None:
            raise QueryError("exact=True needs the arm of the map; this map was made from poses")
        if options.exact is None:
            return by_default and chain is not None and chain.has_closed_form
        return options.exact

    def decide(self, bases: Floats, points: Floats, yaws: Floats, options: QueryOptions) -> DecidedBases:
        """Decide k bases.

        Args:
            bases: (k, 3) x, y [m] and yaw [rad].
            points: (k, m, 3) TCP positions in the world [m].
            yaws: (k, m) approach yaws in the world [rad].
            options: with pitch and roll of the TCP.
        """
        turn = yaws - bases[:, None, 2]
        T = np.zeros((*yaws.shape, 4, 4))
        T[..., :3, :3] = _about_z(turn) @ rotation(0.0, options.pitch, options.roll)
        offset = points - np.concatenate([bases[:, None, :2], np.zeros((len(bases), 1, 1))], axis=2)
        T[..., :3, 3] = np.einsum("kij,kmj->kmi", _about_z(-bases[:, 2]), offset)
        T[..., 3, 3] = 1.0
        answers, configurations = self._solver.solve(T.reshape(-1, 4, 4))
        answers = answers.reshape(yaws.shape)
        may_reach = np.all(answers != Status.NO.value, axis=1)
        certain = np.all(answers == Status.YES.value, axis=1)
        return DecidedBases(may_reach, certain, configurations[:, 0].reshape(yaws.shape))

    @cached_property
    def _solver(self) -> ExactSolver:
        assert self._map.chain is not None
        return exact_solver(self._map.chain, self._map.grid.torso_range)


def _about_z(angle: Floats) -> Floats:
    """(..., 3, 3) rotations about z."""
    R = np.zeros((*angle.shape, 3, 3))
    c, s = np.cos(angle), np.sin(angle)
    R[..., 0, 0], R[..., 0, 1], R[..., 1, 0], R[..., 1, 1], R[..., 2, 2] = c, -s, s, c, 1.0
    return R
