"""Straight lines to and from a contact configuration: which the arm can follow, and what stands in the way of each."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planners.collision.world import CollisionWorld
from planners.motion.arm import FIXED_BITS, on_base, tcp_pose
from planners.motion.straight_lines import trace_by_torso, trace_straight
from planners.scene import Body, HeldObject, RobotState, Scene

__all__ = [
    "APPROACH_PATTERNS",
    "SIDE_CLEARANCE",
    "Approach",
    "ApproachPattern",
    "GraspContext",
    "approach_patterns",
    "free_approach",
    "grasp_context",
    "release_context",
    "trace",
]

SIDE_CLEARANCE = 0.012
"""[m] between an open finger and the object, each side."""

Array = NDArray[np.float64]


class ApproachPattern(NamedTuple):
    """How the hand leaves a contact configuration; it arrives the other way round. Lengths in metres.

    Empty and open it moves `back` along its own axis, then `up`. With the object it moves `held_up`, then `held_back`.
    """

    name: str
    back: float
    up: float
    held_up: float
    held_back: float
    by_torso: bool = False
    """Vertical legs are left to the torso: slow, but what the arm is free of below it is free of all the way."""


APPROACH_PATTERNS = (
    ApproachPattern("above", back=0.0, up=0.25, held_up=0.25, held_back=0.0),
    ApproachPattern("above", back=0.0, up=0.19, held_up=0.19, held_back=0.0),
    ApproachPattern("above", back=0.0, up=0.25, held_up=0.25, held_back=0.0, by_torso=True),
    ApproachPattern("above", back=0.0, up=0.19, held_up=0.19, held_back=0.0, by_torso=True),
    ApproachPattern("front", back=0.10, up=0.0, held_up=0.25, held_back=0.0),
    ApproachPattern("front", back=0.10, up=0.0, held_up=0.19, held_back=0.0),
    ApproachPattern("front", back=0.12, up=0.0, held_up=0.02, held_back=0.14),
)


class GraspContext(NamedTuple):
    """The situation around a contact configuration: worlds without and with the object in hand, openings [m], the
    object."""

    empty: CollisionWorld
    loaded: CollisionWorld
    base: Array
    q: Array
    opening: float
    grip: float
    held: HeldObject
    ignore: int


class Approach(NamedTuple):
    """One line that the arm can follow: waypoints (n, 8) outwards, empty and loaded, and the objects that it hits."""

    pattern: ApproachPattern
    empty: Array
    loaded: Array
    hits: int
    phase: str


def _openings(scene: Scene, body: Body, T_world_tcp: Array) -> tuple[float, float]:
    """[m] between the pads of a hand (4, 4) that is open around an object, and that holds it."""
    grip = 2.0 * body.half_extent_along(T_world_tcp[:3, 1])
    return min(grip + 2 * SIDE_CLEARANCE, scene.robot.max_opening), grip


def grasp_context(world: CollisionWorld, base: ArrayLike, q: Array, name: str, ignore: int) -> GraspContext:
    """The situation around a grasp of an object where it stands."""
    body = world.scene.body(name)
    T_world_tcp = tcp_pose(world.scene.robot, RobotState(np.asarray(base), q, 0.0))
    held = HeldObject(name, np.linalg.inv(T_world_tcp) @ body.pose)
    return GraspContext(
        world, world, np.array(base, dtype=float), q, *_openings(world.scene, body, T_world_tcp), held, ignore
    )


def release_context(
    world: CollisionWorld, base: ArrayLike, q: Array, held: HeldObject, ignore: int
) -> tuple[GraspContext, Body]:
    """The situation around a release, and the object as it will stand."""
    scene = world.scene
    T_world_tcp = tcp_pose(scene.robot, RobotState(np.asarray(base), q, 0.0))
    placed = scene.body(held.name).at_pose(T_world_tcp @ held.T_tcp_object)
    after = CollisionWorld.from_scene(scene.with_body(placed), world.padding)
    openings = _openings(scene, placed, T_world_tcp)
    return GraspContext(after, world, np.array(base, dtype=float), q, *openings, held, ignore), placed


def approach_patterns(world: CollisionWorld) -> tuple[ApproachPattern, ...]:
    """The lines worth a try: those from the front only where something keeps the hand from coming from above."""
    return (
        APPROACH_PATTERNS if _is_covered(world) else tuple(pattern for pattern in APPROACH_PATTERNS if pattern.up > 0.0)
    )


def free_approach(context: GraspContext, pattern: ApproachPattern) -> Approach | None:
    """A line that the arm can follow, empty and loaded, hitting nothing; less work than `trace`."""
    legs = _legs(context, pattern)
    if legs is None:
        return None
    empty, loaded = legs
    ignore = context.ignore
    if context.empty.path_hits(on_base(context.base, empty), context.opening, None, ignore, first_only=True):
        return None
    if context.loaded.path_hits(on_base(context.base, loaded), context.grip, context.held, ignore, first_only=True):
        return None
    return Approach(pattern, empty, loaded, 0, "transit")


def trace(context: GraspContext, pattern: ApproachPattern) -> Approach | str:
    """Follow a line outwards and see what it hits; or why the arm cannot."""
    legs = _legs(context, pattern)
    if legs is None:
        return "the arm cannot follow the line"
    empty, loaded = legs
    here = context.empty.hits(context.base, context.q, context.opening, None, context.ignore)
    out = context.empty.path_hits(on_base(context.base, empty), context.opening, None, context.ignore)
    away = context.loaded.path_hits(on_base(context.base, loaded), context.grip, context.held, context.ignore)
    hits = out | away
    if hits & FIXED_BITS:
        return f"the line touches {' and '.join(context.empty.names_of(hits & FIXED_BITS))}"
    if hits >> context.empty.scene.index(context.held.name) & 1:
        return f"the open hand does not fit around {context.held.name}"
    phase = "grasp" if hits == here else ("approach" if hits == out else "lift")
    return Approach(pattern, empty, loaded, hits, phase)


def _is_covered(world: CollisionWorld) -> bool:
    """Whether something above the table keeps the hand from coming from above."""
    table = world.scene.support
    return any(
        table.top < obstacle.lower[2] < table.top + 0.8
        and (np.abs(obstacle.position - table.position) < obstacle.extent + table.extent)[:2].all()
        for obstacle in world.scene.static_obstacles
    )


def _legs(context: GraspContext, pattern: ApproachPattern) -> tuple[Array, Array] | None:
    """Waypoints (n, 8) outwards along a line, empty and loaded; None where the arm cannot follow."""
    robot, up = context.empty.scene.robot, np.array([0.0, 0.0, 1.0])
    back = -tcp_pose(robot, RobotState(context.base, context.q, 0.0))[:3, 0]
    empty = _follow(context, ((back, pattern.back), (up, pattern.up)), pattern.by_torso)
    if empty is None:
        return None
    loaded = _follow(context, ((up, pattern.held_up), (back, pattern.held_back)), pattern.by_torso)
    return None if loaded is None else (empty, loaded)


def _follow(context: GraspContext, legs: tuple[tuple[Array, float], ...], by_torso: bool) -> Array | None:
    """Waypoints (n, 8) from the contact configuration along straight legs, None where the arm cannot follow."""
    waypoints = context.q[None]
    for direction, distance in legs:
        if distance > 0.0:
            trace_leg = trace_by_torso if by_torso and direction[2] == 1.0 else trace_straight
            leg = trace_leg(context.empty, context.base, waypoints[-1], direction, distance)
            if leg is None:
                return None
            waypoints = np.vstack([waypoints, leg[1:]])
    return waypoints
