"""Fig. 2 of the paper for a robot of ours: base poses for a cup far from the edge of a table."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Circle, FancyBboxPatch, Rectangle
from numpy.typing import NDArray

from assets.robots import RobotSpec
from clutter_env.experiments.maps.bases.base_quality import CollisionModel
from clutter_env.experiments.maps.map_renderer import Cup, MapRenderer, View
from clutter_env.scene.layout import TABLE_HEIGHT, Layout, furniture
from irm.chain import ArmChain
from irm.verification import Verified, tcp_poses, verify
from irm.free_space import FreeSpace
from irm.cache import cached_map
from irm.query_options import YAW_STEP
from irm.inverse_map import InverseReachabilityMap
from irm.inverse_table import base_turns, find_key, flat_key
from irm.placement import BasePlacement

__all__ = ["draw_placement"]

Floats = NDArray[np.float64]

TABLE = Layout("figure", depth=0.8, width=1.6, is_front_only=False)
GROWN = 0.3
"""[m] by which the table's outline is grown, as in the paper."""
REACH = 1.6
"""[m] of floor shown around the table's middle."""
SPACING = 0.06
"""[m] Edge of the squares of floor; of each, the best candidate is drawn."""
YAWS = (-np.pi / 2, np.pi / 2)
"""Approach yaws allowed: from the robot's side of the table."""
CUP_HALF_HEIGHT = 0.05
"""[m]"""
PURPLE = "#7b2cbf"
PIXELS = 900


def draw_placement(robot: RobotSpec, cup: tuple[float, float], colours: str) -> Figure:
    """From above: the candidate bases of one TCP pose and the best valid one; beside it, the robot at this base.

    Args:
        robot: any robot with a map.
        cup: x, y of the cup, from the middle of the table [m].
        colours: name of the colour map for μ.

    Raises:
        ValueError: no base is valid for this cup.
    """
    floor = FreeSpace.from_boxes([(0.0, 0.0, TABLE.depth, TABLE.width)], GROWN, (-REACH, -REACH, REACH, REACH))
    inverse_map = InverseReachabilityMap(cached_map(robot, orientations=266, pitches=(0.0,), heights=(0.7, 1.2)))
    tcp = np.array([*cup, TABLE_HEIGHT + robot.grasp_height])
    everywhere = _candidates(inverse_map, tcp)
    free = inverse_map.query(tcp, yaw_range=YAWS, free_space=floor, k=5)
    chosen = _verified(robot, free, tcp)
    place = Cup((*cup, TABLE_HEIGHT + CUP_HALF_HEIGHT), half_height=CUP_HALF_HEIGHT)
    renderer = MapRenderer(robot, (PIXELS, PIXELS), furniture(TABLE), place)
    above = View((0.0, 0.0, 1.0), 6.0, 90.0, -90.0, 2 * REACH)
    robot_above = renderer.picture(chosen.base, chosen.configurations[0], above, show_floor=False)
    beside = renderer.picture(chosen.base, chosen.configurations[0], View((-0.2, 0.1, 0.65), 3.2, 68.0, -28.0))
    renderer.close()
    figure = Figure(figsize=(13.0, 6.0), layout="constrained")
    plan, photograph = figure.subplots(1, 2, width_ratios=(1.15, 1.0))
    _draw_plan(plan, everywhere, floor, chosen, cup, robot_above, colours)
    photograph.imshow(beside)
    photograph.set_axis_off()
    mu = float(free.manipulability[chosen.rank])
    x, y, yaw = chosen.base
    photograph.set_title(f"the base at x = {x:.2f} m, y = {y:.2f} m, yaw = {np.degrees(yaw):.0f}°: μ = {mu:.3f}")
    return figure


class _Candidates(NamedTuple):
    """Bases (n,) of one TCP pose: x, y [m], yaw [rad], μ."""

    x: Floats
    y: Floats
    yaw: Floats
    manipulability: Floats


