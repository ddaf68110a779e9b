"""Pictures from above: of a plan, of each of its clearances (Figs. 8-10 of Lee & Kim 2019), of the steps of a search.

They show the scene as the robot sees it, with the robot at the bottom: y to the left, x upwards.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap, to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Patch, Polygon, Rectangle
from numpy.typing import NDArray

from assets.robots import RobotSpec
from planners.drawing.choices import ClearancePicture, DrawnSurface, choices_of, last_picture
from planners.scene import Body
from planners.search.report import SearchStep
from planners.tamp.solution import Solution

Array = NDArray[np.float64]

COLOURS = {
    "table": "#faf6ef",
    "NGR1": "#4c78a8",
    "NGR2": "#f2a541",
    "outside": "#8d99a6",
    "target": "#d62728",
    "obstacle": "#f2cf3a",
    "moved": "#b07aa1",
    "cleared": "#dcc7d8",
    "object": "#dcdcdc",
    "location": "#1b8a3a",
    "refused": "#9a9a9a",
    "ink": "#30343b",
}
_MARGIN = 0.15
"""Margin [m] around the support and the base's footprints."""
_BASE_COLOUR = "#4c78a8"
_COLUMNS, _COLUMNS_WIDE, _WIDE = 3, 2, 2.0
"""Pictures side by side, for normal and for wide pictures, and the ratio of width to height of wide ones."""
_PAGE, _TITLE, _LEGEND_ROW = 13.8, 0.45, 0.7 / 3
"""Width [inch] of all pictures, heights of a title and of a row of the legend."""
_MOST = 11
"""Most clearances to draw. Of a longer plan, the first ones are drawn."""
_SEARCH_MARGIN = 0.06
"""Distance [m] from the supports to the camera's mark in pictures of a search."""
_RANKED = 9
"""Number of candidates with their rank as a number."""
_UNKNOWN_RADIUS = 0.03
"""Radius [m] of an object in the gripper that is not among the bodies."""
_SAME_PLACE = 0.005
"""Distance [m] below which two base positions get one mark."""


def draw_overview(solution: Solution, ax: Axes | None = None) -> Axes:
    """Draw a whole plan in axes, or in a new figure: the scene, the clearances in order, and the path of the base."""
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
        _draw_body(axes, body, COLOURS[kind])
    for number, action in enumerate((a for a in solution.actions if a.is_put_down), start=1):
        if (placed := action.released) is not None:
            _draw_body(axes, placed, "none", str(number), COLOURS["location"])
            _join(axes, action.scene.body(action.target), placed.position)
    _draw_base(axes, solution)
    entries = {
        "target": _dot(COLOURS["target"]),
        "cleared": _dot(COLOURS["moved"]),
        "clearance location": _dot(COLOURS["location"], marker="$1$", markersize=7),
        "base": Line2D([], [], linewidth=1.6, color=_BASE_COLOUR),
    }
    axes.legend(list(entries.values()), list(entries), loc="lower right", fontsize=8)
    count = len(solution.clearances)
    what = f"{solution.target} after {count} clearances" if solution.target else f"{solution.picks} picks"
    axes.set_title(f"{what} ({solution.strategy.name})")
    return axes


def _draw_base(axes: Axes, solution: Solution) -> None:
    """Draw the path of the base's centre, and its footprint and heading at its stops. Fit the axes to them."""
    for action in solution.actions:
        base = action.trajectory.base
        axes.plot(base[:, 1], base[:, 0], color=_BASE_COLOUR, linewidth=1.0, zorder=2)
    robot = solution.actions[0].scene.robot
    radius = robot.base_radius
    stops = [solution.actions[0].trajectory.base[0], *(action.trajectory.base[-1] for action in solution.actions)]
    for x, y, yaw in np.unique(np.round(stops, 3), axis=0):
        axes.add_patch(footprint(robot, (x, y, yaw), fill=False, edgecolor=_BASE_COLOUR, linewidth=0.8, zorder=2))
        ahead = (y + radius * np.sin(yaw), x + radius * np.cos(yaw))
        axes.plot((y, ahead[0]), (x, ahead[1]), color=_BASE_COLOUR, linewidth=1.6, zorder=2)
    bases = np.vstack([action.trajectory.base[:, :2] for action in solution.actions])
    support = solution.actions[0].scene.support
    lower = np.minimum(support.lower[:2], bases.min(axis=0) - radius) - _MARGIN
    upper = np.maximum(support.upper[:2], bases.max(axis=0) + radius) + _MARGIN
    axes.set(xlim=(upper[1], lower[1]), ylim=(lower[0], upper[0]), aspect="equal", xlabel="y [m]", ylabel="x [m]")


