"""Branch and bound for one TCP pose over the lift and one or two joints, compiled, for arms with a structure.

With lift and free joint fixed, the closed form tells whether a pose is reached. A box of heights and angles is first
tested at its middle. If no point of it may reach the pose (`irm.ik.exclusion`), the box is excluded. Otherwise it is
cut in two. NO is proved, because every box was excluded. YES comes with a configuration that forward kinematics
confirms. A pose is UNKNOWN where very small boxes remain.

An arm whose wrist is not spherical has no closed form. With its fifth joint fixed too, the same proof applies, so boxes
have a range of its angles as well. At their middles no solution is exact, so the configuration is refined from there.
"""

from __future__ import annotations

from math import ceil, floor, pi
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from irm.answers import NO, UNKNOWN, YES
from irm.chain import ChainArrays
from irm.compilation import njit
from irm.ik.arm_solver import SolverArrays
from irm.ik.exclusion import Angle, may_reach_parallel, may_reach_spherical
from irm.ik.numerical import refine_within
from irm.ik.ranges import TOLERANCE
from irm.ik.structure import ITERATIVE, PARALLEL, ParallelArm, SphericalArm
from irm.ik.structured import parallel_excess, parallel_goal, spherical_excess, spherical_goal
from irm.ik.subproblems import norm, point

Floats = NDArray[np.float64]
LARGEST_LIFT, LARGEST_ANGLE = 0.05, 10.0 * pi / 180.0
"""[m], [rad] Largest size of the first boxes."""
_ROUNDING = 1e-9
"""[m], [rad] Excess length of a range that is neglected."""
_LEVER = 0.3
"""[m] Motion of the wrist per angle of the free joint, which makes boxes about as long as wide."""
_MOST_BOXES = 4000
"""Most boxes examined per pose before it stays UNKNOWN."""
_FINEST = 4.0 * TOLERANCE
"""[m], [rad] Smallest size of a box."""
_FINEST_ERROR = 0.25
"""Size of the smallest box relative to the error of the arm's structure [m]. Smaller boxes are hardly ever excluded if
this box is not."""
_CLOSE, _CLOSER = 0.1, 0.3
"""[rad] Initial excess, and factor. A configuration is refined if its excess is below the factor times that of the best
refined configuration so far."""
_MOST_FAILURES = 64
"""Most solutions of the closed form that are refined without success. At a singularity of an arm whose axes nearly
meet, all refinements fail."""


class _Trial(NamedTuple):
    """Arm and pose of a search. `R` (3, 3), `p` (3,): the pose. `q` (1 + n,): last solution, with its torso. `angles`
    (1, 7) or (1, 6): last angles of the closed form. `lowered` (3,): scratch space."""

    has_wrist: bool
    chain: ChainArrays
    spherical: SphericalArm
    bounds: SphericalArm
    parallel: ParallelArm
    R: Floats
    p: Floats
    q: Floats
    angles: Floats
    lowered: Floats


