"""Perception: masks and depth become upright cylinders and boxes, with the uncertainty of their poses."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.spatial import ConvexHull, QhullError

from planners.scene import Body, StaticObstacle
from planners.scene.bodies import Shape

Array = NDArray[np.float64]

FIRST_MASK = 3
"""Lowest label of an object in an image's masks."""
_LEAST_PIXELS = 10
"""Least number of pixels of a mask."""
_MOST_POINTS = 4000
"""Most points to keep of an object, and `_FITTED` of them for fitting its shape."""
_FITTED = 300
_RIM = 0.008
"""Depth [m] below an object's highest point in which points belong to its top face."""
_SIZES = (0.02, 0.10)
"""Limits [m] of an object's radius or half extents. They are at most `_UNSEEN` of its seen width, too."""
_UNSEEN = 0.75
_WIDEST = 0.22
"""Largest width [m] of one object. A wider mask covers several."""
_HUE = 0.12
"""Difference of the shares of red, green and blue up to which two colours are the same."""
_SHARED = 0.5
"""Share of a mask's points inside a known object from which on the mask belongs to it."""
_NEAR, _NEAR_HAND = 0.012, 0.03
"""Distances [m] around a known object in which points belong to it, normally and for a held object, which may have
slipped."""


@dataclass(frozen=True)
class Description:
    """Description of the target: `colour` (3,), `shape`, `half_extents` (3,) [m]."""

    colour: tuple[float, float, float]
    shape: str
    half_extents: tuple[float, float, float]

    @classmethod
    def of(cls, values: Sequence[float]) -> Description:
        """Description from seven numbers: colour, whether it is a box, half extents."""
        red, green, blue, is_box, *half = (float(value) for value in values)
        return cls((red, green, blue), "box" if is_box else "cylinder", (half[0], half[1], half[2]))

    @property
    def height(self) -> float:
        """Height [m]."""
        return 2 * self.half_extents[2]

    @property
    def radius(self) -> float:
        """Radius [m] of the largest upright cylinder inside the target."""
        return min(self.half_extents[:2])

    def has_colour(self, colour: Array) -> bool:
        """Whether this is the target's colour, in any shade."""
        return bool(np.abs(_shares(np.array(self.colour)) - _shares(colour)).max() < _HUE)


@dataclass(frozen=True, eq=False)
class View:
    """One image: `colours` (h, w, 3), `depth` (h, w) [m], `masks` (h, w), K (3, 3), T_world_camera (4, 4)."""

    colours: NDArray[np.uint8]
    depth: NDArray[np.float32]
    masks: NDArray[np.uint8]
    K: Array
    T_world_camera: Array

    @classmethod
    def of(cls, observation: Mapping[str, Any], camera: str, T_world_base: Array) -> View:
        """View of a camera, from an observation's entries."""
        return cls(
            observation[f"{camera}_rgb"],
            np.ascontiguousarray(observation[f"{camera}_depth"][..., 0]),
            observation[f"{camera}_segmentation"][..., 0],
            observation[f"{camera}_K"],
            T_world_base @ observation[f"{camera}_T_base_camera"],
        )

    @property
    def eye(self) -> Array:
        """Camera position (2,) [m] from above."""
        return self.T_world_camera[:2, 3]

    def points(self, mask: NDArray[np.bool_]) -> Array:
        """World points (n, 3) [m] of the pixels of a mask."""
        v, u = np.nonzero(mask)
        rays = np.column_stack(((u - self.K[0, 2]) / self.K[0, 0], (v - self.K[1, 2]) / self.K[1, 1], np.ones(len(u))))
        T = self.T_world_camera
        return np.asarray(rays * self.depth[mask][:, None] @ T[:3, :3].T + T[:3, 3])


@dataclass(frozen=True, eq=False)
class Seen:
    """A seen object.

    Attributes:
        body: fitted shape and pose.
        points: (n, 3) points [m] of its surface.
        colour: (3,) mean colour, 0 to 1.
        sigma: expected standard deviation [m] of its place, from the fit and from unseen sides.
        is_target: whether it has the target's colour.
    """

    body: Body
    points: Array
    colour: Array
    sigma: float
    is_target: bool = False

    @property
    def name(self) -> str:
        """Name of the body."""
        return self.body.name


