"""Collision-free motions of torso and arm on a standing base, and what is in the way where there is none."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from assets.robots import RobotSpec
from irm.arm.kinematics import ArmChain, forward
from planners.collision.configuration_kernel import make_workspace
from planners.collision.robot_model import RobotArrays
from planners.collision.world import STEP, CollisionWorld
from planners.motion.rrt_connect import blend_corners, rrt_connect, shortcut
from planners.scene import SELF_BIT, STATIC_BIT, HeldObject, RobotState

__all__ = [
    "ArmPath",
    "BlockedBy",
    "NoPath",
    "RRTConfig",
    "blocking_set",
    "plan_arm",
    "tcp_pose",
]

FIXED_BITS = 1 << STATIC_BIT | 1 << SELF_BIT
"""Hits that no clearing can remove."""
_ROLL_RANGE = 2 * math.pi
"""[rad] A joint with more play has several angles for one orientation."""


@dataclass(frozen=True, eq=False)
class ArmPath:
    """A motion of torso and arm, straight between waypoints.

    `base` (3,) x [m], y [m], yaw [rad]; `waypoints` (n, 8) [m], [rad]; `opening` of the gripper [m]; what is in hand;
    `ignore`: bits of objects that did not count as obstacles.
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
    def drive_vectors(self) -> NDArray[np.float64]:
        """(n, 11) base and waypoints."""
        return on_base(self.base, self.waypoints)

    def reversed(self) -> ArmPath:
        """The same motion backwards."""
        return replace(self, waypoints=self.waypoints[::-1])


@dataclass(frozen=True)
class BlockedBy:
    """Objects that must go first, and during which part of the motion they were in the way."""

    blockers: frozenset[str]
    phase: str


@dataclass(frozen=True)
class NoPath:
    """No motion, whatever is cleared: limits, static obstacles, the robot itself, or the planner's patience."""

    reason: str


@dataclass(frozen=True)
class RRTConfig:
    """Effort of one plan.

    Attributes:
        iterations: random targets at most.
        shortcuts: random shortcuts tried afterwards.
        step: [m] between checks while searching; accepted paths are checked again at `collision.STEP`.
        margin: [rad] beyond start and goal from which joints with more than a turn of play are sampled.
        near: share of the random targets of an arm that lie about the straight way from start to goal.
    """

    iterations: int = 600
    shortcuts: int = 20
    step: float = 0.015
    margin: float = 1.5
    near: float = 0.8


DEFAULT_EFFORT = RRTConfig()


def unwrap_joints(robot: RobotArrays, q: ArrayLike, goals: ArrayLike) -> NDArray[np.float64]:
    """The same configurations (8,) or (k, 8), with joints that turn round at the angles nearest to those of `q`
    (8,)."""
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
    base: ArrayLike,
    q_start: ArrayLike,
    q_goals: ArrayLike,
    opening: float,
    held: HeldObject | None = None,
    ignore: int = 0,
    *,
    rng: np.random.Generator,
    config: RRTConfig = DEFAULT_EFFORT,
    phase: str = "transit",
    exact: bool = False,
    find_blockers: bool = True,
) -> ArmPath | BlockedBy | NoPath:
    """A free path from one configuration to one of several, shortened.

    Args:
        world: the scene, compiled.
        base: (3,) where the base stands.
        q_start: (8,).
        q_goals: (8,) or (k, 8).
        opening: of the gripper [m].
        held: what is in hand.
        ignore: bits of objects that are not obstacles.
        rng: for the random tree; the same generator state gives the same path.
        config: effort.
        phase: name to report in an `BlockedBy`.
        exact: end at a goal as it is given; else joints that turn round may end a whole turn away from it, which is
            the same configuration (see `unwrap_joints`).
        find_blockers: whether to find out which objects are in the way, for which the plan is made many times again.

    Returns:
        the path; the smallest set of objects that was found to be in the way; or why clearing would not help.
    """
    place, start = np.array(base, dtype=float), np.array(q_start, dtype=float)
    goals = np.atleast_2d(np.array(q_goals, dtype=float))
    if not exact:
        goals = unwrap_joints(world.robot, start, goals)
    path = _search(world, place, start, goals, opening, held, ignore, rng, config)
    if path is not None:
        return ArmPath(place, path, opening, held, ignore)
    if not find_blockers:
        return NoPath(f"{phase}: no path found within {config.iterations} iterations")
    return blocking_set(world, place, start, goals, opening, held, ignore, rng=rng, config=config, phase=phase)


