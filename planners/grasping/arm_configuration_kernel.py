"""The loops behind `planners.grasping.arm_configurations`, compiled."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from irm.arm.closed_form import MAX_SOLUTIONS
from irm.arm.kinematics import arm_jacobian, fk_frames, ik_arm
from irm.arm.manipulability import condition
from planners.collision.configuration_kernel import Attached, Obstacles, Workspace, configuration_hits, make_workspace
from planners.collision.robot_model import RobotArrays
from planners.scene.masks import SELF_BIT, STATIC_BIT, bit_count

__all__ = ["many_gripper_hits", "scan"]

Array = NDArray[np.float64]

_STATIC = np.uint64(1 << STATIC_BIT)
_SELF = np.uint64(1 << SELF_BIT)
_SOLID = np.uint64((1 << STATIC_BIT) | (1 << SELF_BIT))
_NONE = np.uint64(0)
_PER_MASK = 6
"""ArmConfigurations kept for one set of blockers, each from another hand pose or base."""
_CAPACITY = 96
_TRAVEL_COST = 0.004
"""Manipulability given up per radian of joint travel from the home configuration: short motions are worth something."""
_ELBOW = 4
_HIGH_ELBOW = 0.35
"""[m] above the hand: an elbow that high carries the forearm over what stands on the table."""
_ELBOW_WORTH = 0.4
"""Manipulability that a metre of elbow height is worth: a high arm sweeps little of the table."""
_LIFT = 0.2
"""[m] that the torso can lift the hand straight up, in whatever configuration the arm is."""
_LIFT_WORTH = 0.5
_LIFT_WEIGHT = 10.0
"""[rad/m] What a metre of torso travel counts when the configuration nearest to home is looked for."""


@njit(cache=True)
def many_gripper_hits(
    hand: RobotArrays,
    obstacles: Obstacles,
    held: Attached,
    gripper_poses: Array,
    opening: float,
    active: np.uint64,
    padding: float,
) -> NDArray[np.uint64]:
    """The loop of `gripper_hits`."""
    work = make_workspace(hand, held)
    hits = np.empty(gripper_poses.shape[0], np.uint64)
    place = np.empty(3)
    height = np.empty(1)
    for k in range(gripper_poses.shape[0]):
        place[0], place[1], place[2], height[0] = (
            gripper_poses[k, 0],
            gripper_poses[k, 1],
            gripper_poses[k, 3],
            gripper_poses[k, 2],
        )
        hits[k] = configuration_hits(hand, obstacles, work, place, height, opening, active & ~_SELF, padding, False)
    return hits


@njit(cache=True)
def _nearest_turn(angle: float, wanted: float, lower: float, upper: float) -> float:
    """The equivalent of a roll joint's angle nearest to the wanted one, within its limits."""
    turned = angle + 2.0 * math.pi * np.round((wanted - angle) / (2.0 * math.pi))
    if lower <= turned <= upper:
        return turned
    return angle


@njit(cache=True)
def _turned_home(found: Array, count: int, home: Array, lower: Array, upper: Array) -> int:
    """Keep the solutions with a positive elbow (the others lie alike), their roll joints turned to near home."""
    kept = 0
    for k in range(count):
        if found[k, 4] < 0.0:
            continue
        for joint in (3, 5, 7):
            found[kept, joint] = _nearest_turn(found[k, joint], home[joint], lower[joint], upper[joint])
        for joint in (0, 1, 2, 4, 6):
            found[kept, joint] = found[k, joint]
        kept += 1
    return kept


@njit(cache=True)
def _quality(robot: RobotArrays, q: Array, home: Array) -> float:
    """Manipulability, more for an elbow held high, less a little per radian from the home configuration."""
    n = q.shape[0]
    R, p, J = np.empty((n + 1, 3, 3)), np.empty((n + 1, 3)), np.empty((6, n - 1))
    fk_frames(robot.offsets, robot.axes, robot.tip, q, R, p)
    arm_jacobian(robot.axes, R, p, J)
    travel = 0.0
    for joint in range(1, n):
        travel += abs(q[joint] - home[joint])
    headroom = min(robot.upper[0] - q[0], _LIFT)
    raised = min(max(p[_ELBOW, 2] - p[n, 2], 0.0), _HIGH_ELBOW)
    mu = condition(J, np.empty((6, 6)), np.empty(6), np.empty(6))
    return mu + _ELBOW_WORTH * raised + _LIFT_WORTH * headroom - _TRAVEL_COST * travel


@njit(cache=True)
def _is_bettered(hits: np.uint64, rows_hits: NDArray[np.uint64], count: int, most: int) -> bool:
    """Whether kept configurations hit only a part of this, or `most` of them just this."""
    same = 0
    for i in range(count):
        if rows_hits[i] == hits:
            same += 1
        elif rows_hits[i] & ~hits == _NONE:
            return True
    return same >= most


@njit(cache=True)
def _insert(
    q: Array,
    pair: int,
    hits: np.uint64,
    quality: float,
    rows_q: Array,
    rows_pair: NDArray[np.int64],
    rows_hits: NDArray[np.uint64],
    rows_quality: Array,
    count: int,
) -> int:
    """Add a configuration that no kept one betters, and drop those it betters; the new count.

    One configuration per hand pose and set of hits, and `_PER_MASK` per set of hits.
    """
    kept = 0
    place = -1
    same = 0
    worst = -1
    for i in range(count):
        if rows_hits[i] != hits and hits & ~rows_hits[i] == _NONE:
            continue
        rows_q[kept], rows_pair[kept] = rows_q[i], rows_pair[i]
        rows_hits[kept], rows_quality[kept] = rows_hits[i], rows_quality[i]
        if rows_hits[kept] == hits:
            same += 1
            if rows_pair[kept] == pair:
                place = kept
            if worst < 0 or rows_quality[kept] < rows_quality[worst]:
                worst = kept
        kept += 1
    if place < 0 and same >= _PER_MASK:
        place = worst
    if place >= 0 and rows_quality[place] >= quality:
        return kept
    if place < 0:
        if kept == rows_hits.shape[0]:
            return kept
        place = kept
        kept += 1
    rows_q[place], rows_pair[place], rows_hits[place], rows_quality[place] = q, pair, hits, quality
    return kept


