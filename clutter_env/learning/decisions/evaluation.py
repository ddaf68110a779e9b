"""How good decisions are without physics: on random scenes, against the minimum number of clearances."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from statistics import fmean
from typing import Any

import gymnasium as gym

from clutter_env.learning.decisions.examples import scene_of
from clutter_env.learning.decisions.kinematic import Chooser, KinematicOutcome, simulate_decisions
from planners import Planner, Scene

__all__ = ["DecisionScore", "evaluate_decisions", "score", "starts"]


@dataclass(frozen=True)
class DecisionScore:
    """Decisions in some scenes, without physics.

    Attributes:
        scenes: how many.
        taken: share in which the target is taken by free contacts alone.
        clearances: mean number of clearances where it is taken.
        floor: mean minimum number of clearances there; NaN if it was not computed.
        failures: how often each cause ended an episode, most frequent first.
    """

    scenes: int
    taken: float
    clearances: float
    floor: float
    failures: tuple[tuple[str, int], ...]


def starts(env: gym.Env[Any, Any], seeds: Sequence[int]) -> Iterator[tuple[Scene, str]]:
    """The scenes of some seeds, and the names of their targets."""
    for seed in seeds:
        _, info = env.reset(seed=seed)
        yield scene_of(env), str(info["target"])


def evaluate_decisions(
    chooser: Chooser, env: gym.Env[Any, Any], seeds: Sequence[int], planner: Planner | None = None
) -> DecisionScore:
    """Let a chooser act in the scenes of some seeds.

    Args:
        chooser: chooses the contacts.
        env: `clutter_env/Retrieve-…`.
        seeds: of the scenes.
        planner: for the minimum numbers of clearances; None to do without.
    """
    outcomes, floors = [], []
    for scene, target in starts(env, seeds):
        outcomes.append(simulate_decisions(chooser, scene, target))
        floors.append(None if planner is None else planner.clearance_floor(scene, target).count)
    return score(outcomes, floors)


def score(outcomes: Sequence[KinematicOutcome], floors: Sequence[int | None]) -> DecisionScore:
    """The score of episodes, with the minimum number of clearances of each."""
    taken = [(outcome.clearances, floor) for outcome, floor in zip(outcomes, floors, strict=True) if outcome.is_taken]
    known = [floor for _, floor in taken if floor is not None]
    failures = Counter(outcome.failure for outcome in outcomes if outcome.failure)
    return DecisionScore(
        scenes=len(outcomes),
        taken=len(taken) / max(len(outcomes), 1),
        clearances=fmean(clearances for clearances, _ in taken) if taken else math.nan,
        floor=fmean(known) if known else math.nan,
        failures=tuple(failures.most_common()),
    )
