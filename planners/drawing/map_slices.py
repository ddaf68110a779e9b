"""Slices of a reachability map at some heights: the reachable share of each voxel, or its quality."""

from __future__ import annotations

import math
import numbers
from collections.abc import Sequence
from typing import Literal

import numpy as np
from matplotlib.figure import Figure

from irm import ReachabilityError, ReachabilityMap

_SAME_PITCH = 1e-6
"""Tolerance [rad] of a pitch."""


def plot_slices(
    rm: ReachabilityMap,
    heights: Sequence[float] = (),
    *,
    value: Literal["index", "mu"] = "index",
    pitch: float | None = None,
) -> Figure:
    """Draw a figure with one picture for each height, the robot's base at its origin, x ahead to the right.

    Args:
        rm: the map.
        heights: heights [m] of the TCP. Default: four, evenly over the map. Each is shown by the layer around it.
        value: "index": D of equation 1, the share of reachable orientations [%]. "mu": the best μ of equation 2.
        pitch: pitch [rad] of the gripper, one of the map's. Default: all of them.

    Raises:
        ReachabilityError: heights are no numbers or outside the map, or the map lacks the pitch. The message lists the
            map's values.

    Example:
        plot_slices(cached_map(FETCH), [0.6, 0.8, 1.0], value="mu", pitch=0.0).savefig("slices.png")
    """
    grid, angles = rm.grid, rm.grid.orientations.angles
    top = grid.bottom + grid.layers * grid.thickness
    if np.ndim(heights) != 1 or not all(isinstance(height, numbers.Real) for height in heights):
        raise ReachabilityError(f"heights={heights!r} must be a sequence of numbers [m]")
    wanted = list(heights) or [grid.bottom + (top - grid.bottom) * (k + 1) / 5 for k in range(4)]
    if not all(grid.bottom <= height < top for height in wanted):
        raise ReachabilityError(f"heights={wanted}: the map reaches from {grid.bottom:.2f} to {top:.2f} m")
    layers = [min(grid.layers - 1, math.floor((height - grid.bottom) / grid.thickness)) for height in wanted]
    if value not in ("index", "mu"):
        raise ReachabilityError(f"value={value!r}; valid: 'index', 'mu'")
    shown = np.full(len(angles), True) if pitch is None else np.abs(angles[:, 1] - pitch) < _SAME_PITCH
    if not shown.any():
        known = ", ".join(f"{ring:.3f}" for ring in np.unique(angles[:, 1]))
        raise ReachabilityError(f"pitch={pitch!r} is none of the map's, which are {known} rad")
    z, orientation, x, y = rm.indices()
    mu, best = rm.manipulability, np.zeros((grid.layers, 2 * grid.half, 2 * grid.half))
    free = shown[orientation] & (mu > 0)
    if value == "mu":
        np.maximum.at(best, (z[free], x[free], y[free]), mu[free])
    else:
        np.add.at(best, (z[free], x[free], y[free]), 100.0 / np.count_nonzero(shown))
    figure = Figure(figsize=(3.2 * len(layers) + 0.9, 3.6), layout="constrained")
    axes = figure.subplots(1, len(layers), squeeze=False)[0]
    (cx, cy), half = grid.centre, grid.half * grid.voxel
    highest = float(best[layers].max()) or 1.0
    for axis, layer in zip(axes, layers, strict=True):
        picture = axis.imshow(
            np.ma.masked_equal(best[layer].T, 0.0),
            origin="lower",
            extent=(cx - half, cx + half, cy - half, cy + half),
            cmap="viridis",
            vmin=0.0,
            vmax=highest,
        )
        axis.plot(0.0, 0.0, "r+", markersize=10)
        axis.set(title=f"z = {grid.bottom + (layer + 0.5) * grid.thickness:.2f} m", xlabel="x [m]")
    axes[0].set_ylabel("y [m]")
    label = "best μ" if value == "mu" else "share of orientations in reach [%]"
    figure.colorbar(picture, ax=list(axes), label=label, shrink=0.8)
    return figure
