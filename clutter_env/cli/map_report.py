"""Build the reachability map of a robot, save it, draw slices through it, and report its size and quality."""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from assets import RobotSpec
from clutter_env.reporting.progress import progress_bar
from irm import ArmChain, MapParameters, ReachabilityMap, link_origins

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class MapReport:
    """A map that was built.

    Attributes:
        robot: its name.
        poses: reachable cells.
        voxels: positions that are reachable in at least one orientation.
        mean_reachability_index: mean D of these voxels (equation 1) [%].
        best_manipulability: largest μ of the map (equation 2).
        build_s: CPU time [s].
        megabytes: size of the file.
        file, picture: where the map is, and the slices through it.
    """

    robot: str
    poses: int
    voxels: int
    mean_reachability_index: float
    best_manipulability: float
    build_s: float
    megabytes: float
    file: str
    picture: str

    def __str__(self) -> str:
        """One line for each attribute."""
        values = {name: f"{value:.4g}" if isinstance(value, float) else value for name, value in asdict(self).items()}
        return "\n".join(f"{name:>24}: {value}" for name, value in values.items())


def build_map(robot: RobotSpec | ArmChain, parameters: MapParameters, output: Path) -> MapReport:
    """Build a map with a progress bar, save it to one file, and draw slices through it into a picture beside it.

    Raises:
        ReachabilityError: the robot or the parameters make no sense.
    """
    start = time.process_time()
    rm = ReachabilityMap.build(robot, progress=progress_bar, **asdict(parameters))
    seconds = time.process_time() - start
    rm.save(output)
    picture = output.with_suffix(".png")
    draw_arm_map(rm).savefig(picture, dpi=90)
    index = rm.reachability_index
    return MapReport(
        robot=rm.robot,
        poses=len(rm),
        voxels=int(np.count_nonzero(index)),
        mean_reachability_index=float(index[index > 0].mean()) if len(rm) else 0.0,
        best_manipulability=float(rm.manipulability.max(initial=0.0)),
        build_s=seconds,
        megabytes=output.stat().st_size / 1e6,
        file=str(output),
        picture=str(picture),
    )


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
            axis.plot(
                *link_origins(rm.chain, (rm.chain.lower + rm.chain.upper) / 2)[1:, columns].T,
                color="black",
                marker="o",
                markersize=3,
                linewidth=1.5,
            )
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
