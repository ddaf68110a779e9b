"""The scan for arm configurations behind `planners.grasping.arm_configurations`, compiled."""

from __future__ import annotations

import math
from collections.abc import Collection
from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from irm.compilation import njit
from irm.ik.closed_form import MAX_SOLUTIONS, NOT_MIRRORED
from irm.ik.solvers import arm_solutions
from irm.kernel_arguments import Layout, call_at, copy_row, kernel_address, layout_of, leaf_kernel, pointer_to
from irm.kinematics import arm_jacobian, condition, fk_frames
from planners.collision.hit_kernels import CollisionQuery, arm_hits, configuration_hits
from planners.collision.scene_arrays import RobotArrays
from planners.collision.straight_lines import follow_line
from planners.scene.masks import FIXED_BITS, SELF_BIT, STATIC_BIT

Array = NDArray[np.float64]
CAPACITY = np.int64(96)
"""Configurations kept in all. Typed, so that kernels are not compiled once more for the constant."""
_NONE, _ONE = np.uint64(0), np.uint64(1)
_STATIC, _SELF = np.uint64(1 << STATIC_BIT), np.uint64(1 << SELF_BIT)
_FIXED = np.uint64(FIXED_BITS)
_RISE, _RISE_STEP, _RISE_JUMP = 0.19, 0.01, 0.15
"""Where the torso stays, only configurations count from which the arm lifts the gripper so far straight up [m], in
steps [m] in which no joint turns farther than this [rad]: it could not take the object away in others."""
_PER_MASK = np.int64(6)
"""Configurations kept for one set of hit objects, each for another pair of gripper pose and base pose. Typed, so that
kernels are not compiled once more for the constant."""
_ANY_NUMBER = 64
"""More objects than a mask has."""
_TRAVEL_COST = 0.004
"""Manipulability given up per radian of joint travel from the home configuration: short motions are preferred."""
_FULL_TURN = 2.0 * math.pi
"""[rad] A joint with a wider range reaches one orientation at several angles."""
_HIGH_ELBOW = 0.35
"""[m] above the TCP: an elbow that high carries the forearm over what stands on the table."""
_ELBOW_WORTH = 0.4
"""Manipulability that a metre of elbow height is worth: a high arm sweeps little of the table."""
_LIFT = 0.2
"""[m] of torso travel that is worth keeping: it lifts the gripper straight up in every configuration of the arm."""
_LIFT_WORTH = 0.5
"""Manipulability that a metre of remaining torso travel is worth."""
_LIFT_WEIGHT = 10.0
"""[rad/m] Weight of torso travel when the configuration nearest to home is looked for."""


class Kept(NamedTuple):
    """Up to `CAPACITY` configurations of n joints; the first `size[0]` rows are in use.

    Attributes:
        q: (c, n) torso [m] and arm [rad].
        pair: (c,) index of gripper pose and base pose.
        hits: (c,) objects hit, as masks.
        quality: (c,) see `_quality`.
        size: (1,) number of rows in use.
    """

    q: Array
    pair: NDArray[np.int64]
    hits: NDArray[np.uint64]
    quality: Array
    size: NDArray[np.int64]


class Few(NamedTuple):
    """A scan for new masks alone: one configuration for each, with few objects.

    Attributes:
        also: mask of objects that count in any case.
        fewer_than: a configuration is left out if it hits so many objects, with those of `also`.
    """

    also: int
    fewer_than: int


class Memory(NamedTuple):
    """Memory that a scan of configurations of n joints writes to, allocated outside compiled code.

    Attributes:
        kept: the configurations found so far.
        found: (MAX_SOLUTIONS, n) inverse kinematics; `nearest` (n,) the configuration nearest to home.
        R, p: (n + 1, 3, 3) and (n + 1, 3) frames of the links; `J` (6, n - 1) the Jacobian, and memory of
            `condition`: `A` (6, 6), `d` and `e` (6,).
        can_rise: address of `can_rise`; 0 for a robot with a lift, for which it is not compiled.
        per_mask: configurations wanted for one set of hit objects, known ones included.
        also, fewer_than: of `Few`.
    """

    kept: Kept
    found: Array
    nearest: Array
    R: Array
    p: Array
    J: Array
    A: Array
    d: Array
    e: Array
    can_rise: int
    per_mask: int
    also: np.uint64
    fewer_than: int


