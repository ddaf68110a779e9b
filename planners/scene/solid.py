"""Convex solids: pieces of objects, and static obstacles. Immutable."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Literal, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import ConvexHull, QhullError

Array = NDArray[np.float64]
SolidShape = Literal["box", "cylinder", "capsule", "sphere", "ellipsoid", "hull"]

FLOOR = "floor"
"""Name of the floor as a support. It is no static obstacle, and every scene has it."""
_EQUAL_EXTENTS = {"cylinder": (0, 1), "capsule": (0, 1), "sphere": (0, 1, 2)}
"""Half extents that must be equal, because the solid is round about its z axis or about every axis."""
_SAME = 1e-9
"""[m] Rounding of lengths that must be equal."""
LEVEL = 1e-6
"""Rounding of the entries of a rotation matrix. An axis this near to the vertical is vertical."""
_SIDES = 24
"""Sides of the polygon around a round solid. Its corners are 0.9% of the radius away from the circle."""
BOX_CORNERS = np.array(list(itertools.product((-1.0, 1.0), repeat=3)))
_AROUND = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)])
"""Corners of a rectangle, counter-clockwise."""


class SceneError(ValueError):
    """An impossible scene: wrong shapes, duplicate names, overlapping objects, a robot inside a static obstacle."""


def frozen(values: ArrayLike, shape: tuple[int, ...], what: str) -> NDArray[np.float64]:
    """Make a read-only copy. Raises `SceneError` if it has another shape or is not finite."""
    array = np.array(values, dtype=float)
    if array.shape != shape or not np.isfinite(array).all():
        raise SceneError(f"{what} must be finite with shape {shape}, not {array!r}")
    array.setflags(write=False)
    return array


def _around(elevations: ArrayLike) -> Array:
    """Unit vectors (k, 3) at elevations [rad], `_SIDES` about the z axis at each, a single one for a pole."""
    rows = []
    for elevation in np.asarray(elevations, dtype=float):
        turns = np.arange(_SIDES if abs(elevation) < 1.5 else 1) * (2 * np.pi / _SIDES)
        level, up = np.cos(elevation), np.full(len(turns), np.sin(elevation))
        rows.append(np.column_stack((level * np.cos(turns), level * np.sin(turns), up)))
    return np.concatenate(rows)


_BETWEEN = np.pi / 12
"""[rad] Step between the elevations of the normals of a sphere."""
_FACES = np.concatenate((np.eye(3), -np.eye(3)))
_AROUND_CYLINDER = _around((0.0, -np.pi / 2, np.pi / 2))
_ROUND = _around(_BETWEEN * np.arange(-6.0, 7.0))
"""Normals of the planes around boxes, cylinders and other round solids."""


@dataclass(frozen=True, eq=False)
class Solid:
    """Convex solid in a frame: the world for a static obstacle, or the object's frame for a piece.

    Attributes:
        name: unique among its kind.
        position: (3,) centre of the box around the solid, in the frame [m].
        half_extents: (3,) half extents of this box along the solid's own axes [m]. A cylinder has (radius, radius, half
            height), a capsule the same including its caps, a sphere (radius, radius, radius), an ellipsoid its
            semi-axes.
        shape: "box", "cylinder", "capsule", "sphere", "ellipsoid" or "hull" (the convex hull of `vertices`).
        rotation: (3, 3) R_frame_solid.
        vertices: (n, 3) corners of a hull relative to `position`, along its own axes [m]. (0, 3) for other shapes.

    Raises:
        SceneError: an array has the wrong shape or is not finite, or the half extents do not fit the shape.
    """

    name: str
    position: Array
    half_extents: Array
    shape: SolidShape = "box"
    rotation: Array = field(default_factory=lambda: np.eye(3))
    vertices: Array = field(default_factory=lambda: np.zeros((0, 3)))

    _KIND = "solid"

    def __post_init__(self) -> None:
        count = len(self.vertices)
        sizes = {"position": (3,), "half_extents": (3,), "rotation": (3, 3), "vertices": (count, 3)}
        for name, size in sizes.items():
            object.__setattr__(self, name, frozen(getattr(self, name), size, f"{name} of {self.name!r}"))
        if self.shape not in ("box", "hull", "ellipsoid", *_EQUAL_EXTENTS):
            known = "box, capsule, cylinder, ellipsoid, hull, sphere"
            raise SceneError(f"{self._KIND} {self.name!r} is a {self.shape!r}; known shapes: {known}")
        half = self.half_extents
        if (half <= 0).any():
            raise SceneError(f"{self._KIND} {self.name!r} needs positive half extents, not {half.tolist()}")
        if np.abs(self.rotation @ self.rotation.T - np.eye(3)).max() > LEVEL or np.linalg.det(self.rotation) < 0:
            raise SceneError(f"{self._KIND} {self.name!r} needs a rotation matrix")
        if not self._extents_fit():
            raise SceneError(f"half extents {half.tolist()} of {self._KIND} {self.name!r} fit no {self.shape}")

    def _extents_fit(self) -> bool:
        half = self.half_extents
        if self.shape == "hull":
            return len(self.vertices) > 3 and bool(np.abs(np.abs(self.vertices).max(axis=0) - half).max() < _SAME)
        is_round = np.ptp(half[list(_EQUAL_EXTENTS.get(self.shape, (0,)))]) < _SAME
        return bool(is_round and not (self.shape == "capsule" and half[2] < half[0] - _SAME) and not len(self.vertices))

    @classmethod
    def hull(
        cls, name: str, points: ArrayLike, position: ArrayLike = (0, 0, 0), rotation: ArrayLike | None = None
    ) -> Self:
        """Make the convex hull of points (n, 3) [m], given in a frame at `position` (3,) with axes `rotation` (3, 3).

        Raises:
            SceneError: the points lie in one plane.
        """
        corners, R = np.asarray(points, dtype=float), np.eye(3) if rotation is None else np.asarray(rotation, float)
        try:
            corners = corners[ConvexHull(corners).vertices]
        except (QhullError, ValueError) as error:
            raise SceneError(f"the {len(corners)} points of {cls._KIND} {name!r} enclose no volume") from error
        low, high = corners.min(axis=0), corners.max(axis=0)
        centre = (low + high) / 2
        return cls(name, np.asarray(position) + R @ centre, (high - low) / 2, "hull", R, corners - centre)

    def reach(self, directions: Array) -> Array:
        """Distances (k,) from `position` to the farthest touching planes in directions (k, 3) of unit length [m]."""
        local, half = directions @ self.rotation, self.half_extents
        if self.shape == "box":
            return np.asarray(np.abs(local) @ half)
        if self.shape == "hull":
            return np.asarray((local @ self.vertices.T).max(axis=1))
        if self.shape == "cylinder":
            return np.asarray(np.abs(local[:, 2]) * half[2] + np.hypot(local[:, 0], local[:, 1]) * half[0])
        if self.shape == "capsule":
            return np.asarray(np.abs(local[:, 2]) * (half[2] - half[0]) + half[0])
        return np.linalg.norm(local * half, axis=1)

    @cached_property
    def lower(self) -> Array:
        """Smallest coordinates (3,) of its points in the frame [m]."""
        return self.position - self.reach(-np.eye(3))

    @cached_property
    def upper(self) -> Array:
        """Largest coordinates (3,) of its points in the frame [m]."""
        return self.position + self.reach(np.eye(3))

    @cached_property
    def extent(self) -> Array:
        """Half extents (3,) of the smallest bounding box about `position`, along the axes of the frame [m]."""
        axes = np.eye(3)
        return np.maximum(self.reach(axes), self.reach(-axes))

    def half_extent_along(self, direction: ArrayLike) -> float:
        """Distance from `position` to the farther touching plane perpendicular to a `direction` (3,) [m]."""
        along = np.asarray(direction, dtype=float)
        return float(self.reach(np.stack((along, -along))).max())

    @property
    def is_axis_aligned(self) -> bool:
        """Whether its own axes are those of the frame."""
        return bool(np.abs(self.rotation - np.eye(3)).max() < LEVEL)

    @cached_property
    def outline(self) -> Array:
        """Corners (k, 2), in order, of a convex polygon that contains it seen from above [m].

        It is exact for boxes and hulls. For round solids its sides touch the outline.
        """
        if self.shape == "box" and self.is_axis_aligned:
            return np.asarray(_AROUND * self.half_extents[:2] + self.position[:2])
        if self.shape in ("box", "hull"):
            corners = BOX_CORNERS * self.half_extents if self.shape == "box" else self.vertices
            points = self.position[:2] + corners @ self.rotation[:2].T
            return np.asarray(points[ConvexHull(points).vertices])
        angles = np.arange(_SIDES) * (2 * np.pi / _SIDES)
        normals = np.column_stack((np.cos(angles), np.sin(angles)))
        reach = self.reach(np.column_stack((normals, np.zeros(_SIDES))))
        sides = zip(normals, np.roll(normals, -1, axis=0), reach, np.roll(reach, -1), strict=True)
        return self.position[:2] + np.array([np.linalg.solve((one, other), (a, b)) for one, other, a, b in sides])

    @cached_property
    def corners(self) -> Array:
        """Points (k, 3) in the frame whose convex hull contains it, exact for boxes and hulls [m]."""
        half, ring = self.half_extents, 1.0 / np.cos(np.pi / _SIDES)
        if self.shape == "hull":
            local = self.vertices
        elif self.shape == "box":
            local = BOX_CORNERS * half
        elif self.shape == "cylinder":
            edge = _around((0.0,)) * ring
            local = np.concatenate([(edge + level) * half for level in ((0.0, 0.0, -1.0), (0.0, 0.0, 1.0))])
        else:
            cap = _ROUND * ring / np.cos(_BETWEEN / 2)
            along = np.array([0.0, 0.0, half[2] - half[0]]) if self.shape == "capsule" else np.zeros(3)
            cap = cap * half[[0, 0, 0]] if self.shape == "capsule" else cap * half
            local = np.concatenate((cap - along, cap + along))
        return self.position + local @ self.rotation.T

    @cached_property
    def planes(self) -> tuple[Array, Array]:
        """Outward normals (k, 3) of planes around it, and their distances (k,) from the frame's origin [m].

        The space behind all planes is the solid. It is exact for boxes and hulls, and a polyhedron around round solids.
        """
        if self.shape == "hull":
            equations = ConvexHull(self.corners).equations
            return equations[:, :3], -equations[:, 3]
        normals = {"box": _FACES, "cylinder": _AROUND_CYLINDER}.get(self.shape, _ROUND) @ self.rotation.T
        return normals, normals @ self.position + self.reach(normals)

    @cached_property
    def volume(self) -> float:
        """Volume of the hull of `corners` [m³]."""
        return float(ConvexHull(self.corners).volume)

    def moved(self, rotation: Array, position: Array) -> Self:
        """Transform a solid from a frame at `position` (3,) with axes `rotation` (3, 3) to the outer frame."""
        return replace(self, position=position + rotation @ self.position, rotation=rotation @ self.rotation)

    def cut(self, origins: Array, directions: Array) -> tuple[Array, Array, Array, Array]:
        """Intersect it with lines through `origins` (n, 3) along unit vectors `directions` (n, 3).

        Returns:
            Distances (n,) [m] along each line to its entry and exit, and the outward normals (n, 3) of the planes
            there, see `planes`. Where a line misses the solid, the distance to the entry is at least that to the exit.
        """
        normals, away = self.planes
        rate, gap = directions @ normals.T, away - origins @ normals.T
        with np.errstate(divide="ignore", invalid="ignore"):
            crossing = gap / rate
        is_along = np.abs(rate) < LEVEL
        entries = np.where(is_along | (rate > 0), -np.inf, crossing)
        exits = np.where(is_along | (rate < 0), np.inf, crossing)
        enter, leave = entries.max(axis=1), exits.min(axis=1)
        enter[(is_along & (gap < 0)).any(axis=1)] = np.inf
        return enter, leave, normals[entries.argmax(axis=1)], normals[exits.argmin(axis=1)]


@dataclass(frozen=True, eq=False)
class StaticObstacle(Solid):
    """Convex solid that the robot must not touch or move: a table top, a wall, a pillar, a bottle.

    Its frame is the world. Its name is unique among the static obstacles of a scene.

    Attributes:
        body: name of its body, "" for none. A hollow body is a place for objects.
    """

    body: str = ""

    _KIND = "static obstacle"

    @property
    def top(self) -> float:
        """[m] height of the highest point."""
        return float(self.upper[2])

    @cached_property
    def has_level_top(self) -> bool:
        """Whether objects can stand on it: a box with a vertical axis, or an upright cylinder."""
        vertical = np.abs(self.rotation[2]) > 1 - LEVEL
        return bool(vertical.any() if self.shape == "box" else self.shape == "cylinder" and vertical[2])

    def is_under(self, points: Array) -> NDArray[np.bool_]:
        """Whether points (..., 2) [m] lie above or below its outline, for an upright cylinder its circle."""
        away = points - self.position[:2]
        if self.shape == "cylinder" and self.has_level_top:
            return np.asarray(np.hypot(away[..., 0], away[..., 1]) <= self.half_extents[0])
        corners, sides = self._sides
        turns = sides[:, 0] * (away[..., 1, None] - corners[:, 1]) - sides[:, 1] * (away[..., 0, None] - corners[:, 0])
        return np.asarray((turns >= 0).all(axis=-1))

    @cached_property
    def _sides(self) -> tuple[Array, Array]:
        """Corners (k, 2) of its outline relative to `position`, and the sides that begin there [m]."""
        corners = self.outline - self.position[:2]
        return corners, np.roll(corners, -1, axis=0) - corners
