"""Slices through the map of any arm: the reachability index beside and above it, and the best manipulability."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from irm.chain import ArmChain
from irm.kinematics import fk_frames
from irm.reachability_map import ReachabilityMap

__all__ = ["best_manipulability", "draw_arm_map", "draw_slice"]

Floats = NDArray[np.float64]


def draw_arm_map(rm: ReachabilityMap, colours: str = "turbo_r") -> Figure:
    """D in the plane through the first joint's axis, and D and best μ in the layer with most poses.

    The black line is the arm: the origins of its joints with every joint in the middle of its limits.
    """
    grid = rm.grid
    layer = int(np.bincount(rm.indices()[0], minlength=grid.layers).argmax())
    x, y, z = grid.edges(0), grid.edges(1), grid.z_edges()
    share, at = "reachability index D [%]", f"at z = {grid.layer_height(layer):.3f} m"
    index = rm.reachability_index
    figure = Figure(figsize=(13.6, 4.2), layout="constrained")
    side, top, best = figure.subplots(1, 3)
    draw_slice(
        side,
        (x, z),
        index[:, :, grid.half],
        ("viridis", share, f"{rm.robot}: D in the plane y = {grid.centre[1]:.3f} m"),
    )
    draw_slice(top, (x, y), index[layer].T, ("viridis", share, f"D {at}"))
    draw_slice(best, (x, y), best_manipulability(rm, layer).T, (colours, "best manipulability μ", f"best μ {at}"))
    for axis, label, columns in ((side, "z [m]", (0, 2)), (top, "y [m]", (0, 1)), (best, "y [m]", (0, 1))):
        if rm.chain is not None:
            axis.plot(*_joint_origins(rm.chain)[:, columns].T, color="black", marker="o", markersize=3, linewidth=1.5)
        axis.set(aspect="equal", xlabel="x [m]", ylabel=label)
    return figure


def draw_slice(axis: Axes, edges: tuple[Floats, Floats], values: NDArray[Any], words: tuple[str, str, str]) -> None:
    """One slice with its colour bar; `words`: colours, label of the bar, title."""
    colours, label, title = words
    mesh = axis.pcolormesh(*edges, np.where(values > 0, values, np.nan), cmap=colours)
    axis.figure.colorbar(mesh, ax=axis, label=label, shrink=0.9, aspect=22)
    axis.set(title=title, facecolor="#f4f4f6")


def best_manipulability(rm: ReachabilityMap, layer: int) -> Floats:
    """(x, y) best μ over the orientations, NaN where there is none."""
    z, _, i, j = rm.indices()
    mine = z == layer
    best = np.zeros(rm.grid.shape[2:])
    np.maximum.at(best, (i[mine], j[mine]), rm.manipulability[mine])
    return np.where(best > 0, best, np.nan)


def _joint_origins(chain: ArmChain) -> Floats:
    """(n + 1, 3) origins of the arm's joints and TCP with every joint in the middle of its limits [m]."""
    R, p = np.empty((chain.size + 1, 3, 3)), np.empty((chain.size + 1, 3))
    fk_frames(chain.offsets, chain.axes, chain.tip, (chain.lower + chain.upper) / 2, R, p)
    return p[1:]
