"""Forward kinematics, Jacobian and manipulability of a torso lift and an arm in the base frame, compiled.

The base frame lies on the floor under the robot, x ahead. A configuration `q` is torso and arm, shape (1 + n,).

Manipulability (equation 2 of the paper) is μ = sqrt(λ_min(A) / λ_max(A)) with A = J Jᵀ. The rows of J mix metres and
radians, so μ depends on the unit of length; here it is the metre throughout: linear rows in m per unit of joint motion,
angular rows in rad.

Example:
    chain = ArmChain.from_robot(FETCH)
    T_base_tcp = forward(chain, FETCH.home)
"""

from __future__ import annotations

from math import cos, floor, pi, sin, sqrt

import numpy as np
from numpy.typing import ArrayLike, NDArray

from irm.chain import PRISMATIC, ArmChain
from irm.compilation import WITHOUT_REFERENCE_COUNTS, njit
from irm.errors import ChainError


@njit(cache=True, inline="always")
def wrap(angle: float) -> float:
    """The same angle in [-π, π), compiled."""
    return angle - 2.0 * pi * floor((angle + pi) / (2.0 * pi))


Floats = NDArray[np.float64]
Integers = NDArray[np.int64]


@njit(cache=True, **WITHOUT_REFERENCE_COUNTS)
def fk_frames(offsets: Floats, axes: Integers, tip: Floats, q: Floats, R: Floats, p: Floats) -> None:
    """Frames of every link in the base frame, each after its own joint's motion.

    Args:
        offsets, axes, tip: of `ArmChain`; rows of 3 numbers or of 12.
        q: (n,) torso and arm.
        R: (n + 1, 3, 3) filled with orientations; the last one is the TCP's.
        p: (n + 1, 3) filled with origins [m].
    """
    n = axes.shape[0]
    for i in range(3):  # the base, until the TCP is written to this place
        p[n, i] = 0.0
        for j in range(3):
            R[n, i, j] = 1.0 if i == j else 0.0
    for k in range(n + 1):
        place, parent = offsets[k] if k < n else tip, k - 1 if k > 0 else n
        is_turned = k > 0 and place.shape[0] > 3
        for i in range(3):
            a, b, c = R[parent, i, 0], R[parent, i, 1], R[parent, i, 2]
            p[k, i] = p[parent, i] + a * place[0] + b * place[1] + c * place[2]
            R[k, i, 0], R[k, i, 1], R[k, i, 2] = a, b, c
            for j in range(3 if is_turned else 0):
                R[k, i, j] = a * place[3 + j] + b * place[6 + j] + c * place[9 + j]
        if k == n:
            break
        axis = axes[k]
        if axis >= PRISMATIC:
            for i in range(3):
                p[k, i] += R[k, i, axis - PRISMATIC] * q[k]
        else:
            c, s = cos(q[k]), sin(q[k])
            u, v = (axis + 1) % 3, (axis + 2) % 3
            for i in range(3):
                a, b = R[k, i, u], R[k, i, v]
                R[k, i, u] = c * a + s * b
                R[k, i, v] = c * b - s * a


@njit(cache=True)
def arm_jacobian(axes: Integers, R: Floats, p: Floats, J: Floats) -> None:
    """Geometric Jacobian (6, n - 1) of the arm alone at the frames of `fk_frames`: linear rows first, base frame."""
    n = axes.shape[0]
    for k in range(1, n):
        axis = axes[k] % PRISMATIC
        ax, ay, az = R[k, 0, axis], R[k, 1, axis], R[k, 2, axis]
        dx, dy, dz = p[n, 0] - p[k, 0], p[n, 1] - p[k, 1], p[n, 2] - p[k, 2]
        if axes[k] >= PRISMATIC:
            J[0, k - 1], J[1, k - 1], J[2, k - 1] = ax, ay, az
            J[3, k - 1], J[4, k - 1], J[5, k - 1] = 0.0, 0.0, 0.0
        else:
            J[0, k - 1], J[1, k - 1], J[2, k - 1] = ay * dz - az * dy, az * dx - ax * dz, ax * dy - ay * dx
            J[3, k - 1], J[4, k - 1], J[5, k - 1] = ax, ay, az


def link_frames(chain: ArmChain, q: ArrayLike) -> tuple[Floats, Floats]:
    """Orientations (2 + n, 3, 3) and origins (2 + n, 3) [m] of the links' frames and the TCP's in the base frame."""
    configuration = np.array(q, dtype=float)
    if configuration.shape != (chain.size,):
        raise ChainError(
            f"{chain.robot}: a configuration has shape ({chain.size},), torso and arm, not {configuration.shape}"
        )
    R = np.empty((chain.size + 1, 3, 3))
    p = np.empty((chain.size + 1, 3))
    # Copies, since kernels pass arrays that may be written to: for read-only ones it would be compiled once more.
    fk_frames(chain.offsets.copy(), chain.axes.copy(), chain.tip.copy(), configuration, R, p)
    return R, p


def forward(chain: ArmChain, q: ArrayLike) -> Floats:
    """T_base_tcp (4, 4) of a configuration (1 + n,)."""
    R, p = link_frames(chain, q)
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R[-1], p[-1]
    return T


def link_origins(chain: ArmChain, q: ArrayLike) -> Floats:
    """(2 + n, 3) origins of the torso's and all arm joints' frames, and of the TCP, in the base frame [m]."""
    return link_frames(chain, q)[1]


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
