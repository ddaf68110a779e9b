"""The objects beside the one of a contact, as upright cylinders."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clutter_env.envs.observation import OBSERVATION_LAYOUT
from clutter_env.learning.contacts.reading import Reading

__all__ = ["Cylinders"]

Array = NDArray[np.float64]

_ROW = OBSERVATION_LAYOUT["objects"]


@dataclass(frozen=True, eq=False)
class Cylinders:
    """n upright cylinders.

    Attributes:
        position: (n, 3) [m] their centres.
        radius, height: (n,) [m] their radii and half heights.
        core: (n,) [m] radii within which the objects are in any case: one may be a box.
    """

    position: Array
    radius: Array
    height: Array
    core: Array

    @classmethod
    def beside(cls, reading: Reading, index: int, T: Array) -> Cylinders:
        """All objects of one observation but object `index`, in the frame into which T (4, 4) leads from the base's."""
        rows = reading.objects
        is_other = rows[:, _ROW.index("present")] > 0
        is_other[index] = False
        half = rows[is_other][:, _ROW["half_extents"]]
        return cls(
            position=rows[is_other][:, _ROW["position"]] @ T[:3, :3].T + T[:3, 3],
            radius=half[:, :2].max(axis=1),
            height=half[:, 2],
            core=half[:, :2].min(axis=1),
        )

    def distance(self, points: Array) -> Array:
        """(...) [m] from points (..., 3) to the nearest surface, 0 inside; infinite without cylinders."""
        away = points[..., None, :] - self.position
        across = np.maximum(np.linalg.norm(away[..., :2], axis=-1) - self.radius, 0.0)
        above = np.maximum(np.abs(away[..., 2]) - self.height, 0.0)
        return np.asarray(np.hypot(across, above).min(axis=-1, initial=np.inf))

    def contain(self, points: Array) -> bool:
        """Whether any of the points (..., 3) is inside an object for certain."""
        away = points[..., None, :] - self.position
        is_beside = np.hypot(away[..., 0], away[..., 1]) < self.core
        return bool((is_beside & (np.abs(away[..., 2]) < self.height)).any())
