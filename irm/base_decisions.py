"""Exact decisions about the bases of an answer, by inverse kinematics without self-collision.

A map knows which bases reach at the centres of its cells. Between these centres, and between its rings of pitch,
inverse kinematics decides. Both inverse maps share this module.
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
"""Bases decided beyond the requested number, to replace those that are dropped."""
_MORE_BASES, _AT_A_TIME = 256, 16
"""Bases decided beyond the requested number before an answer is given without a certain base, and the number decided at
a time."""
AtOneTurn = bool
Ranked = Callable[[int, AtOneTurn], Floats]
"""The best bases of a query: at most the given number of rows (m, 7) of x, y, yaw, approach yaw, μ, torso, certain.
With `AtOneTurn`, each base occurs at a single turn about the TCP, because every turn is the same to the arm. Otherwise
the bases keep their distance from each other."""
Poses = Callable[[Floats], Floats]
"""T_world_tcp (m, 4, 4) that belong to the bases of rows (m, 7)."""


class Decided(NamedTuple):
    """Exact answers for k bases, with m TCP poses of each.

    `may_reach` (k,): false where a pose is certainly out of reach. `certain` (k,): whether a configuration is known for
    every pose. `configurations` (k, m, 1 + n): NaN where none is known. `T_base_tcp` (k, m, 4, 4): the poses.
    """

    may_reach: NDArray[np.bool_]
    certain: NDArray[np.bool_]
    configurations: Floats
    T_base_tcp: Floats


class BaseDecisions:
    """Decisions about the bases of one map, by the exact solver of its arm."""

    def __init__(self, reachability_map: ReachabilityMap) -> None:
        self._map = reachability_map

    def is_wanted(self, options: QueryOptions, by_default: bool) -> bool:
        """Whether to decide the bases of a query exactly. `by_default` holds where the caller leaves it open.

        Raises:
            QueryError: the caller requests it for a map without an arm.
        """
        if options.exact and self._map.chain is None:
            raise QueryError("exact=True needs the arm of the map; this map was made from poses")
        if options.exact is None:
            return by_default and self._map.chain is not None
        return options.exact

    @property
    def is_fast(self) -> bool:
        """Whether the arm has a fast closed form. Then several poses of each base can be decided."""
        return self._map.chain is not None and self._map.chain.has_closed_form

    def settle(self, ranked: Ranked, poses: Poses, options: QueryOptions) -> tuple[Floats, Floats | None]:
        """Settle one TCP position: rows (k, 7) of bases, best first, and configurations (k, 1 + n) if decided.

        By default bases are decided only where the map is uncertain about the best one. μ and the order stay those of
        the map. Bases that certainly do not reach are dropped. Bases with a known configuration come before the others.
        With `exact`, μ and torso are those of the configurations.
        """
        rows = ranked(options.k, False)
        if not self.is_wanted(options, by_default=len(rows) > 0 and not rows[0, 6]):
            return rows, None
        if not options.exact:
            kept, q = self._decided(rows, poses, options)
            # The map's choice stands if no base is dropped and at least one is certain.
            if len(kept) == len(rows) and kept[:, 6].any():
                return kept, q
        if len(rows) == options.k:
            rows = ranked(options.k + SPARE_BASES, False)
        rows, q = self._decided(rows, poses, options)
        if not rows[:, 6].any():
            # No base is certain: decide many more, in small batches, until one is.
            others = ranked(options.k + _MORE_BASES, True)
            for first in range(0, len(others), _AT_A_TIME):
                some, found = self._decided(others[first : first + _AT_A_TIME], poses, options)
                if some[:, 6].any():
                    return some, found
        return rows, q

    def _decided(self, rows: Floats, poses: Poses, options: QueryOptions) -> tuple[Floats, Floats]:
        """The bases of rows (m, 7) that may reach their poses, at most `options.k`, and their configurations."""
        kept, q = self.decide_rows(rows, poses(rows), options, options.k)
        return rows[kept], q[kept]

    def decide_rows(
        self, rows: Floats, T_world_tcp: Floats, options: QueryOptions, most: int = MOST_BASES
    ) -> tuple[Integers, Floats]:
        """Indices of the bases of rows (m, 7) that may reach their poses (m, 4, 4), and configurations (m, 1 + n).

        At most `most` indices, certain bases first, then by μ. The rows are changed: they take certainty and torso
        height from the configurations, and with `options.exact` also μ.
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
        """Decide k bases (k, 3) of x, y [m] and yaw [rad] for m TCP poses each (k, m, 4, 4)."""
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
        """Best configurations (r, m, 1 + n) of some bases near the map's torso heights (r, m) [m], and their μ."""
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
    """Indices of the kept bases, certain bases first, then by μ."""
    return np.flatnonzero(kept)[np.lexsort((-mu[kept], ~certain[kept]))]
