"""Inverse kinematics of any chain by damped least squares, compiled: for arms without a closed form."""

from __future__ import annotations

from math import acos, sin, sqrt

import numpy as np
from numpy.typing import NDArray

from irm.chain import ArmChain, ChainArrays, has_free_roll
from irm.compilation import njit
from irm.kinematics import arm_jacobian, fk_frames

Floats = NDArray[np.float64]
MAX_STEPS = 25
"""Most Newton-like steps. From a seed in a neighbouring cell, 6 are usual."""
POSITION_TOLERANCE = 1e-5
"""[m] and [rad] Largest error in each coordinate of a reached pose."""
_STEP_LIMIT = 0.4
"""[rad] or [m] Largest joint motion in one step, so that the linearisation is valid."""
_DAMPING = 0.05
"""Damping per unit of remaining error: strong far from the goal, zero at the goal."""
_STALL = 0.97
"""Ratio of successive errors. Three consecutive steps above it end the iteration without a solution."""


@njit(cache=True)
def _pose_error(R: Floats, p: Floats, R_goal: Floats, p_goal: Floats, free_roll: bool, error: Floats) -> float:
    """Write position difference and rotation vector to the goal into `error` (6,). Returns its largest entry.

    With a free roll, the rotation is the shortest that aligns the x axes.
    """
    for i in range(3):
        error[i] = p_goal[i] - p[i]
    if free_roll:
        cosine = R[0, 0] * R_goal[0, 0] + R[1, 0] * R_goal[1, 0] + R[2, 0] * R_goal[2, 0]
        for i in range(3):
            j, k = (i + 1) % 3, (i + 2) % 3
            error[3 + i] = R[j, 0] * R_goal[k, 0] - R[k, 0] * R_goal[j, 0]
    else:
        trace = 0.0
        for i in range(3):
            for k in range(3):
                trace += R_goal[i, k] * R[i, k]
        cosine = 0.5 * (trace - 1.0)
        for i in range(3):
            j, k = (i + 1) % 3, (i + 2) % 3
            twist = 0.0
            for c in range(3):
                twist += R_goal[k, c] * R[j, c] - R_goal[j, c] * R[k, c]
            error[3 + i] = 0.5 * twist
    angle = acos(min(1.0, max(-1.0, cosine)))
    sine = sin(angle)
    scale = angle / sine if sine > 1e-6 else 1.0
    largest = 0.0
    for i in range(6):
        if i >= 3:
            error[i] *= scale
        largest = max(largest, abs(error[i]))
    if cosine < -0.999999:
        error[3] += angle
        largest = max(largest, angle)
    return largest


@njit(cache=True)
def _damped_step(J: Floats, error: Floats, damping: float, A: Floats, y: Floats, step: Floats) -> None:
    """step = Jᵀ (J Jᵀ + damping)⁻¹ error, by Cholesky. `A` (6, 6) and `y` (6,) are scratch space."""
    n = J.shape[1]
    for i in range(6):
        for j in range(i + 1):
            total = damping if i == j else 0.0
            for k in range(n):
                total += J[i, k] * J[j, k]
            for k in range(j):
                total -= A[i, k] * A[j, k]
            A[i, j] = sqrt(max(total, 1e-12)) if i == j else total / A[j, j]
    for i in range(6):
        total = error[i]
        for k in range(i):
            total -= A[i, k] * y[k]
        y[i] = total / A[i, i]
    for i in range(5, -1, -1):
        total = y[i]
        for k in range(i + 1, 6):
            total -= A[k, i] * y[k]
        y[i] = total / A[i, i]
    for k in range(n):
        total = 0.0
        for i in range(6):
            total += J[i, k] * y[i]
        step[k] = total


