"""Top-down pictures of the Negative Goal Region, R_work, candidates and choices (Figs. 8-10 of Lee & Kim 2019)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Ellipse, Patch, Polygon, Rectangle
from numpy.typing import NDArray

from planners.placing.negative_goal_region import NegativeGoalRegion, SupportGrid
from planners.scene import Body

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
_RANKED = 9
"""Candidates that get their rank as a number."""
_UNKNOWN_RADIUS = 0.03
"""[m] drawn for an object that is in the gripper and not among the bodies."""
_SAME_PLACE = 0.005
"""[m] below which two base positions get one mark."""


@dataclass(frozen=True, eq=False)
class DrawnSurface:
    """The top face of one support: its cells, and where the object must not be put.

    Drawn if given: the mask of R_work over the grid, and where the object's centre must not be.
    """

    grid: SupportGrid
    region: NegativeGoalRegion
    in_work: NDArray[np.bool_] | None = None
    grown: NDArray[np.bool_] | None = None


@dataclass(frozen=True, eq=False)
class ClearancePicture:
    """The supports when one clearance location is chosen, or before the target is taken.

    Attributes:
        surfaces, bodies: top faces of the supports, and all objects on them.
        target, obstacles: names of the target and of the objects still to be cleared after this one.
        candidates: (n, 2) placement locations [m].
        ordered: (m, 2) those allowed, best first.
        chosen: (2,) the location taken, or None.
        moved: name of the object to be put aside, "" for none.
        obstructed: name of the object that it obstructs, "" if it is put aside for no particular object.
        is_far: whether the base drives between taking the object and putting it down.
        cleared: names of the objects put aside before.
        stands: (k, 2) base positions [m], first to take the object, then to put it down.
        outlines: (k, 2) corners [m] of each static obstacle on the support.
    """

    surfaces: Sequence[DrawnSurface]
    bodies: Sequence[Body]
    target: str
    obstacles: Sequence[str] = ()
    candidates: NDArray[np.float64] = field(default_factory=lambda: np.zeros((0, 2)))
    ordered: NDArray[np.float64] = field(default_factory=lambda: np.zeros((0, 2)))
    chosen: NDArray[np.float64] | None = None
    moved: str = ""
    obstructed: str = ""
    is_far: bool = False
    cleared: Sequence[str] = ()
    stands: NDArray[np.float64] = field(default_factory=lambda: np.zeros((0, 2)))
    outlines: Sequence[NDArray[np.float64]] = ()

    @property
    def extent(self) -> tuple[float, float, float, float]:
        """(x low, x high, y low, y high) [m] of all surfaces together."""
        low = np.min([surface.grid.extent for surface in self.surfaces], axis=0)
        high = np.max([surface.grid.extent for surface in self.surfaces], axis=0)
        return float(low[0]), float(high[1]), float(low[2]), float(high[3])

    @property
    def moved_body(self) -> Body | None:
        """The object to be put aside; None if it is in the gripper from the start, or none is put aside."""
        return next((body for body in self.bodies if body.name == self.moved), None)

    def kind(self, body: Body) -> str:
        """What an object is in this picture."""
        if body.name == self.target:
            return "target"
        if body.name == self.moved:
            return "moved"
        if body.name in self.cleared:
            return "cleared"
        return "obstacle" if body.name in self.obstacles else "object"


def draw_clearance(axes: Axes, picture: ClearancePicture, title: str = "") -> None:
    """Draw the picture as the robot sees the table, itself at the bottom: y to the left, x upwards."""
    x_low, x_high, y_low, y_high = picture.extent
    axes.set_facecolor(COLOURS["table"])
    for surface in picture.surfaces:
        _draw_surface(axes, surface)
    for corners in picture.outlines:
        axes.add_patch(Polygon(corners[:, ::-1], facecolor=COLOURS["refused"], edgecolor=COLOURS["ink"], zorder=4))
    for body in picture.bodies:
        axes.add_patch(outline(body, COLOURS[picture.kind(body)]))
        at = (body.position[1], body.position[0])
        number = body.name.removeprefix("object_")
        axes.annotate(number, at, ha="center", va="center", fontsize=7, color=COLOURS["ink"], zorder=6)
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


def legend_entries() -> dict[str, Artist]:
    """Colours and marks of all pictures, by their meaning."""

    def dot(colour: str, **style: Any) -> Line2D:
        return Line2D([], [], linestyle="", color=colour, **{"marker": "o", "markersize": 9, **style})

    edge = {"markeredgecolor": COLOURS["ink"]}
    return {
        "target": dot(COLOURS["target"], **edge),
        "put aside now": dot(COLOURS["moved"], **edge),
        "put aside before": dot(COLOURS["cleared"], **edge),
        "to be cleared later": dot(COLOURS["obstacle"], **edge),
        "stays": dot(COLOURS["object"], **edge),
        "NGR1: taking the target": Patch(color=COLOURS["NGR1"], alpha=0.55),
        "NGR2: clearing the others": Patch(color=COLOURS["NGR2"], alpha=0.55),
        "outside R_work": Patch(facecolor="none", edgecolor=COLOURS["outside"], hatch="////", linewidth=0),
        "place chosen for it": dot(COLOURS["cleared"], markeredgecolor=COLOURS["location"], markeredgewidth=1.4),
        "robot in front, takes | puts": Line2D([], [], **_stand(COLOURS["moved"], COLOURS["location"])),
        "robot in front, takes the target": Line2D([], [], **_stand(COLOURS["target"], COLOURS["target"])),
        "too close for its centre": Line2D([], [], color=COLOURS["ink"], linewidth=0.8, linestyle=":"),
        "candidate, in order": dot(COLOURS["location"], markersize=6),
        "refused candidate": dot(COLOURS["refused"], marker="x", markersize=5),
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


def join(axes: Axes, start: tuple[float, float], end: tuple[float, float]) -> None:
    """Join where an object stands and where it is put, in the picture's axes: under the objects, as it is no path."""
    axes.plot(*zip(start, end, strict=True), color=COLOURS["moved"], linewidth=1.2, dashes=(2, 2), zorder=3, gid="move")


