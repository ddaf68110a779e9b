"""Equations 1 to 5 of the paper, one function each, in the order of the paper.

Jung, Jeon, Yumbla & Moon 2022, "base repositioning by inverse reachability". All other modules are about cells, files
and fast look-ups.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


def reachability_index(reached: NDArray[np.int64], orientations: int) -> Floats:
    """Equation 1: D = R / N × 100, the share of the N sampled TCP orientations in reach at each position [%].

    Args:
        reached: R of each position, any shape.
        orientations: N.
    """
    return reached / orientations * 100.0


# Equation 2, μ = sqrt(λ_min / λ_max) of J Jᵀ, is `irm.kinematics.manipulability`.


def reachability_map(best: NDArray[np.float32]) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
    """Equation 3: RM = {(T_eff, T_base = I, μ)}: the sampled TCP poses in reach, each with its best μ.

    Args:
        best: best μ of every cell, of any shape; 0 where its centre is out of reach.

    Returns:
        (n,) flat numbers of the cells in reach, increasing, and their μ (n,).
    """
    cells = np.flatnonzero(best)
    return cells, best.reshape(-1)[cells]


def inverse_reachability(R: Floats, p: Floats) -> tuple[Floats, Floats]:
    """Equation 4: T_eff = I, T_base = T_eff⁻¹, for TCP orientations `R` (n, 3, 3) and positions `p` (n, 3) [m].

    Returns:
        Orientations (n, 3, 3) and positions (n, 3) of the base in the TCP frame.
    """
    R_base = R.transpose(0, 2, 1)
    return R_base, -np.einsum("nij,nj->ni", R_base, p)


def inverse_reachability_on_floor(x: Floats, y: Floats, yaw: Floats) -> tuple[Floats, Floats, Floats]:
    """Equation 5: T_eff = [R(0, β, α), (0, 0, z)], T_base = [Rz(-γ), Rz(π - γ) (x, y, 0)].

    The base stays on the floor, under a TCP at the origin with approach yaw 0. Height z, pitch β and roll α of the TCP
    do not change: they are the key by which the bases are found.

    Args:
        x, y: (n,) TCP positions in the base frame [m].
        yaw: (n,) TCP yaws γ in the base frame [rad].

    Returns:
        x, y [m] and yaw [rad] of the bases, each (n,).
    """
    c, s = np.cos(np.pi - yaw), np.sin(np.pi - yaw)
    return c * x - s * y, s * x + c * y, -yaw
