"""Straight lines of the gripper to and from a grasp or release configuration.

A pattern is traced outwards from that configuration. The trace tells whether the robot can follow the lines, without
and with the object, and which objects are in the way. Under a shelf, the base drives straight out with a rigid arm.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planners.collision.opened import is_pushed
from planners.collision.straight_lines import trace_by_torso, trace_straight
from planners.collision.world import CollisionWorld, with_clearance_around
from planners.motion.arm import ArmQuery, tcp_pose
from planners.motion.path import on_base
from planners.scene import Body, HeldObject, RobotState, Scene
from planners.scene.cover import LEAST_LIFT, drive_out, driven_out_of, is_covered
from planners.scene.masks import FIXED_BITS

Array = NDArray[np.float64]


class ApproachPattern(NamedTuple):
    """Lines on which the gripper leaves a grasp or release configuration. It arrives along the same lines in reverse.

    Attributes:
        name: for messages.
        back, up: distances [m] of the empty, open gripper: `back` against its approach direction, then `up`.
        held_up, held_back: distances [m] with the object: `held_up`, then `held_back`.
        by_torso: whether the torso makes the vertical lines. That is slow, but the arm can only hit objects above it.
        drives: whether the base then drives straight out from under the shelf with a rigid arm. See `stand_off`.
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
"""Patterns in the order of the tries. Lines from above need little more clearance than the grasp. Lines from the front
fit under shelves."""
_DRIVES = (
    ApproachPattern("drive", back=0.0, up=0.0, held_up=0.12, held_back=0.0, by_torso=True, drives=True),
    ApproachPattern("drive", back=0.0, up=0.0, held_up=0.12, held_back=0.0, drives=True),
    ApproachPattern("drive", back=0.0, up=0.0, held_up=LEAST_LIFT, held_back=0.0, by_torso=True, drives=True),
    ApproachPattern("drive", back=0.0, up=0.0, held_up=LEAST_LIFT, held_back=0.0, drives=True),
)
"""First patterns under a shelf: the object is lifted where it stands, by more than `LIFTED` if the shelf allows."""
_OVER_RIM = tuple(pattern._replace(name="drive over its rim", up=0.06) for pattern in _DRIVES)
"""Patterns for a bowl or mug. The fingers have its wall between them, so the empty gripper comes and leaves above the
rim."""


_TO_HANDLES = (
    ApproachPattern("to the handle", back=0.10, up=0.0, held_up=0.0, held_back=0.0),
    ApproachPattern("to the handle", back=0.06, up=0.0, held_up=0.0, held_back=0.0),
    ApproachPattern("to the handle", back=0.04, up=0.06, held_up=0.0, held_back=0.0),
)
"""Patterns for a handle, which is not lifted: the gripper comes and leaves along its approach direction."""


