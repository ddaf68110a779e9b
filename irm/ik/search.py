"""Answers for one TCP pose by branch and bound over the lift and one or two joints, compiled: arms with a structure.

With the lift and the free joint fixed, the closed form says whether a pose is reached. A box of heights and angles is
first tried at its middle. If no point of it may reach the pose (`irm.ik.exclusion`), it is left out, else it is cut in
two. NO is proved: every box was left out. YES comes with a configuration that forward kinematics confirms. A pose is
UNKNOWN where very small boxes are left.

An arm whose wrist is not spherical has no closed form. Once its fifth joint is fixed too, the same proof serves: boxes
have a range of its angles as well. At their middles nothing fits exactly; from there the configuration is refined.
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
"""[m], [rad] A range that is longer by less is no longer."""
_LEVER = 0.3
"""[m] The motion of the wrist with the free joint by which boxes are made about as long as wide."""
_MOST_BOXES = 4000
"""Boxes examined before a pose stays open."""
_FINEST = 4.0 * TOLERANCE
"""[m], [rad] Smallest size of a box."""
_FINEST_ERROR = 0.25
"""Of the error of the arm's structure [m]: smaller boxes are hardly left out where this one is not."""
_CLOSE, _CLOSER = 0.1, 0.3
"""[rad] Excess from which a configuration is refined, and by which factor it must be less than the last one's."""
_MOST_FAILURES = 64
"""Solutions of the closed form that are refined in vain at most: at a singularity of an arm whose axes do not quite
meet, all are such."""


class _Trial(NamedTuple):
    """What is tried: an arm and a pose, `R` (3, 3) and `p` (3,); `q` (1 + n,) is the last solution, with its torso,
    `angles` (1, 7) or (1, 6) the last angles of the closed form, and `lowered` (3,) scratch space."""

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
def search(arm: SolverArrays, R: Floats, p: Floats, low: float, high: float, q: Floats) -> int:
    """The answer for a TCP pose with the lift from `low` to `high` [m]; a solution into `q` (1 + n,).

    Args:
        arm: its solver, of an arm with a structure of `irm.ik.structure`.
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
    """By how much the best solution at a height and an angle misses, less the slack of the structure; its angles into
    `trial.angles`."""
    trial.lowered[2] = trial.p[2] - lift
    if trial.has_wrist:
        goal = spherical_goal(trial.spherical, trial.R, trial.lowered)
        return max(0.0, spherical_excess(trial.spherical, goal, angle, trial.angles) - trial.spherical.slack)
    level = parallel_goal(trial.parallel, trial.R, trial.lowered)
    return max(0.0, parallel_excess(trial.parallel, level, trial.angles) - trial.parallel.slack)


@njit(cache=True)
def _refined(trial: _Trial, low: float, high: float, lift: float) -> bool:
    """Whether the last angles tried, refined, are a solution, which is then in `trial.q`."""
    trial.q[0] = lift
    for joint in range(trial.angles.shape[1]):
        column = trial.bounds.columns[joint] if trial.has_wrist else joint + 1
        if column >= 0:
            trial.q[column] = trial.angles[0, joint]
    return refine_within(trial.chain, trial.R, trial.p, low, high, trial.q)


@njit(cache=True)
def _may_reach(trial: _Trial, box: Floats) -> bool:
    """Whether any point of a box may reach the pose: false is proved.

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
    """A step through 0 … count - 1 that visits every number once, and far ones first."""
    stride = max(1, floor(0.382 * count))
    while True:
        a, b = count, stride
        while b > 0:
            a, b = b, a % b
        if a == 1:
            return stride
        stride += 1
