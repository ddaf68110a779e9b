"""Collision-free motions of torso and arm with a standing base. If they fail, the objects in the way."""

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
"""Most random targets of a search, and the share of them near the straight line from start to goal."""
SHORTCUTS = 20
"""Random shortcuts to try on a path."""
_COARSE_STEP = 0.015
"""Step [m] between checks during the search. Accepted paths are checked again at `collision.world.STEP`."""
_MARGIN = 1.5
"""Range [rad] beyond start and goal in which joints with a range of more than a turn are sampled."""
_FULL_TURN = 2 * math.pi
"""Range [rad] above which a joint reaches the same orientation at several angles."""
_UP = np.array([0.0, 0.0, 1.0])
_RISES = (0.25, 0.19, 0.12, 0.06)
"""Rises [m] of the gripper before the arm moves home, in the order of the tries."""
_chain = cache(ArmChain.from_robot)
_GAVE_UP = NoPath(f"transit: no path found within {_ITERATIONS} iterations")


@dataclass(frozen=True, eq=False)
class ArmQuery:
    """Surroundings of a motion of torso and arm.

    Attributes:
        world: the compiled scene.
        base: (3,) x [m], y [m], yaw [rad] of the base, read-only.
        opening: gripper opening [m].
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
        """Collision masks of configurations (k, 8)."""
        return [int(hits) for hits in self.world.hits_many(self.base, Q, self.opening, self.held, self.ignore)]

    def path_hits(self, X: Array, first_only: bool = False) -> int:
        """Collision mask of a motion through whole-body configurations (k, 11). See `CollisionWorld.path_hits`."""
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
        robot: the robot with its joint limits.
        q: (8,) torso [m] and arm [rad].
        goals: (8,) or (k, 8).

    Returns:
        The same configurations, in the shape of `goals`, within the limits.
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
    """Plan a collision-free path from one configuration to one of several, shortened, with `CLEARANCE` if possible.

    Args:
        query: the surroundings.
        q_start: (8,) start configuration.
        q_goals: (8,) or (k, 8) goal configurations. See `unwrap_joints` for continuous joints.
        rng: for the random trees. The same generator state gives the same path.
        find_blockers: whether to find the objects in the way. This repeats the search many times.

    Returns:
        The path, the smallest known set of objects in the way, or the reason why clearing does not help.
    """
    start, goals = np.array(q_start, dtype=float), np.atleast_2d(np.array(q_goals, dtype=float))
    path = _path_within(query, start, goals, rng)
    if path is None:
        return _blocking_set(query, start, goals, rng) if find_blockers else _GAVE_UP
    # The robot's links may be closer than CLEARANCE to each other, on any path: self-collision is left out here.
    wide = replace(query, world=query.world.with_padding(CLEARANCE), ignore=query.ignore | 1 << SELF_BIT)
    if wide.path_hits(on_base(query.base, path), first_only=True):
        to_itself = replace(wide, ignore=query.ignore)
        is_near_itself = any(hits >> SELF_BIT & 1 for hits in to_itself.hits(np.vstack([start[None], goals])))
        detour = _path_within(wide if is_near_itself else to_itself, start, goals, rng)
        if detour is not None and not query.path_hits(on_base(query.base, detour), first_only=True):
            path = detour
    return WholeBodyPath(on_base(query.base, path), query.opening, query.held, query.ignore)


def _blocking_set(query: ArmQuery, start: Array, goals: Array, rng: np.random.Generator) -> BlockedBy | NoPath:
    """Find a small set of objects without which `plan_arm` succeeds, confirmed by a plan without them.

    Objects that start and goals touch are tried first. Then come the objects on a path that ignores all objects. An
    object is dropped from these if a path exists without its removal.
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
        """Path (n, 8) with the objects of a mask removed."""
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
    """A checked path (n, 8), None if start or goals are blocked or the search gives up."""
    touched = np.array(query.hits(np.vstack([start[None], goals])), dtype=np.uint64)
    if touched[0] or touched[1:].all():
        return None
    X = on_base(query.base, np.vstack([start[None], goals[touched[1:] == 0]]))
    # The base does not move. Continuous joints stay near start and goals.
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
    """Whether torso and arm are in the home configuration, up to whole turns."""
    return np.array_equal(state.q, unwrap_joints(world.robot, state.q, world.scene.robot.home))


def is_among_objects(world: CollisionWorld, state: RobotState) -> bool:
    """Whether the robot, away from home, is closer than `CLEARANCE` to something other than itself."""
    if is_at_home(world, state):
        return False
    gap, held = world.scene.robot.opening(state.finger_position), world.scene.held
    return bool(world.with_padding(CLEARANCE).hits(state.base, state.q, gap, held, 1 << SELF_BIT))


def plan_home(world: CollisionWorld, state: RobotState, rng: np.random.Generator) -> WholeBodyPath | NoPath:
    """Plan a collision-free path of torso and arm home, with a standing base, so that the base can drive.

    With the gripper among the objects, the arm first moves straight up. If the start is closer to something than the
    world's padding, as in a grasp or after a disturbance, the padding is reduced.

    Args:
        world: the compiled scene, with held objects.
        state: the robot's state.
        rng: for the random trees.

    Returns:
        The path, or the reason why none was found. The gripper takes the path's `opening` before the motion.
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