def make_memory(query: CollisionQuery, known: Collection[int] = (), few: Few | None = None) -> Memory:
    """Memory for one scan with a packed query, with nothing found yet but some `known` masks.

    These are rows without a pair, -1, of a quality that any other exceeds.
    """
    robot, rows = query.robot, int(CAPACITY)
    n, has_lift = len(robot.axes), robot.upper[0] > robot.lower[0]
    masks = sorted(set(known), key=int.bit_count)[:rows]
    kept = Kept(
        np.empty((rows, n)),
        np.full(rows, -1, np.int64),
        np.array([*masks, *[0] * (rows - len(masks))], np.uint64),
        np.full(rows, -np.inf),
        np.array([len(masks)], np.int64),
    )
    R, p, J = np.empty((n + 1, 3, 3)), np.empty((n + 1, 3)), np.empty((6, n - 1))
    rise = 0 if has_lift else _address_of_can_rise(layout_of(query))
    found, A, d, e = np.empty((MAX_SOLUTIONS, n)), np.empty((6, 6)), np.empty(6), np.empty(6)
    per_mask, (also, fewer_than) = (int(_PER_MASK), Few(0, _ANY_NUMBER)) if few is None else (1, few)
    return Memory(kept, found, np.empty(n), R, p, J, A, d, e, rise, per_mask, np.uint64(also), fewer_than)


@cache
def _address_of_can_rise(query: Layout) -> int:
    return kernel_address(can_rise, query, np.empty(1), np.empty(1))


@njit(cache=True)
def can_rise(query: CollisionQuery, base: Array, q: Array) -> int:
    """Whether the arm lifts the gripper straight up by `_RISE` without touching the robot, 1 or 0."""
    robot, up = query.robot, np.array((0.0, 0.0, 1.0))
    path = follow_line(robot, q, up, _RISE, _RISE_STEP, _RISE_JUMP, np.ones(q.shape[0]))
    if path.shape[0] < math.ceil(_RISE / _RISE_STEP - 1e-9) + 1:
        return 0
    for k in range(path.shape[0] - 1, 0, -3):
        if configuration_hits(query, query.active & _SELF, base, path[k]) != _NONE:
            return 0
    return 1


@njit(cache=True)
def many_gripper_hits(query: CollisionQuery, gripper_poses: Array) -> NDArray[np.uint64]:
    """The loop of `gripper_hits`; the robot of `query` is the gripper alone, its two joints height and pitch."""
    hits = np.empty(gripper_poses.shape[0], np.uint64)
    base, joints = np.empty(3), np.empty(2)
    for k in range(gripper_poses.shape[0]):
        base[0], base[1], base[2] = gripper_poses[k, 0], gripper_poses[k, 1], gripper_poses[k, 3]
        joints[0], joints[1] = gripper_poses[k, 2], gripper_poses[k, 4]
        hits[k] = configuration_hits(query, query.active, base, joints)
    return hits


@leaf_kernel
def _nearest_turn(angle: float, wanted: float, lower: float, upper: float) -> float:
    """The equivalent of a roll joint's angle nearest to the wanted one, within its limits."""
    turned = angle + 2.0 * math.pi * np.round((wanted - angle) / (2.0 * math.pi))
    if lower <= turned <= upper:
        return turned
    return angle


@leaf_kernel
def _unwrap(found: Array, count: int, home: Array, robot: RobotArrays) -> None:
    """Turn joints that go round to near home."""
    for k in range(count):
        for joint in range(home.shape[0]):
            angle, lower, upper = found[k, joint], robot.lower[joint], robot.upper[joint]
            if upper - lower > _FULL_TURN:
                found[k, joint] = _nearest_turn(angle, home[joint], lower, upper)


@njit(cache=True)
def _quality(robot: RobotArrays, memory: Memory, q: Array, home: Array) -> float:
    """Manipulability; more for a high elbow and torso travel upwards, less per radian from the home configuration."""
    n, R, p, J = q.shape[0], memory.R, memory.p, memory.J
    fk_frames(robot.offsets, robot.axes, robot.tip, q, R, p)
    headroom = min(robot.upper[0] - q[0], _LIFT)
    arm_jacobian(robot.axes, R, p, J)
    travel = 0.0
    for joint in range(1, n):
        travel += abs(q[joint] - home[joint])
    raised = min(max(p[robot.ik.elbow, 2] - p[n, 2], 0.0), _HIGH_ELBOW)
    mu = condition(J, memory.A, memory.d, memory.e)
    return mu + _ELBOW_WORTH * raised + _LIFT_WORTH * headroom - _TRAVEL_COST * travel


