"""The speed of the environments as a figure."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from clutter_env.experiments.environments.speed import SpeedMeasurement

__all__ = ["plot_speed"]

_PANELS = {
    "steps_per_s": "control steps per CPU second",
    "reset_median_ms": "median reset [ms]",
    "frames_per_s": "480 × 480 images per second",
    "memory_mb": "peak memory [MB]",
}


def plot_speed(rows: list[SpeedMeasurement], file: Path) -> None:
    """Four panels over the number of objects; missing directories are made."""
    figure = Figure(figsize=(9, 6), layout="constrained")
    for axis, (name, title) in zip(figure.subplots(2, 2).ravel(), _PANELS.items(), strict=True):
        values = [getattr(row, name) for row in rows]
        axis.plot([row.objects for row in rows], [np.nan if value is None else value for value in values], "o-")
        axis.set(title=title, xlabel="objects")
        axis.set_ylim(0, 1.08 * max(axis.get_ylim()[1], 1e-9))
        axis.grid(alpha=0.3)
    file.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(file, dpi=120)
