"""Proof that an object overlaps another one wherever it stands at its place, and however it is turned there.

A piece of each object is cut at one height, which gives two convex polygons. They overlap while the centre of the
first object lies in their Minkowski sum, which is convex too: if it contains the corners of all possible centres, it
contains these centres. The yaw is sampled, with a margin for what lies between two samples.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import lru_cache
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError

from planners.regions import EDGE, Region, footprint
from planners.scene import Body
from planners.scene.bodies import resting_ways
from planners.scene.solid import BOX_CORNERS, Solid

Array: TypeAlias = NDArray[np.float64]

_YAWS = 72
"""Samples of the yaw. Half of their spacing moves a point 60 mm off the centre by 2.6 mm."""
_LARGEST = 3
"""Pieces of each object that are tested, those with the largest outlines first: its bottom, or its body."""
_COMMON = 0.002
"""Least height [m] that two pieces have in common. Contacts are soft."""
_TURNS = np.arange(16) * (2 * np.pi / 16)
_RINGS = np.array([(np.cos(turn), np.sin(turn), end) for end in (-1.0, 1.0) for turn in _TURNS])
"""Points (32, 3) on the edges of a cylinder of radius 1."""


class Ends(NamedTuple):
    """Where the centre of an object may be once it stands at its place.

    Attributes:
        level: height [m] on which it stands.
        area: region for its footprint, or for its centre alone. With None, it stands at `point`.
        point: x, y [m], within `tolerance` [m].
        by_centre: whether the region is for the centre alone.
    """

    level: float
    area: Region | None = None
    point: tuple[float, float] = (0.0, 0.0)
    tolerance: float = 0.0
    by_centre: bool = False


@lru_cache(maxsize=4096)
def overlaps_everywhere(body: Body, ends: Ends, other: Body) -> bool:
    """Whether an object overlaps another one at each of its ends, in every yaw and resting orientation: proved.

    Args:
        body: the object, wherever it is now.
        ends: where it may stand.
        other: an object where it stands.
    """
    return all(_overlaps(way, ends, other) for way in resting_ways(body))


def _overlaps(body: Body, ends: Ends, other: Body) -> bool:
    """Whether an object that rests as it is overlaps another one at each of its ends, in every yaw."""
    yaws = np.linspace(0.0, 2 * np.pi, _YAWS, endpoint=False)
    centres, is_possible = _centres(body, ends, yaws)
    nearest = np.linalg.norm(centres - other.position[:2], axis=2).max()
    if not is_possible.any() or nearest > body.radius + other.radius:
        return False
    is_proved = ~is_possible
    for moving, standing in _sections(body, other, ends.level - body.bottom):
        margin = EDGE + ends.tolerance + _between_yaws(moving)
        is_proved |= _is_within(centres, moving, standing, margin, yaws)
        if is_proved.all():
            return True
    return False


def _between_yaws(points: Array) -> float:
    """Largest distance [m] that points (k, 2) move by a turn about the origin to the nearest sample of the yaw."""
    return float(np.linalg.norm(points, axis=1).max()) * math.pi / _YAWS


def _centres(body: Body, ends: Ends, yaws: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Corners (k, n, 2) [m] of the possible centres of an object at each yaw (k,), and whether there are any: (k,)."""
    if ends.area is None:
        return np.tile(ends.point, (len(yaws), 1, 1)), np.ones(len(yaws), np.bool_)
    outline = footprint(body) - body.position[:2]
    half = np.array(ends.area.half_extents) + EDGE
    if ends.by_centre:
        low, high = np.tile(-half, (len(yaws), 1)), np.tile(half, (len(yaws), 1))
    else:
        turned, slack = outline @ _turned(yaws - ends.area.yaw).transpose(0, 2, 1), _between_yaws(outline)
        low, high = -half - turned.min(axis=1) - slack, half - turned.max(axis=1) + slack
    sides = np.stack((low, high), axis=1)
    local = np.stack([sides[:, (a, b), (0, 1)] for a in (0, 1) for b in (0, 1)], axis=1)
    return ends.area.centre + local @ _turned(np.array(ends.area.yaw)).T, np.asarray((low <= high).all(axis=1))


def _turned(yaws: Array) -> Array:
    """Rotation matrices (..., 2, 2) of yaws (...) [rad]."""
    c, s = np.cos(yaws), np.sin(yaws)
    return np.stack((np.stack((c, -s), axis=-1), np.stack((s, c), axis=-1)), axis=-2)


def _sections(body: Body, other: Body, rise: float) -> Iterator[tuple[Array, Array]]:
    """Polygons of a piece of each object at one height, the first (k, 2) about its object's centre, raised by
    `rise` [m], the second (m, 2) where it stands."""
    for one in _largest(body):
        for standing in _largest(other):
            low, high = max(one.lower[2] + rise, standing.lower[2]), min(one.upper[2] + rise, standing.upper[2])
            if high - low < _COMMON:
                continue
            level = (low + high) / 2
            first, second = _section(one, level - rise), _section(standing, level)
            if len(first) and len(second):
                yield first - body.position[:2], second


def _largest(body: Body) -> list[Solid]:
    """Its pieces with the largest outlines."""
    return sorted(body.placed, key=lambda one: -float(ConvexHull(one.outline).volume))[:_LARGEST]


def _section(solid: Solid, level: float) -> Array:
    """Corners (k, 2) of a polygon in a solid at that height, counter-clockwise. (0, 2) if none is known."""
    known = {"box": BOX_CORNERS, "cylinder": _RINGS}
    local = solid.vertices if solid.shape == "hull" else known.get(solid.shape, np.zeros((0, 3))) * solid.half_extents
    points = solid.position + local @ solid.rotation.T
    above, below = points[points[:, 2] >= level], points[points[:, 2] < level]
    share = (level - below[:, None, 2]) / (above[None, :, 2] - below[:, None, 2])
    cut = (below[:, None, :2] + share[..., None] * (above[None, :, :2] - below[:, None, :2])).reshape(-1, 2)
    try:
        return np.asarray(cut[ConvexHull(cut).vertices])
    except (QhullError, ValueError):  # no points, or all on a line
        return np.zeros((0, 2))


def _is_within(centres: Array, moving: Array, standing: Array, margin: float, yaws: Array) -> NDArray[np.bool_]:
    """Whether all centres (k, n, 2) lie within the Minkowski sum of two polygons, at each yaw (k,): (k,).

    Args:
        centres: possible centres of the object at each yaw.
        moving: polygon (a, 2) about this centre, counter-clockwise.
        standing: polygon (b, 2), counter-clockwise.
        margin: least distance [m] to the sum's sides.
        yaws: turns of the polygon about the centre [rad].
    """
    R = _turned(yaws)
    of_standing = np.tile(_normals(standing), (len(yaws), 1, 1))
    of_moving = -_normals(moving) @ R.transpose(0, 2, 1)
    normals = np.concatenate((of_standing, of_moving), axis=1)
    least = (normals @ R @ moving.T).min(axis=2)
    most = (normals @ standing.T).max(axis=2)
    along = (normals @ centres.transpose(0, 2, 1)).max(axis=2)
    return np.asarray((along <= most - least - margin).all(axis=1))


def _normals(corners: Array) -> Array:
    """Outward normals (k, 2) of the sides of a polygon (k, 2), counter-clockwise."""
    sides = np.roll(corners, -1, axis=0) - corners
    return np.column_stack((sides[:, 1], -sides[:, 0])) / np.linalg.norm(sides, axis=1, keepdims=True)
