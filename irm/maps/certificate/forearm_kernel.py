"""The directions of the forearm that an arm with the structure of Fetch's arm may take over a box of wrist centres.

The wrist flex is the angle between forearm and approach axis. So a pose is in reach if there is a forearm, for some
torso height and pan angle, whose direction is at most the flex limit away from the approach. Directions are unit
vectors with x along the bearing of the wrist centre and z up; the elbow is in the arm's plane, which is at -turn.
"""

from __future__ import annotations

from math import acos, pi, sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from irm.arm.intervals import cosine_range, products
from irm.arm.plane_bounds import SLACK, LiftBounds, WristBox, lift_bounds, lift_of_branch
from irm.compilation import njit

__all__ = ["Cone", "forearm_cone"]

Floats = NDArray[np.float64]


class Cone(NamedTuple):
    """All directions of the forearm over a box: `x`, `y`, `z` of their middle, and the largest angle from it `radius`
    [rad]; `is_possible`: whether there is any; `is_certain`: whether every wrist centre of the box has one."""

    is_possible: bool
    is_certain: bool
    x: float
    y: float
    z: float
    radius: float


@njit(cache=True)
def forearm_cone(
    links: Floats, lower: Floats, upper: Floats, box: WristBox, branch: int, cuts: tuple[int, int, int]
) -> Cone:
    """The cone around the forearms of one branch of the elbow, 0 or 1, over a box of wrist centres.

    Bounds are computed for each part of the box, which is cut into `cuts` parts in rho, turn and height.
    """
    parts = np.empty((cuts[0] * cuts[1] * cuts[2], 4))
    found, is_certain = 0, True
    rho, turn = (box.rho1 - box.rho0) / cuts[0], (box.turn1 - box.turn0) / cuts[1]
    height = (box.height1 - box.height0) / cuts[2]
    for i in range(cuts[0]):
        for j in range(cuts[1]):
            for k in range(cuts[2]):
                part = WristBox(
                    box.rho0 + i * rho,
                    box.rho0 + (i + 1) * rho,
                    box.turn0 + j * turn,
                    box.turn0 + (j + 1) * turn,
                    box.height0 + k * height,
                    box.height0 + (k + 1) * height,
                )
                one = _cone_of_part(links, lower, upper, part, branch)
                is_certain = is_certain and one.is_certain
                if one.is_possible:
                    parts[found, 0], parts[found, 1], parts[found, 2], parts[found, 3] = one.x, one.y, one.z, one.radius
                    found += 1
    if found == 0:
        return Cone(False, False, 0.0, 0.0, 0.0, 0.0)
    return _around(parts[:found], is_certain)


@njit(cache=True)
def _around(parts: Floats, is_certain: bool) -> Cone:
    """A cone that contains all cones of `parts` (n, 4), rows of x, y, z, radius."""
    x, y, z = parts[:, 0].sum(), parts[:, 1].sum(), parts[:, 2].sum()
    length = sqrt(x * x + y * y + z * z)
    if length < SLACK:
        return Cone(True, is_certain, 1.0, 0.0, 0.0, pi)
    x, y, z = x / length, y / length, z / length
    radius = 0.0
    for k in range(parts.shape[0]):
        cosine = x * parts[k, 0] + y * parts[k, 1] + z * parts[k, 2]
        radius = max(radius, parts[k, 3] + acos(min(1.0, max(-1.0, cosine))))
    return Cone(True, is_certain, x, y, z, min(pi, radius))


@njit(cache=True)
def _cone_of_part(links: Floats, lower: Floats, upper: Floats, box: WristBox, branch: int) -> Cone:
    """The cone over a small box, by interval arithmetic."""
    bounds: LiftBounds = lift_bounds(links, upper, box)
    if not bounds.is_possible:
        return Cone(False, False, 0.0, 0.0, 0.0, 0.0)
    low, high = lift_of_branch(bounds, branch)
    lift0, lift1, is_certain = pi, -pi, False
    for turn in range(-1, 2):
        start, end = low + 2.0 * pi * turn, high + 2.0 * pi * turn
        if max(start, lower[2]) <= min(end, upper[2]) + SLACK:
            lift0, lift1 = min(lift0, max(start, lower[2])), max(lift1, min(end, upper[2]))
            is_certain = is_certain or (bounds.is_certain and start >= lower[2] and end <= upper[2])
    if lift0 > lift1 + 2.0 * SLACK:
        return Cone(False, False, 0.0, 0.0, 0.0, 0.0)
    return _directions(links, box, lift0 - SLACK, lift1 + SLACK, is_certain)


@njit(cache=True)
def _directions(links: Floats, box: WristBox, lift0: float, lift1: float, is_certain: bool) -> Cone:
    """The cone of the forearm, given the range of the lift angle: wrist centre - elbow, which has length L2."""
    L1, L2 = links[4], links[5]
    cosine = cosine_range(lift0, lift1)
    sine = cosine_range(lift0 - 0.5 * pi, lift1 - 0.5 * pi)
    ahead0, ahead1 = links[2] + L1 * cosine[0], links[2] + L1 * cosine[1]
    c0, c1 = cosine_range(box.turn0, box.turn1)
    s0, s1 = cosine_range(box.turn0 - 0.5 * pi, box.turn1 - 0.5 * pi)
    level0, level1 = products(ahead0, ahead1, c0, c1)
    side0, side1 = products(ahead0, ahead1, s0, s1)
    x0, x1 = box.rho0 - level1, box.rho1 - level0
    z0, z1 = box.height0 + L1 * sine[0], box.height1 + L1 * sine[1]
    x, y, z = 0.5 * (x0 + x1), 0.5 * (side0 + side1), 0.5 * (z0 + z1)
    off2 = 0.25 * ((x1 - x0) * (x1 - x0) + (side1 - side0) * (side1 - side0) + (z1 - z0) * (z1 - z0))
    length = sqrt(x * x + y * y + z * z)
    if length < SLACK:
        return Cone(True, is_certain, 1.0, 0.0, 0.0, pi)
    cosine_off = (length * length + L2 * L2 - off2) / (2.0 * length * L2)
    radius = acos(min(1.0, max(-1.0, cosine_off))) + SLACK
    return Cone(True, is_certain, x / length, y / length, z / length, radius)
