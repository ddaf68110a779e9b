"""The rows of a comparison, as Markdown tables, and the results file of one evaluation."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, NamedTuple

import numpy as np

from clutter_env import GOAL_FAMILIES
from clutter_env.evaluation.evaluate import Evaluation
from clutter_env.evaluation.score import Score
from clutter_env.reporting.intervals import NO_INTERVAL, Interval, bootstrap, success_interval
from clutter_env.reporting.tables import NOTHING, markdown_table, number_text
from clutter_env.suites import Floor, content_digest, suite

FORMAT = 7
"""Version of the results file."""
STRATA = ("0", "1", "2", "3 or more", "none", "not proved")
"""Lower bounds. "none": there is no plan. "not proved": fewer clearances than the bound may do."""


def stratum(floor: Floor) -> str:
    """The stratum of a scene with that lower bound."""
    if not floor.is_proved:
        return "not proved"
    return "none" if floor.count is None else STRATA[min(floor.count, 3)]


class StratumRate(NamedTuple):
    """Clean success on the scenes with one lower bound: number of scenes, and rate."""

    scenes: int
    clean: Interval


@dataclass(frozen=True)
class Row:
    """One policy on one set of scenes: means with 95% intervals.

    Attributes:
        scene_set: name of the scenes. See `SceneSet.name`.
        policy: its name.
        track: "observations", "privileged" or "human". See `clutter_env.policies.protocol`.
        runs: number of training seeds.
        episodes: number of episodes of all runs.
        clean: share of the episodes with success. See `Score.clean` and `success_interval`.
        lifted: share of the episodes whose target was lifted, whatever else moved. NaN for Reach and Pick.
        by_floor: clean success by stratum, see `STRATA`. Empty if no lower bounds are known.
        moved_per_floor: number of objects moved and of drawers and doors opened, divided by the lower bound, which
            counts both. Over the solved scenes whose lower bound is proved and at least 1. NaN for Rearrange.
        moved, cleared, disturbed, fallen: numbers of objects, over all episodes.
        furniture_force, self_force: the robot's largest mean force over 0.1 s in an episode, on the furniture, and on
            itself and the ground [N], over all episodes.
        total_path: moved by all objects that need not move for the goal, while not carried [m], over all episodes.
        refused: number of skills refused by the motion layer, over all episodes.
        steps: of the environment.
        sim_s: simulated time [s].
        wall_s: wall time [s].
        failures: causes of failure with their counts.
    """

    scene_set: str
    policy: str
    track: str
    runs: int
    episodes: int
    clean: Interval
    lifted: Interval
    by_floor: Mapping[str, StratumRate]
    moved_per_floor: Interval
    moved: Interval
    cleared: Interval
    disturbed: Interval
    fallen: Interval
    furniture_force: Interval
    self_force: Interval
    total_path: Interval
    refused: Interval
    steps: Interval
    sim_s: Interval
    wall_s: Interval
    failures: Mapping[str, int]


_MEANS = (
    "moved",
    "cleared",
    "disturbed",
    "fallen",
    "furniture_force",
    "self_force",
    "total_path",
    "refused",
    "steps",
    "sim_s",
    "wall_s",
)


def summarise(policy: str, evaluations: Sequence[Evaluation], seed: int = 0) -> Row:
    """The row of one policy.

    Args:
        policy: its name.
        evaluations: one per training seed, all of the same scenes.
        seed: of the bootstrap.
    """
    rng = np.random.default_rng(seed)
    scenes, floors = evaluations[0].scenes.name, evaluations[0].floors
    is_rearrange = evaluations[0].scenes.family == "rearrange"  # what is moved there is above all what the goal names
    runs = [evaluation.scores for evaluation in evaluations]
    return Row(
        scene_set=scenes,
        policy=policy,
        track=evaluations[0].traits.track,
        runs=len(runs),
        episodes=sum(map(len, runs)),
        clean=_rate(runs, "clean", rng),
        lifted=NO_INTERVAL if scenes in GOAL_FAMILIES else _rate(runs, "lifted", rng),
        by_floor=_by_floor(runs, floors, rng),
        moved_per_floor=bootstrap([_moved_per_floor(run, () if is_rearrange else floors) for run in runs], rng),
        **{name: bootstrap([[getattr(score, name) for score in run] for run in runs], rng) for name in _MEANS},
        failures=dict(Counter(score.failure for run in runs for score in run if not score.clean).most_common()),
    )


def results(evaluation: Evaluation) -> dict[str, Any]:
    """The content of the results file of one policy on one set of scenes.

    `digest` covers the scenes, the policy's name and files, the environment, the actions and the scores, but no wall
    times: equal digests mean equal results. `clutter_env.evaluation.verify` plays the recordings again.
    """
    scenes, episodes = evaluation.scenes, evaluation.episodes
    counts = [floor.count for floor in evaluation.floors] or [None] * len(episodes)
    played = {
        "scenes": scenes.name,
        "suite": scenes.suite,
        "suite_sha256": suite(scenes.suite).digest if scenes.suite else "",
        "split": scenes.split,
        "policy": evaluation.policy,
        "track": evaluation.traits.track,
        "weights": evaluation.weights,
        "seed": evaluation.seed,
        "feasibility": evaluation.feasibility,
        "grasps": evaluation.traits.grasps,
        "environment": evaluation.provenance["environment"],
        "judged_in": evaluation.judged_in,
        "env_id": scenes.env_id,
        "obstructed": scenes.obstructed,
        "layout": scenes.layout,
        "objects": scenes.objects,
        **({"task": scenes.task} if scenes.task else {}),
        "first_seed": scenes.first_seed,
        "episodes": [
            {
                "index": index,
                "floor": count,
                "actions": played.recording.digest if played.recording else "",
                **{name: value for name, value in asdict(played.score).items() if name != "wall_s"},
            }
            for index, (played, count) in enumerate(zip(episodes, counts, strict=True))
        ],
    }
    summary = vars(summarise(evaluation.policy, [evaluation]))
    return {
        "format": FORMAT,
        "provenance": evaluation.provenance,
        "digest": content_digest(played),
        "summary": {name: value for name, value in summary.items() if name != "wall_s"},
        "crashes": sum(episode.score.is_crash for episode in episodes),
        **played,
        "recordings": [None if played.recording is None else played.recording.to_json() for played in episodes],
    }


def markdown(rows: Sequence[Row]) -> str:
    """The main table. Steps are of the environment: skills where a policy acts by skills."""
    means = {
        "disturbed": 2,
        "fallen": 2,
        "furniture_force": 0,
        "self_force": 0,
        "total_path": 3,
        "refused": 2,
        "steps": 0,
    }
    means |= {"sim_s": 1, "wall_s": 1}
    head = ["scenes", "policy", "track", "runs × scenes", "clean success", "lifted", "moved / lower bound"]
    head += [
        "disturbed",
        "fallen",
        "furniture N",
        "self N",
        "path m",
        "refused",
        "steps",
        "sim s",
        "wall s",
        "failures",
    ]
    cells = []
    for row in rows:
        played = f"{row.runs} × {row.episodes // max(row.runs, 1)}"
        rates = map(str, (row.clean, row.lifted, row.moved_per_floor))
        numbers = (number_text(getattr(row, name).mean, f"{{:.{digits}f}}") for name, digits in means.items())
        causes = ", ".join(f"{cause} {count}" for cause, count in Counter(row.failures).most_common())
        cells.append([row.scene_set, row.policy, row.track, played, *rates, *numbers, causes or "none"])
    return markdown_table(head, cells)


def markdown_short(row: Row) -> str:
    """The main figures of one policy on one set of scenes. `markdown` has all columns."""
    head = ["clean success", "lifted", "moved / lower bound", "sim s", "failures"]
    causes = ", ".join(f"{cause} {count}" for cause, count in Counter(row.failures).most_common())
    rates = map(str, (row.clean, row.lifted, row.moved_per_floor))
    return markdown_table(head, [[*rates, number_text(row.sim_s.mean, "{:.1f}"), causes or "none"]])


def markdown_by_floor(rows: Sequence[Row]) -> str:
    """Clean success by the lower bound, with the number of scenes. "" if none are known."""
    known = [row for row in rows if row.by_floor]
    strata = [name for name in STRATA if any(name in row.by_floor for row in known)]
    if not known:
        return ""

    def cell(rate: StratumRate | None) -> str:
        return NOTHING if rate is None else f"{rate.clean} of {rate.scenes}"

    cells = [[row.scene_set, row.policy, *(cell(row.by_floor.get(name)) for name in strata)] for row in known]
    return markdown_table(["scenes", "policy", *(f"lower bound {name}" for name in strata)], cells)


def _rate(runs: Sequence[Sequence[Score]], name: str, rng: np.random.Generator) -> Interval:
    return success_interval([[bool(getattr(score, name)) for score in run] for run in runs], rng)


def _by_floor(
    runs: Sequence[Sequence[Score]], floors: Sequence[Floor], rng: np.random.Generator
) -> dict[str, StratumRate]:
    found = {}
    for name in STRATA:
        chosen = [index for index, floor in enumerate(floors) if stratum(floor) == name]
        if chosen:
            found[name] = StratumRate(len(chosen), _rate([[run[k] for k in chosen] for run in runs], "clean", rng))
    return found


def _moved_per_floor(run: Sequence[Score], floors: Sequence[Floor]) -> list[float]:
    """(Objects moved + opened) / lower bound of every scene. NaN if it is unsolved, or no bound ≥ 1 is proved."""
    return [
        (score.moved + score.opened) / floor.count if score.clean and floor.is_proved and floor.count else math.nan
        for score, floor in zip(run, floors, strict=bool(floors))
    ]