@njit(cache=True)
def _order_by_hits(known: NDArray[np.uint64]) -> NDArray[np.int64]:
    """Indices of hand poses, those that hit fewest objects first."""
    weight = np.empty(known.shape[0], np.int64)
    for k in range(known.shape[0]):
        weight[k] = bit_count(np.int64(known[k] & ~_SOLID))
    return np.argsort(weight, kind="mergesort")


@njit(cache=True)
def _consider(
    robot: RobotArrays,
    obstacles: Obstacles,
    work: Workspace,
    base: Array,
    q: Array,
    pair: int,
    opening: float,
    active: np.uint64,
    by_gripper: np.uint64,
    padding: float,
    first_free: bool,
    home: Array,
    rows_q: Array,
    rows_pair: NDArray[np.int64],
    rows_hits: NDArray[np.uint64],
    rows_quality: Array,
    count: int,
) -> int:
    """Keep a configuration if it is worth it; the new count. What the hand hits is known and not looked at again."""
    wanted = active & ~by_gripper & ~_SELF
    hits = configuration_hits(robot, obstacles, work, base, q, opening, wanted, padding, first_free)
    hits |= by_gripper
    if hits & _SOLID != _NONE or (first_free and hits != _NONE):
        return count
    if _is_bettered(hits, rows_hits, count, _CAPACITY):
        return count
    if configuration_hits(robot, obstacles, work, base, q, opening, active & _SELF, padding, True):
        return count
    return _insert(q, pair, hits, _quality(robot, q, home), rows_q, rows_pair, rows_hits, rows_quality, count)


@njit(cache=True)
def scan(
    robot: RobotArrays,
    obstacles: Obstacles,
    held: Attached,
    links: Array,
    lower: Array,
    upper: Array,
    home: Array,
    bases: Array,
    gripper_poses: Array,
    known: NDArray[np.uint64],
    torsos: Array,
    rolls: Array,
    opening: float,
    active: np.uint64,
    padding: float,
    first_free: bool,
    nearest_home: bool,
) -> tuple[Array, NDArray[np.int64], NDArray[np.uint64], Array]:
    """The loop of `scan_configurations`: hands that hit little come first; what they hit need not be looked at
    again."""
    work = make_workspace(robot, held)
    n = lower.shape[0]
    rows_q = np.empty((_CAPACITY, n))
    rows_pair = np.empty(_CAPACITY, np.int64)
    rows_hits = np.empty(_CAPACITY, np.uint64)
    rows_quality = np.empty(_CAPACITY)
    found = np.empty((MAX_SOLUTIONS, n))
    nearest = np.empty(n)
    R, p = np.zeros((3, 3)), np.empty(3)
    R[2, 2] = 1.0
    order = np.arange(bases.shape[0]) if first_free else _order_by_hits(known)
    count = 0
    for pair in order:
        by_gripper = known[pair]
        if by_gripper & _SOLID != _NONE or (first_free and by_gripper != _NONE):
            continue
        base, hand = bases[pair], gripper_poses[pair]
        if configuration_hits(robot, obstacles, work, base, home, opening, active & _STATIC, padding, True):
            continue
        R[0, 0] = R[1, 1] = math.cos(hand[3] - base[2])
        R[1, 0] = math.sin(hand[3] - base[2])
        R[0, 1] = -R[1, 0]
        c, s, x, y = math.cos(base[2]), math.sin(base[2]), hand[0] - base[0], hand[1] - base[1]
        p[0], p[1], p[2] = c * x + s * y, c * y - s * x, hand[2]
        least = np.inf
        for torso in torsos:
            if _is_bettered(by_gripper, rows_hits, count, _PER_MASK):
                break
            for roll in rolls:
                solutions = ik_arm(links, R, p, torso, roll, lower, upper, found)
                for k in range(_turned_home(found, solutions, home, lower, upper)):
                    q = found[k]
                    if nearest_home:
                        travel = (_LIFT_WEIGHT * (q[0] - home[0])) ** 2 + ((q[1:] - home[1:]) ** 2).sum()
                        solid = active & _SOLID
                        if travel < least and not configuration_hits(
                            robot, obstacles, work, base, q, opening, solid, padding, True
                        ):
                            least = travel
                            nearest[:] = q
                        continue
                    count = _consider(
                        robot, obstacles, work, base, q, pair, opening, active, by_gripper, padding, first_free, home,
                        rows_q, rows_pair, rows_hits, rows_quality, count,
                    )  # fmt: skip
        if least < np.inf:
            count = _consider(
                robot, obstacles, work, base, nearest, pair, opening, active, by_gripper, padding, first_free, home,
                rows_q, rows_pair, rows_hits, rows_quality, count,
            )  # fmt: skip
        if first_free and count > 0:
            break
    return rows_q[:count].copy(), rows_pair[:count].copy(), rows_hits[:count].copy(), rows_quality[:count].copy()
