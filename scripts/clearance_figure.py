"""Top-down pictures of the Negative Goal Region, R_work, candidates and choices (Figs. 8-10 of Lee & Kim 2019)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.patches import Circle, Polygon
from numpy.typing import NDArray

from planners.clearance import NegativeGoalRegion, SupportGrid
from planners.scene import Body

__all__ = ["ClearancePicture", "draw_clearance"]

COLOURS = {
    "NGR1": "#4c78a8",
    "NGR2": "#f2a541",
    "outside R_work": "#9aa0a6",
    "target": "#d62728",
    "obstacle": "#e6b800",
    "object": "#d9d9d9",
    "location": "#2ca02c",
    "refused": "#7f7f7f",
}


@dataclass(frozen=True, eq=False)
class ClearancePicture:
    """What one choice of a clearance location saw.

    Attributes:
        grid: cells of the support plane.
        region: where the object must not be put.
        bodies: all objects on the table.
        target: name of the target.
        obstacles: names of the objects to be cleared.
        in_work: mask of R_work over the grid, or None not to draw it.
        candidates: (n, 2) placement locations [m].
        ordered: (m, 2) those allowed, best first.
        chosen: (2,) the location taken, or None.
    """

    grid: SupportGrid
    region: NegativeGoalRegion
    bodies: Sequence[Body]
    target: str
    obstacles: Sequence[str] = ()
    in_work: NDArray[np.bool_] | None = None
    candidates: NDArray[np.float64] = field(default_factory=lambda: np.zeros((0, 2)))
    ordered: NDArray[np.float64] = field(default_factory=lambda: np.zeros((0, 2)))
    chosen: NDArray[np.float64] | None = None


def draw_clearance(axes: Axes, picture: ClearancePicture, title: str = "") -> None:
    """Draw the picture with the robot's side at the bottom: y to the left, x upwards."""
    _draw_regions(axes, picture)
    for body in picture.bodies:
        kind = "target" if body.name == picture.target else "obstacle" if body.name in picture.obstacles else "object"
        axes.add_patch(_outline(body, COLOURS[kind]))
        axes.annotate(body.name.removeprefix("object_"), (body.position[1], body.position[0]), ha="center", va="center")
    _draw_locations(axes, picture)
    x_low, x_high, y_low, y_high = picture.grid.extent
    axes.set(xlim=(y_high, y_low), ylim=(x_low, x_high), aspect="equal", title=title, xlabel="y [m]", ylabel="x [m]")
    handles = [Circle((0, 0), color=COLOURS[name]) for name in ("NGR1", "NGR2", "target", "obstacle")]
    axes.legend(
        handles, ["NGR1", "NGR2", "target", "obstacle"], loc="upper center", bbox_to_anchor=(0.5, -0.12), ncols=4
    )


def _draw_regions(axes: Axes, picture: ClearancePicture) -> None:
    x_low, x_high, y_low, y_high = picture.grid.extent
    layers = [("NGR2", picture.region.ngr2, 0.55), ("NGR1", picture.region.ngr1, 0.55)]
    if picture.in_work is not None:
        layers.insert(0, ("outside R_work", ~picture.in_work, 0.3))
    for name, mask, opacity in layers:
        image = np.empty((*mask.shape, 4))
        image[..., :3] = to_rgb(COLOURS[name])
        image[..., 3] = opacity * mask
        axes.imshow(image, origin="lower", extent=(y_low, y_high, x_low, x_high), interpolation="nearest")


def _draw_locations(axes: Axes, picture: ClearancePicture) -> None:
    axes.scatter(picture.candidates[:, 1], picture.candidates[:, 0], s=12, marker="x", color=COLOURS["refused"])
    axes.scatter(picture.ordered[:, 1], picture.ordered[:, 0], s=22, color=COLOURS["location"], zorder=3)
    for rank, (x, y) in enumerate(picture.ordered[:9], start=1):
        axes.annotate(str(rank), (y, x), xytext=(3, 3), textcoords="offset points", fontsize="x-small")
    if picture.chosen is not None:
        x, y = picture.chosen
        axes.scatter([y], [x], s=120, facecolors="none", edgecolors=COLOURS["location"], linewidths=2, zorder=4)


def _outline(body: Body, colour: str) -> Circle | Polygon:
    """The object from above, with y to the right of the picture's axes as matplotlib sees them."""
    x, y = float(body.position[0]), float(body.position[1])
    if body.shape == "cylinder" and body.is_upright:
        return Circle((y, x), body.radius, facecolor=colour, edgecolor="black", alpha=0.9)
    rotation, half = body.rotation, body.half_extents
    level = np.delete(np.arange(3), np.abs(rotation[2]).argmax())
    corners = [
        body.position[:2] + sum(s * half[a] * rotation[:2, a] for s, a in zip(signs, level, strict=True))
        for signs in ((-1, -1), (-1, 1), (1, 1), (1, -1))
    ]
    return Polygon([(c[1], c[0]) for c in corners], facecolor=colour, edgecolor="black", alpha=0.9)
