"""Static obstacles: convex solids that neither the robot nor anything else moves. Immutable, in world coordinates."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, field
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import ConvexHull, QhullError

from planners.scene.bodies import SceneError, frozen

Array = NDArray[np.float64]
StaticShape = Literal["box", "cylinder", "capsule", "sphere", "ellipsoid", "hull"]

FLOOR = "floor"
"""Name of the floor as a support, which is no static obstacle: every scene has it."""
_EQUAL_EXTENTS = {"cylinder": (0, 1), "capsule": (0, 1), "sphere": (0, 1, 2)}
"""Half extents that must be equal, since the solid is round about its z axis or about every axis."""
_SAME = 1e-9
"""[m] Rounding of lengths that must be equal."""
_LEVEL = 1e-6
"""Rounding of the entries of a rotation matrix: an axis this near to the vertical is vertical."""
_SIDES = 24
"""Sides of the polygon around the outline of a round solid: its corners are 0.9% of the radius away from a circle."""
_CORNERS = np.array(list(itertools.product((-1.0, 1.0), repeat=3)))
_AROUND = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)])
"""Corners of a rectangle, counter-clockwise."""


@dataclass(frozen=True, eq=False)
class StaticObstacle:
    """A convex solid that stays where it is: a table top, a wall, a pillar, a bottle that the robot must not touch.

    Attributes:
        name: unique among the static obstacles of a scene.
        position: (3,) [m] centre of the box around the solid, in the world.
        half_extents: (3,) [m] of that box along the solid's own axes. A cylinder has (radius, radius, half height), a
            capsule the same with its caps included, a sphere three times its radius, an ellipsoid its semi-axes.
        shape: "box", "cylinder", "capsule", "sphere", "ellipsoid" or "hull" (the convex hull of `vertices`).
        rotation: (3, 3) R_world_obstacle.
        vertices: (n, 3) [m] corners of a hull relative to `position`, along its own axes; (0, 3) for other shapes.

    Raises:
        SceneError: an array has the wrong shape or is not finite, or the half extents do not fit the shape.
    """

    name: str
    position: Array
    half_extents: Array
    shape: StaticShape = "box"
    rotation: Array = field(default_factory=lambda: np.eye(3))
    vertices: Array = field(default_factory=lambda: np.zeros((0, 3)))

    def __post_init__(self) -> None:
        count = len(self.vertices)
        sizes = {"position": (3,), "half_extents": (3,), "rotation": (3, 3), "vertices": (count, 3)}
        for name, size in sizes.items():
            object.__setattr__(self, name, frozen(getattr(self, name), size, f"{name} of {self.name!r}"))
        if self.shape not in ("box", "hull", "ellipsoid", *_EQUAL_EXTENTS):
            known = "box, capsule, cylinder, ellipsoid, hull, sphere"
            raise SceneError(f"static obstacle {self.name!r} is a {self.shape!r}; known shapes: {known}")
        half = self.half_extents
        if (half <= 0).any():
            raise SceneError(f"static obstacle {self.name!r} needs positive half extents, not {half.tolist()}")
        if np.abs(self.rotation @ self.rotation.T - np.eye(3)).max() > _LEVEL or np.linalg.det(self.rotation) < 0:
            raise SceneError(f"static obstacle {self.name!r} needs a rotation matrix")
        if not self._extents_fit():
            raise SceneError(f"half extents {half.tolist()} of static obstacle {self.name!r} fit no {self.shape}")

    def _extents_fit(self) -> bool:
        half = self.half_extents
        if self.shape == "hull":
            return len(self.vertices) > 3 and bool(np.abs(np.abs(self.vertices).max(axis=0) - half).max() < _SAME)
        is_round = np.ptp(half[list(_EQUAL_EXTENTS.get(self.shape, (0,)))]) < _SAME
        return bool(is_round and not (self.shape == "capsule" and half[2] < half[0] - _SAME) and not len(self.vertices))

    @classmethod
    def hull(
        cls, name: str, points: ArrayLike, position: ArrayLike = (0, 0, 0), rotation: ArrayLike | None = None
    ) -> StaticObstacle:
        """The convex hull of points (n, 3) [m] given in a frame at `position` (3,) with axes `rotation` (3, 3).

        Raises:
            SceneError: the points lie in one plane.
        """
        corners, R = np.asarray(points, dtype=float), np.eye(3) if rotation is None else np.asarray(rotation, float)
        try:
            corners = corners[ConvexHull(corners).vertices]
        except (QhullError, ValueError) as error:
            raise SceneError(f"the {len(corners)} points of static obstacle {name!r} enclose no volume") from error
        low, high = corners.min(axis=0), corners.max(axis=0)
        centre = (low + high) / 2
        return cls(name, np.asarray(position) + R @ centre, (high - low) / 2, "hull", R, corners - centre)

    def _reach(self, directions: Array) -> Array:
        """(k,) [m] from `position` to the farthest planes perpendicular to world directions (k, 3) of unit length."""
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
        """(3,) [m] smallest coordinates of its points in the world."""
        return self.position - self._reach(-np.eye(3))

    @cached_property
    def upper(self) -> Array:
        """(3,) [m] largest coordinates of its points in the world."""
        return self.position + self._reach(np.eye(3))

    @cached_property
    def extent(self) -> Array:
        """(3,) [m] half extents of the smallest box about `position`, along the world's axes, that contains it."""
        axes = np.eye(3)
        return np.maximum(self._reach(axes), self._reach(-axes))

    def half_extent_along(self, direction: ArrayLike) -> float:
        """[m] from `position` to the farther plane perpendicular to a world `direction` (3,) that touches the solid."""
        along = np.asarray(direction, dtype=float)
        return float(self._reach(np.stack((along, -along))).max())

    @property
    def top(self) -> float:
        """[m] height of the highest point."""
        return float(self.upper[2])

    @property
    def is_axis_aligned(self) -> bool:
        """Whether its own axes are those of the world."""
        return bool(np.abs(self.rotation - np.eye(3)).max() < _LEVEL)

    @cached_property
    def has_level_top(self) -> bool:
        """Whether objects can stand on it: a box with a vertical axis, or an upright cylinder."""
        vertical = np.abs(self.rotation[2]) > 1 - _LEVEL
        return bool(vertical.any() if self.shape == "box" else self.shape == "cylinder" and vertical[2])

    @cached_property
    def outline(self) -> Array:
        """(k, 2) [m] corners, in order, of a convex polygon that contains it seen from above.

        It is exact for boxes and hulls; for round solids its sides touch the outline.
        """
        if self.shape == "box" and self.is_axis_aligned:
            return np.asarray(_AROUND * self.half_extents[:2] + self.position[:2])
        if self.shape in ("box", "hull"):
            corners = _CORNERS * self.half_extents if self.shape == "box" else self.vertices
            points = self.position[:2] + corners @ self.rotation[:2].T
            return np.asarray(points[ConvexHull(points).vertices])
        angles = np.arange(_SIDES) * (2 * np.pi / _SIDES)
        normals = np.column_stack((np.cos(angles), np.sin(angles)))
        reach = self._reach(np.column_stack((normals, np.zeros(_SIDES))))
        sides = zip(normals, np.roll(normals, -1, axis=0), reach, np.roll(reach, -1), strict=True)
        return self.position[:2] + np.array([np.linalg.solve((one, other), (a, b)) for one, other, a, b in sides])

    def is_under(self, points: Array) -> NDArray[np.bool_]:
        """Which points (..., 2) [m] lie above or below its outline; of an upright cylinder, its circle."""
        away = points - self.position[:2]
        if self.shape == "cylinder" and self.has_level_top:
            return np.asarray(np.hypot(away[..., 0], away[..., 1]) <= self.half_extents[0])
        corners = self.outline - self.position[:2]
        sides = np.roll(corners, -1, axis=0) - corners
        turns = sides[:, 0] * (away[..., 1, None] - corners[:, 1]) - sides[:, 1] * (away[..., 0, None] - corners[:, 0])
        return np.asarray((turns >= 0).all(axis=-1))
