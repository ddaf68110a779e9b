"""Interval arithmetic of angles and products, compiled: bounds that hold for every value between two ends."""

from __future__ import annotations

from math import atan2, ceil, cos, floor, pi

from irm.arm.angles import wrap
from irm.compilation import njit

__all__ = ["bearing_range", "cosine_range", "products"]


@njit(cache=True)
def cosine_range(low: float, high: float) -> tuple[float, float]:
    """Smallest and largest cosine of the angles from `low` to `high`."""
    at_low, at_high = cos(low), cos(high)
    smallest, largest = min(at_low, at_high), max(at_low, at_high)
    if floor(high / (2.0 * pi)) >= ceil(low / (2.0 * pi)):
        largest = 1.0
    if floor((high - pi) / (2.0 * pi)) >= ceil((low - pi) / (2.0 * pi)):
        smallest = -1.0
    return smallest, largest


@njit(cache=True)
def bearing_range(x0: float, x1: float, z0: float, z1: float) -> tuple[float, float]:
    """Smallest and largest atan2(z, x) over a rectangle, continuous across ±π."""
    if x0 <= 0.0 <= x1 and z0 <= 0.0 <= z1:
        return -pi, pi
    middle = atan2(0.5 * (z0 + z1), 0.5 * (x0 + x1))
    low, high = 0.0, 0.0
    for x in (x0, x1):
        for z in (z0, z1):
            off = wrap(atan2(z, x) - middle)
            low, high = min(low, off), max(high, off)
    return middle + low, middle + high


@njit(cache=True)
def products(a0: float, a1: float, b0: float, b1: float) -> tuple[float, float]:
    """Smallest and largest product of two intervals."""
    p, q, r, s = a0 * b0, a0 * b1, a1 * b0, a1 * b1
    return min(p, q, r, s), max(p, q, r, s)
