"""The results of a comparison as Markdown tables."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from clutter_env.evaluation.score import Score
from clutter_env.reporting.intervals import NO_INTERVAL, Interval, bootstrap, success_interval
from clutter_env.reporting.tables import NOTHING, markdown_table, number_text
from clutter_env.suites import Floor

STRATA = ("0", "1", "2", "3 or more", "none", "unproved")
"""Minimum numbers of clearances; "none": there is no plan; "unproved": only an upper bound is known."""


def stratum(floor: Floor) -> str:
    """The stratum of a scene with that minimum number of clearances."""
    if not floor.is_proved:
        return "unproved"
    return "none" if floor.count is None else STRATA[min(floor.count, 3)]


class StratumRate(NamedTuple):
    """Clean success on the scenes with one minimum number of clearances: number of scenes, and rate."""

    scenes: int
    clean: Interval


@dataclass(frozen=True)
class Row:
    """One policy on one set of scenes: means with 95% intervals.

    Attributes:
        scene_set: name of the scenes; see `SceneSet.name`.
        policy: its name.
        runs: number of training seeds.
        episodes: number of episodes of all runs.
        clean: share of the episodes with success; see `Score.clean` and `success_interval`.
        lifted: share of the episodes whose target was lifted, whatever else moved; NaN for Reach and Pick.
        by_floor: clean success by stratum, see `STRATA`; empty where no minimum numbers are known.
        moved_per_floor: number of objects moved, divided by the minimum number of clearances, over the scenes that the
            policy solved and whose proved minimum is at least 1.
        disturbed, fallen: numbers of objects, over all episodes.
        refused: number of skills refused by the motion layer, over all episodes.
        steps: of the environment.
        sim_s: simulated time [s].
        wall_s: wall time [s].
        failures: causes of failure with their counts.
    """

    scene_set: str
    policy: str
    runs: int
    episodes: int
    clean: Interval
    lifted: Interval
    by_floor: Mapping[str, StratumRate]
    moved_per_floor: Interval
    disturbed: Interval
    fallen: Interval
    refused: Interval
    steps: Interval
    sim_s: Interval
    wall_s: Interval
    failures: Mapping[str, int]


def summarise(
    scene_set: str, policy: str, runs: Sequence[Sequence[Score]], floors: Mapping[int, Floor], seed: int
) -> Row:
    """The row of one policy.

    Args:
        scene_set: name of the scenes.
        policy: name of the policy.
        runs: its scores, one sequence per training seed, all of the same scenes in the same order.
        floors: minimum number of clearances by seed of the scene, as far as known.
        seed: of the bootstrap.
    """
    rng = np.random.default_rng(seed)

    def mean(name: str) -> Interval:
        """Of one attribute of the scores, over all episodes."""
        return bootstrap([[float(getattr(score, name)) for score in run] for run in runs], rng)

    return Row(
        scene_set=scene_set,
        policy=policy,
        runs=len(runs),
        episodes=sum(len(run) for run in runs),
        clean=_rate(runs, "clean", rng),
        lifted=NO_INTERVAL if scene_set in ("reach", "pick") else _rate(runs, "lifted", rng),
        by_floor=_by_floor(runs, floors, rng),
        moved_per_floor=bootstrap([_moved_per_floor(run, floors) for run in runs], rng),
        disturbed=mean("disturbed"),
        fallen=mean("fallen"),
        refused=mean("refused"),
        steps=mean("steps"),
        sim_s=mean("sim_s"),
        wall_s=mean("wall_s"),
        failures=dict(Counter(score.failure for run in runs for score in run if not score.clean)),
    )


def markdown(rows: Sequence[Row]) -> str:
    """The main table. Steps are of the environment: skills where a policy acts by skills."""
    head = [
        "scenes",
        "policy",
        "runs × scenes",
        "clean success",
        "lifted",
        "moved / lower bound",
        "disturbed",
        "fallen",
    ]
    head += ["refused", "steps", "sim s", "wall s", "failures"]
    return markdown_table(head, [_cells(row) for row in rows])


def markdown_by_floor(rows: Sequence[Row]) -> str:
    """Clean success by the minimum number of clearances, with the number of scenes; "" where none are known."""
    known = [row for row in rows if row.by_floor]
    strata = [name for name in STRATA if any(name in row.by_floor for row in known)]
    if not known:
        return ""
    cells = [
        [
            row.scene_set,
            row.policy,
            *(f"{row.by_floor[n].clean} of {row.by_floor[n].scenes}" if n in row.by_floor else NOTHING for n in strata),
        ]
        for row in known
    ]
    return markdown_table(["scenes", "policy", *(f"lower bound {name}" for name in strata)], cells)


def _cells(row: Row) -> list[str]:
    causes = ", ".join(f"{cause} {count}" for cause, count in Counter(row.failures).most_common())
    return [
        row.scene_set,
        row.policy,
        f"{row.runs} × {row.episodes // max(row.runs, 1)}",
        str(row.clean),
        str(row.lifted),
        str(row.moved_per_floor),
        number_text(row.disturbed.mean),
        number_text(row.fallen.mean),
        number_text(row.refused.mean),
        number_text(row.steps.mean, "{:.0f}"),
        number_text(row.sim_s.mean, "{:.1f}"),
        number_text(row.wall_s.mean, "{:.1f}"),
        causes or "none",
    ]


def _rate(runs: Sequence[Sequence[Score]], name: str, rng: np.random.Generator) -> Interval:
    return success_interval([[bool(getattr(score, name)) for score in run] for run in runs], rng)


def _by_floor(
    runs: Sequence[Sequence[Score]], floors: Mapping[int, Floor], rng: np.random.Generator
) -> dict[str, StratumRate]:
    found = {}
    for name in STRATA:
        seeds = {seed for seed, floor in floors.items() if stratum(floor) == name}
        own = [[score for score in run if score.seed in seeds] for run in runs]
        if scenes := max(map(len, own), default=0):
            found[name] = StratumRate(scenes, _rate(own, "clean", rng))
    return found


def _moved_per_floor(run: Sequence[Score], floors: Mapping[int, Floor]) -> list[float]:
    """The quotient on every scene; NaN where it was not solved, or no minimum of at least 1 is proved."""
    known = {seed: floor.count for seed, floor in floors.items() if floor.is_proved and floor.count}
    return [score.moved / known[score.seed] if score.clean and score.seed in known else math.nan for score in run]
