"""Does any angle of the free joint give an arm with a spherical wrist a solution? A scan that knows its gaps, compiled.

The excess of `irm.arm.general.spherical_kernel` is a continuous function of the free angle, and 0 where there is a
solution. It is computed on a grid. Between two angles it could reach 0 only if it changes by their sum. Where a bounded
slope allows this, the interval is halved, and so on. What is left at the finest step is open.
"""

from __future__ import annotations

from math import ceil, floor, pi
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from irm.arm.answers import NO, OPEN, YES
from irm.arm.chain_arrays import ChainArrays
from irm.arm.general.spherical_kernel import SphericalGoal, spherical_excess, spherical_goal
from irm.arm.general.structure import SphericalArm
from irm.arm.numerical import approach_pose
from irm.compilation import njit

__all__ = ["refine", "scan_free_joint"]

Floats = NDArray[np.float64]

COARSE_STEP = 2.5 * pi / 180.0
"""[rad] Largest step of the first grid."""

HALVINGS = 9
"""How often an interval is halved before it is called open: down to 0.005 degrees."""

SLOPE = 20.0
"""Largest slope of the excess that is assumed, measured: with it no reachable pose was called out of reach, see
docs/irm.md."""

_CAPACITY = 4096
"""Intervals that are kept for halving at a time."""


class _Trial(NamedTuple):
    """What is tried: an arm and a pose, `R` (3, 3) and `p` (3,); `q` (1 + n,) is the last solution, with its torso, and
    `angles` (1, 7) in the order of solving."""

    chain: ChainArrays
    arm: SphericalArm
    goal: SphericalGoal
    R: Floats
    p: Floats
    q: Floats
    angles: Floats


@njit(cache=True)
def refine(chain: ChainArrays, R: Floats, p: Floats, q: Floats) -> bool:
    """Whether the configuration `q` (n,), refined in place, reaches a TCP pose within the limits."""
    n = chain.axes.shape[0]
    frames, origins, J = np.empty((n + 1, 3, 3)), np.empty((n + 1, 3)), np.empty((6, n - 1))
    for joint in range(1, n):
        q[joint] = min(chain.upper[joint], max(chain.lower[joint], q[joint]))
    limits = chain.lower, chain.upper
    return approach_pose(chain.offsets, chain.axes, chain.tip, *limits, R, p, False, q, frames, origins, J)


@njit(cache=True)
def _try_angle(trial: _Trial, free: float) -> tuple[bool, float]:
    """Whether a free angle gives a solution, which is then in `trial.q`, and the excess without that of the slack."""
    excess = spherical_excess(trial.arm, trial.goal, free, trial.angles)
    if excess > trial.arm.slack:
        return False, excess - trial.arm.slack
    for joint in range(7):
        if trial.arm.columns[joint] >= 0:
            trial.q[trial.arm.columns[joint]] = trial.angles[0, joint]
    return refine(trial.chain, trial.R, trial.p, trial.q), 0.0


@njit(cache=True)
def scan_free_joint(chain: ChainArrays, arm: SphericalArm, R: Floats, p: Floats, q: Floats) -> tuple[int, float]:
    """The answer for a TCP pose `R` (3, 3), `p` (3,) at the torso height `q[0]`, and the smallest excess found [rad].

    A solution is written into `q` (1 + n,).
    """
    lowered = p.copy()
    lowered[2] -= q[0]
    trial = _Trial(chain, arm, spherical_goal(arm, R, lowered), R, p, q, np.empty((1, 7)))
    width = min(2.0 * pi, arm.upper[0] - arm.lower[0])
    first = 0.5 * (arm.lower[0] + arm.upper[0] - width)
    if width == 0.0:
        found, excess = _try_angle(trial, first)
        return (YES if found else (NO if excess > 0.0 else OPEN)), excess
    count = ceil(width / COARSE_STEP)
    step = width / count
    excesses = np.empty(count + 1)
    stride = _coprime_stride(count + 1)
    for k in range(count + 1):
        node = k * stride % (count + 1)
        found, excesses[node] = _try_angle(trial, first + node * step)
        if found:
            return YES, 0.0
    return _halve(trial, first, step, excesses)


@njit(cache=True)
def _halve(trial: _Trial, first: float, step: float, excesses: Floats) -> tuple[int, float]:
    """Halve the intervals in which the excess could reach 0, until there is none, or a solution, or the finest step."""
    best = excesses.min()
    starts, ends = np.empty((2, _CAPACITY)), np.empty((2, _CAPACITY, 2))
    kept = 0
    for k in range(excesses.size - 1):
        if excesses[k] + excesses[k + 1] < SLOPE * step:
            starts[0, kept], ends[0, kept, 0], ends[0, kept, 1] = first + k * step, excesses[k], excesses[k + 1]
            kept += 1
    for level in range(HALVINGS):
        now, after, step = level % 2, (level + 1) % 2, 0.5 * step
        count = 0
        for k in range(kept):
            found, excess = _try_angle(trial, starts[now, k] + step)
            if found:
                return YES, 0.0
            best = min(best, excess)
            if count + 2 > _CAPACITY:
                return OPEN, best
            for half in range(2):
                if ends[now, k, half] + excess < SLOPE * step:
                    starts[after, count] = starts[now, k] + half * step
                    ends[after, count, half], ends[after, count, 1 - half] = ends[now, k, half], excess
                    count += 1
        kept = count
    return (NO if kept == 0 and best > 0.0 else OPEN), best


@njit(cache=True)
def _coprime_stride(count: int) -> int:
    """A step through 0 … count - 1 that visits every number once, and far ones first."""
    stride = max(1, floor(0.382 * count))
    while True:
        a, b = count, stride
        while b > 0:
            a, b = b, a % b
        if a == 1:
            return stride
        stride += 1