def perceive(
    view: View, known: Sequence[Seen], supports: Sequence[StaticObstacle], target: Description, held: str = ""
) -> tuple[Seen, ...]:
    """Update the known objects at their present places with a view, and add new ones.

    A mask belongs to the known object that contains most of its points. A mask that covers several objects is left out.
    A known object that turns out to be two is replaced by these. Two parts of the target are joined once its place is
    known, but a held object keeps its name. An object in the hand stays as it was seen before.
    """
    found = {one.name: one for one in known}
    shown: dict[str, Array] = {}  # points of each object that this view shows
    count = max((int(one.name.rpartition("_")[2]) for one in known), default=-1) + 1
    for label in np.unique(view.masks[view.masks >= FIRST_MASK]).tolist():
        mask = of_one_colour(view.masks == label, view.colours)
        points = view.points(mask)
        if len(points) < _LEAST_PIXELS or np.ptp(np.percentile(points, (2, 98), axis=0), axis=0)[:2].max() > _WIDEST:
            continue
        if held and _inside(found[held].body, points, _NEAR_HAND).mean() >= _SHARED:
            continue
        colour = view.colours[mask].mean(axis=0) / 255
        is_target = target.has_colour(colour)
        others = [one for one in found.values() if one.is_target == is_target]
        shares = {one.name: float(_inside(one.body, points).mean()) for one in others}
        first = max(shares, key=lambda name: shares[name], default="")
        is_known = shares.get(first, 0.0) >= _SHARED
        strangers = [share for name, share in shares.items() if not (is_known and name == first)]
        if not is_target and max(strangers, default=0.0) > _SHARED / 3:
            continue  # partly another object's: masks that merge
        if is_known and first in shown and not is_target:
            body, sigma = fit_upright(first, shown[first], supports, eye=view.eye)
            found[first] = Seen(body, shown[first], found[first].colour, sigma)
            is_known = False
        if is_known:
            name, shown[first] = first, points
            points = _some(np.concatenate((found[name].points, points)), _MOST_POINTS)
            colour = found[name].colour
        else:
            name, count = f"seen_{count:02d}", count + 1
            shown[name] = points
        body, sigma = fit_upright(name, points, supports, target if is_target else None, view.eye)
        for part in [one for one in found.values() if one.is_target and is_target and one.name not in (name, held)]:
            if _inside(body, part.points).mean() >= _SHARED:
                del found[part.name]
        found[name] = Seen(body, points, colour, sigma, is_target)
    return tuple(found.values())


def of_one_colour(mask: NDArray[np.bool_], colours: NDArray[Any]) -> NDArray[np.bool_]:
    """Remove pixels from a mask (height, width) whose colour (height, width, 3) differs from most of it.

    So two objects with merged masks are reduced to one, and a ragged edge to its own pixels.
    """
    shares = _shares(colours[mask].astype(float))
    kept = mask.copy()
    kept[mask] = np.abs(shares - np.median(shares, axis=0)).max(axis=1) < _HUE
    return kept


def _shares(colours: Array) -> Array:
    """Shares of red, green and blue (…, 3) in colours, which do not depend on shade."""
    return np.asarray(colours / np.maximum(colours.sum(axis=-1, keepdims=True), 1e-6))


def _some(points: Array, most: int) -> Array:
    """At most so many points, evenly spread over their order."""
    return points[np.linspace(0, len(points) - 1, min(len(points), most)).astype(int)]


def _inside(body: Body, points: Array, near: float = _NEAR) -> NDArray[np.bool_]:
    """Whether points (n, 3) lie in an object, or near it: (n,)."""
    local = (points - body.position) @ body.rotation
    return np.asarray((np.abs(local) < body.half_extents + near).all(axis=1))


def fit_upright(
    name: str,
    points: Array,
    supports: Sequence[StaticObstacle],
    target: Description | None = None,
    eye: Array | None = None,
) -> tuple[Body, float]:
    """Fit an upright cylinder or box to points of a surface. Return it with the uncertainty [m] of its place.

    The outline from above is fitted by least squares: side points lie on it, top points within it. The shape with the
    smaller error is taken. An unseen side is as near as the points allow. The part that is wider than its points lies
    behind them as seen from `eye` (2,) [m], if given. The object stands on the highest support under its lowest point.
    For the target, only the pose is fitted.
    """
    z_low, z_high = np.percentile(points[:, 2], (1, 99))
    middle = np.median(points[:, :2], axis=0)
    under = [one.top for one in supports if one.is_under(middle) and one.top < z_low + 0.03]
    bottom = max(under, default=float(z_low))
    top = bottom + target.height if target else max(float(z_high), bottom + 0.02)
    chosen = _some(points, _FITTED)
    xy, is_side = chosen[:, :2], chosen[:, 2] < z_high - _RIM
    size = None if target is None else np.array(target.half_extents[:2])
    away = np.zeros(2) if eye is None else (middle - eye) / np.linalg.norm(middle - eye)
    fits: dict[Shape, tuple[tuple[float, ...], float]] = {}
    if target is None or target.shape == "cylinder":
        fits["cylinder"] = _fit_circle(xy, is_side, size, away)
    if target is None or target.shape == "box":
        fits["box"] = _fit_rectangle(xy, is_side, size, away)
    # A rectangle has more parameters and fits noise better, so its error gets a penalty.
    shape = min(fits, key=lambda kind: fits[kind][1] * (1.25 if kind == "box" else 1.0))
    (x, y, half_x, half_y, yaw), error = fits[shape]
    half, position = np.array((half_x, half_y, (top - bottom) / 2)), np.array((x, y, (top + bottom) / 2))
    body = Body(name, shape, half, position, np.array((math.cos(yaw / 2), 0.0, 0.0, math.sin(yaw / 2))))
    around = np.arctan2(*(xy - (x, y)).T[::-1])
    at_edge = np.hypot(*(xy - (x, y)).T) > 0.6 * min(half_x, half_y)
    sectors = len(np.unique(np.floor(around[at_edge] / (math.pi / 6))))
    sigma = 0.002 + error + 0.008 * (1 - min(sectors, 12) / 12)
    return body, float(sigma)


