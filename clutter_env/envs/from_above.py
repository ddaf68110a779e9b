"""Grasps from above, how near a gripper is to one, and objects in its way, by plain geometry without a planner.

The gripper's fingers open along its own y axis. At the grasp of an object they are opened by a little more than its
width. Another object is in the way if it would be between a finger, or the palm, and its place at the grasp.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

TIP, PALM = 0.024, 0.047
"""[m] from the TCP down to the fingertips and up to the palm, of Fetch's gripper."""
FINGER_DEPTH, FINGER_THICKNESS = 0.0135, 0.014
"""[m] Half a finger along x, and a whole one along y, across which the fingers open."""
PALM_HALF = (0.040, 0.063)
"""[m] Half the palm along x and y."""
FINGER_ROOM = 0.012
"""[m] between the object and each finger before it closes."""
MARGIN = 0.005
"""[m] that stay free beside fingers and palm."""
HELD_BELOW_TOP = 0.025
"""[m] of the TCP below the object's top at the grasp, unless the object is too low for it."""
REACH_SCALE = 5.0
"""[1/m] `Nearness.near` falls to a half at 0.11 m."""
OVER = 0.01
"""[m] of the fingertips above an object, from where the gripper goes down around it."""
AROUND = 0.8
"""Share of the descent from which the object is between the fingers, which may then close."""

Array = NDArray[np.float64]


class Nearness(NamedTuple):
    """Progress of a grasp, each 0 to 1: nearness of the gripper to it, of the object to its place between the fingers,
    and how far they have closed."""

    near: float
    around: float
    closed: float


@dataclass(frozen=True)
class Standing:
    """Objects as they stand: centres (n, 2) [m], half widths (n,) [m] of the circle around each, tops (n,) [m] above
    the table. Absent objects have their top below the table."""

    centres: Array
    half_widths: Array
    tops: Array

    def grasp_height(self, index: int, lowest: float) -> float:
        """[m] of the TCP above the table at the grasp of an object, `lowest` [m] at least."""
        return max(float(self.tops[index]) - HELD_BELOW_TOP, lowest)

    def in_the_way(self, index: int, lowest: float, heading: float = 0.0) -> list[int]:
        """Objects in the way of the grasp of an object from above, the nearest first.

        Args:
            index: of the object to grasp.
            lowest: [m] height of the TCP above the table, at least.
            heading: [rad] of the gripper's x axis in the frame of the centres.
        """
        height = self.grasp_height(index, lowest)
        beside = self._gaps(index, heading, (FINGER_DEPTH, self.outer_half(index)))
        below = self._gaps(index, heading, PALM_HALF)
        is_hit = (beside < MARGIN) & (self.tops > height - TIP - MARGIN)
        is_hit |= (below < MARGIN) & (self.tops > height + PALM - MARGIN)
        is_hit[index] = False
        distance = np.hypot(*(self.centres - self.centres[index]).T)
        return sorted(np.flatnonzero(is_hit).tolist(), key=lambda other: float(distance[other]))

    def gap(self, index: int, other: int, heading: float = 0.0) -> float:
        """[m] between another object and the gripper at the grasp of an object, whatever their heights."""
        fingers = self._gaps(index, heading, (FINGER_DEPTH, self.outer_half(index)))
        return float(min(fingers[other], self._gaps(index, heading, PALM_HALF)[other]))

    def outer_half(self, index: int) -> float:
        """[m] from the TCP to the outside of each finger before the grasp."""
        return float(self.half_widths[index]) + FINGER_ROOM + FINGER_THICKNESS

    def nearness(self, index: int, lowest: float, tcp: Sequence[float], width: float, widest: float) -> Nearness:
        """Nearness of an open or closing gripper to the grasp of an object.

        Near is measured along the way from above: a gripper low beside an object is far from its grasp. Half of it is
        for fingers that are open enough, or have the object between them.

        Args:
            index: of the object to grasp.
            lowest: [m] height of the TCP above the table, at least.
            tcp: (3,) [m] place of the TCP, its height above the table.
            width: [m] between the fingers.
            widest: [m] between the fingers when they are open.
        """
        (x, y, height), half_width, top = tcp, float(self.half_widths[index]), float(self.tops[index])
        grasp, over = self.grasp_height(index, lowest), top + TIP + OVER
        off_axis = math.hypot(x - self.centres[index, 0], y - self.centres[index, 1])
        is_over = off_axis < half_width / 2 + FINGER_ROOM
        way = abs(height - grasp) if is_over else abs(height - over) + over - grasp
        around = min(max((top + TIP - height) / (top + TIP - grasp), 0.0), 1.0) if is_over else 0.0
        room = width - 2 * half_width
        near = 1.0 - math.tanh(REACH_SCALE * (off_axis + way))
        if around > AROUND:
            most = max(widest - 2 * half_width, FINGER_ROOM)
            return Nearness(near, around, 1.0 - min(max(room / most, 0.0), 1.0))
        return Nearness(near * (1.0 + min(max(room / (2 * FINGER_ROOM), 0.0), 1.0)) / 2, around, 0.0)

    def _gaps(self, index: int, heading: float, half: tuple[float, float]) -> Array:
        """(n,) [m] between each object and a rectangle around one of them, negative where they overlap."""
        offsets = self.centres - self.centres[index]
        cosine, sine = math.cos(heading), math.sin(heading)
        along = np.abs(cosine * offsets[:, 0] + sine * offsets[:, 1]) - half[0]
        across = np.abs(cosine * offsets[:, 1] - sine * offsets[:, 0]) - half[1]
        outside = np.hypot(np.maximum(along, 0.0), np.maximum(across, 0.0))
        return np.asarray(outside + np.minimum(np.maximum(along, across), 0.0) - self.half_widths)
