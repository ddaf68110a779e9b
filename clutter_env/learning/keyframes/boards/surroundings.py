"""What stands about a contact: the furniture of the layout as boxes, other objects as upright cylinders."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clutter_env.envs.observation import OBSERVATION_LAYOUT
from clutter_env.learning.contacts.reading import Reading, planar_pose
from clutter_env.scene.layout import Layout, furniture

__all__ = ["Surroundings"]

Array = NDArray[np.float64]

_ROW = OBSERVATION_LAYOUT["objects"]


@dataclass(frozen=True, eq=False)
class Surroundings:
    """m boxes and n upright cylinders in the world.

    Attributes:
        centre, half: (m, 3) [m] of the boxes.
        position: (n, 3) [m] centres of the cylinders; `radius`, `height` (n,) [m] their radii and half heights.
        core: (n,) [m] radii within which the objects are in any case: one may be a box.
    """

    centre: Array
    half: Array
    position: Array
    radius: Array
    height: Array
    core: Array

    @classmethod
    def of(cls, layout: Layout, reading: Reading, index: int) -> Surroundings:
        """Around object `index`, which is left out."""
        boxes = furniture(layout)
        rows = reading.objects
        is_other = rows[:, _ROW.index("present")] > 0
        is_other[index] = False
        T = planar_pose(reading.base)
        half = rows[is_other][:, _ROW["half_extents"]]
        return cls(
            centre=np.array([box.position for box in boxes]),
            half=np.array([box.half_extents for box in boxes]),
            position=rows[is_other][:, _ROW["position"]] @ T[:3, :3].T + T[:3, 3],
            radius=half[:, :2].max(axis=1),
            height=half[:, 2],
            core=half[:, :2].min(axis=1),
        )

    def distance(self, points: Array) -> Array:
        """(...) [m] from points (..., 3) to the nearest surface, 0 inside."""
        outside = np.maximum(np.abs(points[..., None, :] - self.centre) - self.half, 0.0)
        nearest = np.linalg.norm(outside, axis=-1).min(axis=-1)
        if not len(self.position):
            return np.asarray(nearest)
        away = points[..., None, :] - self.position
        across = np.maximum(np.linalg.norm(away[..., :2], axis=-1) - self.radius, 0.0)
        above = np.maximum(np.abs(away[..., 2]) - self.height, 0.0)
        return np.minimum(nearest, np.hypot(across, above).min(axis=-1))

    def contain(self, points: Array) -> bool:
        """Whether any of the points (..., 3) is inside a box or an object for certain."""
        if (np.abs(points[..., None, :] - self.centre) < self.half).all(axis=-1).any():
            return True
        away = points[..., None, :] - self.position
        is_beside = np.hypot(away[..., 0], away[..., 1]) < self.core
        return bool((is_beside & (np.abs(away[..., 2]) < self.height)).any())