def _draw_locations(axes: Axes, picture: ClearancePicture) -> None:
    """Candidates with their ranks; the one chosen as the object's outline, its rank above it."""
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
    """Draw where the object is put, and join it with where it stands."""
    if picture.chosen is None:
        return
    x, y = (float(value) for value in picture.chosen)
    ghost = {"facecolor": COLOURS["cleared"], "edgecolor": COLOURS["location"], "linestyle": "--", "linewidth": 1.6}
    axes.add_patch(Circle((y, x), _radius(picture), alpha=0.8, zorder=6, gid="put", **ghost))
    number = picture.moved.removeprefix("object_")
    axes.annotate(number, (y, x), ha="center", va="center", fontsize=7, color=COLOURS["ink"], zorder=7)
    if (moved := picture.moved_body) is not None:
        join(axes, (float(moved.position[1]), float(moved.position[0])), (y, x))


def _radius(picture: ClearancePicture) -> float:
    """[m] of the object that is put aside."""
    return _UNKNOWN_RADIUS if picture.moved_body is None else picture.moved_body.radius


def _draw_stands(axes: Axes, picture: ClearancePicture) -> None:
    """Mark the base positions at the lower edge, in front of the table; one that serves for both has both colours."""
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
    """The mark of a base position: a triangle, its halves in the colours of what the robot does from there."""
    edge = {"markeredgecolor": COLOURS["ink"], "linestyle": ""}
    return {"marker": "^", "markersize": 11, "fillstyle": "left", "color": left, "markerfacecoloralt": right, **edge}


def outline(body: Body, colour: str) -> Ellipse | Polygon:
    """The object from above, in the picture's axes: y along, x up."""
    x, y = float(body.position[0]), float(body.position[1])
    style: dict[str, Any] = {
        "facecolor": colour,
        "edgecolor": COLOURS["ink"],
        "linewidth": 0.8,
        "alpha": 0.92,
        "zorder": 5,
    }
    if body.shape == "cylinder" and body.is_upright:
        return Circle((y, x), body.radius, **style)
    rotation, half = body.rotation, body.half_extents
    level = np.delete(np.arange(3), np.abs(rotation[2]).argmax())
    corners = [
        body.position[:2] + sum(s * half[a] * rotation[:2, a] for s, a in zip(signs, level, strict=True))
        for signs in ((-1, -1), (-1, 1), (1, 1), (1, -1))
    ]
    return Polygon([(c[1], c[0]) for c in corners], **style)
