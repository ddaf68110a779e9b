"""Collision-free motions of torso and arm on a standing base; where there is none, which objects are in the way."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from assets.robots import RobotSpec
from irm.chain import ArmChain
from irm.kinematics import forward
from planners.collision.scene_arrays import RobotArrays
from planners.collision.world import STEP, CollisionWorld
from planners.motion.arm_query import DEFAULT_EFFORT, ArmQuery, RRTConfig
from planners.motion.rrt import blend_corners, rrt_connect, shortcut
from planners.scene import SELF_BIT, HeldObject, RobotState
from planners.scene.masks import FIXED_BITS

ROOM = 0.01
"""[m] that free motions keep from everything where they can: the arm lags, and what is held sinks by some mm."""
_PHASE = "transit"
"""The phase of a motion that this module plans, for messages."""
_ROLL_RANGE = 2 * math.pi
"""[rad] A joint with a wider range reaches one orientation at several angles."""


@dataclass(frozen=True, eq=False)
class ArmPath:
    """A motion of torso and arm, straight between waypoints. Arrays are read-only.

    Attributes:
        base: (3,) x [m], y [m], yaw [rad].
        waypoints: (n, 8) torso [m] and arm [rad].
        opening: of the gripper [m].
        held: the held object.
        ignore: mask of objects that did not count as obstacles.
    """

    base: NDArray[np.float64]
    waypoints: NDArray[np.float64]
    opening: float
    held: HeldObject | None = None
    ignore: int = 0

    def __post_init__(self) -> None:
        for name in ("base", "waypoints"):
            array = np.array(getattr(self, name), dtype=float)
            array.setflags(write=False)
            object.__setattr__(self, name, array)

    @property
    def start(self) -> NDArray[np.float64]:
        """(8,) first waypoint."""
        return np.asarray(self.waypoints[0])

    @property
    def end(self) -> NDArray[np.float64]:
        """(8,) last waypoint."""
        return np.asarray(self.waypoints[-1])

    @property
    def configurations(self) -> NDArray[np.float64]:
        """(n, 11) whole-body configurations: base and waypoints."""
        return on_base(self.base, self.waypoints)

    def reversed(self) -> ArmPath:
        """The same motion backwards."""
        return replace(self, waypoints=self.waypoints[::-1])


@dataclass(frozen=True)
class BlockedBy:
    """No path as the scene is: these objects are in the way, in this phase of the motion."""

    blockers: frozenset[str]
    phase: str


@dataclass(frozen=True)
class NoPath:
    """No path, whatever is cleared, and why: limits, static obstacles, self-collision, or the search gave up."""

    reason: str


def unwrap_joints(robot: RobotArrays, q: ArrayLike, goals: ArrayLike) -> NDArray[np.float64]:
    """Add whole turns to continuous joints so that each is nearest to its angle in `q`.

    Args:
        robot: whose joint limits.
        q: (8,) torso [m] and arm [rad].
        goals: (8,) or (k, 8).

    Returns:
        the same configurations, in the shape of `goals`, within the limits.
    """
    start, turned = np.asarray(q, dtype=float), np.array(goals, dtype=float)
    for joint in np.flatnonzero(robot.upper - robot.lower > _ROLL_RANGE):
        angle = turned[..., joint]
        nearest = angle + 2 * math.pi * np.round((start[joint] - angle) / (2 * math.pi))
        inside = (nearest >= robot.lower[joint]) & (nearest <= robot.upper[joint])
        turned[..., joint] = np.where(inside, nearest, angle)
    return turned


@cache
def _chain(robot: RobotSpec) -> ArmChain:
    return ArmChain.from_robot(robot)


def tcp_pose(robot: RobotSpec, state: RobotState) -> NDArray[np.float64]:
    """T_world_tcp (4, 4) of the robot in a state."""
    x, y, yaw = state.base
    T_world_base = np.eye(4)
    T_world_base[:2, :2] = [[math.cos(yaw), -math.sin(yaw)], [math.sin(yaw), math.cos(yaw)]]
    T_world_base[:2, 3] = x, y
    return np.asarray(T_world_base @ forward(_chain(robot), state.q))


def plan_arm(
    world: CollisionWorld,
    query: ArmQuery,
    q_start: ArrayLike,
    q_goals: ArrayLike,
    *,
    rng: np.random.Generator,
    config: RRTConfig = DEFAULT_EFFORT,
    find_blockers: bool = True,
) -> ArmPath | BlockedBy | NoPath:
    """A free path from one configuration to one of several, shortened; at a distance of `ROOM` if one is found there.

    Args:
        world: the scene, compiled.
        query: base pose, gripper opening, held object, and what does not count.
        q_start: (8,).
        q_goals: (8,) or (k, 8).
        rng: for the random trees; the same generator state gives the same path.
        config: effort.
        find_blockers: whether to find out which objects are in the way; this repeats the search many times.

    Returns:
        the path; the smallest set of objects that was found to be in the way; or why clearing would not help.
    """
    start, goals = np.array(q_start, dtype=float), np.atleast_2d(np.array(q_goals, dtype=float))
    if not query.exact:
        goals = unwrap_joints(world.robot, start, goals)
    path = _search(world, query, start, goals, rng, config)
    if path is not None:
        return ArmPath(query.base, path, query.opening, query.held, query.ignore)
    if not find_blockers:
        return _gave_up(config)
    return blocking_set(world, query, start, goals, rng=rng, config=config)


def blocking_set(
    world: CollisionWorld,
    query: ArmQuery,
    q_start: ArrayLike,
    q_goals: ArrayLike,
    *,
    rng: np.random.Generator,
    config: RRTConfig = DEFAULT_EFFORT,
) -> BlockedBy | NoPath:
    """The smallest set of objects found without which `plan_arm` succeeds; confirmed by planning without them.

    The objects that start and goals touch are tried first, then those met by a path that ignores all objects; of the
    latter, each without which a path is found all the same is left out. Arguments as for `plan_arm`; goals are taken
    as given.
    """
    start, goals = np.array(q_start, dtype=float), np.atleast_2d(np.array(q_goals, dtype=float))
    opening, held, ignore = query.opening, query.held, query.ignore
    touched = [int(h) for h in world.hits_many(query.base, np.vstack([start[None], goals]), opening, held, ignore)]
    if touched[0] & FIXED_BITS:
        return NoPath(f"the start touches {named_bits(world, touched[0] & FIXED_BITS)}")
    standing = [(h, goal) for h, goal in zip(touched[1:], goals, strict=True) if not h & FIXED_BITS]
    if not standing:
        worst = touched[1] if len(touched) > 1 else FIXED_BITS
        return NoPath(f"every goal touches {named_bits(world, worst & FIXED_BITS)}")
    least = min((h for h, _ in standing), key=lambda h: (h.bit_count(), h)) | touched[0]
    free_goals = np.array([goal for _, goal in standing])

    def plan_without(mask: int) -> NDArray[np.float64] | None:
        """A path among the other objects, (n, 8)."""
        return _path_within(world, replace(query, ignore=ignore | mask), start, free_goals, rng, config)

    if least and plan_without(least) is not None:
        return BlockedBy(frozenset(world.scene.names_of(least)), _PHASE)
    everything = (1 << len(world.scene.objects)) - 1
    path = plan_without(everything)
    if path is None:
        return NoPath("no path even without any object")
    blockers = world.path_hits(on_base(query.base, path), opening, held, ignore) & everything
    for bit in [1 << i for i in range(len(world.scene.objects)) if blockers & ~least & 1 << i]:
        if plan_without(blockers & ~bit) is not None:
            blockers &= ~bit
    if not blockers:
        return _gave_up(config)
    return BlockedBy(frozenset(world.scene.names_of(blockers)), _PHASE)


def named_bits(world: CollisionWorld, mask: int) -> str:
    """The names of what a mask stands for, joined by "and"."""
    return " and ".join(world.names_of(mask)) or "nothing"


def on_base(base: NDArray[np.float64], waypoints: NDArray[np.float64]) -> NDArray[np.float64]:
    """Whole-body configurations (n, 11): a base pose (3,) with each of `waypoints` (n, 8)."""
    return np.hstack([np.tile(base, (len(waypoints), 1)), waypoints])


def _gave_up(config: RRTConfig) -> NoPath:
    return NoPath(f"{_PHASE}: no path found within {config.iterations} iterations")


def _search(
    world: CollisionWorld,
    query: ArmQuery,
    start: NDArray[np.float64],
    goals: NDArray[np.float64],
    rng: np.random.Generator,
    config: RRTConfig,
) -> NDArray[np.float64] | None:
    """A verified path (n, 8) that keeps `ROOM` from everything but the robot, or else the world's padding; or None."""
    path = _path_within(world, query, start, goals, rng, config)
    if path is None:
        return None
    roomy = world.with_padding(ROOM)
    ignore = query.ignore | 1 << SELF_BIT
    if not roomy.path_hits(on_base(query.base, path), query.opening, query.held, ignore, first_only=True):
        return path
    detour = _path_within(roomy, query, start, goals, rng, config)
    return path if detour is None else detour


