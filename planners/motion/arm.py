"""Collision-free motions of torso and arm on a standing base; where there is none, which objects are in the way."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from assets.robots import RobotSpec
from irm.chain import ArmChain
from irm.compilation import njit
from irm.kinematics import fk_frames, forward
from planners.collision.scene_arrays import RobotArrays
from planners.collision.straight_lines import trace_by_torso, trace_straight
from planners.collision.world import OVERLAP, STEP, CollisionWorld
from planners.motion.path import CLEARANCE, BlockedBy, NoPath, WholeBodyPath, on_base
from planners.motion.rrt import blend_corners, rrt_connect, shortcut
from planners.scene import SELF_BIT, HeldObject, RobotState
from planners.scene.masks import FIXED_BITS
from planners.scene.solid import frozen

Array = NDArray[np.float64]

_ITERATIONS, _NEAR = 600, 0.8
"""Random targets of a search at most, and the share of them drawn about the straight line from start to goal."""
SHORTCUTS = 20
"""Random shortcuts tried on a path that was found."""
_COARSE_STEP = 0.015
"""[m] between checks while searching; accepted paths are checked again at `collision.world.STEP`."""
_MARGIN = 1.5
"""[rad] beyond start and goal within which joints with a range of more than a turn are sampled."""
_FULL_TURN = 2 * math.pi
"""[rad] A joint with a wider range reaches one orientation at several angles."""
_UP = np.array([0.0, 0.0, 1.0])
_RISES = (0.25, 0.19, 0.12, 0.06)
"""[m] that the gripper moves straight up before the arm moves home, tried in this order."""
_chain = cache(ArmChain.from_robot)
_GAVE_UP = NoPath(f"transit: no path found within {_ITERATIONS} iterations")


@dataclass(frozen=True, eq=False)
class ArmQuery:
    """The situation in which torso and arm move, or are asked whether they could.

    Attributes:
        world: the scene, compiled.
        base: (3,) x [m], y [m], yaw [rad]: where the base stands; read-only.
        opening: of the gripper [m].
        held: the held object.
        ignore: mask of objects that are not obstacles.
    """

    world: CollisionWorld
    base: Array
    opening: float
    held: HeldObject | None = None
    ignore: int = 0

    def __post_init__(self) -> None:
        object.__setattr__(self, "base", frozen(self.base, (3,), "base"))

    def hits(self, Q: Array) -> list[int]:
        """Masks of what configurations (k, 8) hit."""
        return [int(hits) for hits in self.world.hits_many(self.base, Q, self.opening, self.held, self.ignore)]

    def path_hits(self, X: Array, first_only: bool = False) -> int:
        """Mask of what a motion through whole-body configurations (k, 11) hits; see `CollisionWorld.path_hits`."""
        return self.world.path_hits(X, self.opening, self.held, self.ignore, first_only=first_only)


def tcp_pose(robot: RobotSpec, state: RobotState) -> Array:
    """T_world_tcp (4, 4) of the robot in a state."""
    x, y, yaw = state.base
    T_world_base = np.eye(4)
    T_world_base[:2, :2] = [[math.cos(yaw), -math.sin(yaw)], [math.sin(yaw), math.cos(yaw)]]
    T_world_base[:2, 3] = x, y
    return np.asarray(T_world_base @ forward(_chain(robot), state.q))


def tcp_poses(robot: RobotArrays, X: Array) -> Array:
    """T_world_tcp (n, 4, 4) of whole-body configurations (n, 11)."""
    return np.asarray(_tcp_poses(robot, np.array(X, order="C")))


@njit(cache=True)
def _tcp_poses(robot: RobotArrays, X: Array) -> Array:
    n, T = robot.axes.shape[0], np.zeros((X.shape[0], 4, 4))
    R, p = np.empty((n + 1, 3, 3)), np.empty((n + 1, 3))
    for row in range(X.shape[0]):
        fk_frames(robot.offsets, robot.axes, robot.tip, X[row, 3:], R, p)
        c, s = math.cos(X[row, 2]), math.sin(X[row, 2])
        for column in range(4):
            x = p[n, 0] if column == 3 else R[n, 0, column]
            y = p[n, 1] if column == 3 else R[n, 1, column]
            T[row, 0, column], T[row, 1, column] = c * x - s * y, s * x + c * y
            T[row, 2, column] = p[n, 2] if column == 3 else R[n, 2, column]
        T[row, 0, 3] += X[row, 0]
        T[row, 1, 3] += X[row, 1]
        T[row, 3, 3] = 1.0
    return T


def unwrap_joints(robot: RobotArrays, q: ArrayLike, goals: ArrayLike) -> Array:
    """Add whole turns to continuous joints so that each is nearest to its angle in `q`.

    Args:
        robot: whose joint limits.
        q: (8,) torso [m] and arm [rad].
        goals: (8,) or (k, 8).

    Returns:
        the same configurations, in the shape of `goals`, within the limits.
    """
    start, turned = np.asarray(q, dtype=float), np.array(goals, dtype=float)
    for joint in np.flatnonzero(robot.upper - robot.lower > _FULL_TURN):
        angle = turned[..., joint]
        nearest = angle + 2 * math.pi * np.round((start[joint] - angle) / (2 * math.pi))
        inside = (nearest >= robot.lower[joint]) & (nearest <= robot.upper[joint])
        turned[..., joint] = np.where(inside, nearest, angle)
    return turned


def plan_arm(
    query: ArmQuery,
    q_start: ArrayLike,
    q_goals: ArrayLike,
    *,
    rng: np.random.Generator,
    find_blockers: bool = True,
) -> WholeBodyPath | BlockedBy | NoPath:
    """A free path from one configuration to one of several, shortened; at a distance of `CLEARANCE` if one is found.

    Args:
        query: the situation.
        q_start: (8,).
        q_goals: (8,) or (k, 8); see `unwrap_joints` for continuous joints.
        rng: for the random trees; the same generator state gives the same path.
        find_blockers: whether to find out which objects are in the way; this repeats the search many times.

    Returns:
        the path; the smallest set of objects that was found to be in the way; or why clearing would not help.
    """
    start, goals = np.array(q_start, dtype=float), np.atleast_2d(np.array(q_goals, dtype=float))
    path = _path_within(query, start, goals, rng)
    if path is None:
        return _blocking_set(query, start, goals, rng) if find_blockers else _GAVE_UP
    # The robot may be nearer than that to itself: its links are where they are in every path.
    wide = replace(query, world=query.world.with_padding(CLEARANCE), ignore=query.ignore | 1 << SELF_BIT)
    if wide.path_hits(on_base(query.base, path), first_only=True):
        to_itself = replace(wide, ignore=query.ignore)
        is_near_itself = any(hits >> SELF_BIT & 1 for hits in to_itself.hits(np.vstack([start[None], goals])))
        detour = _path_within(wide if is_near_itself else to_itself, start, goals, rng)
        if detour is not None and not query.path_hits(on_base(query.base, detour), first_only=True):
            path = detour
    return WholeBodyPath(on_base(query.base, path), query.opening, query.held, query.ignore)


def _blocking_set(query: ArmQuery, start: Array, goals: Array, rng: np.random.Generator) -> BlockedBy | NoPath:
    """The smallest set of objects found without which `plan_arm` succeeds; confirmed by planning without them.

    The objects that start and goals touch are tried first, then those met by a path that ignores all objects; of the
    latter, each without which a path is found all the same is left out.
    """
    world, names = query.world, query.world.scene.names
    touched = query.hits(np.vstack([start[None], goals]))
    if touched[0] & FIXED_BITS:
        return NoPath(f"the start touches {' and '.join(world.names_of(touched[0] & FIXED_BITS))}")
    standing = [(h, goal) for h, goal in zip(touched[1:], goals, strict=True) if not h & FIXED_BITS]
    if not standing:
        worst = touched[1] if len(touched) > 1 else FIXED_BITS
        return NoPath(f"every goal touches {' and '.join(world.names_of(worst & FIXED_BITS))}")
    least = min((h for h, _ in standing), key=lambda h: (h.bit_count(), h)) | touched[0]
    free_goals = np.array([goal for _, goal in standing])

    def plan_without(mask: int) -> Array | None:
        """A path among the other objects, (n, 8)."""
        return _path_within(replace(query, ignore=query.ignore | mask), start, free_goals, rng)

    if least and plan_without(least) is not None:
        return BlockedBy(frozenset(world.scene.names_of(least)), "transit")
    everything = (1 << len(names)) - 1
    path = plan_without(everything)
    if path is None:
        return NoPath("no path even without any object")
    blockers = query.path_hits(on_base(query.base, path)) & everything
    for bit in [1 << i for i in range(len(names)) if blockers & ~least & 1 << i]:
        if plan_without(blockers & ~bit) is not None:
            blockers &= ~bit
    return BlockedBy(frozenset(world.scene.names_of(blockers)), "transit") if blockers else _GAVE_UP


def _path_within(query: ArmQuery, start: Array, goals: Array, rng: np.random.Generator) -> Array | None:
    """A verified path (n, 8), None when start or goals are blocked or the search gives up."""
    touched = np.array(query.hits(np.vstack([start[None], goals])), dtype=np.uint64)
    if touched[0] or touched[1:].all():
        return None
    X = on_base(query.base, np.vstack([start[None], goals[touched[1:] == 0]]))
    # The base stands; joints that turn without end stay near start and goals.
    robot, lower, upper = query.world.robot, X.min(axis=0), X.max(axis=0)
    turns = robot.upper - robot.lower > _FULL_TURN
    lower[3:] = np.where(turns, np.maximum(robot.lower, lower[3:] - _MARGIN), robot.lower)
    upper[3:] = np.where(turns, np.minimum(robot.upper, upper[3:] + _MARGIN), robot.upper)
    checks = query.world.query(query.opening, query.held, query.ignore, first_only=True)
    for step in (_COARSE_STEP, STEP):
        path = rrt_connect(checks, X[0], X[1:], lower, upper, step, _ITERATIONS, _NEAR, rng)
        if not len(path):
            return None
        path = shortcut(checks, path, step, SHORTCUTS, rng)
        path = blend_corners(checks, path, step)
        if not query.path_hits(path):
            return np.asarray(path[:, len(query.base) :])
    return None


def is_at_home(world: CollisionWorld, state: RobotState) -> bool:
    """Whether torso and arm are in the home configuration, but for whole turns."""
    return np.array_equal(state.q, unwrap_joints(world.robot, state.q, world.scene.robot.home))


def is_among_objects(world: CollisionWorld, state: RobotState) -> bool:
    """Whether the robot, away from home, is nearer than `CLEARANCE` to something other than itself."""
    if is_at_home(world, state):
        return False
    gap, held = world.scene.robot.opening(state.finger_position), world.scene.held
    return bool(world.with_padding(CLEARANCE).hits(state.base, state.q, gap, held, 1 << SELF_BIT))


def plan_home(world: CollisionWorld, state: RobotState, rng: np.random.Generator) -> WholeBodyPath | NoPath:
    """A free path of torso and arm to the home configuration, on a standing base, so that the base can drive.

    A robot that starts with its gripper among the objects moves straight up first. Where the start is nearer to
    something than the world's padding, as in a grasp or after a disturbance, less padding will do.

    Args:
        world: the scene, compiled, with what is held.
        state: where the robot is.
        rng: for the random trees.

    Returns:
        the path, whose `opening` the gripper takes before it; or why there is none.
    """
    held, robot = world.scene.held, world.scene.robot
    gap = robot.opening(state.finger_position)
    touched, is_among = world.hits(state.base, state.q, gap, held), is_among_objects(world, state)
    opening = min(gap + 2 * robot.finger_gap, robot.max_opening) if touched and held is None else gap
    for padded in (world, world.with_padding(0.0), world.with_padding(-OVERLAP)):
        query = ArmQuery(padded, state.base, opening, held)
        ignore = query.hits(state.q[None])[0] & ~FIXED_BITS
        lines = [state.q[None]]
        for rise in _RISES:
            up = (trace(padded, state.base, state.q, _UP, rise) for trace in (trace_straight, trace_by_torso))
            lines += [line for line in up if line is not None]
        for line in sorted(lines, key=len, reverse=is_among):
            if replace(query, ignore=ignore).path_hits(on_base(state.base, line)):
                continue
            goal = unwrap_joints(padded.robot, line[-1], robot.home)
            path = plan_arm(query, line[-1], goal, rng=rng, find_blockers=False)
            if isinstance(path, WholeBodyPath):
                raised = on_base(state.base, line[:-1])
                return WholeBodyPath(np.vstack([raised, path.configurations]), opening, held)
    return NoPath("home: no free path of the arm to its home configuration found")
