"""A whole plan in one picture from above: the scene, the clearances in order, and the path of the base."""

from __future__ import annotations

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Polygon

from planners.drawing.region import COLOURS, join, outline
from planners.scene import Body
from planners.tamp.solution import Solution

_MARGIN = 0.15
"""[m] around the support and the base's footprints."""
_BASE_COLOUR = "#4c78a8"


def draw_overview(solution: Solution, ax: Axes | None = None) -> Axes:
    """Draw a plan as the robot sees the scene at the start, itself at the bottom: y to the left, x upwards.

    Args:
        solution: the plan.
        ax: axes to draw in; a new figure without it.

    Returns:
        The axes.

    Raises:
        ValueError: the plan has no actions, because the target is in the gripper from the start.
    """
    if not solution.actions:
        raise ValueError("a plan without actions has nothing to draw")
    axes = plt.subplots(figsize=(6.4, 7.2), layout="constrained")[1] if ax is None else ax
    scene = solution.actions[0].scene
    for obstacle in sorted(scene.static_obstacles, key=lambda entry: entry.top):  # lower ones first
        is_support = obstacle.name == scene.support.name
        face = COLOURS["table"] if is_support else "none"
        edge = COLOURS["ink"] if is_support else COLOURS["refused"]
        axes.add_patch(Polygon(obstacle.outline[:, ::-1], facecolor=face, edgecolor=edge, linewidth=0.8, zorder=1))
    for body in scene.objects:
        kind = "target" if body.name == solution.target else "moved" if body.name in solution.clearances else "object"
        axes.add_patch(outline(body, COLOURS[kind]))
        _write(axes, body, body.name.removeprefix("object_"), COLOURS["ink"])
    _draw_clearances(axes, solution)
    _draw_base(axes, solution)
    entries = {
        "target": Line2D([], [], linestyle="", marker="o", markersize=9, color=COLOURS["target"]),
        "cleared": Line2D([], [], linestyle="", marker="o", markersize=9, color=COLOURS["moved"]),
        "clearance location": Line2D([], [], linestyle="", marker="$1$", markersize=7, color=COLOURS["location"]),
        "base": Line2D([], [], linewidth=1.6, color=_BASE_COLOUR),
    }
    axes.legend(list(entries.values()), list(entries), loc="lower right", fontsize=8)
    axes.set_title(f"{solution.target} after {len(solution.clearances)} clearances ({solution.strategy.name})")
    return axes


def _draw_clearances(axes: Axes, solution: Solution) -> None:
    """For each clearance the outline of the object where it is put, numbered, joined with where it stood."""
    for number, action in enumerate((a for a in solution.actions if a.is_clearance), start=1):
        placed = action.released
        if placed is None:
            continue
        axes.add_patch(outline(placed, "none"))
        _write(axes, placed, str(number), COLOURS["location"])
        join(axes, _place(action.scene.body(action.target)), _place(placed))


def _place(body: Body) -> tuple[float, float]:
    """Where a body stands in the axes: y along, x up."""
    return float(body.position[1]), float(body.position[0])


def _write(axes: Axes, body: Body, text: str, colour: str) -> None:
    """A short text on a body."""
    axes.annotate(text, _place(body), ha="center", va="center", fontsize=7, color=colour, zorder=10)


def _draw_base(axes: Axes, solution: Solution) -> None:
    """The path of the base's centre, and its footprint and heading wherever it stops; the axes show all of it."""
    for action in solution.actions:
        base = action.trajectory.base
        axes.plot(base[:, 1], base[:, 0], color=_BASE_COLOUR, linewidth=1.0, zorder=2)
    radius = solution.actions[0].scene.robot.base_radius
    stops = [solution.actions[0].trajectory.base[0], *(action.trajectory.base[-1] for action in solution.actions)]
    for x, y, yaw in np.unique(np.round(stops, 3), axis=0):
        axes.add_patch(Circle((y, x), radius, fill=False, edgecolor=_BASE_COLOUR, linewidth=0.8, zorder=2))
        ahead = (y + radius * np.sin(yaw), x + radius * np.cos(yaw))
        axes.plot((y, ahead[0]), (x, ahead[1]), color=_BASE_COLOUR, linewidth=1.6, zorder=2)
    bases = np.vstack([action.trajectory.base[:, :2] for action in solution.actions])
    support = solution.actions[0].scene.support
    lower = np.minimum(support.lower[:2], bases.min(axis=0) - radius) - _MARGIN
    upper = np.maximum(support.upper[:2], bases.max(axis=0) + radius) + _MARGIN
    axes.set(xlim=(upper[1], lower[1]), ylim=(lower[0], upper[0]), aspect="equal", xlabel="y [m]", ylabel="x [m]")