def _fit_circle(
    xy: Array, is_side: NDArray[np.bool_], size: Array | None, away: Array
) -> tuple[tuple[float, ...], float]:
    """x, y, radius, radius, 0 of the circle, and its root mean square error [m]."""
    centre = (xy.min(axis=0) + xy.max(axis=0)) / 2
    start = max(float(np.hypot(*(xy - centre).T).max()), _SIZES[0] * 1.01) if size is None else float(size[0])

    def errors(parameters: Array) -> Array:
        radius = float(size[0]) if size is not None else parameters[2]
        away = np.hypot(*(xy - parameters[:2]).T) - radius
        return np.where(is_side, away, np.maximum(away, 0.0))

    widest = float(np.clip(_UNSEEN * np.ptp(xy, axis=0).max(), _SIZES[0] * 1.05, _SIZES[1]))
    start = start if size is not None else min(start, widest * 0.99)
    behind = max(start - np.ptp(xy @ away) / 2, 0.0)
    first = np.array((*(centre + behind * away), start))[: 3 if size is None else 2]
    low = np.array((-np.inf, -np.inf, _SIZES[0]))[: len(first)]
    high = np.array((np.inf, np.inf, widest))[: len(first)]
    solved = least_squares(errors, first, bounds=(low, high), loss="soft_l1", f_scale=0.004, max_nfev=60)
    x, y, *radius = solved.x
    r = float(radius[0]) if radius else start
    return (float(x), float(y), r, r, 0.0), float(np.sqrt((errors(solved.x) ** 2).mean()))


def _fit_rectangle(
    xy: Array, is_side: NDArray[np.bool_], size: Array | None, away: Array
) -> tuple[tuple[float, ...], float]:
    """x, y, half extents, yaw of the rectangle, and its root mean square error [m], the better of two starts."""
    try:
        outline = xy[ConvexHull(xy).vertices]
    except QhullError:  # points on a line
        outline = xy

    def axes(yaw: float) -> Array:
        c, s = math.cos(yaw), math.sin(yaw)
        return np.array(((c, -s), (s, c)))

    def errors(parameters: Array) -> Array:
        beyond = np.abs((xy - parameters[:2]) @ axes(parameters[2])) - (parameters[3:] if size is None else size)
        outside = np.hypot(*np.maximum(beyond, 0.0).T)
        away = np.where((beyond > 0).any(axis=1), outside, beyond.max(axis=1))
        return np.where(is_side, away, np.maximum(away, 0.0))

    def extents(yaw: float) -> tuple[Array, Array]:
        local = outline @ axes(yaw)
        return local.min(axis=0), local.max(axis=0)

    yaws = np.arange(30) * math.pi / (60 if size is None or abs(size[0] - size[1]) < 1e-3 else 30)
    areas = [float(np.prod(np.maximum(high - low, 0.01))) for low, high in map(extents, yaws)]
    fits = []
    for yaw in yaws[np.argsort(areas)[:2]]:
        low, high = extents(yaw)
        widest = np.clip(_UNSEEN * (high - low), _SIZES[0] * 1.05, _SIZES[1])
        half = np.clip((high - low) / 2, _SIZES[0] * 1.01, widest * 0.99)
        behind = np.maximum((half if size is None else size) - (high - low) / 2, 0.0) * (away @ axes(yaw))
        first = np.array((*(axes(yaw) @ ((low + high) / 2 + behind)), yaw, *(half if size is None else ())))
        least = np.array((-np.inf, -np.inf, -np.inf, _SIZES[0], _SIZES[0]))[: len(first)]
        most = np.array((np.inf, np.inf, np.inf, *widest))[: len(first)]
        solved = least_squares(errors, first, bounds=(least, most), loss="soft_l1", f_scale=0.004, max_nfev=40)
        x, y, turn, *rest = (float(value) for value in solved.x)
        a, b = rest if size is None else size.tolist()
        fits.append(((x, y, a, b, turn), float(np.sqrt((errors(solved.x) ** 2).mean()))))
    return min(fits, key=lambda fit: fit[1])