def _path_within(
    world: CollisionWorld,
    query: ArmQuery,
    start: NDArray[np.float64],
    goals: NDArray[np.float64],
    rng: np.random.Generator,
    config: RRTConfig,
) -> NDArray[np.float64] | None:
    """A verified path (n, 8), None when start or goals are blocked or the search gives up."""
    opening, held, ignore = query.opening, query.held, query.ignore
    touched = world.hits_many(query.base, np.vstack([start[None], goals]), opening, held, ignore)
    if touched[0] or touched[1:].all():
        return None
    X = on_base(query.base, np.vstack([start[None], goals[touched[1:] == 0]]))
    lower, upper = _bounds(world.robot, X, config.margin)
    checks = world.query(opening, held, ignore, first_only=True)
    for step in (config.step, STEP):
        path = rrt_connect(checks, X[0], X[1:], lower, upper, step, config.iterations, config.near, rng)
        if not len(path):
            return None
        path = shortcut(checks, path, step, config.shortcuts, rng)
        path = blend_corners(checks, path, step)
        if not world.path_hits(path, opening, held, ignore):
            return np.asarray(path[:, len(query.base) :])
    return None


def _bounds(
    robot: RobotArrays, X: NDArray[np.float64], margin: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Bounds of random whole-body configurations: the base stands, continuous joints stay near start and goals."""
    lower, upper = X.min(axis=0), X.max(axis=0)
    turns = robot.upper - robot.lower > _ROLL_RANGE
    lower[3:] = np.where(turns, np.maximum(robot.lower, lower[3:] - margin), robot.lower)
    upper[3:] = np.where(turns, np.minimum(robot.upper, upper[3:] + margin), robot.upper)
    return lower, upper