@njit(cache=True)
def search(arm: SolverArrays, R: Floats, p: Floats, low: float, high: float, q: Floats) -> int:  # noqa: C901  compiled: one loop over one state
    """Decide a TCP pose with the lift from `low` to `high` [m]. Writes a solution into `q` (1 + n,).

    Args:
        arm: solver of an arm with a structure of `irm.ik.structure`.
        R, p: (3, 3), (3,) of the TCP in the base frame.
        low, high: range of the lift [m].
        q: (1 + n,) filled where the answer is YES.
    """
    has_wrist, is_exact = arm.kind != PARALLEL, arm.kind != ITERATIVE
    columns = 7 if has_wrist else 6
    trial = _Trial(
        has_wrist, arm.chain, arm.spherical, arm.bounds, arm.parallel, R, p, q, np.empty((1, columns)), p.copy()
    )
    lower, upper = arm.bounds.lower, arm.bounds.upper
    width = min(2.0 * pi, upper[0] - lower[0])
    first_angle = 0.5 * (lower[0] + upper[0] - width)
    half_fifth, offset = min(pi, 0.5 * (upper[4] - lower[4])), norm(point(arm.bounds.offset))
    heights, turns = _count(high - low, LARGEST_LIFT), _count(width, LARGEST_ANGLE)
    half_lift, half_angle = 0.5 * (high - low) / heights, 0.5 * width / turns
    boxes = np.empty((heights * turns + 2 * _MOST_BOXES, 6))
    count, stride, failures = heights * turns, _coprime_stride(heights * turns), 0
    best, best_lift, best_angle = np.inf, low, first_angle
    for k in range(count):
        # Distant nodes come first, which finds a solution early.
        node = k * stride % count
        lift = low + (2 * (node // turns) + 1) * half_lift
        angle = first_angle + (2 * (node % turns) + 1) * half_angle
        boxes[k, 0], boxes[k, 1], boxes[k, 2], boxes[k, 3] = lift, half_lift, angle, half_angle
        boxes[k, 4], boxes[k, 5] = 0.5 * (lower[4] + upper[4]), half_fifth
        if not is_exact:
            continue
        excess = _excess(trial, lift, angle)
        if excess == 0.0:
            if _refined(trial, low, high, lift):
                return YES
            failures += 1
        if excess < best:
            best, best_lift, best_angle = excess, lift, angle
    first, last, initial, refined, left, next_try = 0, count, count, _CLOSE, 0, 1
    finest = max(_FINEST, _FINEST_ERROR * (arm.bounds.error if has_wrist else arm.parallel.error))
    is_open = False
    while first < last:
        box = boxes[first]
        lift, angle = box[0], box[2]
        first += 1
        if not _may_reach(trial, box):
            continue
        left += 1
        if not is_exact:
            if left == next_try:
                next_try *= 2
                if _refined(trial, low, high, lift):
                    return YES
        elif first > initial:
            excess = _excess(trial, lift, angle)
            if excess < best:
                best, best_lift, best_angle = excess, lift, angle
            if (excess == 0.0 and failures < _MOST_FAILURES) or excess < _CLOSER * refined:
                if _refined(trial, low, high, lift):
                    return YES
                failures += excess == 0.0
                refined = min(refined, excess)
        if last + 2 > len(boxes):
            is_open = True
            break
        motions = box[1], _LEVER * box[3], offset * box[5]
        if max(motions) < finest:
            is_open = True
            continue
        boxes[last : last + 2] = box
        which = 0 if motions[0] == max(motions) else (2 if motions[1] == max(motions) else 4)
        half = 0.5 * box[which + 1]
        boxes[last, which] -= half
        boxes[last + 1, which] += half
        boxes[last : last + 2, which + 1] = half
        last += 2
    if not is_open:
        return NO
    if not is_exact:
        return UNKNOWN
    _excess(trial, best_lift, best_angle)
    return YES if _refined(trial, low, high, best_lift) else UNKNOWN


@njit(cache=True)
def _count(length: float, largest: float) -> int:
    return max(1, ceil(length / largest - _ROUNDING))


@njit(cache=True)
def _excess(trial: _Trial, lift: float, angle: float) -> float:
    """Excess of the best solution at a height and an angle, minus the slack of the structure. Writes its angles into
    `trial.angles`."""
    trial.lowered[2] = trial.p[2] - lift
    if trial.has_wrist:
        goal = spherical_goal(trial.spherical, trial.R, trial.lowered)
        return max(0.0, spherical_excess(trial.spherical, goal, angle, trial.angles) - trial.spherical.slack)
    level = parallel_goal(trial.parallel, trial.R, trial.lowered)
    return max(0.0, parallel_excess(trial.parallel, level, trial.angles) - trial.parallel.slack)


@njit(cache=True)
def _refined(trial: _Trial, low: float, high: float, lift: float) -> bool:
    """Refine the last angles. True if they become a solution, in `trial.q`."""
    trial.q[0] = lift
    for joint in range(trial.angles.shape[1]):
        column = trial.bounds.columns[joint] if trial.has_wrist else joint + 1
        if column >= 0:
            trial.q[column] = trial.angles[0, joint]
    return refine_within(trial.chain, trial.R, trial.p, low, high, trial.q)


@njit(cache=True)
def _may_reach(trial: _Trial, box: Floats) -> bool:
    """Whether any point of a box may reach the pose. False is proved.

    `box` (6,): middle and half size of its heights [m], and of the angles of the free joint and of the fifth [rad].
    """
    trial.lowered[2] = trial.p[2] - box[0]
    if trial.has_wrist:
        arm = trial.bounds
        lever = norm(point(trial.lowered)) + norm(point(arm.wrist)) + norm(point(arm.tool))
        error = arm.error + TOLERANCE * (1.0 + lever)
        goal, free, fifth = spherical_goal(arm, trial.R, trial.lowered), Angle(box[2], box[3]), Angle(box[4], box[5])
        return may_reach_spherical(arm, goal, box[1], free, fifth, error, trial.angles)
    level = trial.parallel
    lever = norm(point(level.points[4])) + norm(point(level.tool))
    error = level.error + box[1] + TOLERANCE + (level.turn + TOLERANCE) * lever
    return may_reach_parallel(level, parallel_goal(level, trial.R, trial.lowered), error)


@njit(cache=True)
def _coprime_stride(count: int) -> int:
    """A step through 0 … count - 1 that visits every number once, distant numbers first."""
    stride = max(1, floor(0.382 * count))
    while True:
        a, b = count, stride
        while b > 0:
            a, b = b, a % b
        if a == 1:
            return stride
        stride += 1
