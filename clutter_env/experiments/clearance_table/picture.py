"""The clearance table as a picture."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import LogLocator

from clutter_env.experiments.clearance_table.paper import PAPER, PAPER_OBJECTS
from clutter_env.experiments.clearance_table.statistics import Row, Shared
from clutter_env.experiments.clearance_table.table import Summary
from clutter_env.experiments.clearance_table.variants import ABLATIONS, ARMS
from clutter_env.reporting.intervals import Interval

__all__ = ["draw_table", "plot"]

COLOURS = {"lookahead": "#0072b2", "ngr": "#009e73", "dogar": "#cc79a7", "srivastava": "#d55e00"}
COLOURS |= dict(zip(ARMS, ("#56b4e9", "#e69f00", "#009e73"), strict=True))
COLOURS |= dict(zip(ABLATIONS, ("#56b4e9", "#e69f00", "#f0e442", "#999999"), strict=False))
"""Of the palette of Okabe & Ito (2008), which colour-blind readers can tell apart as well."""
GREY = "#777777"
_BESIDE = 0.16
"""Distance of neighbouring strategies, in steps between numbers of objects, so that no interval hides another one."""
_FLOOR = 0.36
"""Half the length of the black line that marks the floor, in the same steps."""


def plot(summary: Summary, path: Path) -> None:
    """Write the picture to a file."""
    path.parent.mkdir(parents=True, exist_ok=True)
    draw_table(summary).savefig(path, dpi=130)


def draw_table(summary: Summary) -> Figure:
    """Success and planning time of all scenes; clearances and the floor of the scenes that every strategy solves."""
    figure = Figure(figsize=(11, 7.6), layout="constrained")
    success, clearances, duplicated, seconds = figure.subplots(2, 2).flat
    objects = sorted({row.objects for row in summary.rows})
    strategies = list(dict.fromkeys(row.strategy for row in summary.rows))
    for strategy in strategies:
        rows = [row for row in summary.rows if row.strategy == strategy]
        shared = [entry for entry in summary.shared if entry.strategy == strategy]
        shift = _BESIDE * (strategies.index(strategy) - (len(strategies) - 1) / 2)
        _points(success, objects, rows, [row.success for row in rows], shift)
        _points(clearances, objects, shared, [entry.clearances for entry in shared], shift)
        _points(duplicated, objects, shared, [entry.duplicated for entry in shared], shift)
        times = [Interval(row.total.median, row.total.median, row.total.p95) for row in rows]
        _points(seconds, objects, rows, times, shift)
    _mark_floors(clearances, objects, summary.shared)
    _paper_lines(clearances, objects, "clearances")
    _paper_lines(duplicated, objects, "duplicated")
    success.set(title="Share of scenes solved\nand its 95% interval", ylim=(-0.02, 1.04))
    clearances.set(title="Objects cleared\nscenes that every strategy solves", ylim=(0, None))
    duplicated.set(title="Objects cleared twice or more\nscenes that every strategy solves")
    seconds.set(title="CPU time of a solve [s]\nmedian, and line to the 95th percentile", yscale="log")
    seconds.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    seconds.yaxis.set_major_formatter("{x:g}")
    seconds.yaxis.set_minor_formatter("")
    counts = {entry.objects: entry.scenes for entry in summary.shared}
    for axes in (success, clearances, duplicated, seconds):
        of_shared = axes in (clearances, duplicated)
        labels = [f"{number}\nscenes: {counts.get(number, 0)}" if of_shared else str(number) for number in objects]
        axes.set_xticks(range(len(objects)), labels)
        axes.set_xlabel("objects on the table")
        axes.grid(alpha=0.25, axis="y")
        axes.spines[["top", "right"]].set_visible(False)
    success.legend(loc="lower left", frameon=False)
    clearances.legend(handles=_paper_legend(), loc="upper left", frameon=False, fontsize="small")
    return figure


def _points(
    axes: Axes, objects: Sequence[int], own: Sequence[Row | Shared], values: Sequence[Interval], shift: float
) -> None:
    """One strategy: a point and its interval for every number of objects that has one."""
    if not own:
        return
    name = own[0].strategy
    mean, low, high = np.array(values).T
    at = [objects.index(entry.objects) + shift for entry in own]
    colour, reach = COLOURS.get(name, GREY), np.maximum([mean - low, high - mean], 0.0)
    axes.errorbar(at, mean, reach, label=name, fmt="o", markersize=5, capsize=2.5, elinewidth=1.4, color=colour)


def _mark_floors(axes: Axes, objects: Sequence[int], shared: Sequence[Shared]) -> None:
    """A black line at the mean floor of the scenes whose clearances are drawn."""
    for entry in {entry.objects: entry for entry in shared}.values():
        at = objects.index(entry.objects)
        axes.plot([at - _FLOOR, at + _FLOOR], [entry.floor] * 2, color="black", linewidth=1.4, zorder=1, gid="floor")


def _paper_lines(axes: Axes, objects: Sequence[int], figure: str) -> None:
    """Table 1 of the paper, of other scenes, for the numbers of objects that both have."""
    for name, values in PAPER[figure].items():
        known = [(objects.index(n), value) for n, value in zip(PAPER_OBJECTS, values, strict=True) if n in objects]
        if known:
            axes.plot(*zip(*known, strict=True), color=COLOURS[name], linestyle="--", linewidth=1, alpha=0.6, zorder=0)


def _paper_legend() -> list[Line2D]:
    lines = [Line2D([], [], color="black", linewidth=1.4, label="floor (minimum) of the same scenes")]
    for name, said in (("srivastava", "Srivastava"), ("ngr", "NGR")):
        label = f"{said} in the paper (other scenes)"
        lines.append(Line2D([], [], color=COLOURS[name], linestyle="--", linewidth=1, alpha=0.6, label=label))
    return lines
