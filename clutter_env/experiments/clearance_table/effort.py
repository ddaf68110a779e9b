"""What a plan costs beside its clearances: base motions and simulated time, paired with a reference."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from clutter_env.experiments.clearance_table.trials import Attempt
from clutter_env.reporting.intervals import Interval, bootstrap

__all__ = ["Effort", "effort_of"]


class Effort(NamedTuple):
    """Means over the scenes that both solved.

    Attributes:
        base_moves, reference_moves: base motions of one plan; of the reference.
        less_moves: base motions less than the reference.
        time, reference_time: [s] of simulated time of one plan; of the reference.
        less_time: [s] less than the reference.
    """

    base_moves: float
    reference_moves: float
    less_moves: Interval
    time: float
    reference_time: float
    less_time: Interval


def effort_of(own: Mapping[int, Attempt], reference: Mapping[int, Attempt], rng: np.random.Generator) -> Effort:
    """The effort on the scenes, by seed, that both solved."""
    pairs = [(one, reference[k]) for k, one in own.items() if one.solved and k in reference and reference[k].solved]
    moves = np.array([(one.base_moves, other.base_moves) for one, other in pairs], float).reshape(-1, 2)
    spent = np.array([(one.sim_s, other.sim_s) for one, other in pairs], float).reshape(-1, 2)
    mean = [float(column.mean()) if len(pairs) else np.nan for column in (*moves.T, *spent.T)]
    less = [bootstrap([(values[:, 1] - values[:, 0]).tolist()], rng) for values in (moves, spent)]
    return Effort(mean[0], mean[1], less[0], mean[2], mean[3], less[1])