@dataclass(frozen=True, eq=False)
class ContactQuery:
    """A grasp or a release, with its surroundings.

    Attributes:
        empty: query for the empty, open gripper, with the object standing in the world.
        loaded: query for the loaded gripper.
        q: (8,) torso [m] and arm [rad] when the fingers close or open.
        body: the object at its pose before the grasp or after the release.
        held: the held object.
        T_world_tcp: (4, 4) TCP pose at the contact.
    """

    empty: ArmQuery
    loaded: ArmQuery
    q: Array
    body: Body
    held: HeldObject
    T_world_tcp: Array

    @classmethod
    def grasp(cls, world: CollisionWorld, base: ArrayLike, q: ArrayLike, name: str, ignore: int = 0) -> ContactQuery:
        """A grasp of an object where it stands. `ignore` is a mask of objects that are no obstacles."""
        body = world.scene.body(name)
        held = HeldObject.grasped(body, _tcp_pose(world.scene, base, q))
        return cls._of(world, with_clearance_around(world, name), base, q, held, ignore)

    @classmethod
    def release(
        cls, world: CollisionWorld, base: ArrayLike, q: ArrayLike, held: HeldObject, ignore: int = 0
    ) -> ContactQuery:
        """A release of a held object at its pose in the gripper. `ignore` as for a grasp. Raises `UnknownObject`."""
        placed = world.scene.body(held.name).at_pose(_tcp_pose(world.scene, base, q) @ held.T_tcp_object)
        return cls._of(world.with_body(placed), world, base, q, held, ignore)

    @classmethod
    def _of(
        cls,
        empty: CollisionWorld,
        loaded: CollisionWorld,
        base: ArrayLike,
        q: ArrayLike,
        held: HeldObject,
        ignore: int,
    ) -> ContactQuery:
        """The query in the worlds for the empty gripper, with the object standing, and for the loaded gripper."""
        scene, there, body = empty.scene, np.asarray(base, float), empty.scene.body(held.name)
        T_world_tcp = _tcp_pose(scene, base, q)
        grip = body.width_in_gripper(np.linalg.inv(T_world_tcp) @ body.pose)
        opening = min(grip + 2 * scene.robot.finger_gap, scene.robot.max_opening)
        opening = 0.0 if is_pushed(scene, held.name) else opening
        coming = ArmQuery(empty, there, opening, None, ignore)
        # Fingers around a handle may touch the bracket between handle and door: it moves with the handle.
        holding = coming if is_handle(scene, held.name) else ArmQuery(loaded, there, grip, held, ignore)
        return cls(coming, holding, np.asarray(q, float), body, held, T_world_tcp)

    @cached_property
    def is_covered(self) -> bool:
        """Whether a shelf hangs over the object."""
        return is_covered(self.empty.world.scene, self.body.foot)

    @property
    def patterns(self) -> tuple[ApproachPattern, ...]:
        """All patterns in the order of the tries. Those with a drive are for a base that drives, under a shelf."""
        if is_handle(self.empty.world.scene, self.held.name):
            return _TO_HANDLES
        if not self.is_covered or self.empty.world.scene.robot.base_drive == "fixed":
            return APPROACH_PATTERNS
        return (_DRIVES + _OVER_RIM if self.body.pieces else _DRIVES) + APPROACH_PATTERNS

    @property
    def likely_patterns(self) -> tuple[ApproachPattern, ...]:
        """Patterns to trace before any free path is planned. Those from the front are used under a shelf only."""
        is_any = self.is_covered or is_handle(self.empty.world.scene, self.held.name)
        return self.patterns if is_any else tuple(one for one in self.patterns if one.up > 0.0)


def is_handle(scene: Scene, name: str) -> bool:
    """Whether an object represents a handle, which is pulled and not lifted."""
    return scene.pull is not None and scene.pull.handle == name


class Approach(NamedTuple):
    """An approach pattern traced from a grasp or release configuration.

    Attributes:
        pattern: the pattern.
        empty, loaded: whole-body configurations (n, 11) outwards, without and with the object.
        hits: mask of the objects in the way.
        phase: phase of the motion in which the last of them is hit: "grasp" (standing still), "approach" or "lift".
    """

    pattern: ApproachPattern
    empty: Array
    loaded: Array
    hits: int
    phase: str


def can_take(world: CollisionWorld, base: ArrayLike, q_grasp: ArrayLike, name: str) -> bool:
    """Whether approach to a grasp (8,) of that object, and retreat with it, are collision-free."""
    query = ContactQuery.grasp(world, base, q_grasp, name)
    return any(free_approach(query, pattern) is not None for pattern in query.patterns)


def can_put_down(world: CollisionWorld, base: ArrayLike, q_release: ArrayLike, held: HeldObject) -> bool:
    """Whether lowering the held object to a configuration (8,), opening and retreat are collision-free."""
    query = ContactQuery.release(world, base, q_release, held)
    return any(free_approach(query, pattern) is not None for pattern in query.likely_patterns)


def planned_approach(
    world: CollisionWorld, base: ArrayLike, q_grasp: ArrayLike, name: str
) -> tuple[ContactQuery, Approach] | None:
    """Approach and retreat by the first pattern for a grasp (8,) of that object, with all other objects ignored."""
    others = world.scene.mask(world.scene.names) & ~world.scene.mask([name])
    query = ContactQuery.grasp(world, base, q_grasp, name, others)
    return next(((query, approach) for approach in _traced(query)), None)


def fewest_blockers(world: CollisionWorld, base: ArrayLike, q_grasp: ArrayLike, name: str) -> int | None:
    """Find the smallest set of objects in the way of the straight lines to and from a grasp (8,), as a mask.

    Held objects are ignored: they are put down before.

    Returns:
        None if all of the lines are out of reach or lead through static obstacles.
    """
    ignore = world.scene.mask(world.scene.held_names)
    return fewest_hits(ContactQuery.grasp(world, base, q_grasp, name, ignore))


