"""Bounds of the lift angle over a box of wrist centres, for an arm with the structure of Fetch's arm, compiled.

In the plane that turns with the pan joint (x ahead, z up, origin at the lift axis), the wrist centre v depends on its
distance ρ from the pan axis, on φ = bearing of the wrist centre - pan, and on its height:

    v = (ρ cos φ - shoulder_x, ρ sin φ, v_z)                d² = |v|²
    a = L1 + L2 cos(elbow) = (d² + L1² - L2²) / 2 L1        h² = L2² sin²(elbow) - v_y²
    lift = ∓ atan2(h, a) - atan2(v_z, v_x)
"""

from __future__ import annotations

from math import atan2, cos, pi, sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from irm.arm.intervals import bearing_range, cosine_range
from irm.compilation import njit

__all__ = ["SLACK", "LiftBounds", "WristBox", "lift_bounds", "lift_of_branch"]

Floats = NDArray[np.float64]

SLACK = 1e-9
"""[m], [m²] or [rad] by which a bound must be violated, so that rounding cannot exclude a solution."""


class WristBox(NamedTuple):
    """A box of wrist centres: lowest and highest distance `rho` from the pan axis [m], angle `turn` from the plane of
    the arm [rad], and `height` above the lift axis [m]."""

    rho0: float
    rho1: float
    turn0: float
    turn1: float
    height0: float
    height1: float


class LiftBounds(NamedTuple):
    """What a box of wrist centres allows.

    `is_possible`: whether the lengths of the arm and the elbow's limit allow any of them; `is_certain`: whether they
    allow all; `bend` and `bearing`: smallest and largest value of the two angles of which the lift is the sum [rad].
    """

    is_possible: bool
    is_certain: bool
    bend0: float
    bend1: float
    bearing0: float
    bearing1: float


@njit(cache=True)
def lift_bounds(links: Floats, upper: Floats, box: WristBox) -> LiftBounds:
    """Bounds of the lift angle over a box, in both branches."""
    L1, L2, shoulder = links[4], links[5], links[2]
    z0, z1 = box.height0, box.height1
    c0, c1 = cosine_range(box.turn0, box.turn1)
    s0, s1 = cosine_range(box.turn0 - 0.5 * pi, box.turn1 - 0.5 * pi)
    z_near = 0.0 if z0 <= 0.0 <= z1 else min(abs(z0), abs(z1))
    z_far = max(abs(z0), abs(z1))
    rho = min(box.rho1, max(box.rho0, shoulder * c1))
    near = rho * rho + shoulder * shoulder - 2.0 * rho * shoulder * c1 + z_near * z_near
    far = shoulder * shoulder + z_far * z_far
    far += max(box.rho0 * (box.rho0 - 2.0 * shoulder * c0), box.rho1 * (box.rho1 - 2.0 * shoulder * c0))
    shortest = L1 * L1 + L2 * L2 + 2.0 * L1 * L2 * cos(upper[4])
    longest = (L1 + L2) * (L1 + L2)
    if near > longest + SLACK or far < shortest - SLACK:
        return LiftBounds(False, False, 0.0, 0.0, 0.0, 0.0)
    is_certain = near >= shortest and far <= longest
    near, far = max(near, shortest), min(far, longest)
    a0, a1 = (near + L1 * L1 - L2 * L2) / (2.0 * L1), (far + L1 * L1 - L2 * L2) / (2.0 * L1)
    side_near = 0.0 if s0 <= 0.0 <= s1 else box.rho0 * min(abs(s0), abs(s1))
    side_far = box.rho1 * max(abs(s0), abs(s1))
    widest = L2 * L2 if near <= L1 * L1 + L2 * L2 <= far else max(near - a0 * a0, far - a1 * a1)
    widest -= side_near * side_near
    if widest < -SLACK:
        return LiftBounds(False, False, 0.0, 0.0, 0.0, 0.0)
    narrowest = min(near - a0 * a0, far - a1 * a1) - side_far * side_far
    h0, h1 = sqrt(max(0.0, narrowest)), sqrt(max(0.0, widest))
    bend0 = atan2(h0 if a1 > 0.0 else h1, a1)
    bend1 = atan2(h1 if a0 > 0.0 else h0, a0)
    x0 = min(box.rho0 * c0, box.rho1 * c0) - shoulder
    x1 = max(box.rho0 * c1, box.rho1 * c1) - shoulder
    low, high = bearing_range(x0, x1, z0, z1)
    return LiftBounds(True, is_certain and narrowest >= 0.0, bend0, bend1, low, high)


@njit(cache=True)
def lift_of_branch(bounds: LiftBounds, branch: int) -> tuple[float, float]:
    """Smallest and largest lift angle of a branch of the elbow, 0 or 1, without the joint's limits [rad]."""
    if branch == 0:
        return -bounds.bend1 - bounds.bearing1, -bounds.bend0 - bounds.bearing0
    return bounds.bend0 - bounds.bearing1, bounds.bend1 - bounds.bearing0
