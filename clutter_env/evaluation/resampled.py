"""Other suites by the same rules: how far a score depends on which scenes were drawn."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

from clutter_env.evaluation.evaluate import evaluate
from clutter_env.evaluation.suite_making import MOST_TRIED
from clutter_env.evaluation.verify import FRESH_SEEDS, fresh_suite


class Spread(NamedTuple):
    """Clean success of one policy on several suites by the same rules.

    Attributes:
        policy: its name.
        scenes: of each suite.
        rates: one for each suite.
    """

    policy: str
    scenes: int
    rates: tuple[float, ...]

    @property
    def range(self) -> float:
        """The highest rate less the lowest."""
        return max(self.rates) - min(self.rates)


def resampled(
    policy: str,
    suite: str,
    suites: int,
    scenes: int,
    workers: int = 1,
    tick: Callable[[], object] = lambda: None,
    first_seeds: Sequence[int] = FRESH_SEEDS[::MOST_TRIED],
) -> Spread:
    """Play several suites that are drawn by the rules of one.

    Args:
        policy: a name as for `clutter-env evaluate`.
        suite: name of a suite.
        suites: how many are drawn.
        scenes: of each.
        workers: number of processes.
        tick: called after every episode.
        first_seeds: from which the seeds of each are tried.

    Raises:
        SuiteError: too few of the seeds qualify.
        PolicyError: the policy cannot play these scenes.
    """
    rates = []
    with TemporaryDirectory() as folder:
        for seed in first_seeds[:suites]:
            drawn = fresh_suite(suite, scenes, seed, Path(folder), workers)
            found = evaluate(policy, drawn, workers=workers, tick=tick)
            rates.append(found.num_clean / scenes)
    return Spread(policy, scenes, tuple(rates))