def fewest_hits(query: ContactQuery) -> int | None:
    """Find the smallest set of objects in the way of the straight lines to and from a contact, as `fewest_blockers`."""
    return min((found.hits for found in _traced(query)), key=int.bit_count, default=None)


def _traced(query: ContactQuery) -> Iterator[Approach]:
    """Traced patterns that the arm can follow once all movable objects in the way have left."""
    return (found for pattern in query.likely_patterns if isinstance(found := trace(query, pattern), Approach))


def stand_off(scene: Scene, base: ArrayLike, q: ArrayLike, body: Body) -> Array:
    """Base pose (3,) in front of a shelf, from which the base drives straight in to an object. See `drive_out`."""
    return drive_out(driven_out_of(scene, body), base, _tcp_pose(scene, base, q))[-1]


def free_approach(query: ContactQuery, pattern: ApproachPattern) -> Approach | None:
    """Trace a pattern if it is collision-free without and with the object, else None. Faster than `trace`."""
    lines = _lines(query, pattern)
    if lines is None or query.empty.path_hits(lines[0], first_only=True):
        return None
    return None if query.loaded.path_hits(lines[1], first_only=True) else Approach(pattern, *lines, 0, "transit")


def trace(query: ContactQuery, pattern: ApproachPattern) -> Approach | str:
    """Trace a pattern and find all objects in its way. Without a possible motion, return the reason as text."""
    lines = _lines(query, pattern)
    if lines is None:
        return "the arm cannot follow the line"
    empty, loaded = lines
    here, out = query.empty.hits(query.q[None])[0], query.empty.path_hits(empty)
    hits, world = out | query.loaded.path_hits(loaded), query.empty.world
    if hits & FIXED_BITS:
        return f"the line touches {' and '.join(world.names_of(hits & FIXED_BITS))}"
    if hits >> world.scene.index(query.held.name) & 1:
        return f"the open gripper does not fit around {query.held.name}"
    phase = "grasp" if hits == here else ("approach" if hits == out else "lift")
    return Approach(pattern, empty, loaded, hits, phase)


def _lines(query: ContactQuery, pattern: ApproachPattern) -> tuple[Array, Array] | None:
    """Configurations (n, 11) outwards along a pattern, without and with the object. None if the arm cannot follow."""
    back, up = -query.T_world_tcp[:3, 0], np.array([0.0, 0.0, 1.0])
    empty = _follow(query, ((back, pattern.back), (up, pattern.up)), pattern)
    if empty is None:
        return None
    is_same = pattern.back == pattern.held_back == 0.0 and pattern.up == pattern.held_up
    loaded = empty if is_same else _follow(query, ((up, pattern.held_up), (back, pattern.held_back)), pattern)
    return None if loaded is None else (empty, loaded)


def _follow(query: ContactQuery, lines: tuple[tuple[Array, float], ...], pattern: ApproachPattern) -> Array | None:
    """Configurations (n, 11) along lines (direction, distance [m]) in turn, then out. None if the arm cannot follow."""
    world, base, waypoints = query.empty.world, query.empty.base, query.q[None]
    for direction, distance in lines:
        if distance > 0.0:
            trace_line = trace_by_torso if pattern.by_torso and direction[2] == 1.0 else trace_straight
            line = trace_line(world, base, waypoints[-1], direction, distance)
            if line is None:
                return None
            waypoints = np.vstack([waypoints, line[1:]])
    standing = on_base(base, waypoints)
    if not pattern.drives:
        return standing
    if world.scene.robot.base_drive != "holonomic":
        return None  # For a differential base, straight out is seldom straight ahead.
    drive = drive_out(driven_out_of(world.scene, query.body), base, query.T_world_tcp)
    return np.vstack([standing, *(np.concatenate((outside, waypoints[-1])) for outside in drive[1:])])


def _tcp_pose(scene: Scene, base: ArrayLike, q: ArrayLike) -> Array:
    return tcp_pose(scene.robot, RobotState(np.asarray(base, float), np.asarray(q, float), 0.0))
