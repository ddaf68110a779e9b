"""Exact Euclidean distance transform, compiled (Felzenszwalb & Huttenlocher 2012: lower envelopes of parabolas)."""

from __future__ import annotations

from math import sqrt

import numpy as np
from numpy.typing import NDArray

from irm.compilation import njit

__all__ = ["distance_to_seeds"]

Floats = NDArray[np.float64]

_FAR = 1e12
"""Squared distance in cells where there is no seed."""


@njit(cache=True, inline="always")
def _crossing(f: Floats, p: int, q: int) -> float:
    """Where the parabolas of two sites intersect; always above -_FAR."""
    return float(((f[q] + q * q) - (f[p] + p * p)) / (2.0 * (q - p)))


@njit(cache=True)
def _transform_row(f: Floats, out: Floats, site: NDArray[np.int64], edge: Floats) -> None:
    """out[q] = min over p of (q - p)² + f[p]."""
    n = f.shape[0]
    last = 0
    site[0] = 0
    edge[0], edge[1] = -_FAR, _FAR
    for q in range(1, n):
        crossing = _crossing(f, site[last], q)
        while crossing <= edge[last]:
            last -= 1
            crossing = _crossing(f, site[last], q)
        last += 1
        site[last] = q
        edge[last], edge[last + 1] = crossing, _FAR
    k = 0
    for q in range(n):
        while edge[k + 1] < q:
            k += 1
        out[q] = (q - site[k]) ** 2 + f[site[k]]


@njit(cache=True)
def distance_to_seeds(seeds: NDArray[np.bool_], resolution: float) -> NDArray[np.float32]:
    """Distance from every cell's centre to the nearest seed's centre [m]; very large if there is no seed."""
    width, depth = seeds.shape
    size = max(width, depth)
    squared = np.empty((width, depth))
    row, out, edge = np.empty(size), np.empty(size), np.empty(size + 1)
    site = np.empty(size, np.int64)
    for i in range(width):
        for j in range(depth):
            row[j] = 0.0 if seeds[i, j] else _FAR
        _transform_row(row[:depth], out[:depth], site, edge)
        for j in range(depth):
            squared[i, j] = out[j]
    result = np.empty((width, depth), np.float32)
    for j in range(depth):
        for i in range(width):
            row[i] = squared[i, j]
        _transform_row(row[:width], out[:width], site, edge)
        for i in range(width):
            result[i, j] = sqrt(out[i]) * resolution
    return result