@leaf_kernel
def _is_dominated(kept: Kept, hits: np.uint64, most: int) -> bool:
    """Whether kept configurations hit only a part of this, or `most` of them just this."""
    same = 0
    for i in range(kept.size[0]):
        if kept.hits[i] == hits:
            same += 1
        elif kept.hits[i] & ~hits == _NONE:
            return True
    return same >= most


@leaf_kernel
def _has_too_many(memory: Memory, hits: np.uint64) -> bool:
    """Whether these are too many objects for `Few`."""
    left, count = hits | memory.also, 0
    while left != _NONE and count < memory.fewer_than:
        left &= left - _ONE
        count += 1
    return count >= memory.fewer_than


@leaf_kernel
def _insert(kept: Kept, q: Array, pair: int, hits: np.uint64, quality: float) -> None:
    """Add a configuration that no kept one dominates, and drop those it dominates.

    One configuration is kept for each pair and set of hits, and `_PER_MASK` for each set of hits: those of highest
    quality.
    """
    count, place, same, worst = 0, -1, 0, -1
    for i in range(kept.size[0]):
        if kept.hits[i] != hits and hits & ~kept.hits[i] == _NONE:
            continue
        copy_row(kept.q[i], kept.q[count])
        kept.pair[count], kept.hits[count], kept.quality[count] = kept.pair[i], kept.hits[i], kept.quality[i]
        if kept.hits[count] == hits:
            same += 1
            if kept.pair[count] == pair:
                place = count
            if worst < 0 or kept.quality[count] < kept.quality[worst]:
                worst = count
        count += 1
    kept.size[0] = count
    if place < 0 and same >= _PER_MASK:
        place = worst
    if place >= 0 and kept.quality[place] >= quality:
        return
    if place < 0:
        if count == kept.hits.shape[0]:
            return
        place = count
        kept.size[0] = count + 1
    copy_row(q, kept.q[place])
    kept.pair[place], kept.hits[place], kept.quality[place] = pair, hits, quality


@leaf_kernel
def _hits(
    query: CollisionQuery, driven: CollisionQuery, active: np.uint64, base: Array, q: Array, out: Array
) -> np.uint64:
    """What a configuration hits at a base pose, and on the drive that begins at another one, `out`; (0,) for none."""
    hits = _NONE
    if out.shape[0] > 0:
        hits = configuration_hits(driven, active, out, q)
        if hits & _FIXED != _NONE or (query.first_only and hits != _NONE):
            return np.uint64(hits)
    return np.uint64(hits | configuration_hits(query, active & ~hits, base, q))


@njit(cache=True)
def many_configuration_hits(
    query: CollisionQuery, driven: CollisionQuery, shift: Array, bases: Array, Q: Array
) -> NDArray[np.uint64]:
    """What configurations (k, n) hit, each at its base pose (k, 3); `driven` and `shift` as for `scan`."""
    hits, drives = np.empty(Q.shape[0], np.uint64), shift.shape[0] > 0
    out = np.empty(3 if drives else 0)
    for k in range(Q.shape[0]):
        if drives:
            out[0], out[1], out[2] = bases[k, 0] + shift[k, 0], bases[k, 1] + shift[k, 1], bases[k, 2]
        hits[k] = _hits(query, driven, query.active, bases[k], Q[k], out)
    return hits


@njit(cache=True)
def _consider(
    query: CollisionQuery,
    driven: CollisionQuery,
    memory: Memory,
    by_gripper: np.uint64,
    base: Array,
    out: Array,
    q: Array,
    pair: int,
    home: Array,
) -> None:
    """Keep a configuration if no kept one dominates it. What the gripper hits is known and not checked again."""
    hits = by_gripper | arm_hits(query, query.active & ~by_gripper, base, q)
    if out.shape[0] > 0 and hits & _FIXED == _NONE:
        hits |= configuration_hits(driven, query.active & ~hits & ~_SELF, out, q)
    if hits & _FIXED != _NONE or (query.first_only and hits != _NONE):
        return
    if _has_too_many(memory, hits) or _is_dominated(memory.kept, hits, CAPACITY if memory.per_mask > 1 else 1):
        return
    if configuration_hits(query, query.active & _SELF, base, q) != _NONE:
        return
    if memory.can_rise == 0 or call_at(memory.can_rise, (query, base, q)) == 1:
        _insert(memory.kept, q, pair, hits, _quality(query.robot, memory, q, home))


