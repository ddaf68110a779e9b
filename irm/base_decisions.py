"""Exact decisions about the bases of an answer: which of them reach, by inverse kinematics and without self-collision.

A map says which bases reach at the centres of its cells. Between the centres, and between its rings of pitch, inverse
kinematics decides. Both inverse maps share this module.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from irm.answers import NO, YES
from irm.errors import QueryError
from irm.query_keys import MOST_BASES, QueryOptions
from irm.reachability_map import ReachabilityMap
from irm.rotations import rotations

if TYPE_CHECKING:
    from irm.ik.solvers import ExactSolver

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
SPARE_BASES = 8
"""Bases that are decided beyond the number wanted, in place of those that are dropped."""
_MORE_BASES, _AT_A_TIME = 256, 16
"""Bases decided exactly, beyond the number wanted, before an answer is given without a certain base; and how many of
them at a time."""
AtOneTurn = bool
Ranked = Callable[[int, AtOneTurn], Floats]
"""The best bases of a query: at most so many rows (m, 7) of x, y, yaw, approach yaw, μ, torso, certain. At one turn
each if that is true: to the arm, a base is the same at every turn about the TCP. Else apart from each other."""
Poses = Callable[[Floats], Floats]
"""T_world_tcp (m, 4, 4) that the bases of rows (m, 7) are for."""


class Decided(NamedTuple):
    """Exact answers for k bases, with m TCP poses of each.

    `may_reach` (k,): false where a pose is certainly out of reach; `certain` (k,): whether a configuration is known for
    all; these `configurations` (k, m, 1 + n), NaN where there is none; and the poses, `T_base_tcp` (k, m, 4, 4).
    """

    may_reach: NDArray[np.bool_]
    certain: NDArray[np.bool_]
    configurations: Floats
    T_base_tcp: Floats


class BaseDecisions:
    """Decides the bases of one map by the exact solver of its arm."""

    def __init__(self, reachability_map: ReachabilityMap) -> None:
        self._map = reachability_map

    def is_wanted(self, options: QueryOptions, by_default: bool) -> bool:
        """Whether the bases of a query are to be decided exactly; `by_default`: if the caller does not say.

        Raises:
            QueryError: the caller wants it, and the map does not know its arm.
        """
        if options.exact and self._map.chain is None:
            raise QueryError("exact=True needs the arm of the map; this map was made from poses")
        if options.exact is None:
            return by_default and self._map.chain is not None
        return options.exact

    @property
    def is_fast(self) -> bool:
        """Whether the arm has the closed form that takes little time: several poses of each base are decided then."""
        return self._map.chain is not None and self._map.chain.has_closed_form

    def settle(self, ranked: Ranked, poses: Poses, options: QueryOptions) -> tuple[Floats, Floats | None]:
        """The answer for one TCP position: rows (k, 7) of bases, best first, and configurations (k, 1 + n) if decided.

        By default bases are decided where the map is not certain of the best one. μ and the order stay those of the
        map, but bases that certainly do not reach are dropped, and those of which a configuration is known come before
        those of which none was found. With `exact`, μ and torso are those of the configurations.
        """
        rows = ranked(options.k, False)
        if not self.is_wanted(options, by_default=len(rows) > 0 and not rows[0, 6]):
            return rows, None
        if not options.exact:
            kept, q = self._decided(rows, poses, options)
            if len(kept) == len(rows) and kept[:, 6].any():
                return kept, q
        if len(rows) == options.k:
            rows = ranked(options.k + SPARE_BASES, False)
        rows, q = self._decided(rows, poses, options)
        if not rows[:, 6].any():
            others = ranked(options.k + _MORE_BASES, True)
            for first in range(0, len(others), _AT_A_TIME):
                some, found = self._decided(others[first : first + _AT_A_TIME], poses, options)
                if some[:, 6].any():
                    return some, found
        return rows, q

    def _decided(self, rows: Floats, poses: Poses, options: QueryOptions) -> tuple[Floats, Floats]:
        """Those of the bases (m, 7) that may reach their poses, `options.k` at most, and configurations."""
        kept, q = self.decide_rows(rows, poses(rows), options, options.k)
        return rows[kept], q[kept]

    def decide_rows(
        self, rows: Floats, T_world_tcp: Floats, options: QueryOptions, most: int = MOST_BASES
    ) -> tuple[Integers, Floats]:
        """Which of the bases of rows (m, 7) may reach their poses (m, 4, 4), and configurations (m, 1 + n) that do.

        They are `most` at most, the certain and best first. Sets certainty and torso height of the rows, and with
        `options.exact` μ, to those of the configurations.
        """
        decided = self.decide(rows[:, :3], T_world_tcp[:, None])
        certain, q = decided.certain, decided.configurations[:, 0].copy()
        rows[:, 6] = certain
        kept = best_first(rows[:, 4], certain, decided.may_reach)[:most]
        sure = kept[certain[kept]]
        better, mu = self.improve(decided, sure, rows[sure, 5, None])
        q[sure], rows[sure, 5] = better[:, 0], better[:, 0, 0]
        if options.exact:
            rows[sure, 4] = mu[:, 0]
        return kept[best_first(rows[kept, 4], certain[kept], np.ones(len(kept), dtype=bool))], q

    def decide(self, bases: Floats, T_world_tcp: Floats) -> Decided:
        """Exact answers for k bases (k, 3) x, y [m] and yaw [rad], and m TCP poses of each (k, m, 4, 4)."""
        T = np.array(T_world_tcp)
        back = rotations(-bases[:, 2], np.zeros(len(bases)), np.zeros(len(bases)))[:, None]
        T[..., :2, 3] -= bases[:, None, :2]
        T[..., :3, :] = back @ T[..., :3, :]
        flat = T.reshape(-1, 4, 4)
        # A base at several turns about the TCP is the same base to the arm.
        _, first, same = np.unique(flat.round(6).reshape(-1, 16), axis=0, return_index=True, return_inverse=True)
        answers, q = self._solver.solve(flat[first])
        answers = answers[same].reshape(T.shape[:2])
        configurations = q[same].reshape(*T.shape[:2], self._solver.chain.size)
        return Decided(np.all(answers != NO, axis=1), np.all(answers == YES, axis=1), configurations, T)

    def improve(self, decided: Decided, rows: NDArray[np.int64], torsos: Floats) -> tuple[Floats, Floats]:
        """The best configurations (r, m, 1 + n) of some bases near the map's torso heights (r, m) [m], and their μ."""
        found = decided.configurations[rows]
        T, n = decided.T_base_tcp[rows].reshape(-1, 4, 4), found.shape[-1]
        q, mu = self._solver.improve(T, found.reshape(-1, n), torsos.reshape(-1))
        return q.reshape(found.shape), mu.reshape(found.shape[:-1])

    @cached_property
    def _solver(self) -> ExactSolver:
        from irm.ik.solvers import ExactSolver  # only for exact answers

        assert self._map.chain is not None
        return ExactSolver(self._map.chain, self._map.grid.torso_range)


def best_first(mu: Floats, certain: NDArray[np.bool_], kept: NDArray[np.bool_]) -> Integers:
    """Indices of those kept, the certain ones first, then by μ."""
    return np.flatnonzero(kept)[np.lexsort((-mu[kept], ~certain[kept]))]
