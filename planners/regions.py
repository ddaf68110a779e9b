"""Regions of supports, and outlines of objects seen from above: data and plain geometry below scenes and goals."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Protocol, TypeAlias, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array: TypeAlias = NDArray[np.float64]

RESTING = 0.005
"""Tolerance [m] of an object's lowest point above or below the face it stands on: contacts are soft."""
EDGE = 0.002
"""Tolerance [m] of an object over the edge of its region."""
_ANGLES = np.arange(24) * (2 * np.pi / 24)
RIM = np.column_stack((np.cos(_ANGLES), np.sin(_ANGLES)))
"""Points (24, 2) on a circle of radius 1: the rim of a round footprint."""
_CORNERS = np.array(list(itertools.product((-1.0, 1.0), repeat=3)))


class GoalError(ValueError):
    """A goal that is invalid in a scene, contradicts itself, or cannot be read. The message says what is valid."""


class Outlined(Protocol):
    """Attributes for the outline of an object, as in `planners.Body`."""

    # fmt: off
    @property
    def shape(self) -> str: ...
    @property
    def half_extents(self) -> Array: ...
    @property
    def position(self) -> Array: ...
    @property
    def rotation(self) -> Array: ...
    @property
    def outline(self) -> Array: ...
    # fmt: on


class Standing(Outlined, Protocol):
    """An object that stands on something and may carry others."""

    # fmt: off
    @property
    def bottom(self) -> float: ...
    @property
    def top(self) -> float: ...
    # fmt: on


StandingT = TypeVar("StandingT", bound=Standing)


@dataclass(frozen=True)
class Region:
    """A named rectangle on a support.

    Attributes:
        name: unique name among regions, supports and objects.
        support: name of the support with this region on its top face.
        centre: x, y [m] in the world.
        half_extents: half extents [m] along its own axes.
        yaw: yaw [rad] of its x axis.
        drop: height [m] from which an object may fall if the gripper does not fit at the bottom, as in a bin.

    Raises:
        GoalError: half extents are not positive, the drop is negative, numbers are not finite, or the name is missing.
    """

    name: str
    support: str
    centre: tuple[float, float]
    half_extents: tuple[float, float]
    yaw: float = 0.0
    drop: float = 0.0

    def __post_init__(self) -> None:
        try:
            for name in ("centre", "half_extents"):
                x, y = getattr(self, name)
                object.__setattr__(self, name, (float(x), float(y)))
            for name in ("yaw", "drop"):
                object.__setattr__(self, name, float(getattr(self, name)))
            numbers = (*self.centre, *self.half_extents, self.yaw, self.drop)
            is_valid = np.isfinite(numbers).all() and min(self.half_extents) > 0 and self.drop >= 0
        except (TypeError, ValueError, OverflowError):
            is_valid = False
        if not is_valid or not is_name(self.name) or not is_name(self.support):
            raise GoalError(
                f"a region needs a name, the name of its support, two finite numbers for its centre, two positive half "
                f"extents, a yaw and a drop of at least 0, not {self!r:.200}"
            )

    @property
    def corners(self) -> Array:
        """Corners (4, 2) [m] in the world, counter-clockwise."""
        signs = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)], dtype=float)
        return np.asarray(self.centre + signs * self.half_extents @ self._axes.T)

    def local(self, points: ArrayLike) -> Array:
        """World points (..., 2) [m] in the region's frame."""
        return np.asarray((np.asarray(points, dtype=float) - self.centre) @ self._axes)

    def contains_points(self, points: ArrayLike) -> NDArray[np.bool_]:
        """Whether world points (..., 2) [m] lie in the region: (...)."""
        return np.asarray((np.abs(self.local(points)) <= self.half_extents).all(axis=-1))

    def touches_disc(self, points: ArrayLike, radius: float) -> NDArray[np.bool_]:
        """Whether discs of that radius [m] at world points (..., 2) overlap the region: (...)."""
        away = np.maximum(np.abs(self.local(points)) - self.half_extents, 0.0)
        return np.asarray(np.hypot(away[..., 0], away[..., 1]) < radius)

    def contains(self, body: Outlined) -> bool:
        """Whether the footprint of an object lies within the region, with tolerance `EDGE`."""
        return bool((np.abs(self.local(footprint(body))) <= np.array(self.half_extents) + EDGE).all())

    def touches(self, body: Outlined) -> bool:
        """Whether the footprint of an object overlaps the region by more than `EDGE`."""
        return overlap(self.corners, footprint(body)) > EDGE

    @property
    def _axes(self) -> Array:
        c, s = math.cos(self.yaw), math.sin(self.yaw)
        return np.array([[c, -s], [s, c]])


def footprint(body: Outlined, margin: float = 0.0) -> Array:
    """Points (k, 2) [m] whose convex hull is the object seen from above, grown by `margin` [m]."""
    if body.shape == "pieces":
        away = body.outline - body.position[:2]
        distance = np.linalg.norm(away, axis=1, keepdims=True)
        return np.asarray(body.position[:2] + away * np.maximum(1 + margin / distance, 0.0))
    grown = np.maximum(np.array(body.half_extents) + margin, 0.0)
    if body.shape == "box":
        return np.asarray(body.position[:2] + _CORNERS * grown @ body.rotation[:2].T)
    axis, rim = body.rotation[:2, 2] * grown[2], RIM * grown[:2] @ body.rotation[:2, :2].T
    if math.hypot(*axis) < EDGE / 2:  # upright: both ends are one circle
        return np.asarray(body.position[:2] + rim)
    return np.concatenate((body.position[:2] + axis + rim, body.position[:2] - axis + rim))


def overlap(one: Array, other: Array) -> float:
    """Smallest overlap [m] of the convex hulls of two point sets (k, 2). Negative values are distances.

    It is measured across the lines between neighbouring points of each set, which is exact for rectangles.
    """
    normals = []
    for points in (one, other):
        sides = np.concatenate([points - points[0], np.roll(points, -1, axis=0) - points])
        length = np.linalg.norm(sides, axis=1)
        sides = sides[length > 1e-9] / length[length > 1e-9, None]
        normals.append(np.column_stack((-sides[:, 1], sides[:, 0])))
    across = np.concatenate(normals)
    a, b = across @ one.T, across @ other.T
    depth = np.minimum(a.max(axis=1) - b.min(axis=1), b.max(axis=1) - a.min(axis=1))
    return float(depth.min())


def is_name(value: object) -> bool:
    """Whether a value can name an object, a support or a region: a string that PDDL can quote."""
    return isinstance(value, str) and bool(value) and '"' not in value


def with_those_on(found: Iterable[StandingT], standing: Sequence[StandingT]) -> list[StandingT]:
    """Objects, and all others that stand on them, directly or on each other."""
    reached = list(found)
    for below in reached:
        reached += [
            body
            for body in standing
            if body not in reached
            and abs(body.bottom - below.top) <= RESTING
            and overlap(footprint(body), footprint(below)) > 0
        ]
    return reached
