"""Forward and inverse kinematics of a torso lift and an arm in the base frame, compiled.

The base frame lies on the floor under the robot, x ahead. A configuration `q` is torso and arm, shape (1 + n,).

Example:
    chain = ArmChain.from_robot(FETCH)
    T_base_tcp = forward(chain, FETCH.home)
    configurations = inverse(chain, T_base_tcp, torsos=[0.2], rolls=np.linspace(-np.pi, np.pi, 36))
"""

from __future__ import annotations

from collections.abc import Sequence
from math import cos, sin

import numpy as np
from numpy.typing import ArrayLike, NDArray

from irm.arm.chain import PRISMATIC, ArmChain, has_free_roll
from irm.arm.closed_form import MAX_SOLUTIONS, ik_arm
from irm.arm.manipulability import manipulability
from irm.compilation import njit
from irm.errors import ChainError

__all__ = [
    "PRISMATIC",
    "ArmChain",
    "arm_jacobian",
    "fk_frames",
    "forward",
    "has_free_roll",
    "ik_arm",
    "inverse",
    "jacobian",
    "manipulability",
]

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]


@njit(cache=True, inline="always")
def _place(R_parent: Floats, p_parent: Floats, place: Floats, R: Floats, p: Floats) -> None:
    """Frame at a `place` in its parent's frame: an origin (3,), or with the nine entries of an orientation (12,)."""
    for i in range(3):
        p[i] = p_parent[i] + R_parent[i, 0] * place[0] + R_parent[i, 1] * place[1] + R_parent[i, 2] * place[2]
        for j in range(3):
            if place.shape[0] == 3:
                R[i, j] = R_parent[i, j]
            else:
                R[i, j] = R_parent[i, 0] * place[3 + j] + R_parent[i, 1] * place[6 + j] + R_parent[i, 2] * place[9 + j]


@njit(cache=True)
def fk_frames(offsets: Floats, axes: Integers, tip: Floats, q: Floats, R: Floats, p: Floats) -> None:
    """Frames of every link in the base frame, each after its own joint's motion.

    Args:
        offsets, axes, tip: of `ArmChain`; rows of 3 numbers or of 12.
        q: (n,) torso and arm.
        R: (n + 1, 3, 3) filled with orientations; the last one is the TCP's.
        p: (n + 1, 3) filled with origins [m].
    """
    n = axes.shape[0]
    for k in range(n):
        o = offsets[k]
        if k == 0:
            for i in range(3):
                p[0, i] = o[i]
                for j in range(3):
                    R[0, i, j] = 1.0 if i == j else 0.0
        else:
            _place(R[k - 1], p[k - 1], o, R[k], p[k])
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
    _place(R[n - 1], p[n - 1], tip, R[n], p[n])


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


def _frames(chain: ArmChain, q: ArrayLike) -> tuple[Floats, Floats]:
    configuration = np.array(q, dtype=float)
    if configuration.shape != (chain.size,):
        raise ChainError(
            f"{chain.robot}: a configuration has shape ({chain.size},), torso and arm, not {configuration.shape}"
        )
    R = np.empty((chain.size + 1, 3, 3))
    p = np.empty((chain.size + 1, 3))
    fk_frames(chain.offsets, chain.axes, chain.tip, configuration, R, p)
    return R, p


def forward(chain: ArmChain, q: ArrayLike) -> Floats:
    """T_base_tcp (4, 4) of a configuration (1 + n,)."""
    R, p = _frames(chain, q)
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R[-1], p[-1]
    return T


def jacobian(chain: ArmChain, q: ArrayLike) -> Floats:
    """Geometric Jacobian (6, n) of the TCP with respect to the arm joints, in the base frame.

    Rows: linear velocity [m] per unit of joint motion, then angular [rad]. The torso has no column.
    """
    R, p = _frames(chain, q)
    J = np.empty((6, chain.size - 1))
    arm_jacobian(chain.axes, R, p, J)
    return J


@njit(cache=True)
def _inverse_grid(
    links: Floats, R: Floats, p: Floats, torsos: Floats, rolls: Floats, lower: Floats, upper: Floats, rows: Floats
) -> int:
    """Write all solutions on the grid into `rows`; the number of solutions."""
    found = np.empty((MAX_SOLUTIONS, 8))
    total = 0
    for torso in torsos:
        for roll in rolls:
            count = ik_arm(links, R, p, torso, roll, lower, upper, found)
            for k in range(count):
                rows[total] = found[k]
                total += 1
    return total


def inverse(chain: ArmChain, T_base_tcp: ArrayLike, torsos: Sequence[float] | Floats, rolls: ArrayLike) -> Floats:
    """Every closed-form solution within the limits on a grid of the two free parameters.

    Args:
        chain: of an arm with a closed form.
        T_base_tcp: (4, 4) target.
        torsos: torso heights to try [m].
        rolls: upper-arm rolls to try [rad], in [-π, π].

    Returns:
        (k, 8) configurations, k = 0 if there is none; roll joints in [-π, π].

    Raises:
        ChainError: the arm has no closed form.
    """
    if not chain.has_closed_form:
        raise ChainError(f"{chain.robot} has no closed form; use irm.arm.numerical.solve")
    T = np.ascontiguousarray(T_base_tcp, dtype=float)
    if T.shape != (4, 4):
        raise ChainError(f"T_base_tcp has shape (4, 4), not {T.shape}")
    heights = np.atleast_1d(np.asarray(torsos, dtype=float))
    angles = np.atleast_1d(np.asarray(rolls, dtype=float))
    rows = np.empty((MAX_SOLUTIONS * heights.size * angles.size, 8))
    R, p = np.ascontiguousarray(T[:3, :3]), np.ascontiguousarray(T[:3, 3])
    count = _inverse_grid(chain.links, R, p, heights, angles, chain.lower, chain.upper, rows)
    return rows[:count].copy()
