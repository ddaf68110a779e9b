"""What stands about a contact: the furniture of the layout as boxes, other objects as upright cylinders."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clutter_env.learning.contacts.cylinders import Cylinders
from clutter_env.learning.contacts.reading import Reading, planar_pose
from clutter_env.scene.layout import Layout, furniture

__all__ = ["Surroundings"]

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Surroundings:
    """m boxes and n objects in the world.

    Attributes:
        centre, half: (m, 3) [m] of the boxes.
        objects: the n objects.
    """

    centre: Array
    half: Array
    objects: Cylinders

    @classmethod
    def of(cls, layout: Layout, reading: Reading, index: int) -> Surroundings:
        """Around object `index`, which is left out."""
        boxes = furniture(layout)
        return cls(
            centre=np.array([box.position for box in boxes]),
            half=np.array([box.half_extents for box in boxes]),
            objects=Cylinders.beside(reading, index, planar_pose(reading.base)),
        )

    def distance(self, points: Array) -> Array:
        """(...) [m] from points (..., 3) to the nearest surface, 0 inside."""
        outside = np.maximum(np.abs(points[..., None, :] - self.centre) - self.half, 0.0)
        return np.minimum(np.linalg.norm(outside, axis=-1).min(axis=-1), self.objects.distance(points))

    def contain(self, points: Array) -> bool:
        """Whether any of the points (..., 3) is inside a box or an object for certain."""
        is_in_box = (np.abs(points[..., None, :] - self.centre) < self.half).all(axis=-1).any()
        return bool(is_in_box) or self.objects.contain(points)
