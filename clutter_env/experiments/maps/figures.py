"""Figures of a robot's maps, as Figs. 1 and 2 of the paper: the reachability map, both inverse maps, and base poses.

Blue is high manipulability and red is low, as in the paper.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from numpy.typing import NDArray

from assets.robots import RobotSpec
from clutter_env.experiments.maps.map_renderer import Arrows, MapRenderer, View
from clutter_env.experiments.maps.placement_figure import draw_placement
from clutter_env.experiments.maps.slices import best_manipulability, draw_slice
from irm.cache import cached_map
from irm.equations import inverse_reachability, inverse_reachability_on_floor
from irm.rotations import rotation
from irm.reachability_map import ReachabilityMap

Floats = NDArray[np.float64]

COLOURS = "turbo_r"
BLACK = np.array([0.05, 0.05, 0.05, 1.0])
COARSE: dict[str, Any] = {"voxel": 0.15, "orientations": 26}
"""The map of Fig. 1: coarse, so that the arrows do not hide each other."""
SLICE = 0.15
"""[m] Thickness of the slice of Fig. 1b."""
PANEL = (480, 440)
"""Size of one picture of Fig. 1 in pixels."""
SIDE, PIXELS = 2.4, 640
"""Edge of a slice [m], and in pixels."""


def draw_figures(robot: RobotSpec, folder: Path, cup: tuple[float, float], dpi: int) -> list[Path]:
    """Draw all figures of a robot's maps.

    Args:
        robot: whose maps.
        folder: where the pictures go; made if it is missing.
        cup: x, y of the cup on the table of the last figure, from its middle [m].
        dpi: resolution of the pictures.

    Returns:
        The files.

    Raises:
        ValueError: no base is valid for the cup.
    """
    folder.mkdir(parents=True, exist_ok=True)
    figures = {
        "irm_maps.png": draw_maps(robot),
        "irm_slices.png": draw_slices(robot),
        "irm_placement.png": draw_placement(robot, cup, COLOURS),
    }
    for name, figure in figures.items():
        figure.savefig(folder / name, dpi=dpi, pil_kwargs={"optimize": True})
    return [folder / name for name in figures]


def draw_maps(robot: RobotSpec) -> Figure:
    """Fig. 1: the reachability map, and its inverse by equation 4 and by equation 5."""
    rm = ReachabilityMap.build(robot, **COARSE)
    scale = Normalize(0, float(rm.manipulability.max()))
    colours = np.asarray(colormaps[COLOURS](scale(rm.manipulability)))
    home = np.array(robot.home)
    renderer = MapRenderer(robot, PANEL)
    far_half = rm.positions[:, 1] > 0
    p, R = rm.positions, _rotations(rm)
    tcps = Arrows(p[far_half], R[far_half, :, 0], colours[far_half], 0.10, 0.008)
    view = View((0.25, 0.3, 0.88), 3.5, 110.0, -18.0)
    pictures = [renderer.picture(np.zeros(3), home, view, [tcps])]
    for bases in (_bases_of_equation_4(rm, colours), _bases_of_equation_5(rm, colours)):
        pictures.append(renderer.picture(np.zeros(3), home, bases.view, bases.arrows, show_robot=False))
    renderer.close()
    return _panels(pictures, scale)


@dataclass(frozen=True)
class _Bases:
    """Arrows of an inverse map, and the view of its picture."""

    arrows: tuple[Arrows, ...]
    view: View


def _rotations(rm: ReachabilityMap) -> Floats:
    """(n, 3, 3) TCP orientation of every pose."""
    return np.array([rotation(*angles) for angles in rm.grid.orientations.angles])[rm.indices()[1]]


def _bases_of_equation_4(rm: ReachabilityMap, colours: Floats) -> _Bases:
    """T_base = T_eff⁻¹ around one TCP pose: a slice through it from the side, as most bases lean or are in the air."""
    R_base, place = inverse_reachability(_rotations(rm), rm.positions)
    sliced = np.abs(place[:, 1]) < SLICE / 2
    tcp = Arrows(np.zeros((1, 3)), np.eye(3)[:1], BLACK[None], 0.4, 0.03)
    bases = Arrows(place[sliced], R_base[sliced, :, 0], colours[sliced], 0.13, 0.011)
    low, high = bases.tails.min(axis=0), bases.tails.max(axis=0)
    view = View((*(low + high) / 2,), 5.0, 90.0, 0.0, float(1.1 * (high - low).max()))
    return _Bases((bases, tcp), view)


def _bases_of_equation_5(rm: ReachabilityMap, colours: Floats) -> _Bases:
    """T_base = Rz(-γ), Rz(π - γ) (x, y, 0) for the TCP R(0, β, α) at (0, 0, z); arrows of high μ are drawn on top."""
    x, y, z = rm.positions.T
    yaw, pitch, _ = rm.yaw_pitch_roll.T
    order = np.argsort(rm.manipulability)
    base_x, base_y, base_yaw = inverse_reachability_on_floor(x, y, yaw)
    lift = 0.02 + 0.02 * np.argsort(order) / len(order)
    place = np.column_stack([base_x, base_y, lift])
    ahead = np.column_stack([np.cos(base_yaw), np.sin(base_yaw), np.zeros(len(yaw))])
    keys = np.unique(np.column_stack([z, pitch]).round(6), axis=0)
    tails = np.column_stack([np.zeros((len(keys), 2)), keys[:, 0]])
    points = np.column_stack([np.cos(keys[:, 1]), np.zeros(len(keys)), -np.sin(keys[:, 1])])
    tcps = Arrows(tails, points, np.tile(BLACK, (len(keys), 1)), 0.12, 0.008)
    bases = Arrows(place, ahead, colours, 0.10, 0.008)
    return _Bases((bases, tcps), View((0.0, 0.0, 0.78), 3.4, 110.0, -28.0))


def _panels(pictures: list[NDArray[np.uint8]], scale: Normalize) -> Figure:
    titles = (
        "(a) reachability map (equation 3):\nTCP poses, the half on the robot's left",
        "(b) inverse map (equation 4): slice of the\nbases around one TCP pose (black), from the side",
        "(c) inverse map (equation 5):\nbases on the floor, TCP poses (black)",
    )
    figure = Figure(figsize=(13.2, 4.4), layout="constrained")
    axes = figure.subplots(1, len(pictures))
    for axis, picture, title in zip(axes, pictures, titles, strict=True):
        axis.imshow(picture)
        axis.set_title(title, fontsize=11)
        axis.set_axis_off()
    mu = ScalarMappable(scale, COLOURS)
    figure.colorbar(mu, ax=axes, label="manipulability μ (linear rows in m)", fraction=0.02, pad=0.01)
    return figure


def draw_slices(robot: RobotSpec) -> Figure:
    """Slices through the reachability map: D in a vertical plane, and D and best μ at the height of a table."""
    rm = cached_map(robot)
    renderer = MapRenderer(robot, (PIXELS, PIXELS))
    base, home, grid = np.zeros(3), np.array(robot.home), rm.grid
    x_middle, half = grid.centre[0], SIDE / 2
    robot_beside = renderer.picture(base, home, View((x_middle, 0, 0.95), 5, 90, 0, SIDE), show_floor=False)
    robot_below = renderer.picture(base, home, View((x_middle, 0, 0.95), 5, 90, -90, SIDE), show_floor=False)
    renderer.close()
    layer = grid.layer(_table_height(rm, robot))
    z, height = grid.layer_height(layer), (-0.25, 2.15)
    side, top = rm.reachability_index[:, :, grid.half], rm.reachability_index[layer]
    best = best_manipulability(rm, layer)
    figure = Figure(figsize=(13.6, 4.2), layout="constrained")
    axes = figure.subplots(1, 3)
    edges = grid.edges(0), grid.edges(1)
    share, title = "reachability index D [%]", f"D in the plane y = {grid.axis(1)[grid.half]:.3f} m"
    draw_slice(axes[0], (edges[0], grid.z_edges()), side, ("viridis", share, title))
    axes[0].set(ylabel="z [m]")
    axes[0].imshow(robot_beside, extent=(x_middle - half, x_middle + half, *height), zorder=3)
    axes[0].set(ylim=height)
    draw_slice(axes[1], edges, top.T, ("viridis", share, f"D at z = {z:.3f} m"))
    draw_slice(axes[2], edges, best.T, (COLOURS, "best manipulability μ", f"best μ at z = {z:.3f} m"))
    for axis in axes[1:]:
        axis.imshow(robot_below, extent=(x_middle - half, x_middle + half, -half, half), zorder=3, alpha=0.9)
        axis.set(ylim=(-half, half), ylabel="y [m]")
    for axis in axes:
        axis.set(xlim=(x_middle - half, x_middle + half), aspect="equal", xlabel="x [m]")
    return figure


def _table_height(rm: ReachabilityMap, robot: RobotSpec) -> float:
    """A TCP height above a table."""
    return min(rm.grid.top, 0.75 + robot.grasp_height)