@njit(cache=True)
def approach_pose(
    arm: ChainArrays, R_goal: Floats, p_goal: Floats, free_roll: bool, q: Floats, R: Floats, p: Floats, J: Floats
) -> bool:
    """Move the arm joints of `q` (n,) in place to the goal of the TCP. True if it is reached within the limits.

    The torso `q[0]` stays fixed. `R` (n + 1, 3, 3), `p` (n + 1, 3) and `J` (6, n - 1) receive the frames and the
    Jacobian at the result.
    """
    n, lower, upper = arm.axes.shape[0], arm.lower, arm.upper
    error, step, y, A = np.empty(6), np.empty(n - 1), np.empty(6), np.empty((6, 6))
    previous = 1e9
    stalled = 0
    for _ in range(MAX_STEPS):
        fk_frames(arm.offsets, arm.axes, arm.tip, q, R, p)
        arm_jacobian(arm.axes, R, p, J)
        size = _pose_error(R[n], p[n], R_goal, p_goal, free_roll, error)
        if size < POSITION_TOLERANCE:
            return True
        stalled = stalled + 1 if size > _STALL * previous else 0
        if stalled == 3 or not size < 1e9:
            return False
        previous = size
        _damped_step(J, error, (_DAMPING * size) ** 2 + 1e-10, A, y, step)
        longest = 0.0
        for k in range(n - 1):
            longest = max(longest, abs(step[k]))
        scale = min(1.0, _STEP_LIMIT / longest) if longest > 0.0 else 1.0
        for k in range(n - 1):
            q[k + 1] = min(upper[k + 1], max(lower[k + 1], q[k + 1] + scale * step[k]))
    return False


@njit(cache=True)
def refine(chain: ChainArrays, R: Floats, p: Floats, q: Floats) -> bool:
    """Whether the configuration `q` (n,), refined in place, reaches a TCP pose within the limits."""
    n = chain.axes.shape[0]
    frames, origins, J = np.empty((n + 1, 3, 3)), np.empty((n + 1, 3)), np.empty((6, n - 1))
    for joint in range(1, n):
        q[joint] = min(chain.upper[joint], max(chain.lower[joint], q[joint]))
    return approach_pose(chain, R, p, False, q, frames, origins, J)


@njit(cache=True)
def refine_within(chain: ChainArrays, R: Floats, p: Floats, low: float, high: float, q: Floats) -> bool:
    """`refine` with a lift that may move from `low` to `high` [m], and with joints held at their limits.

    A joint is held at a limit that the next step would exceed, and the step of the others is computed again. Near a
    corner of the limits, clamping alone would miss the solution.
    """
    n = chain.axes.shape[0]
    frames, origins, J = np.empty((n + 1, 3, 3)), np.empty((n + 1, 3)), np.empty((6, n - 1))
    lower, upper, moved = chain.lower.copy(), chain.upper.copy(), np.empty((6, n))
    error, step, y, A = np.empty(6), np.empty(n), np.empty(6), np.empty((6, 6))
    lower[0], upper[0] = low, high
    for joint in range(n):
        q[joint] = min(upper[joint], max(lower[joint], q[joint]))
    previous, stalled = 1e9, 0
    for _ in range(MAX_STEPS):
        fk_frames(chain.offsets, chain.axes, chain.tip, q, frames, origins)
        size = _pose_error(frames[n], origins[n], R, p, False, error)
        if size < POSITION_TOLERANCE:
            return True
        stalled = stalled + 1 if size > _STALL * previous else 0
        if stalled == 3 or not size < 1e9:
            return False
        previous = size
        arm_jacobian(chain.axes, frames, origins, J)
        for i in range(6):
            moved[i, 0] = 1.0 if i == 2 and low < high else 0.0
            for k in range(n - 1):
                moved[i, k + 1] = J[i, k]
        is_held = True
        while is_held:
            _damped_step(moved, error, (_DAMPING * size) ** 2 + 1e-10, A, y, step)
            is_held = False
            for k in range(n):
                if (step[k] < 0.0 and q[k] <= lower[k]) or (step[k] > 0.0 and q[k] >= upper[k]):
                    is_held = True
                    for i in range(6):
                        moved[i, k] = 0.0
        longest = 0.0
        for k in range(n):
            longest = max(longest, abs(step[k]))
        scale = min(1.0, _STEP_LIMIT / longest) if longest > 0.0 else 1.0
        for k in range(n):
            q[k] = min(upper[k], max(lower[k], q[k] + scale * step[k]))
    return False


def random_seeds(chain: ArmChain, count: int, torso: float, rng: np.random.Generator) -> Floats:
    """(count, 1 + n) configurations, uniform within the limits and one turn, all at one torso height."""
    middle = (chain.lower + chain.upper) / 2
    low, high = np.maximum(chain.lower, middle - np.pi), np.minimum(chain.upper, middle + np.pi)
    if has_free_roll(chain):
        low[-1] = high[-1] = middle[-1]
    seeds = rng.uniform(low, high, size=(count, chain.size))
    seeds[:, 0] = torso
    return seeds
