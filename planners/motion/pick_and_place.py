"""Picking an object up and putting it down with a standing base: the choreography around one contact configuration.

A pick goes from the start configuration to a hover configuration (free), along a straight line to the grasp, lifts the
object straight, and ends in the carry configuration (free). A placement is the same backwards. Straight lines are tried
in the order of `hand_lines.APPROACH_PATTERNS`: from above they need hardly more room than the grasp, from the front
they pass below a board.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from planners.collision.world import CollisionWorld
from planners.motion.approaches import (
    APPROACH_PATTERNS,
    Approach,
    ApproachPattern,
    GraspContext,
    approach_patterns,
    free_approach,
    grasp_context,
    release_context,
    trace,
)
from planners.motion.arm import (
    DEFAULT_EFFORT,
    ArmPath,
    BlockedBy,
    NoPath,
    RRTConfig,
    plan_arm,
    unwrap_joints,
)
from planners.scene import Body, HeldObject

__all__ = ["PickMotion", "PlaceMotion", "can_leave", "can_put_down", "plan_pick", "plan_place"]


@dataclass(frozen=True, eq=False)
class PickMotion:
    """Take an object: free `transit`, straight `approach`, (close,) straight `lift`, free `retreat` with it in hand."""

    name: str
    pattern: ApproachPattern
    transit: ArmPath
    approach: ArmPath
    lift: ArmPath
    retreat: ArmPath
    held: HeldObject

    @property
    def paths(self) -> tuple[ArmPath, ArmPath, ArmPath, ArmPath]:
        """In order of time; the fingers close after the second."""
        return self.transit, self.approach, self.lift, self.retreat


@dataclass(frozen=True, eq=False)
class PlaceMotion:
    """Put an object down: free `transit`, straight `lower`, (open,) straight `rise`, free `retreat` with empty hand."""

    placed: Body
    pattern: ApproachPattern
    transit: ArmPath
    lower: ArmPath
    rise: ArmPath
    retreat: ArmPath
    held: HeldObject

    @property
    def paths(self) -> tuple[ArmPath, ArmPath, ArmPath, ArmPath]:
        """In order of time; the fingers open after the second."""
        return self.transit, self.lower, self.rise, self.retreat


_Composed: TypeAlias = tuple[ApproachPattern, ArmPath, ArmPath, ArmPath, ArmPath]
"""A line, the motion along it outwards, empty and loaded, and the free paths to and from it."""


def plan_pick(
    world: CollisionWorld,
    base: ArrayLike,
    q_start: ArrayLike,
    q_grasp: ArrayLike,
    name: str,
    *,
    rng: np.random.Generator,
    q_carry: ArrayLike | None = None,
    patterns: tuple[ApproachPattern, ...] = APPROACH_PATTERNS,
    ignore: int = 0,
    config: RRTConfig = DEFAULT_EFFORT,
) -> PickMotion | BlockedBy | NoPath:
    """Take an object with a given grasp.

    Args:
        world: the scene, compiled.
        base: (3,) where the base stands.
        q_start: (8,) configuration at the start.
        q_grasp: (8,) configuration in which the fingers close.
        name: which object.
        rng: for the free parts.
        q_carry: (8,) configuration at the end, up to whole turns of joints that turn round; the robot's home by
        default.
        patterns: straight lines to try, in order.
        ignore: bits of objects that are not obstacles.
        config: effort of the free parts.

    Returns:
        the motion; the smallest set of objects found to be in its way; or why clearing would not help.

    Raises:
        UnknownObject: no such object.
    """
    q = unwrap_joints(world.robot, q_start, q_grasp)
    context = grasp_context(world, base, q, name, ignore)
    end = unwrap_joints(world.robot, q, world.scene.robot.home if q_carry is None else q_carry)
    found = _plan_around(context, (q_start, end), patterns, rng, config)
    if not isinstance(found, tuple):
        return found
    pattern, empty, loaded, transit, retreat = found
    return PickMotion(name, pattern, transit, empty.reversed(), loaded, retreat, context.held)


def plan_place(
    world: CollisionWorld,
    base: ArrayLike,
    q_start: ArrayLike,
    q_release: ArrayLike,
    held: HeldObject,
    *,
    rng: np.random.Generator,
    q_end: ArrayLike | None = None,
    patterns: tuple[ApproachPattern, ...] = APPROACH_PATTERNS,
    ignore: int = 0,
    config: RRTConfig = DEFAULT_EFFORT,
    find_blockers: bool = True,
) -> PlaceMotion | BlockedBy | NoPath:
    """Put down what is in hand; the object then stands where `q_release` holds it.

    Args:
        world: the scene, compiled; the object's own pose in it does not matter.
        base: (3,) where the base stands.
        q_start: (8,) configuration at the start.
        q_release: (8,) configuration in which the fingers open.
        held: what is in hand.
        rng, lines, ignore, config: as for `plan_pick`.
        q_end: (8,) configuration at the end; the robot's home by default.
        find_blockers: whether to find out which objects are in the way; without, any obstruction is `NoPath`, and
        quick.

    Returns:
        the motion; the smallest set of objects found to be in its way; or why clearing would not help.

    Raises:
        UnknownObject: no such object.
    """
    scene = world.scene
    q = unwrap_joints(world.robot, q_start, q_release)
    context, placed = release_context(world, base, q, held, ignore)
    end = unwrap_joints(world.robot, q, scene.robot.home if q_end is None else q_end)
    found = _plan_around(context, (end, q_start), patterns, rng, config, find_blockers)
    if not isinstance(found, tuple):
        return found
    pattern, empty, loaded, retreat, transit = found
    return PlaceMotion(placed, pattern, transit.reversed(), loaded.reversed(), empty, retreat.reversed(), held)


def can_leave(world: CollisionWorld, base: ArrayLike, q_grasp: ArrayLike, name: str) -> bool:
    """Whether the hand can leave a grasp of that object upwards, if no other object were there."""
    others = world.scene.mask(world.scene.names) & ~world.scene.mask([name])
    context = grasp_context(world, base, np.asarray(q_grasp, dtype=float), name, others)
    return any(isinstance(trace(context, pattern), Approach) for pattern in approach_patterns(world))


def can_put_down(world: CollisionWorld, base: ArrayLike, q_release: ArrayLike, held: HeldObject) -> bool:
    """Whether the hand can bring an object down to a configuration, let go and leave without touching anything."""
    context, _ = release_context(world, base, np.asarray(q_release, dtype=float), held, 0)
    return any(free_approach(context, pattern) is not None for pattern in approach_patterns(world))


def _plan_around(
    context: GraspContext,
    ends: tuple[ArrayLike, ArrayLike],
    patterns: tuple[ApproachPattern, ...],
    rng: np.random.Generator,
    config: RRTConfig,
    find_blockers: bool = True,
) -> _Composed | BlockedBy | NoPath:
    """The line, outwards empty and loaded, and the free paths: `ends[0]` → hover empty, hover loaded → `ends[1]`."""
    for pattern in patterns:
        option = free_approach(context, pattern)
        free = None if option is None else _connect(context, option, ends, rng, config, find_blockers=False)
        if option is not None and isinstance(free, tuple):
            return _composed(context, option, free)
    return _refusal(context, ends, patterns, rng, config) if find_blockers else NoPath("no free line")


def _composed(context: GraspContext, option: Approach, free: tuple[ArmPath, ArmPath]) -> _Composed:
    empty = ArmPath(context.base, option.empty, context.opening, None, context.ignore)
    loaded = ArmPath(context.base, option.loaded, context.grip, context.held, context.ignore)
    return option.pattern, empty, loaded, *free


def _refusal(
    context: GraspContext,
    ends: tuple[ArrayLike, ArrayLike],
    patterns: tuple[ApproachPattern, ...],
    rng: np.random.Generator,
    config: RRTConfig,
) -> _Composed | BlockedBy | NoPath:
    """The fewest objects in the way of any line and of the ways to and from it; a motion, should one be found now."""
    traced = [(pattern, trace(context, pattern)) for pattern in patterns]
    reasons = [f"{pattern.name}: {option}" for pattern, option in traced if isinstance(option, str)]
    options = [option for _, option in traced if not isinstance(option, str)]
    refused: list[BlockedBy] = []
    for option in sorted(options, key=lambda option: option.hits.bit_count()):
        if refused and option.hits.bit_count() >= min(len(other.blockers) for other in refused):
            break
        free = _connect(context, option, ends, rng, config, find_blockers=True)
        if isinstance(free, NoPath):
            reasons.append(f"{option.pattern.name}: {free.reason}")
        elif isinstance(free, BlockedBy):
            refused.append(free)
        else:
            return _composed(context, option, free)
    if refused:
        return min(refused, key=lambda obstruction: (len(obstruction.blockers), sorted(obstruction.blockers)))
    return NoPath("; ".join(dict.fromkeys(reasons)))


def _connect(
    context: GraspContext,
    option: Approach,
    ends: tuple[ArrayLike, ArrayLike],
    rng: np.random.Generator,
    config: RRTConfig,
    find_blockers: bool,
) -> tuple[ArmPath, ArmPath] | BlockedBy | NoPath:
    """The free paths to and from a line, once the objects that it hits are gone."""
    ignore = context.ignore | option.hits
    paths: list[ArmPath] = []
    blockers = set(context.empty.scene.names_of(option.hits))
    for start, goal, is_loaded in _free_parts(option, ends):
        world, opening = (context.loaded, context.grip) if is_loaded else (context.empty, context.opening)
        held = context.held if is_loaded else None
        path = plan_arm(
            world,
            context.base,
            start,
            goal,
            opening,
            held,
            ignore,
            rng=rng,
            config=config,
            exact=True,
            find_blockers=find_blockers,
        )
        if isinstance(path, NoPath):
            return path
        if isinstance(path, BlockedBy):
            blockers |= path.blockers
        else:
            paths.append(path)
    if blockers:
        return BlockedBy(frozenset(blockers), option.phase if option.hits else "transit")
    return paths[0], paths[1]


def _free_parts(option: Approach, ends: tuple[ArrayLike, ArrayLike]) -> Iterator[tuple[ArrayLike, ArrayLike, bool]]:
    """Start, goal, and whether the object is in hand, of both free paths."""
    yield ends[0], option.empty[-1], False
    yield option.loaded[-1], ends[1], True
