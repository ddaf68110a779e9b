"""Manipulability μ of a Jacobian, equation 2 of the paper, compiled.

μ = sqrt(λ_min(A) / λ_max(A)) with A = J Jᵀ. The rows of J mix metres and radians, so μ depends on the unit of length;
here it is the metre throughout: linear rows in m per unit of joint motion, angular rows in rad.
"""

from __future__ import annotations

from math import sqrt

import numpy as np
from numpy.typing import ArrayLike, NDArray

from irm.compilation import njit

__all__ = ["condition", "manipulability"]

Floats = NDArray[np.float64]

_SWEEPS = 30
"""Largest number of QL iterations per eigenvalue; three are usual."""


@njit(cache=True)
def _tridiagonalise(A: Floats, diagonal: Floats, beside: Floats) -> None:
    """Householder reduction of a symmetric matrix, in place: the tridiagonal result has the eigenvalues of A."""
    n = A.shape[0]
    u = np.empty(n)
    w = np.empty(n)
    for k in range(n - 2):
        tail = 0.0
        for i in range(k + 2, n):
            tail += A[i, k] * A[i, k]
        diagonal[k] = A[k, k]
        if tail == 0.0:
            beside[k] = A[k + 1, k]
            continue
        norm = sqrt(tail + A[k + 1, k] * A[k + 1, k])
        alpha = -norm if A[k + 1, k] > 0.0 else norm
        beside[k] = alpha
        u[k + 1] = A[k + 1, k] - alpha
        for i in range(k + 2, n):
            u[i] = A[i, k]
        h = norm * norm - A[k + 1, k] * alpha
        dot = 0.0
        for i in range(k + 1, n):
            total = 0.0
            for j in range(k + 1, n):
                total += A[i, j] * u[j]
            w[i] = total / h
            dot += u[i] * w[i]
        for i in range(k + 1, n):
            w[i] -= 0.5 * dot / h * u[i]
        for i in range(k + 1, n):
            for j in range(k + 1, n):
                A[i, j] -= u[i] * w[j] + w[i] * u[j]
    diagonal[n - 2], diagonal[n - 1] = A[n - 2, n - 2], A[n - 1, n - 1]
    beside[n - 2], beside[n - 1] = A[n - 1, n - 2], 0.0


@njit(cache=True)
def _eigenvalues(d: Floats, e: Floats) -> None:
    """Implicit QL on a tridiagonal matrix, in place: eigenvalues into `d`, unsorted."""
    n = d.shape[0]
    for first in range(n):
        for _ in range(_SWEEPS):
            m = first
            while m < n - 1:
                scale = abs(d[m]) + abs(d[m + 1])
                if abs(e[m]) + scale == scale:
                    break
                m += 1
            if m == first:
                break
            g = (d[first + 1] - d[first]) / (2.0 * e[first])
            r = sqrt(g * g + 1.0)
            g = d[m] - d[first] + e[first] / (g + (r if g >= 0.0 else -r))
            s, c, p = 1.0, 1.0, 0.0
            split = False
            for i in range(m - 1, first - 1, -1):
                f, b = s * e[i], c * e[i]
                r = sqrt(f * f + g * g)
                e[i + 1] = r
                if r == 0.0:
                    d[i + 1] -= p
                    e[m] = 0.0
                    split = True
                    break
                s, c = f / r, g / r
                g = d[i + 1] - p
                r = (d[i] - g) * s + 2.0 * c * b
                p = s * r
                d[i + 1] = g + p
                g = c * r - b
            if not split:
                d[first] -= p
                e[first] = g
                e[m] = 0.0


@njit(cache=True)
def condition(J: Floats, A: Floats, diagonal: Floats, beside: Floats) -> float:
    """μ of a (6, n) Jacobian; `A` (6, 6), `diagonal` and `beside` (6,) are scratch space."""
    rows, columns = J.shape
    for i in range(rows):
        for j in range(i, rows):
            total = 0.0
            for k in range(columns):
                total += J[i, k] * J[j, k]
            A[i, j] = total
            A[j, i] = total
    _tridiagonalise(A, diagonal, beside)
    _eigenvalues(diagonal, beside)
    smallest, largest = diagonal[0], diagonal[0]
    for i in range(1, rows):
        smallest, largest = min(smallest, diagonal[i]), max(largest, diagonal[i])
    return sqrt(max(smallest, 0.0) / largest) if largest > 0.0 else 0.0


def manipulability(J: ArrayLike) -> float:
    """μ of a (6, n) geometric Jacobian with linear rows in m: 0 at a singularity, at most 1."""
    matrix = np.ascontiguousarray(J, dtype=float)
    rows = matrix.shape[0]
    return float(condition(matrix, np.empty((rows, rows)), np.empty(rows), np.empty(rows)))
