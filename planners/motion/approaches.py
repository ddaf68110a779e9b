"""Approach patterns: straight lines of the gripper to and from a grasp or release configuration.

A pattern is traced from that configuration outwards. The question is whether the robot can follow it, without and with
the object, and which objects are in the way. Under a shelf the base drives straight out with the arm rigid.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from assets.robots import RobotSpec
from planners.collision.straight_lines import trace_by_torso, trace_straight
from planners.collision.world import CollisionWorld, with_clearance_below
from planners.motion.arm import on_base, tcp_pose
from planners.motion.arm_query import ArmQuery
from planners.scene import Body, HeldObject, RobotState, Scene
from planners.scene.cover import LEAST_LIFT, drive_out, is_covered
from planners.scene.masks import FIXED_BITS

SIDE_CLEARANCE = 0.012
"""[m] between each finger of the open gripper and the object."""

Array = NDArray[np.float64]


class ApproachPattern(NamedTuple):
    """How the gripper leaves a grasp or release configuration; it arrives along the same lines in reverse.

    Attributes:
        name: for messages.
        back, up: [m] The empty, open gripper moves `back` against its approach direction, then `up`.
        held_up, held_back: [m] With the object the gripper moves `held_up`, then `held_back`.
        by_torso: vertical lines are left to the torso: slow, but the arm then hits only what is above it.
        drives: afterwards the base drives straight out from under the shelf, the arm rigid; see `stand_off`.
    """

    name: str
    back: float
    up: float
    held_up: float
    held_back: float
    by_torso: bool = False
    drives: bool = False


APPROACH_PATTERNS = (
    ApproachPattern("above", back=0.0, up=0.25, held_up=0.25, held_back=0.0),
    ApproachPattern("above", back=0.0, up=0.19, held_up=0.19, held_back=0.0),
    ApproachPattern("above", back=0.0, up=0.25, held_up=0.25, held_back=0.0, by_torso=True),
    ApproachPattern("above", back=0.0, up=0.19, held_up=0.19, held_back=0.0, by_torso=True),
    ApproachPattern("front", back=0.10, up=0.0, held_up=0.25, held_back=0.0),
    ApproachPattern("front", back=0.10, up=0.0, held_up=0.19, held_back=0.0),
    ApproachPattern("front", back=0.12, up=0.0, held_up=0.02, held_back=0.14),
)
"""In this order: lines from above need little more clearance than the grasp, those from the front fit under shelves."""
_DRIVES = (
    ApproachPattern("drive", back=0.0, up=0.0, held_up=0.12, held_back=0.0, by_torso=True, drives=True),
    ApproachPattern("drive", back=0.0, up=0.0, held_up=0.12, held_back=0.0, drives=True),
    ApproachPattern("drive", back=0.0, up=0.0, held_up=LEAST_LIFT, held_back=0.0, by_torso=True, drives=True),
    ApproachPattern("drive", back=0.0, up=0.0, held_up=LEAST_LIFT, held_back=0.0, drives=True),
)
"""Tried first under a shelf: the object is lifted where it stands, as high as counts as lifted if the shelf allows."""


class GraspContext(NamedTuple):
    """The situation around a grasp or release configuration.

    Attributes:
        empty: the world while the gripper is empty; the object stands in it.
        loaded: the world while the object is held.
        base: (3,) x [m], y [m], yaw [rad].
        q: (8,) torso [m] and arm [rad] when the fingers close or open.
        opening: [m] of the open gripper around the object.
        grip: [m] of the gripper closed on the object.
        held: the object, as it is held.
        ignore: mask of objects that are not obstacles.
        is_covered: whether a shelf hangs over the object.
    """

    empty: CollisionWorld
    loaded: CollisionWorld
    base: Array
    q: Array
    opening: float
    grip: float
    held: HeldObject
    ignore: int
    is_covered: bool

    @property
    def empty_query(self) -> ArmQuery:
        """For motions of the empty arm."""
        return ArmQuery(self.base, self.opening, None, self.ignore, exact=True)

    @property
    def loaded_query(self) -> ArmQuery:
        """For motions with the object."""
        return ArmQuery(self.base, self.grip, self.held, self.ignore, exact=True)


class Approach(NamedTuple):
    """An approach pattern traced from a grasp or release configuration.

    Attributes:
        pattern: which.
        empty, loaded: whole-body configurations (n, 11) outwards, without and with the object.
        hits: mask of the objects in the way.
        phase: of the motion in which the last of them is hit: "grasp" (standing still), "approach" or "lift".
    """

    pattern: ApproachPattern
    empty: Array
    loaded: Array
    hits: int
    phase: str


def grasp_context(world: CollisionWorld, base: ArrayLike, q: Array, name: str, ignore: int) -> GraspContext:
    """The situation around a grasp of an object where it stands.

    Raises:
        UnknownObject: no such object.
    """
    body = world.scene.body(name)
    T_world_tcp = tcp_pose(world.scene.robot, RobotState(np.asarray(base), q, 0.0))
    held = HeldObject.grasped(body, T_world_tcp)
    openings = _openings(world.scene.robot, body, T_world_tcp)
    loaded, covered = with_clearance_below(world, name), is_covered(world.scene, body.foot)
    return GraspContext(world, loaded, np.array(base, dtype=float), q, *openings, held, ignore, covered)


def release_context(
    world: CollisionWorld, base: ArrayLike, q: Array, held: HeldObject, ignore: int
) -> tuple[GraspContext, Body]:
    """The situation around a release, and the object where it will then stand.

    Raises:
        UnknownObject: no such object.
    """
    T_world_tcp = tcp_pose(world.scene.robot, RobotState(np.asarray(base), q, 0.0))
    placed = world.scene.body(held.name).at_pose(T_world_tcp @ held.T_tcp_object)
    openings = _openings(world.scene.robot, placed, T_world_tcp)
    covered, standing = is_covered(world.scene, placed.foot), np.array(base, dtype=float)
    return GraspContext(world.with_body(placed), world, standing, q, *openings, held, ignore, covered), placed


def _openings(robot: RobotSpec, body: Body, T_world_tcp: Array) -> tuple[float, float]:
    """[m] between the fingers of a gripper at a pose (4, 4): open around an object, and closed on it."""
    grip = body.width_in_gripper(np.linalg.inv(T_world_tcp) @ body.pose)
    return min(grip + 2 * SIDE_CLEARANCE, robot.max_opening), grip


def approach_patterns(context: GraspContext) -> tuple[ApproachPattern, ...]:
    """All patterns, in the order in which they are tried: driving ones only under a shelf."""
    return _DRIVES + APPROACH_PATTERNS if context.is_covered else APPROACH_PATTERNS


def likely_patterns(context: GraspContext) -> tuple[ApproachPattern, ...]:
    """The patterns worth tracing before any free path is planned: those from the front only under a shelf."""
    patterns = approach_patterns(context)
    return patterns if context.is_covered else tuple(pattern for pattern in patterns if pattern.up > 0.0)


def stand_off(scene: Scene, base: ArrayLike, q: ArrayLike) -> Array:
    """The base pose (3,) outside from which the base drives straight in to one under a shelf; see `drive_out`."""
    return _drive(scene, np.asarray(base, dtype=float), np.asarray(q, dtype=float))[-1]


def free_approach(context: GraspContext, pattern: ApproachPattern) -> Approach | None:
    """The traced pattern if the arm can follow it without and with the object and hits nothing; faster than `trace`."""
    lines = _lines(context, pattern)
    if lines is None:
        return None
    empty, loaded = lines
    ignore = context.ignore
    if context.empty.path_hits(empty, context.opening, None, ignore, first_only=True):
        return None
    if context.loaded.path_hits(loaded, context.grip, context.held, ignore, first_only=True):
        return None
    return Approach(pattern, empty, loaded, 0, "transit")


def trace(context: GraspContext, pattern: ApproachPattern) -> Approach | str:
    """Trace a pattern and find all objects in its way; the reason if the arm cannot follow it or no clearing helps."""
    lines = _lines(context, pattern)
    if lines is None:
        return "the arm cannot follow the line"
    empty, loaded = lines
    here = context.empty.hits(context.base, context.q, context.opening, None, context.ignore)
    out = context.empty.path_hits(empty, context.opening, None, context.ignore)
    away = context.loaded.path_hits(loaded, context.grip, context.held, context.ignore)
    hits = out | away
    if hits & FIXED_BITS:
        return f"the line touches {' and '.join(context.empty.names_of(hits & FIXED_BITS))}"
    if hits >> context.empty.scene.index(context.held.name) & 1:
        return f"the open gripper does not fit around {context.held.name}"
    phase = "grasp" if hits == here else ("approach" if hits == out else "lift")
    return Approach(pattern, empty, loaded, hits, phase)


def _lines(context: GraspContext, pattern: ApproachPattern) -> tuple[Array, Array] | None:
    """Configurations (n, 11) outwards along a pattern, without and with the object; None if it cannot be followed."""
    robot, up = context.empty.scene.robot, np.array([0.0, 0.0, 1.0])
    back = -tcp_pose(robot, RobotState(context.base, context.q, 0.0))[:3, 0]
    empty = _follow(context, ((back, pattern.back), (up, pattern.up)), pattern)
    if empty is None:
        return None
    loaded = _follow(context, ((up, pattern.held_up), (back, pattern.held_back)), pattern)
    return None if loaded is None else (empty, loaded)


def _follow(context: GraspContext, lines: tuple[tuple[Array, float], ...], pattern: ApproachPattern) -> Array | None:
    """Configurations (n, 11) from where it stands along (direction, distance [m]) in turn, then out; None as above."""
    waypoints = context.q[None]
    for direction, distance in lines:
        if distance > 0.0:
            trace_line = trace_by_torso if pattern.by_torso and direction[2] == 1.0 else trace_straight
            line = trace_line(context.empty, context.base, waypoints[-1], direction, distance)
            if line is None:
                return None
            waypoints = np.vstack([waypoints, line[1:]])
    standing = on_base(context.base, waypoints)
    if not pattern.drives:
        return standing
    drive = _drive(context.empty.scene, context.base, context.q)
    return np.vstack([standing, *(np.concatenate((base, waypoints[-1])) for base in drive[1:])])


def _drive(scene: Scene, base: Array, q: Array) -> Array:
    """Base poses (k, 3) of the drive out with the arm rigid in a configuration (8,), the first one included."""
    return drive_out(scene.support, base, tcp_pose(scene.robot, RobotState(base, q, 0.0)))
