"""The results of a comparison as a Markdown table and as a plot over the number of objects."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from clutter_env.learning.comparison.evaluation import Score
from clutter_env.reporting.statistics import NO_INTERVAL, Interval, bootstrap, success_interval
from clutter_env.reporting.tables import markdown_table, number_text

__all__ = ["Row", "markdown", "plot", "summarise"]

OFFSET = 0.3
"""[objects] Horizontal distance between the points of two policies, so that none hides another."""


@dataclass(frozen=True)
class Row:
    """One policy on one set of scenes: means with 95% intervals.

    Attributes:
        scene_set: "o15", "reach", …; see `scene_set_name`.
        policy: its name.
        runs: number of training seeds.
        episodes: number of episodes of all runs.
        success: share of the episodes with (clean) success; see `success_interval`.
        lifted: share of the episodes whose target was lifted, whatever else moved; NaN for Reach and Pick.
        moved: number of objects moved, over the scenes that the policy solved.
        excess: `moved` minus the minimum number of clearances, over the solved scenes for which it is proved.
        steps: of the environment.
        sim_s: simulated time [s].
        wall_s: wall time [s].
        failures: causes of failure with their counts.
    """

    scene_set: str
    policy: str
    runs: int
    episodes: int
    success: Interval
    lifted: Interval
    moved: Interval
    excess: Interval
    steps: Interval
    sim_s: Interval
    wall_s: Interval
    failures: Mapping[str, int]


def summarise(
    scene_set: str, policy: str, runs: Sequence[Sequence[Score]], floors: Mapping[int, int | None], seed: int
) -> Row:
    """The row of one policy.

    Args:
        scene_set: name of the scenes.
        policy: name of the policy.
        runs: its scores, one sequence per training seed.
        floors: minimum number of clearances by seed of the scene, None where it is not proved.
        seed: of the bootstrap.
    """
    rng = np.random.default_rng(seed)
    solved = [[score for score in run if score.is_success] for run in runs]
    return Row(
        scene_set=scene_set,
        policy=policy,
        runs=len(runs),
        episodes=sum(len(run) for run in runs),
        success=success_interval([[score.is_success for score in run] for run in runs], rng),
        moved=bootstrap([[score.moved for score in run] for run in solved], rng),
        excess=bootstrap([_excess(run, floors) for run in solved], rng),
        steps=bootstrap([[score.steps for score in run] for run in runs], rng),
        sim_s=bootstrap([[score.sim_s for score in run] for run in runs], rng),
        wall_s=bootstrap([[score.wall_s for score in run] for run in runs], rng),
        lifted=_lifted(scene_set, runs, rng),
        failures=dict(Counter(score.failure for run in runs for score in run if not score.is_success)),
    )


def markdown(rows: Sequence[Row]) -> str:
    """The table. Steps are of the environment: skills where a policy acts by skills."""
    head = ["scenes", "policy", "runs × scenes", "clean success", "lifted", "moved", "moved - floor"]
    head += ["steps", "sim s", "wall s", "failures"]
    return markdown_table(head, [_cells(row) for row in rows])


def _cells(row: Row) -> list[str]:
    causes = ", ".join(f"{cause} {count}" for cause, count in Counter(row.failures).most_common())
    return [
        row.scene_set,
        row.policy,
        f"{row.runs} × {row.episodes // max(row.runs, 1)}",
        str(row.success),
        str(row.lifted),
        str(row.moved),
        str(row.excess),
        number_text(row.steps.mean, "{:.0f}"),
        number_text(row.sim_s.mean, "{:.1f}"),
        number_text(row.wall_s.mean, "{:.1f}"),
        causes or "none",
    ]


def plot(rows: Sequence[Row], path: Path) -> None:
    """Draw success and objects moved over the number of objects, with intervals; other sets of scenes are left out."""
    counted = [row for row in rows if row.scene_set.startswith("o") and row.scene_set[1:].isdigit()]
    if not counted:
        return
    figure = Figure(figsize=(10, 4.4), layout="constrained")
    panels = figure.subplots(1, 2)
    policies = list(dict.fromkeys(row.policy for row in counted))
    for index, policy in enumerate(policies):
        own = [row for row in counted if row.policy == policy]
        numbers = np.array([int(row.scene_set[1:]) for row in own]) + OFFSET * (index - (len(policies) - 1) / 2)
        _draw(panels[0], numbers, [row.success for row in own], policy, index)
        _draw(panels[1], numbers, [row.moved for row in own], policy, index)
    panels[0].set(title="clean success", ylim=(-0.03, 1.03))
    panels[1].set(title="objects moved, on solved scenes")
    panels[1].set_ylim(bottom=0)
    for axes in panels:
        axes.set_xlabel("objects on the table")
        axes.set_xticks(sorted({int(row.scene_set[1:]) for row in counted}))
        axes.grid(alpha=0.3)
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=5, fontsize=9)
    figure.savefig(path, dpi=120)


def _draw(axes: Any, numbers: NDArray[np.float64], values: Sequence[Interval], label: str, index: int) -> None:
    """Draw the points of one policy; there is none where it solved no scene."""
    means, low, high = (np.array(column) for column in zip(*values, strict=True))
    marker, colour = "osD^vPX"[index % 7], f"C{index % 10}"
    lengths = np.maximum((means - low, high - means), 0.0)
    axes.errorbar(numbers, means, yerr=lengths, marker=marker, color=colour, capsize=3, label=label)


def _lifted(scene_set: str, runs: Sequence[Sequence[Score]], rng: np.random.Generator) -> Interval:
    """The share of targets lifted; lifting is not the task in Reach and Pick."""
    if scene_set in ("reach", "pick"):
        return NO_INTERVAL
    return success_interval([[score.lifted for score in run] for run in runs], rng)


def _excess(run: Sequence[Score], floors: Mapping[int, int | None]) -> list[float]:
    known = [(score.moved, floors.get(score.seed)) for score in run]
    return [moved - floor for moved, floor in known if floor is not None]
