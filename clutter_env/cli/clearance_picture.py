"""The picture of a clearance table: success, planning time, clearances and the lower bound."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import LogLocator

from clutter_env.cli.clearance_tables import PAPER, PAPER_OBJECTS, Summary
from clutter_env.reporting.intervals import Interval

COLOURS = {"lookahead": "#0072b2", "ngr": "#009e73", "dogar": "#cc79a7", "srivastava": "#d55e00"}
OTHER_COLOURS = ("#56b4e9", "#e69f00", "#f0e442", "#999999")
"""Of the palette of Okabe & Ito (2008), which colour-blind readers can tell apart as well."""
_BESIDE = 0.16
"""Distance of neighbouring strategies, in steps between numbers of objects, so that no interval hides another one."""
_FLOOR = 0.36
"""Half the length of the black line that marks the lower bound, in the same steps."""


def draw(summary: Summary) -> Figure:
    """Success and planning time of all scenes. Clearances and lower bound of the scenes that every strategy solves."""
    figure = Figure(figsize=(12, 8), layout="constrained")
    success, clearances, duplicated, seconds = panels = figure.subplots(2, 2).ravel()
    objects = sorted({entry["objects"] for entry in summary["rows"]})
    strategies = list(dict.fromkeys(entry["strategy"] for entry in summary["rows"]))
    others = iter(OTHER_COLOURS)
    colours = {name: COLOURS.get(name) or next(others, "#777777") for name in strategies}
    for index, name in enumerate(strategies):
        rows = [entry for entry in summary["rows"] if entry["strategy"] == name]
        solve_times = [Interval(entry["total"].median, entry["total"].median, entry["total"].p95) for entry in rows]
        shift = _BESIDE * (index - (len(strategies) - 1) / 2)
        places = [objects.index(entry["objects"]) + shift for entry in rows]
        for axes, values in (
            (success, [entry["success"] for entry in rows]),
            (clearances, [entry["shared_clearances"] for entry in rows]),
            (duplicated, [entry["shared_duplicated"] for entry in rows]),
            (seconds, solve_times),
        ):
            mean, low, high = np.array(values).T
            reach, style = np.maximum([mean - low, high - mean], 0.0), {"markersize": 5, "elinewidth": 1.4}
            axes.errorbar(places, mean, reach, label=name, fmt="o", capsize=2.5, color=colours[name], **style)
    shared = {entry["objects"]: entry for entry in summary["rows"]}  # the same scenes for all strategies
    for at, number in enumerate(objects):
        ends, heights = [at - _FLOOR, at + _FLOOR], [shared[number]["shared_floor"].mean] * 2
        clearances.plot(ends, heights, color="black", linewidth=1.4, zorder=1, gid="floor")
    legend = [Line2D([], [], color="black", linewidth=1.4, label="lower bound of the same scenes")]
    dashed: dict[str, Any] = {"linestyle": "--", "linewidth": 1, "alpha": 0.6}
    for name, said in (("srivastava", "Srivastava"), ("ngr", "NGR")):
        legend.append(Line2D([], [], color=COLOURS[name], label=f"{said} in the paper (other scenes)", **dashed))
        for axes, figure_name in ((clearances, "clearances"), (duplicated, "duplicated")):
            printed = zip(PAPER_OBJECTS, PAPER[figure_name][name], strict=True)
            known = [(objects.index(n), value) for n, value in printed if n in objects]
            if known:
                axes.plot(*zip(*known, strict=True), color=COLOURS[name], zorder=0, **dashed)
    interval, which = "mean and its 95% interval", "scenes that every strategy solves"
    success.set(title="Scenes solved\nshare and its 95% interval", ylabel="share of scenes", ylim=(-0.02, 1.04))
    clearances.set(title=f"Objects cleared, {interval}\n{which}", ylabel="objects in a scene", ylim=(0, None))
    duplicated.set(title=f"Objects cleared twice or more, {interval}\n{which}", ylabel="objects in a scene")
    seconds.set(title="Time of a solve\nmedian, and line to the 95th percentile", ylabel="CPU time [s]", yscale="log")
    seconds.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    seconds.yaxis.set_major_formatter("{x:g}")
    seconds.yaxis.set_minor_formatter("")
    for axes in panels:
        counts = axes in (clearances, duplicated)
        labels = [f"{number}\nscenes: {shared[number]['shared']}" if counts else str(number) for number in objects]
        axes.set_xticks(range(len(labels)), labels)
        axes.set_xlabel("objects on the table")
        axes.grid(alpha=0.25, axis="y")
        axes.spines[["top", "right"]].set_visible(False)
    success.legend(loc="lower left", frameon=False)
    clearances.legend(handles=legend, loc="upper left", frameon=False, fontsize="small")
    return figure