def footprint(robot: RobotSpec, base: tuple[float, float, float], **style: Any) -> Circle | Polygon:
    """Outline of the base at a pose x, y [m], yaw [rad]: its corners, or a circle. x is up, y to the left."""
    x, y, yaw = base
    if not robot.base_outline:
        return Circle((y, x), robot.base_radius, **style)
    c, s = np.cos(yaw), np.sin(yaw)
    return Polygon([(y + s * a + c * b, x + c * a - s * b) for a, b in robot.base_outline], closed=True, **style)


def draw_plan(solution: Solution, path: Path) -> None:
    """Write the pictures of a plan's clearances (Figs. 8-10 of Lee & Kim 2019) to one image file."""
    choices = choices_of(solution)
    pictures = []
    for number, choice in enumerate(choices[:_MOST], start=1):
        because = f" (obstructs {choice.obstructed})" if choice.obstructed else ""
        pictures.append((f"{number}  {choice.moved}{because}{', after a drive' if choice.is_far else ''}", choice))
    if solution.target or not solution.actions:
        pictures.append((f"{len(choices) + 1}  {solution.target} can be taken", last_picture(solution)))
    if not pictures:
        raise ValueError("a plan that puts nothing aside has no clearances to draw")
    x_low, x_high, y_low, y_high = pictures[0][1].extent
    aspect = (y_high - y_low) / (x_high - x_low)
    most = _COLUMNS if aspect < _WIDE else _COLUMNS_WIDE
    columns, width = min(most, len(pictures)), _PAGE / most
    rows = -(-len(pictures) // columns)
    legend = legend_entries()
    height = (width / aspect + _TITLE) * rows + _LEGEND_ROW * -(-len(legend) // (2 * columns))
    figure = Figure(figsize=(width * columns, height), layout="constrained")
    all_axes = np.atleast_1d(figure.subplots(rows, columns)).ravel()
    for axes, (title, picture) in zip(all_axes, pictures, strict=False):
        draw_clearance(axes, picture, title)
    for axes in all_axes[len(pictures) :]:
        axes.set_axis_off()
    style: dict[str, Any] = {"ncols": 2 * columns, "frameon": False, "fontsize": 8}
    figure.legend(list(legend.values()), list(legend), loc="outside lower center", **style)
    figure.savefig(path, dpi=130)


def draw_search(steps: Sequence[SearchStep]) -> Figure:
    """Draw the decisions of a search: possible target places, known objects, camera positions.

    Once the target is seen, unseen places are paler.
    """
    columns = min(len(steps), _COLUMNS_WIDE) or 1
    rows = math.ceil(len(steps) / columns) or 1
    extents = np.array([grid.extent for step in steps for grid in step.grids.values()] or [(0.0, 1.0, 0.0, 1.0)])
    (x_low, y_low), (x_high, y_high) = extents[:, 0::2].min(axis=0), extents[:, 1::2].max(axis=0)
    width = _PAGE / columns
    height = width * (x_high - x_low + 2 * _SEARCH_MARGIN) / (y_high - y_low + _SEARCH_MARGIN)
    figure = Figure(figsize=(_PAGE, (height + _TITLE) * rows + 2 * _LEGEND_ROW), layout="constrained")
    possible = ListedColormap([COLOURS["NGR2"]])
    for number, step in enumerate(steps, start=1):
        axes = figure.add_subplot(rows, columns, number)
        for support, cells in step.places.items():
            x0, x1, y0, y1 = step.grids[support].extent
            face, edge = COLOURS["table"], COLOURS["ink"]
            axes.add_patch(Rectangle((y0, x0), y1 - y0, x1 - x0, facecolor=face, edgecolor=edge))
            shown = np.ma.masked_where(~cells, cells)
            strength = 0.35 if any(seen.is_target for seen in step.known) else 1.0
            axes.imshow(shown, extent=(y0, y1, x0, x1), origin="lower", cmap=possible, alpha=strength, zorder=2)
        for seen in step.known:
            colour = COLOURS["target" if seen.is_target else "object"]
            _draw_body(axes, seen.body, colour, seen.name.removeprefix("seen_"))
        eye = float(np.clip(step.eye[1], y_low, y_high)), max(step.eye[0], x_low - _SEARCH_MARGIN)
        axes.plot(*eye, "^", color=COLOURS["ink"], markersize=9, clip_on=False)
        axes.set_title(f"{step.time:.0f} s: {step.text}", fontsize=10, loc="left", color=COLOURS["ink"], wrap=True)
        y_limits, x_limits = (y_high + 0.01, y_low - 0.01), (x_low - 1.5 * _SEARCH_MARGIN, x_high + 0.01)
        axes.set(xlim=y_limits, ylim=x_limits, aspect="equal")
        axes.axis("off")
    entries = {
        "the target can be here": Patch(color=COLOURS["NGR2"]),
        "not seen, the target is elsewhere": Patch(color=COLOURS["NGR2"], alpha=0.35),
        "seen": _dot(COLOURS["object"], markeredgecolor=COLOURS["ink"]),
        "target, seen": _dot(COLOURS["target"], markeredgecolor=COLOURS["ink"]),
        "the camera is in front of here": _dot(COLOURS["ink"], marker="^"),
    }
    figure.legend(list(entries.values()), list(entries), loc="outside lower center", ncols=5, frameon=False, fontsize=9)
    return figure


def draw_clearance(axes: Axes, picture: ClearancePicture, title: str = "") -> None:
    """Draw the choice of one clearance location, or the supports before the target is taken."""
    x_low, x_high, y_low, y_high = picture.extent
    axes.set_facecolor(COLOURS["table"])
    for surface in picture.surfaces:
        _draw_surface(axes, surface)
    for corners in picture.outlines:
        axes.add_patch(Polygon(corners[:, ::-1], facecolor=COLOURS["refused"], edgecolor=COLOURS["ink"], zorder=4))
    for body in picture.bodies:
        _draw_body(axes, body, COLOURS[picture.kind(body)])
    _draw_locations(axes, picture)
    _draw_move(axes, picture)
    _draw_stands(axes, picture)
    axes.set(xlim=(y_high, y_low), ylim=(x_low, x_high), aspect="equal")
    axes.set_xlabel("y [m]", fontsize=8)
    axes.set_ylabel("x [m]", fontsize=8)
    axes.set_title(title, fontsize=10, loc="left", color=COLOURS["ink"])
    axes.tick_params(labelsize=7, color=COLOURS["refused"])
    for spine in axes.spines.values():
        spine.set_color(COLOURS["refused"])


def _dot(colour: str, **style: Any) -> Line2D:
    return Line2D([], [], linestyle="", color=colour, **{"marker": "o", "markersize": 9, **style})


def legend_entries() -> dict[str, Artist]:
    """Colours and marks of all pictures, by their meaning."""
    edge = {"markeredgecolor": COLOURS["ink"]}
    return {
        "target": _dot(COLOURS["target"], **edge),
        "put aside now": _dot(COLOURS["moved"], **edge),
        "put aside before": _dot(COLOURS["cleared"], **edge),
        "to be cleared later": _dot(COLOURS["obstacle"], **edge),
        "stays": _dot(COLOURS["object"], **edge),
        "NGR1: taking the target": Patch(color=COLOURS["NGR1"], alpha=0.55),
        "NGR2: clearing the others": Patch(color=COLOURS["NGR2"], alpha=0.55),
        "outside R_work": Patch(facecolor="none", edgecolor=COLOURS["outside"], hatch="////", linewidth=0),
        "place chosen for it": _dot(COLOURS["cleared"], markeredgecolor=COLOURS["location"], markeredgewidth=1.4),
        "robot in front, takes | puts": Line2D([], [], **_stand(COLOURS["moved"], COLOURS["location"])),
        "robot in front, takes the target": Line2D([], [], **_stand(COLOURS["target"], COLOURS["target"])),
        "too close for its centre": Line2D([], [], color=COLOURS["ink"], linewidth=0.8, linestyle=":"),
        "candidate, in order": _dot(COLOURS["location"], markersize=6),
        "refused candidate": _dot(COLOURS["refused"], marker="x", markersize=5),
    }


def _draw_surface(axes: Axes, surface: DrawnSurface) -> None:
    """Draw the edges of one support, and the regions on it."""
    x_low, x_high, y_low, y_high = surface.grid.extent
    extent = (y_low, y_high, x_low, x_high)
    edges: dict[str, Any] = {"fill": False, "edgecolor": COLOURS["refused"], "linewidth": 0.8, "zorder": 2}
    axes.add_patch(Rectangle((y_low, x_low), y_high - y_low, x_high - x_low, **edges))
    for name, mask in (("NGR2", surface.region.ngr2), ("NGR1", surface.region.ngr1)):
        image = np.empty((*mask.shape, 4))
        image[..., :3] = to_rgb(COLOURS[name])
        image[..., 3] = 0.5 * mask
        axes.imshow(image, origin="lower", extent=extent, interpolation="nearest", zorder=1)
    if surface.in_work is not None and not surface.in_work.all():
        outside = np.where(surface.in_work, 0.0, 1.0)
        hatched = axes.contourf(outside, levels=[0.5, 1.5], colors="none", hatches=["////"], extent=extent, zorder=2)
        hatched.set(edgecolor=COLOURS["outside"], linewidth=0)
        axes.contour(outside, levels=[0.5], colors=COLOURS["outside"], extent=extent, linewidths=1, zorder=2)
    if surface.grown is not None and surface.grown.any():
        style: dict[str, Any] = {"colors": COLOURS["ink"], "linewidths": 0.6, "linestyles": ":"}
        axes.contour(surface.grown.astype(float), levels=[0.5], extent=extent, zorder=2, **style)


def _draw_locations(axes: Axes, picture: ClearancePicture) -> None:
    """Draw candidates with their ranks. The chosen one is the object's outline with its rank above."""
    allowed = {(x, y) for x, y in picture.ordered}
    refused = np.array([p for p in picture.candidates if tuple(p) not in allowed]).reshape(-1, 2)
    axes.scatter(refused[:, 1], refused[:, 0], s=14, marker="x", linewidths=0.9, color=COLOURS["refused"], zorder=7)
    is_chosen = [picture.chosen is not None and np.allclose(place, picture.chosen) for place in picture.ordered]
    others = picture.ordered[~np.array(is_chosen, dtype=bool)]
    axes.scatter(others[:, 1], others[:, 0], s=20, color=COLOURS["location"], zorder=7)
    for rank, (x, y) in enumerate(picture.ordered[:_RANKED], start=1):
        style: dict[str, Any] = {"color": COLOURS["location"], "fontsize": 7, "fontweight": "bold", "zorder": 8}
        above = (y, x + _radius(picture)) if is_chosen[rank - 1] else (y, x)
        offset = (0, 2) if is_chosen[rank - 1] else (4, 3)
        axes.annotate(str(rank), above, xytext=offset, textcoords="offset points", **style)


def _draw_move(axes: Axes, picture: ClearancePicture) -> None:
    """Draw the chosen place of the object, and join it with the object's position."""
    if picture.chosen is None:
        return
    x, y = (float(value) for value in picture.chosen)
    ghost = {"facecolor": COLOURS["cleared"], "edgecolor": COLOURS["location"], "linestyle": "--", "linewidth": 1.6}
    axes.add_patch(Circle((y, x), _radius(picture), alpha=0.8, zorder=6, gid="put", **ghost))
    number = picture.moved.removeprefix("object_")
    axes.annotate(number, (y, x), ha="center", va="center", fontsize=7, color=COLOURS["ink"], zorder=7)
    if picture.moved_body is not None:
        _join(axes, picture.moved_body, picture.chosen)


def _radius(picture: ClearancePicture) -> float:
    """Radius [m] of the object that is put aside."""
    return _UNKNOWN_RADIUS if picture.moved_body is None else picture.moved_body.radius


def _draw_stands(axes: Axes, picture: ClearancePicture) -> None:
    """Mark the base positions at the lower edge, in front of the table. A position for both has both colours."""
    x_low, _, y_low, y_high = picture.extent
    take, put = COLOURS["moved"], COLOURS["location"]
    if len(picture.stands) < 2:
        marks = [(place, COLOURS["target"], COLOURS["target"]) for place in picture.stands]
    elif np.linalg.norm(picture.stands[0] - picture.stands[1]) < _SAME_PLACE:
        marks = [(picture.stands[0], take, put)]
    else:
        marks = [(picture.stands[0], take, take), (picture.stands[1], put, put)]
    for (_, y), left, right in marks:
        at = float(np.clip(y, y_low, y_high))
        axes.plot([at], [x_low], clip_on=False, zorder=10, gid="stand", **_stand(left, right))


def _stand(left: str, right: str) -> dict[str, Any]:
    """Mark of a base position: a triangle with halves in the colours of the actions from there."""
    edge = {"markeredgecolor": COLOURS["ink"], "linestyle": ""}
    return {"marker": "^", "markersize": 11, "fillstyle": "left", "color": left, "markerfacecoloralt": right, **edge}


def _draw_body(axes: Axes, body: Body, colour: str, text: str | None = None, ink: str = COLOURS["ink"]) -> None:
    """Draw an object from above, with its number or another short text."""
    at = (float(body.position[1]), float(body.position[0]))
    style: dict[str, Any] = {"facecolor": colour, "edgecolor": COLOURS["ink"], "linewidth": 0.8, "alpha": 0.92}
    if body.shape == "cylinder" and body.is_upright:
        axes.add_patch(Circle(at, body.radius, zorder=5, **style))
    elif body.shape == "pieces":
        # Edges are drawn below the faces, so that only the outline of all pieces together is visible.
        for zorder, over in ((5.0, {"linewidth": 1.6}), (5.1, {"linewidth": 0.0})):
            for piece in body.placed:
                axes.add_patch(Polygon(piece.outline[:, ::-1], zorder=zorder, **{**style, "alpha": None, **over}))
    else:
        level = np.delete(np.arange(3), np.abs(body.rotation[2]).argmax())
        corners = np.array([(-1, -1), (-1, 1), (1, 1), (1, -1)]) * body.half_extents[level]
        places = body.position[:2] + corners @ body.rotation[:2, level].T
        axes.add_patch(Polygon(places[:, ::-1], zorder=5, **style))
    number = body.name.removeprefix("object_") if text is None else text
    axes.annotate(number, at, ha="center", va="center", fontsize=7, color=ink, zorder=6)


def _join(axes: Axes, body: Body, end: Array) -> None:
    """Join an object's position and its place with a line under the objects, since it is no path."""
    x, y = zip(body.position[:2], end[:2], strict=True)
    axes.plot(y, x, color=COLOURS["moved"], linewidth=1.2, dashes=(2, 2), zorder=3, gid="move")