def blocking_set(
    world: CollisionWorld,
    base: ArrayLike,
    q_start: ArrayLike,
    q_goals: ArrayLike,
    opening: float,
    held: HeldObject | None = None,
    ignore: int = 0,
    *,
    rng: np.random.Generator,
    config: RRTConfig = DEFAULT_EFFORT,
    phase: str = "transit",
) -> BlockedBy | NoPath:
    """The smallest set of objects found whose removal lets `plan_arm` succeed; confirmed by planning without them.

    First what start and goals touch themselves, then the objects met by a path that ignores all of them, less those
    that turn out not to matter. Arguments as for `plan_arm`.
    """
    place, start = np.array(base, dtype=float), np.array(q_start, dtype=float)
    goals = np.atleast_2d(np.array(q_goals, dtype=float))
    touched = [int(h) for h in world.hits_many(place, np.vstack([start[None], goals]), opening, held, ignore)]
    if touched[0] & FIXED_BITS:
        return NoPath(f"the start touches {named_bits(world, touched[0] & FIXED_BITS)}")
    standing = [(h, goal) for h, goal in zip(touched[1:], goals, strict=True) if not h & FIXED_BITS]
    if not standing:
        worst = touched[1] if len(touched) > 1 else FIXED_BITS
        return NoPath(f"every goal touches {named_bits(world, worst & FIXED_BITS)}")
    least = min((h for h, _ in standing), key=lambda h: (h.bit_count(), h)) | touched[0]
    free_goals = np.array([goal for _, goal in standing])

    def plan_without(mask: int) -> NDArray[np.float64] | None:
        return _search(world, place, start, free_goals, opening, held, ignore | mask, rng, config)

    if least and plan_without(least) is not None:
        return BlockedBy(frozenset(world.scene.names_of(least)), phase)
    everything = (1 << len(world.scene.objects)) - 1
    path = plan_without(everything)
    if path is None:
        return NoPath("no path even without any object")
    blockers = world.path_hits(on_base(place, path), opening, held, ignore) & everything
    for bit in [1 << i for i in range(len(world.scene.objects)) if blockers & ~least & 1 << i]:
        if plan_without(blockers & ~bit) is not None:
            blockers &= ~bit
    if not blockers:
        return NoPath(f"{phase}: no path found within {config.iterations} iterations")
    return BlockedBy(frozenset(world.scene.names_of(blockers)), phase)


def named_bits(world: CollisionWorld, mask: int) -> str:
    """What the bits of a mask stand for, in words."""
    return " and ".join(world.names_of(mask)) or "nothing"


def on_base(base: NDArray[np.float64], waypoints: NDArray[np.float64]) -> NDArray[np.float64]:
    """Drive vectors (n, 11)."""
    return np.hstack([np.tile(base, (len(waypoints), 1)), waypoints])


def _search(
    world: CollisionWorld,
    base: NDArray[np.float64],
    start: NDArray[np.float64],
    goals: NDArray[np.float64],
    opening: float,
    held: HeldObject | None,
    ignore: int,
    rng: np.random.Generator,
    config: RRTConfig,
) -> NDArray[np.float64] | None:
    """A verified path (n, 8), None when start or goals are blocked or the search gives up."""
    touched = world.hits_many(base, np.vstack([start[None], goals]), opening, held, ignore)
    if touched[0] or touched[1:].all():
        return None
    X = on_base(base, np.vstack([start[None], goals[touched[1:] == 0]]))
    lower, upper = _bounds(world.robot, X, config.margin)
    work = make_workspace(world.robot, world.attached(held))
    arguments = float(opening), world.active(ignore), world.padding
    for step in (config.step, STEP):
        path = rrt_connect(
            world.robot,
            world.obstacles,
            work,
            X[0],
            X[1:],
            lower,
            upper,
            *arguments,
            step,
            config.iterations,
            config.near,
            rng,
        )
        if not len(path):
            return None
        path = shortcut(world.robot, world.obstacles, work, path, *arguments, step, config.shortcuts, rng)
        path = blend_corners(world.robot, world.obstacles, work, path, *arguments, step)
        if not world.path_hits(path, opening, held, ignore):
            return np.asarray(path[:, len(base) :])
    return None


def _bounds(
    robot: RobotArrays, X: NDArray[np.float64], margin: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Where to draw random whole-body configurations from: the base stays, joints that turn round stay near start and
    goals."""
    lower, upper = X.min(axis=0), X.max(axis=0)
    turns = robot.upper - robot.lower > _ROLL_RANGE
    lower[3:] = np.where(turns, np.maximum(robot.lower, lower[3:] - margin), robot.lower)
    upper[3:] = np.where(turns, np.minimum(robot.upper, upper[3:] + margin), robot.upper)
    return lower, upper
