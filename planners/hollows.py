"""Hollows of baskets, bowls, boxes, trays, mugs and drawers, found from their convex pieces seen from above.

The pieces form a height field. Water is poured on it, and a part that holds water deeper than `SHALLOW` is hollow. Its
lowest level part is the floor, and the water level is the rim. The largest hollow is used. Gaps between pieces that are
narrower than `_GAP` hold water.
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import grey_closing, label
from scipy.spatial import ConvexHull, QhullError

from planners.regions import EDGE, RESTING, Array, Region, footprint, overlap

if TYPE_CHECKING:
    from planners.scene import Body, Scene, StaticObstacle
    from planners.scene.solid import Solid

SHALLOW = 0.006
"""Depth [m] that a hollow exceeds."""
_CELL, _MOST = 0.002, 150
"""Cell size [m] of the height field, and most cells along its longer side. Larger fields get larger cells."""
_GAP = 5
"""Width of a closed gap, in cells."""
_LEAST = 0.02
"""Least size [m] of the floor of a hollow, along each side."""
_BESIDE = 0.03
"""Range [m] around a support in which walls are searched."""
_FOOTROOM = 0.015
"""Height [m] above a support. A wall begins below it."""


@dataclass(frozen=True, eq=False)
class Hollow:
    """Inside of a container, in the world.

    Attributes:
        name: name of the object, of the static body, or of the support.
        floor, rim: heights [m].
        base: (k, 2) corners [m] of a convex polygon around the floor.
        mouth: (k, 2) corners [m] of a convex polygon around the opening, at its widest below the rim.
        area: the rectangle around the mouth, aligned with the container.
    """

    name: str
    floor: float
    rim: float
    base: Array
    mouth: Array
    area: Region

    @property
    def depth(self) -> float:
        """Height [m] from floor to rim."""
        return self.rim - self.floor

    @property
    def width(self) -> float:
        """Smallest width [m] of the mouth."""
        sides = np.roll(self.mouth, -1, axis=0) - self.mouth
        normals = np.column_stack((-sides[:, 1], sides[:, 0])) / np.linalg.norm(sides, axis=1, keepdims=True)
        return float(np.ptp(self.mouth @ normals.T, axis=0).min())

    def contains(self, body: Body) -> bool:
        """Whether an object is inside: between floor and rim, or standing on the floor within the walls.

        Its centre is over the mouth, its lowest point between floor and rim. In addition, its centre is below the rim,
        or it stands on the floor with its whole footprint within the mouth.
        """
        if not self.floor - RESTING <= body.bottom < self.rim - EDGE:
            return False
        if overlap(self.mouth, body.position[None, :2]) < 0:
            return False
        return float(body.position[2]) <= self.rim or (
            body.bottom <= self.floor + RESTING and _are_within(self.mouth, footprint(body))
        )


def hollow_of(scene: Scene, name: str) -> Hollow | None:
    """Hollow of an object or a static body, by its name, if any."""
    if name in scene.names:
        return hollow_of_body(scene.body(name))
    parts = tuple(one for one in scene.static_obstacles if one.body == name)
    return _of_static(name, parts) if name else None


@lru_cache(maxsize=256)
def hollow_of_body(body: Body) -> Hollow | None:
    """Hollow of an upright object. None if it lies, or is solid."""
    if body.shape != "pieces" or not body.is_upright:
        return None
    found = _of_pieces(body.pieces)
    if found is None:
        return None
    c, s, (x, y, z) = math.cos(body.yaw), math.sin(body.yaw), body.position
    turn = np.array([[c, -s], [s, c]])
    return _moved(found, body.name, turn, np.array((x, y)), float(z), body.yaw)


def hollow_about(scene: Scene, face: StaticObstacle) -> Hollow | None:
    """Hollow with a support as its floor, between static obstacles on and next to it, if any."""
    low, high = face.lower[:2] - _BESIDE, face.upper[:2] + _BESIDE
    near = (one for one in scene.static_obstacles if (one.lower[:2] < high).all() and (one.upper[:2] > low).all())
    walls = tuple(
        one
        for one in near
        if one.name != face.name and one.lower[2] < face.top + _FOOTROOM and one.top > face.top + SHALLOW
    )
    return _about(face, walls) if walls else None


def static_hollows(scene: Scene) -> tuple[str, ...]:
    """Names of the static bodies with a hollow."""
    names = dict.fromkeys(one.body for one in scene.static_obstacles if one.body)
    return tuple(name for name in names if hollow_of(scene, name) is not None)


def hollow_names(scene: Scene) -> tuple[str, ...]:
    """Names of everything that holds objects: objects first, then static bodies."""
    objects = (body.name for body in scene.objects if hollow_of_body(body) is not None)
    return tuple(dict.fromkeys((*objects, *static_hollows(scene))))


def contents_of(scene: Scene, container: Body) -> Iterator[Body]:
    """Objects inside another object."""
    hollow = hollow_of_body(container)
    if hollow is not None:
        held = scene.held_names
        inside = (one for one in scene.objects if one.name != container.name and one.name not in held)
        yield from (one for one in inside if hollow.contains(one))


@lru_cache(maxsize=256)
def _of_pieces(pieces: tuple[Solid, ...]) -> Hollow | None:
    """Hollow of an object in its own frame, upright."""
    return _hollow("", pieces)


@lru_cache(maxsize=256)
def _of_static(name: str, parts: tuple[StaticObstacle, ...]) -> Hollow | None:
    """Hollow of static parts, aligned with the largest of them."""
    if not parts:
        return None
    largest = max(parts, key=lambda one: float(np.prod(one.half_extents[:2])))
    x_axis = largest.rotation[:2, 0] if largest.shape in ("box", "hull") else np.array((1.0, 0.0))
    return _turned(name, parts, math.atan2(x_axis[1], x_axis[0]))


@lru_cache(maxsize=256)
def _about(face: StaticObstacle, walls: tuple[StaticObstacle, ...]) -> Hollow | None:
    x_axis = face.rotation[:2, 0] if face.shape == "box" else np.array((1.0, 0.0))
    found = _turned(face.name, (face, *walls), math.atan2(x_axis[1], x_axis[0]), face)
    return found if found is not None and abs(found.floor - face.top) <= RESTING else None


def _turned(name: str, parts: Sequence[Solid], yaw: float, face: StaticObstacle | None = None) -> Hollow | None:
    """Hollow of parts in the world, with the height field along axes of a yaw [rad]. `face` as for `_hollow`."""
    c, s = math.cos(-yaw), math.sin(-yaw)
    R = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    turned = [one.moved(R, np.zeros(3)) for one in parts]
    found = _hollow(name, turned, turned[0] if face is not None else None)
    return None if found is None else _moved(found, name, R[:2, :2].T, np.zeros(2), 0.0, yaw)


def _moved(found: Hollow, name: str, turn: Array, shift: Array, rise: float, yaw: float) -> Hollow:
    """A hollow given along the axes, turned by a matrix (2, 2) and moved."""
    centre = shift + turn @ np.array(found.area.centre)
    area = Region(name, name, tuple(centre), found.area.half_extents, yaw)
    base, mouth = (shift + points @ turn.T for points in (found.base, found.mouth))
    return Hollow(name, found.floor + rise, found.rim + rise, base, mouth, area)


def _hollow(name: str, parts: Sequence[Solid], face: Solid | None = None) -> Hollow | None:
    """Largest hollow of convex parts, along the axes. With a `face`, the height field covers only the face and its
    surroundings."""
    if len(parts) < 2:
        return None
    around = list(parts) if face is None else [face]
    margin = 0.0 if face is None else _BESIDE
    low = np.min([one.lower[:2] for one in around], axis=0) - margin
    high = np.max([one.upper[:2] for one in around], axis=0) + margin
    cell = max(_CELL, float((high - low).max()) / _MOST)
    counts = np.maximum(np.ceil((high - low) / cell).astype(int), 1)
    axes = [start + cell * (np.arange(count) + 0.5) for start, count in zip(low, counts, strict=True)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    heights = _heights(parts, points.reshape(-1, 2)).reshape(points.shape[:2])
    lowest = float(min(one.lower[2] for one in parts)) - 1.0
    heights = np.where(np.isfinite(heights), heights, lowest)
    heights = np.maximum(
        heights, grey_closing(np.pad(heights, _GAP, constant_values=lowest), size=_GAP)[_INNER, _INNER]
    )
    water = _poured(heights, heights < lowest + 0.5)
    wet, count = label(water - heights > SHALLOW)
    if not count:
        return None
    pool = wet == 1 + int(np.bincount(wet.ravel())[1:].argmax())
    bottom = float(heights[pool].min())
    flat, count = label(pool & (heights <= bottom + RESTING))
    base = flat == 1 + int(np.bincount(flat.ravel())[1:].argmax())
    rim = float(water[base].max())
    floor = float(np.median(heights[base]))
    grown = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) * (cell / 2)
    if np.ptp(points[base], axis=0).min() + cell < _LEAST or rim - floor <= SHALLOW:
        return None
    try:
        outlines = [(points[cells][:, None] + grown).reshape(-1, 2) for cells in (base, pool)]
        polygons = [outline[ConvexHull(outline).vertices] for outline in outlines]
    except QhullError:
        return None
    smallest, largest = polygons[1].min(axis=0), polygons[1].max(axis=0)
    area = Region(name or "inside", name or "inside", tuple((smallest + largest) / 2), tuple((largest - smallest) / 2))
    return Hollow(name, floor, rim, polygons[0], polygons[1], area)


_INNER = slice(_GAP, -_GAP)


def _heights(parts: Sequence[Solid], points: Array) -> Array:
    """Height [m] of the highest part at points (n, 2): (n,), -inf for no part."""
    found = np.full(len(points), -np.inf)
    for one in parts:
        near = np.flatnonzero(((points >= one.lower[:2]) & (points <= one.upper[:2])).all(axis=1))
        if len(near):
            origins = np.column_stack((points[near], np.zeros(len(near))))
            enter, leave, *_ = one.cut(origins, np.tile((0.0, 0.0, 1.0), (len(near), 1)))
            found[near] = np.maximum(found[near], np.where(enter < leave, leave, -np.inf))
    return found


def _poured(heights: Array, drains: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Water level [m] on a height field (n, m). Water runs off its edges and through its drains.

    Cells are filled in the order of their heights from the edges inward (Barnes, Lehman & Mulla 2014, algorithm 1).
    """
    rows, columns = heights.shape
    level = heights.tolist()
    done = drains.copy()
    done[[0, -1]] = done[:, [0, -1]] = True
    seen = done.tolist()
    queue = [(level[i][j], i, j) for i, j in np.argwhere(done).tolist()]
    heapq.heapify(queue)
    while queue:
        here, i, j = heapq.heappop(queue)
        for k, m in ((i - 1, j), (i + 1, j), (i, j - 1), (i, j + 1)):
            if 0 <= k < rows and 0 <= m < columns and not seen[k][m]:
                seen[k][m] = True
                level[k][m] = max(level[k][m], here)
                heapq.heappush(queue, (level[k][m], k, m))
    return np.array(level)


def _are_within(polygon: Array, points: Array) -> bool:
    """Whether points (n, 2) lie in a convex polygon (k, 2), counter-clockwise, with tolerance `EDGE`."""
    sides = np.roll(polygon, -1, axis=0) - polygon
    length = np.linalg.norm(sides, axis=1)
    away = points[:, None] - polygon
    inwards = (sides[:, 0] * away[..., 1] - sides[:, 1] * away[..., 0]) / length
    return bool((inwards >= -EDGE).all())
