"""Picking an object up and putting it down: free paths and straight lines around one configuration.

A pick goes from the start configuration to a hover configuration (free path), along straight lines to the grasp, lifts
the object along straight lines, and ends in a carry configuration (free path). A placement is the same in reverse.
The straight lines are those of `approaches.approach_patterns`, tried in that order. Where the hover configuration has
another base pose than the start, the free path to it begins with a drive.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planners.collision.world import CollisionWorld
from planners.motion.approaches import (
    Approach,
    ApproachPattern,
    GraspContext,
    approach_patterns,
    free_approach,
    grasp_context,
    likely_patterns,
    release_context,
    trace,
)
from planners.motion.arm import BlockedBy, NoPath, unwrap_joints
from planners.motion.arm_query import DEFAULT_EFFORT, RRTConfig
from planners.motion.base import unwrap_yaw
from planners.motion.free_paths import SAME_BASE, Task, free_paths
from planners.motion.whole_body_path import WholeBodyPath
from planners.scene import Body, HeldObject

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class PickMotion:
    """Take an object: free `transit`, straight `approach`, (close,) straight `lift`, free `retreat` holding it.

    Attributes:
        name: of the object.
        pattern: of the straight lines.
        transit, approach, lift, retreat: the paths, each from where the one before ends.
        held: the object, as it is held from the lift on.
    """

    name: str
    pattern: ApproachPattern
    transit: WholeBodyPath
    approach: WholeBodyPath
    lift: WholeBodyPath
    retreat: WholeBodyPath
    held: HeldObject

    @property
    def paths(self) -> tuple[WholeBodyPath, WholeBodyPath, WholeBodyPath, WholeBodyPath]:
        """In order of time; the fingers close after the second."""
        return self.transit, self.approach, self.lift, self.retreat


@dataclass(frozen=True, eq=False)
class PlaceMotion:
    """Put an object down: free `transit`, straight `lower`, (open,) straight `rise`, free `retreat` without it.

    Attributes:
        placed: the object where it then stands.
        pattern: of the straight lines.
        transit, lower, rise, retreat: the paths, each from where the one before ends.
        held: the object, as it is held until the fingers open.
    """

    placed: Body
    pattern: ApproachPattern
    transit: WholeBodyPath
    lower: WholeBodyPath
    rise: WholeBodyPath
    retreat: WholeBodyPath
    held: HeldObject

    @property
    def paths(self) -> tuple[WholeBodyPath, WholeBodyPath, WholeBodyPath, WholeBodyPath]:
        """In order of time; the fingers open after the second."""
        return self.transit, self.lower, self.rise, self.retreat


_Composed: TypeAlias = tuple[ApproachPattern, WholeBodyPath, WholeBodyPath, WholeBodyPath, WholeBodyPath]
"""A pattern; the motion along it outwards, without and with the object; the free paths without and with the object."""


def plan_pick(
    world: CollisionWorld,
    base: ArrayLike,
    start: ArrayLike,
    q_grasp: ArrayLike,
    name: str,
    *,
    rng: np.random.Generator,
    ignore: int = 0,
    config: RRTConfig = DEFAULT_EFFORT,
) -> PickMotion | BlockedBy | NoPath:
    """Take an object with a given grasp, then carry it in the home configuration, or another where that does not fit.

    Args:
        world: the scene, compiled.
        base: (3,) where the base stands when the fingers close.
        start: (8,) configuration at the start, or (11,) with the base pose first if the base stands elsewhere then.
        q_grasp: (8,) configuration in which the fingers close.
        name: of the object.
        rng: for the free paths.
        ignore: mask of objects that are not obstacles.
        config: effort of each free path.

    Returns:
        the motion; the smallest set of objects found to be in its way; or why clearing would not help. Continuous
        joints may end whole turns away from home.

    Raises:
        UnknownObject: no such object.
    """
    inside, stand, q_start = _split(world, base, start)
    context = grasp_context(world, inside, unwrap_joints(world.robot, q_start, q_grasp), name, ignore)
    found = _plan_around(Task(context, stand, q_start, False, rng, config))
    if not isinstance(found, tuple):
        return found
    pattern, empty, loaded, transit, retreat = found
    return PickMotion(name, pattern, transit, empty.reversed(), loaded, retreat, context.held)


def plan_place(
    world: CollisionWorld,
    base: ArrayLike,
    start: ArrayLike,
    q_release: ArrayLike,
    held: HeldObject,
    *,
    rng: np.random.Generator,
    config: RRTConfig = DEFAULT_EFFORT,
    find_blockers: bool = True,
) -> PlaceMotion | BlockedBy | NoPath:
    """Put down the held object, then move to the robot's home configuration.

    Args:
        world: the scene, compiled; the held object's own pose in it does not matter.
        base: (3,) where the base stands when the fingers open.
        start: (8,) configuration at the start, or (11,) with the base pose first if the base stands elsewhere then.
        q_release: (8,) configuration in which the fingers open: the object then stands where this one holds it.
        held: the held object.
        rng, config: as for `plan_pick`.
        find_blockers: whether to find out which objects are in the way; if not, the answer comes sooner and is
            `NoPath` where it would be `BlockedBy`.

    Returns:
        the motion; the smallest set of objects found to be in its way; or why clearing would not help.

    Raises:
        UnknownObject: no such object.
    """
    inside, stand, q_start = _split(world, base, start)
    context, placed = release_context(world, inside, unwrap_joints(world.robot, q_start, q_release), held, 0)
    found = _plan_around(Task(context, stand, q_start, True, rng, config), find_blockers)
    if not isinstance(found, tuple):
        return found
    pattern, empty, loaded, retreat, transit = found
    return PlaceMotion(placed, pattern, transit.reversed(), loaded.reversed(), empty, retreat.reversed(), held)


def planned_approach(
    world: CollisionWorld, base: ArrayLike, q_grasp: ArrayLike, name: str
) -> tuple[GraspContext, Approach] | None:
    """The first pattern along which the gripper could lift that object from a grasp (8,) if no other object were there.

    Raises:
        UnknownObject: no such object.
    """
    others = world.scene.mask(world.scene.names) & ~world.scene.mask([name])
    context = grasp_context(world, base, np.asarray(q_grasp, dtype=float), name, others)
    traced = (trace(context, pattern) for pattern in likely_patterns(context))
    return next(((context, approach) for approach in traced if isinstance(approach, Approach)), None)


def can_leave(world: CollisionWorld, base: ArrayLike, q_grasp: ArrayLike, name: str) -> bool:
    """Whether the gripper could lift that object from a grasp (8,) if no other object were there.

    Raises:
        UnknownObject: no such object.
    """
    return planned_approach(world, base, q_grasp, name) is not None


def fewest_blockers(world: CollisionWorld, base: ArrayLike, q_grasp: ArrayLike, name: str) -> int | None:
    """The smallest set of objects in the way of the straight lines to and from a grasp (8,), as a mask.

    Returns:
        None if the robot cannot follow any of the lines, or they lead through static obstacles.

    Raises:
        UnknownObject: no such object.
    """
    context = grasp_context(world, base, np.asarray(q_grasp, dtype=float), name, 0)
    traced = (trace(context, pattern) for pattern in likely_patterns(context))
    return min((found.hits for found in traced if isinstance(found, Approach)), key=int.bit_count, default=None)


def can_put_down(world: CollisionWorld, base: ArrayLike, q_release: ArrayLike, held: HeldObject) -> bool:
    """Whether the gripper can lower the held object to a configuration (8,), open and leave without hitting anything.

    Raises:
        UnknownObject: no such object.
    """
    context, _ = release_context(world, base, np.asarray(q_release, dtype=float), held, 0)
    return any(free_approach(context, pattern) is not None for pattern in likely_patterns(context))


def can_take(world: CollisionWorld, base: ArrayLike, q_grasp: ArrayLike, name: str) -> bool:
    """Whether the gripper can come to a grasp (8,) of that object and leave with it without hitting anything.

    Raises:
        UnknownObject: no such object.
    """
    context = grasp_context(world, base, np.asarray(q_grasp, dtype=float), name, 0)
    return any(free_approach(context, pattern) is not None for pattern in approach_patterns(context))


def _split(world: CollisionWorld, base: ArrayLike, start: ArrayLike) -> tuple[Array, Array, Array]:
    """Base pose (3,) of the contact, then base pose and configuration (8,) at the start.

    The first is the second if they are the same but for rounding and whole turns; if not, it is without whole turns.
    """
    x, inside = np.array(start, dtype=float), np.array(base, dtype=float)
    if len(x) == len(world.robot.lower):
        return inside, inside, x
    inside[2] = unwrap_yaw(inside[2], x[2])
    is_there = np.abs(inside - x[:3]).max() < SAME_BASE
    return (x[:3] if is_there else inside), x[:3], x[3:]


def _plan_around(task: Task, find_blockers: bool = True) -> _Composed | BlockedBy | NoPath:
    """Straight lines, outwards, and the free paths to and from their end."""
    for pattern in approach_patterns(task.context):
        approach = free_approach(task.context, pattern)
        free = None if approach is None else free_paths(task, approach, find_blockers=False)
        if approach is not None and isinstance(free, tuple):
            return _composed(task.context, approach, free)
    return _least_blocked(task) if find_blockers else NoPath("no free approach found")


def _composed(context: GraspContext, approach: Approach, free: tuple[WholeBodyPath, WholeBodyPath]) -> _Composed:
    empty = WholeBodyPath(approach.empty, context.opening, None, context.ignore)
    loaded = WholeBodyPath(approach.loaded, context.grip, context.held, context.ignore)
    return approach.pattern, empty, loaded, *free


def _least_blocked(task: Task) -> _Composed | BlockedBy | NoPath:
    """The fewest objects in the way over all patterns, free paths included; a motion, if one is found this time."""
    traced = [(pattern, trace(task.context, pattern)) for pattern in approach_patterns(task.context)]
    reasons = [f"{pattern.name}: {found}" for pattern, found in traced if isinstance(found, str)]
    approaches = [found for _, found in traced if not isinstance(found, str)]
    blocked: list[BlockedBy] = []
    for approach in sorted(approaches, key=lambda approach: approach.hits.bit_count()):
        if blocked and approach.hits.bit_count() >= min(len(other.blockers) for other in blocked):
            break
        free = free_paths(task, approach, find_blockers=True)
        if isinstance(free, NoPath):
            reasons.append(f"{approach.pattern.name}: {free.reason}")
        elif isinstance(free, BlockedBy):
            blocked.append(free)
        else:
            return _composed(task.context, approach, free)
    if blocked:
        return min(blocked, key=lambda found: (len(found.blockers), sorted(found.blockers)))
    return NoPath("; ".join(dict.fromkeys(reasons)))