@leaf_kernel
def _travel(q: Array, home: Array) -> float:
    """Squared joint travel [rad²] from the home configuration, the torso's weighed by `_LIFT_WEIGHT`."""
    arm = 0.0
    for joint in range(1, q.shape[0]):
        arm += (q[joint] - home[joint]) * (q[joint] - home[joint])
    torso = _LIFT_WEIGHT * (q[0] - home[0])
    return torso * torso + arm


@leaf_kernel
def _pose_in_base(gripper_pose: Array, base: Array, R: Array, p: Array) -> None:
    """Write orientation Rz(yaw) Ry(pitch) (3, 3) and position (3,) of a gripper pose in the frame of a base pose."""
    cy, sy = math.cos(gripper_pose[3] - base[2]), math.sin(gripper_pose[3] - base[2])
    cp, sp = math.cos(gripper_pose[4]), math.sin(gripper_pose[4])
    R[0, 0], R[0, 1], R[0, 2] = cy * cp, -sy, cy * sp
    R[1, 0], R[1, 1], R[1, 2] = sy * cp, cy, sy * sp
    R[2, 0], R[2, 1], R[2, 2] = -sp, 0.0, cp
    c, s, x, y = math.cos(base[2]), math.sin(base[2]), gripper_pose[0] - base[0], gripper_pose[1] - base[1]
    p[0], p[1], p[2] = c * x + s * y, c * y - s * x, gripper_pose[2]


@njit(cache=True)
def _scan_pair(
    query: CollisionQuery,
    driven: CollisionQuery,
    memory: Memory,
    by_gripper: np.uint64,
    base: Array,
    out: Array,
    pair: int,
    R: Array,
    p: Array,
    home: Array,
    torsos: Array,
    rolls: Array,
    nearest_home: bool,
) -> None:
    """Consider all configurations for one pair of gripper pose (`R`, `p` in the base frame) and base pose."""
    robot, found = query.robot, memory.found
    nearest, least = memory.nearest, np.inf
    for torso in torsos:
        if _is_dominated(memory.kept, by_gripper, memory.per_mask):
            break
        for roll in rolls:
            solutions = arm_solutions(robot.ik, R, p, torso, roll, found, NOT_MIRRORED)
            _unwrap(found, solutions, home, robot)
            for k in range(solutions):
                q = found[k]
                if not nearest_home:
                    _consider(query, driven, memory, by_gripper, base, out, q, pair, home)
                    continue
                travel = _travel(q, home)
                if travel < least and _hits(query, driven, query.active & _FIXED, base, q, out) == _NONE:
                    least = travel
                    copy_row(q, nearest)
    if least < np.inf:
        _consider(query, driven, memory, by_gripper, base, out, nearest, pair, home)


@njit(cache=True)
def scan(
    query: CollisionQuery,
    driven: CollisionQuery,
    shift: Array,
    memory: Memory,
    home: Array,
    bases: Array,
    gripper_poses: Array,
    known: NDArray[np.uint64],
    order: NDArray[np.int64],
    torsos: Array,
    rolls: Array,
    nearest_home: bool,
) -> None:
    """The loop of `scan_configurations` over pairs of gripper pose and base pose, in an `order` (k,).

    `shift` (k, 2) [m] leads from each base pose to where a drive begins, on which `driven` checks what the rigid robot
    hits; (0, 2) for none. Without a drive a base pose counts only if the robot in its `home` (n,) configuration hits
    nothing static there; on a drive the arm is in its final configuration from the start.

    `known` (k,) is what the gripper alone hits. With `query.first_only` the scan stops after the first pair for which
    some configuration hits nothing. What is found is in `memory.kept`.
    """
    writes, first_free, drives = pointer_to(memory), query.first_only, shift.shape[0] > 0
    R, p, out = np.empty((3, 3)), np.empty(3), np.empty(3 if drives else 0)
    for pair in order:
        by_gripper, base = known[pair], bases[pair]
        if by_gripper & _FIXED != _NONE or (first_free and by_gripper != _NONE) or _has_too_many(writes, by_gripper):
            continue
        if drives:
            out[0], out[1], out[2] = base[0] + shift[pair, 0], base[1] + shift[pair, 1], base[2]
        elif configuration_hits(query, query.active & _STATIC, base, home) != _NONE:
            continue
        _pose_in_base(gripper_poses[pair], base, R, p)
        _scan_pair(query, driven, writes, by_gripper, base, out, pair, R, p, home, torsos, rolls, nearest_home)
        if first_free and memory.kept.size[0] > 0:
            break
