"""The results of a comparison as a Markdown table and as a plot over the number of objects."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from clutter_env.learning.comparison.evaluation import Score
from clutter_env.reporting.statistics import Interval, bootstrap

__all__ = ["Row", "markdown", "plot", "summarise"]

BESIDE = 0.3
"""How far apart policies are drawn, in objects, so that none hides another."""


@dataclass(frozen=True)
class Row:
    """One policy in one scene_set: means with intervals; `moved` and `excess` over the scenes it solved.

    Attributes:
        scene_set: "o15", "reach", ….
        policy: its name.
        runs: training seeds.
        episodes: played in all.
        success: share of episodes.
        moved: objects moved.
        excess: objects moved beyond the floor.
        steps: of the environment.
        sim_s: [s].
        wall_s: [s].
        failures: causes with counts.
    """

    scene_set: str
    policy: str
    runs: int
    episodes: int
    success: Interval
    moved: Interval
    excess: Interval
    steps: Interval
    sim_s: Interval
    wall_s: Interval
    failures: Mapping[str, int]


def summarise(
    scene_set: str, policy: str, runs: Sequence[Sequence[Score]], floors: Mapping[int, int | None], seed: int
) -> Row:
    """The row of a policy's runs, one sequence of scores per training seed."""
    rng = np.random.default_rng(seed)
    solved = [[score for score in run if score.is_success] for run in runs]
    return Row(
        scene_set=scene_set,
        policy=policy,
        runs=len(runs),
        episodes=sum(len(run) for run in runs),
        success=bootstrap([[score.is_success for score in run] for run in runs], rng),
        moved=bootstrap([[score.moved for score in run] for run in solved], rng),
        excess=bootstrap([_excess(run, floors) for run in solved], rng),
        steps=bootstrap([[score.steps for score in run] for run in runs], rng),
        sim_s=bootstrap([[score.sim_s for score in run] for run in runs], rng),
        wall_s=bootstrap([[score.wall_s for score in run] for run in runs], rng),
        failures=dict(Counter(score.failure for run in runs for score in run if not score.is_success)),
    )


def markdown(rows: Sequence[Row]) -> str:
    """The table; intervals are 95%, steps are of the environment (skills where a policy acts by skills)."""
    head = (
        "scenes",
        "policy",
        "runs × scenes",
        "success",
        "moved",
        "moved - floor",
        "steps",
        "sim s",
        "wall s",
        "failures",
    )
    lines = [_line(head), _line(["---"] * len(head))]
    for row in rows:
        causes = ", ".join(f"{cause} {count}" for cause, count in Counter(row.failures).most_common())
        lines.append(
            _line(
                (
                    row.scene_set,
                    row.policy,
                    f"{row.runs} × {row.episodes // max(row.runs, 1)}",
                    str(row.success),
                    _text(row.moved),
                    _text(row.excess),
                    f"{row.steps.mean:.0f}",
                    f"{row.sim_s.mean:.1f}",
                    f"{row.wall_s.mean:.1f}",
                    causes or "-",
                )
            )
        )
    return "\n".join(lines) + "\n"


def plot(rows: Sequence[Row], path: Path) -> None:
    """Success and objects moved over the number of objects, with intervals; scene_sets without a number are left
    out."""
    counted = [row for row in rows if row.scene_set.startswith("o") and row.scene_set[1:].isdigit()]
    if not counted:
        return
    mpl.use("Agg")
    figure = Figure(figsize=(10, 4.4), layout="constrained")
    panels = figure.subplots(1, 2)
    policies = list(dict.fromkeys(row.policy for row in counted))
    for place, policy in enumerate(policies):
        own = [row for row in counted if row.policy == policy]
        numbers = np.array([int(row.scene_set[1:]) for row in own]) + BESIDE * (place - (len(policies) - 1) / 2)
        _draw(panels[0], numbers, [row.success for row in own], policy, place)
        _draw(panels[1], numbers, [row.moved for row in own], policy, place)
    panels[0].set(title="success", ylim=(-0.03, 1.03))
    panels[1].set(title="objects moved, on solved scenes")
    panels[1].set_ylim(bottom=0)
    for axes in panels:
        axes.set_xlabel("objects on the table")
        axes.set_xticks(sorted({int(row.scene_set[1:]) for row in counted}))
        axes.grid(alpha=0.3)
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=5, fontsize=9)
    figure.savefig(path, dpi=120)


def _draw(axes: Any, numbers: NDArray[np.float64], values: Sequence[Interval], label: str, place: int) -> None:
    """One policy's line; where it solved nothing, there is no point."""
    means, low, high = (np.array(column) for column in zip(*values, strict=True))
    marker, colour = "osD^vPX"[place % 7], f"C{place % 10}"
    axes.errorbar(
        numbers, means, yerr=np.stack((means - low, high - means)), marker=marker, color=colour, capsize=3, label=label
    )


def _excess(run: Sequence[Score], floors: Mapping[int, int | None]) -> list[float]:
    known = [(score.moved, floors.get(score.seed)) for score in run]
    return [moved - floor for moved, floor in known if floor is not None]


def _text(interval: Interval) -> str:
    return "-" if np.isnan(interval.mean) else str(interval)


def _line(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cells) + " |"
