"""Policies of two levels from training runs: learned decisions, learned motions, or both."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from clutter_env.learning.comparison.learned_policies import planned_decisions
from clutter_env.learning.contacts.hierarchical import HierarchicalPolicy
from clutter_env.learning.contacts.planned_mover import PlannedMover
from clutter_env.learning.contacts.protocols import Mover
from clutter_env.learning.decisions.decider import LearnedDecider
from clutter_env.learning.errors import LearningError
from clutter_env.learning.policies.movers import load_mover
from clutter_env.learning.policies.runs import (
    DECISION_LEARNERS,
    DECISIONS_FILE,
    MOVER_FILE,
    MOVER_LEARNERS,
    load_run,
)

__all__ = ["two_level_policy"]


def two_level_policy(directories: Sequence[Path]) -> HierarchicalPolicy:
    """The policy of a run that learned decisions, of one that learned motions, or of both.

    Learned decisions alone are brought about by the planner's motions; learned motions alone bring about the decisions
    of the canonical expert, with the grasps that were learned.

    Raises:
        LearningError: another combination of runs.
    """
    runs = [(str(load_run(directory)["algorithm"]), directory) for directory in directories]
    deciders = [directory for algorithm, directory in runs if algorithm in DECISION_LEARNERS]
    movers = [(algorithm, directory) for algorithm, directory in runs if algorithm in MOVER_LEARNERS]
    if len(deciders) > 1 or len(movers) > 1 or len(deciders) + len(movers) != len(runs):
        names = " and ".join(algorithm for algorithm, _ in runs)
        raise LearningError(
            f"runs of {names} are no policy of two levels; join one of {', '.join(DECISION_LEARNERS)} and one of "
            f"{', '.join(MOVER_LEARNERS)}"
        )
    mover = _mover(*movers[0]) if movers else PlannedMover()
    grasps = str(load_run(deciders[0] if deciders else movers[0][1])["settings"]["grasps"])
    if not deciders:
        return planned_decisions(mover, grasps)
    decider = LearnedDecider.load(deciders[0] / DECISIONS_FILE)
    return HierarchicalPolicy(decider, mover, "side" if grasps == "side" else "all")


def _mover(algorithm: str, directory: Path) -> Mover:
    return load_mover(algorithm, directory / MOVER_FILE)