def _candidates(inverse_map: InverseReachabilityMap, tcp: Floats) -> _Candidates:
    """The best base of every square of the floor, whether it is free or not."""
    grid, tiles = inverse_map.reachability_map.grid, inverse_map.tiles
    key = find_key(grid, float(tcp[2]), 0.0, 0.0)
    if key is None:
        raise ValueError(f"the TCP cannot reach the height {tcp[2]:.2f} m")
    flat, yaws = flat_key(grid, key.layer, key.group), base_turns(grid, key, YAWS, YAW_STEP)[:, None]
    mine = slice(int(tiles.base_first[flat]), int(tiles.base_first[flat + 1]))
    c, s = np.cos(yaws), np.sin(yaws)
    x = (tcp[0] + c * tiles.x[mine] - s * tiles.y[mine]).ravel()
    y = (tcp[1] + s * tiles.x[mine] + c * tiles.y[mine]).ravel()
    yaw, mu = (yaws + tiles.yaw[mine]).ravel(), np.tile(tiles.mu[mine], len(yaws))
    best_first = np.argsort(-mu, kind="stable")
    squares = np.floor(np.column_stack([x, y])[best_first] / SPACING)
    _, first = np.unique(squares, axis=0, return_index=True)
    best = best_first[first]
    return _Candidates(x[best], y[best], yaw[best], mu[best].astype(float))


def _verified(robot: RobotSpec, bases: BasePlacement, tcp: Floats) -> Verified:
    """The best valid base: the arm reaches the TCP pose without a collision."""
    model = CollisionModel(robot, TABLE)
    found = verify(
        ArmChain.from_robot(robot), bases, lambda rank: tcp_poses(tcp, bases.approach_yaw[rank]), model.is_free
    )
    if not isinstance(found, Verified):
        raise ValueError(f"no base is valid for a cup at {tcp[:2]}; choose a position nearer to the table's edge")
    return found


def _draw_plan(
    axes: Axes,
    bases: _Candidates,
    floor: FreeSpace,
    chosen: Verified,
    cup: tuple[float, float],
    robot_above: NDArray[np.uint8],
    colours: str,
) -> None:
    half_depth, half_width = TABLE.depth / 2, TABLE.width / 2
    corner = (-half_depth, -half_width)
    axes.add_patch(Rectangle(corner, TABLE.depth, TABLE.width, facecolor="#e9dcc6", edgecolor="#8d7650", zorder=0))
    round_box = f"round,pad={GROWN},rounding_size={GROWN}"
    axes.add_patch(
        FancyBboxPatch(
            corner, TABLE.depth, TABLE.width, round_box, facecolor="none", edgecolor="#e0a800", linewidth=2.5, zorder=2
        )
    )
    x, y, yaw, mu = bases
    is_free = floor.are_free(x, y)
    scale = Normalize(0, float(mu.max()))
    for mask, alpha in ((~is_free, 0.18), (is_free, 1.0)):
        arrows = axes.quiver(
            x[mask],
            y[mask],
            np.cos(yaw[mask]),
            np.sin(yaw[mask]),
            mu[mask],
            cmap=colours,
            norm=scale,
            alpha=alpha,
            pivot="mid",
            angles="xy",
            scale_units="xy",
            scale=1 / (0.9 * SPACING),
            width=0.0035,
            headwidth=4.5,
            headlength=5,
            headaxislength=4.5,
            zorder=1,
        )
    axes.imshow(robot_above, extent=(-REACH, REACH, -REACH, REACH), alpha=0.85, zorder=3)
    axes.add_patch(Circle(cup, 0.035, facecolor="#d91a1a", edgecolor="white", zorder=4))
    _draw_chosen(axes, chosen.base)
    axes.annotate("cup", cup, (cup[0] + 0.06, cup[1] + 0.06), zorder=5)
    axes.text(half_depth - 0.03, -half_width + 0.05, "table", ha="right", color="#6b5836")
    axes.text(0.0, -half_width - GROWN - 0.09, f"outline grown by {GROWN} m", ha="center", color="#a87e00")
    axes.figure.colorbar(arrows, ax=axes, label="best manipulability μ at this place", shrink=0.85)
    axes.set(xlim=(-REACH, REACH), ylim=(-REACH, REACH), aspect="equal", xlabel="x [m]", ylabel="y [m]")
    axes.set_title("bases from which the arm reaches the cup (faint: too near to the table)")


def _draw_chosen(axes: Axes, base: Floats) -> None:
    """The verified base as a purple arrow along its heading."""
    x, y, yaw = base
    axes.quiver(
        x,
        y,
        np.cos(yaw),
        np.sin(yaw),
        color=PURPLE,
        angles="xy",
        scale_units="xy",
        scale=1 / 0.42,
        width=0.011,
        zorder=5,
    )
