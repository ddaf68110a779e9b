"""Where the base stands on its way to a contact under a board and away from it: plain geometry."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from clutter_env.scene.layout import TABLE, Layout, furniture
from planners import Contact, StaticObstacle, drive_out

__all__ = ["Stations", "table_of", "way_points"]

Array = NDArray[np.float64]

_SPACING = 0.02
"""[m] between points on a way at which the robot is compared with what stands about it."""


class Stations:
    """Base poses (3,) at a contact: inside, where the gripper reaches the object; backed off; and outside."""

    def __init__(self, table: StaticObstacle, contact: Contact) -> None:
        self._inside, self._back, self._outside = drive_out(table, contact.base, contact.tcp)

    def at_end(self, phase: str) -> Array:
        """Where the base stands at the end of a phase."""
        if phase in ("enter", "back"):
            return self._back
        return self._inside if phase in ("reach", "close", "lift", "lower", "open") else self._outside


def table_of(layout: Layout) -> StaticObstacle:
    """The table on which objects stand."""
    box = next(box for box in furniture(layout) if box.name == TABLE)
    return StaticObstacle(box.name, np.array(box.position), np.array(box.half_extents))


def way_points(table: StaticObstacle, contact: Contact) -> Array:
    """(w, 2) [m] How far the base is from where it stands at a contact, along the way out, in the world."""
    corners = drive_out(table, contact.base, contact.tcp)[:, :2] - contact.base[:2]
    parts = [
        np.linspace(start, end, max(int(np.ceil(np.linalg.norm(end - start) / _SPACING)), 1) + 1)
        for start, end in pairwise(corners)
    ]
    return np.concatenate(parts)
