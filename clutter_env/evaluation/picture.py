"""The results of a comparison as a picture: one line per policy, one panel per measurement."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.transforms import ScaledTranslation

from clutter_env.evaluation.tables import STRATA, Row
from clutter_env.reporting.intervals import Interval

_LINE, _MARGIN = 0.42, 1.05
"""[inch] Height of a policy's line, and of title, axis and legend of a set of scenes."""
_TICKS = 0.2
"""[inch] Height of the numbers under an axis."""
_WIDTH = 11.0
"""[inch]"""
_WITHIN = 0.26
"""Largest distance of a mark from the middle of its line. Lines are 1 apart."""
_CLEAN, _LIFTED, _MOVED = "#1f6fb4", "#9a9a9a", "#444444"
_FLOOR_COLOURS = dict(zip(STRATA, ("#fdbe6f", "#f28e2b", "#d1495b", "#7b2d5b", "#000000", "#bbbbbb"), strict=True))


def plot(rows: Sequence[Row], path: Path) -> None:
    """Draw success, by lower bound too, and objects moved, with 95% intervals. Each set of scenes has a group of
    lines."""
    names = list(dict.fromkeys(row.scene_set for row in rows))
    groups = [[row for row in rows if row.scene_set == name] for name in names]
    heights = [_LINE * len(group) + _MARGIN for group in groups]
    figure = Figure(figsize=(_WIDTH, sum(heights) + 0.4), layout="constrained")
    panels = figure.subplots(
        len(groups), 3, squeeze=False, gridspec_kw={"height_ratios": heights, "width_ratios": (1.3, 1.3, 1.0)}
    )
    for (success, by_floor, moved), group in zip(panels, groups, strict=True):
        _draw(success, [row.lifted for row in group], 0.13, _LIFTED, "lifted", marker="o", hollow=True)
        _draw(success, [row.clean for row in group], -0.13, _CLEAN, "clean", marker="o")
        strata = [name for name in STRATA if any(name in row.by_floor for row in group)]
        for place, name in enumerate(strata):
            offset = 0.0 if len(strata) == 1 else _WITHIN * (2 * place / (len(strata) - 1) - 1)
            rates = [row.by_floor.get(name) for row in group]
            label = f"{name} ({max(rate.scenes for rate in rates if rate)} scenes)"
            shown = [rate and rate.clean for rate in rates]
            _draw(by_floor, shown, offset, _FLOOR_COLOURS[name], label, marker="s")
        _draw(moved, [row.moved_per_floor for row in group], 0.0, _MOVED, "", marker="D")
        moved.axvline(1.0, color="0.5", linewidth=1, linestyle=":")
        success.set(xlim=(-0.03, 1.03))
        by_floor.set(title="clean success, by lower bound", xlim=(-0.03, 1.03))
        moved.set(title="moved / lower bound, solved", xlim=(0, max(1.1, moved.get_xlim()[1])))
        for axes in (success, by_floor, moved):
            axes.set_ylim(len(group) - 0.5, -0.5)
            axes.set_yticks(range(len(group)), [row.policy for row in group] if axes is success else [])
            axes.grid(axis="x", alpha=0.3)
            axes.tick_params(axis="y", length=0)
            axes.title.set_fontsize(10)
            axes.tick_params(labelsize=9)
            for line in range(1, len(group)):
                axes.axhline(line - 0.5, color="0.9", linewidth=0.8, zorder=0)
            if axes is success or (axes is by_floor and strata):
                # What the marks are, below the panel: inside it hides intervals.
                under_ticks = axes.transAxes + ScaledTranslation(0, -_TICKS, figure.dpi_scale_trans)
                below: dict[str, Any] = {
                    "loc": "upper center",
                    "bbox_to_anchor": (0.5, 0),
                    "bbox_transform": under_ticks,
                }
                axes.legend(ncols=3, fontsize=8, frameon=False, columnspacing=1.0, **below)
        success.set_title(f"{group[0].scene_set}: success", fontsize=10, fontweight="bold")
    figure.savefig(path, dpi=120)


def _draw(
    axes: Any,
    values: Sequence[Interval | None],
    offset: float,
    colour: str,
    label: str,
    marker: str,
    hollow: bool = False,
) -> None:
    """Marks with intervals, one per line. A missing value has none."""
    shown = [(line + offset, *value) for line, value in enumerate(values) if value and not math.isnan(value.mean)]
    heights, means, low, high = np.array(shown).reshape(-1, 4).T
    axes.errorbar(
        means,
        heights,
        xerr=np.maximum((means - low, high - means), 0.0),
        fmt=marker,
        color=colour,
        markerfacecolor="white" if hollow else colour,
        markersize=5,
        capsize=2,
        label=label,
    )
