"""Closed-form inverse kinematics of arms with a spherical wrist, for a given angle of the free joint, compiled.

The distance from the shoulder to the wrist gives the elbow (subproblem 3), its direction the two joints of the shoulder
(subproblem 2), the orientation the three joints of the wrist (subproblems 2 and 1).
"""

from __future__ import annotations

from math import sin
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from irm.arm.general.structure import SphericalArm
from irm.arm.general.subproblems import angle_about, angles_to_distance, angles_to_meet, nearest_turn
from irm.arm.general.vectors import Vector, add, cross, norm, perpendicular, point, row, subtract, times, turn
from irm.compilation import njit

__all__ = ["SphericalGoal", "spherical_excess", "spherical_goal"]

Floats = NDArray[np.float64]

_LENGTH_WEIGHT = 4.0
"""How much a missing length counts, measured by the motion of the wrist with the free joint."""

_SHORTEST = 1e-3
"""[m] Smallest length that these measures are divided by."""


class SphericalGoal(NamedTuple):
    """A pose to be reached: the `wrist`, and where its orientation takes the last axis and a `side` of it."""

    wrist: Vector
    last_axis: Vector
    side_at_zero: Vector
    side: Vector


@njit(cache=True)
def spherical_goal(arm: SphericalArm, R: Floats, p: Floats) -> SphericalGoal:
    """The goal of a TCP at `R` (3, 3), `p` (3,), in the frame that the arm is solved from."""
    if arm.reversed:
        R = np.ascontiguousarray(R.T)
        p = -(R @ p)
    moved = R @ arm.R_tool.T
    last = row(arm.axes, 6)
    side = perpendicular(last)
    wrist = add(point(p), times(moved, subtract(point(arm.wrist), point(arm.tool))))
    return SphericalGoal(wrist, times(moved, last), side, times(moved, side))


@njit(cache=True)
def spherical_excess(arm: SphericalArm, goal: SphericalGoal, free: float, q: Floats) -> float:
    """By how much the best solution for a `free` angle misses the goal or the limits [rad]; its angles into `q` (7,).

    0 if there is a solution within the limits. The excess is a continuous function of the free angle. Near a
    singularity some joints move fast when the free joint turns; there their excess counts less, as the motion of what
    they turn, so that the slope of this function is bounded.
    """
    axis_1, axis_2, axis_3, axis_4 = row(arm.axes, 0), row(arm.axes, 1), row(arm.axes, 2), row(arm.axes, 3)
    pivot, shoulder, elbow = point(arm.pivot), point(arm.shoulder), point(arm.elbow)
    to_wrist = subtract(add(pivot, turn(axis_1, -free, subtract(goal.wrist, pivot))), shoulder)
    distance = max(norm(to_wrist), _SHORTEST)
    upper_arm, forearm = subtract(elbow, shoulder), subtract(point(arm.wrist), elbow)
    elbow_1, elbow_2, missed = angles_to_distance(axis_4, upper_arm, forearm, distance)
    free, own_excess = nearest_turn(free, arm.lower[0], arm.upper[0])
    weight = _LENGTH_WEIGHT / max(norm(cross(axis_1, subtract(goal.wrist, pivot))), _SHORTEST)
    shared = max(own_excess, weight * max(0.0, missed - arm.error))
    bend = min(1.0, weight * norm(cross(axis_4, upper_arm)) * norm(cross(axis_4, forearm)) / distance)
    ease_4 = bend * abs(sin(0.5 * (elbow_1 - elbow_2)))
    best = 1e9
    for k in range(1 if missed > 0.0 else 2):
        q4, excess_4 = nearest_turn(elbow_1 if k == 0 else elbow_2, arm.lower[3], arm.upper[3])
        excess_4 = _motion(excess_4, bend, ease_4)
        if max(shared, excess_4) >= best:
            continue
        reach = add(upper_arm, turn(axis_4, q4, forearm))
        minus_q2, q3, minus_q2_other, q3_other, apart, ease = angles_to_meet(axis_2, to_wrist, axis_3, reach)
        sine_2, sine_3 = _sine(axis_2, to_wrist), _sine(axis_3, reach)
        for i in range(1 if apart > 0.0 else 2):
            q2, excess_2 = nearest_turn(-minus_q2 if i == 0 else -minus_q2_other, arm.lower[1], arm.upper[1])
            angle_3, excess_3 = nearest_turn(q3 if i == 0 else q3_other, arm.lower[2], arm.upper[2])
            excess = max(shared, excess_4, apart, _motion(excess_2, sine_2, ease), _motion(excess_3, sine_3, ease))
            if excess >= best:
                continue
            last_axis, side = goal.last_axis, goal.side
            for axis, angle in ((axis_1, free), (axis_2, q2), (axis_3, angle_3), (axis_4, q4)):
                last_axis, side = turn(axis, -angle, last_axis), turn(axis, -angle, side)
            q5, q6, q7, excess_567 = _wrist(arm, last_axis, side, goal.side_at_zero, best)
            if max(excess, excess_567) < best:
                best = max(excess, excess_567)
                q[0], q[1], q[2], q[3], q[4], q[5], q[6] = free, q2, angle_3, q4, q5, q6, q7
    return best


@njit(cache=True, inline="always")
def _sine(axis: Vector, v: Vector) -> float:
    """Of the angle between an axis and a vector."""
    return norm(cross(axis, v)) / max(norm(v), _SHORTEST)


@njit(cache=True, inline="always")
def _motion(excess: float, sine: float, ease: float) -> float:
    """How far a vector must move so that a joint that meets it turns by `excess` [rad].

    `sine` is that of the angle between the axis and the vector. Where `ease`, see `angles_to_meet`, is 0 two solutions
    coincide, and the joint turns with the square root of the motion.
    """
    return min(sine * excess, ease * excess + 0.5 * sine * excess * excess)


@njit(cache=True)
def _wrist(
    arm: SphericalArm, last_axis: Vector, side: Vector, side_at_zero: Vector, enough: float
) -> tuple[float, float, float, float]:
    """Angles of the wrist that take the last axis and its side from zero to the given ones, and their excess [rad]."""
    axis_5, axis_6, axis_7 = row(arm.axes, 4), row(arm.axes, 5), row(arm.axes, 6)
    minus_q5, q6, minus_q5_other, q6_other, apart, ease = angles_to_meet(axis_5, last_axis, axis_6, axis_7)
    sine = _sine(axis_5, last_axis)
    ease_6 = ease / max(sine, _SHORTEST)
    best = 0.0, 0.0, 0.0, 1e9
    for k in range(1 if apart > 0.0 else 2):
        q5, excess_5 = nearest_turn(-minus_q5 if k == 0 else -minus_q5_other, arm.lower[4], arm.upper[4])
        angle_6, excess_6 = nearest_turn(q6 if k == 0 else q6_other, arm.lower[5], arm.upper[5])
        excess = max(apart, _motion(excess_5, sine, ease), _motion(excess_6, 1.0, ease_6))
        if excess >= min(best[3], enough):
            continue
        turned = turn(axis_6, -angle_6, turn(axis_5, -q5, side))
        q7, excess_7 = nearest_turn(angle_about(axis_7, side_at_zero, turned), arm.lower[6], arm.upper[6])
        if max(excess, _motion(excess_7, sine, ease)) < best[3]:
            best = q5, angle_6, q7, max(excess, _motion(excess_7, sine, ease))
    return best
