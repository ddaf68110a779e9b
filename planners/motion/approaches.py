"""Straight lines of the gripper to and from a grasp or release configuration.

A pattern is traced from that configuration outwards. The question is whether the robot can follow it, without and with
the object, and which objects are in the way. Under a shelf the base drives straight out with the arm rigid.
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
_OVER_RIM = tuple(pattern._replace(name="drive over its rim", up=0.06) for pattern in _DRIVES)
"""The same of a bowl or mug, whose wall the empty gripper has between its fingers: it comes and goes above the rim."""


_TO_HANDLES = (
    ApproachPattern("to the handle", back=0.10, up=0.0, held_up=0.0, held_back=0.0),
    ApproachPattern("to the handle", back=0.06, up=0.0, held_up=0.0, held_back=0.0),
    ApproachPattern("to the handle", back=0.04, up=0.06, held_up=0.0, held_back=0.0),
)
"""A handle is not lifted: the gripper comes and goes along its approach direction."""


@dataclass(frozen=True, eq=False)
class ContactQuery:
    """A grasp or a release, and the situation around it.

    Attributes:
        empty: while the gripper is empty and open; the object stands in that world.
        loaded: while the object is held.
        q: (8,) torso [m] and arm [rad] when the fingers close or open.
        body: the object where it stands before it is grasped, or after it was released.
        held: the object, as it is held.
        T_world_tcp: (4, 4) of the gripper then.
    """

    empty: ArmQuery
    loaded: ArmQuery
    q: Array
    body: Body
    held: HeldObject
    T_world_tcp: Array

    @classmethod
    def grasp(cls, world: CollisionWorld, base: ArrayLike, q: ArrayLike, name: str, ignore: int = 0) -> ContactQuery:
        """A grasp of an object where it stands, `ignore` a mask of objects that are no obstacles."""
        body = world.scene.body(name)
        held = HeldObject.grasped(body, _tcp_pose(world.scene, base, q))
        return cls._of(world, with_clearance_around(world, name), base, q, held, ignore)

    @classmethod
    def release(
        cls, world: CollisionWorld, base: ArrayLike, q: ArrayLike, held: HeldObject, ignore: int = 0
    ) -> ContactQuery:
        """A release of a held object where the gripper has it then, `ignore` as for a grasp; raises `UnknownObject`."""
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
        """The query in the worlds without the object in hand, where it stands, and with it."""
        scene, there, body = empty.scene, np.asarray(base, float), empty.scene.body(held.name)
        T_world_tcp = _tcp_pose(scene, base, q)
        grip = body.width_in_gripper(np.linalg.inv(T_world_tcp) @ body.pose)
        opening = min(grip + 2 * scene.robot.finger_gap, scene.robot.max_opening)
        opening = 0.0 if is_pushed(scene, held.name) else opening
        coming = ArmQuery(empty, there, opening, None, ignore)
        # Fingers that close on a handle may touch what holds it to its door: it is moved with it.
        holding = coming if is_handle(scene, held.name) else ArmQuery(loaded, there, grip, held, ignore)
        return cls(coming, holding, np.asarray(q, float), body, held, T_world_tcp)

    @cached_property
    def is_covered(self) -> bool:
        """Whether a shelf hangs over the object."""
        return is_covered(self.empty.world.scene, self.body.foot)

    @property
    def patterns(self) -> tuple[ApproachPattern, ...]:
        """All patterns, in the order in which they are tried: driving ones only under a shelf."""
        if is_handle(self.empty.world.scene, self.held.name):
            return _TO_HANDLES
        drives = (_DRIVES + _OVER_RIM if self.body.pieces else _DRIVES) if self.is_covered else ()
        return drives + APPROACH_PATTERNS

    @property
    def likely_patterns(self) -> tuple[ApproachPattern, ...]:
        """The patterns worth tracing before any free path is planned: those from the front only under a shelf."""
        is_any = self.is_covered or is_handle(self.empty.world.scene, self.held.name)
        return self.patterns if is_any else tuple(one for one in self.patterns if one.up > 0.0)


def is_handle(scene: Scene, name: str) -> bool:
    """Whether an object stands for a handle, which is pulled and not lifted."""
    return scene.pull is not None and scene.pull.handle == name


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


def can_take(world: CollisionWorld, base: ArrayLike, q_grasp: ArrayLike, name: str) -> bool:
    """Whether the gripper can come to a grasp (8,) of that object and leave with it without hitting anything."""
    query = ContactQuery.grasp(world, base, q_grasp, name)
    return any(free_approach(query, pattern) is not None for pattern in query.patterns)


def can_put_down(world: CollisionWorld, base: ArrayLike, q_release: ArrayLike, held: HeldObject) -> bool:
    """Whether the gripper can lower the held object to a configuration (8,), open and leave, and hit nothing."""
    query = ContactQuery.release(world, base, q_release, held)
    return any(free_approach(query, pattern) is not None for pattern in query.likely_patterns)


def planned_approach(
    world: CollisionWorld, base: ArrayLike, q_grasp: ArrayLike, name: str
) -> tuple[ContactQuery, Approach] | None:
    """The first pattern along which the gripper could lift that object from a grasp (8,) if no other one were there."""
    others = world.scene.mask(world.scene.names) & ~world.scene.mask([name])
    query = ContactQuery.grasp(world, base, q_grasp, name, others)
    return next(((query, approach) for approach in _traced(query)), None)


def fewest_blockers(world: CollisionWorld, base: ArrayLike, q_grasp: ArrayLike, name: str) -> int | None:
    """The smallest set of objects in the way of the straight lines to and from a grasp (8,), as a mask.

    What is held is not: it is put down before.

    Returns:
        None if the robot cannot follow any of the lines, or they lead through static obstacles.
    """
    ignore = world.scene.mask(world.scene.held_names)
    return fewest_hits(ContactQuery.grasp(world, base, q_grasp, name, ignore))


def fewest_hits(query: ContactQuery) -> int | None:
    """The smallest set of objects in the way of the straight lines to and from a contact, as `fewest_blockers`."""
    return min((found.hits for found in _traced(query)), key=int.bit_count, default=None)


def _traced(query: ContactQuery) -> Iterator[Approach]:
    """The patterns worth tracing along which the arm can go if nothing were in its way that can be cleared."""
    return (found for pattern in query.likely_patterns if isinstance(found := trace(query, pattern), Approach))


def stand_off(scene: Scene, base: ArrayLike, q: ArrayLike, body: Body) -> Array:
    """The base pose (3,) outside from which the base drives straight in to an object; see `drive_out`."""
    return drive_out(driven_out_of(scene, body), base, _tcp_pose(scene, base, q))[-1]


def free_approach(query: ContactQuery, pattern: ApproachPattern) -> Approach | None:
    """The traced pattern if the arm can follow it without and with the object and hits nothing; faster than `trace`."""
    lines = _lines(query, pattern)
    if lines is None or query.empty.path_hits(lines[0], first_only=True):
        return None
    return None if query.loaded.path_hits(lines[1], first_only=True) else Approach(pattern, *lines, 0, "transit")


def trace(query: ContactQuery, pattern: ApproachPattern) -> Approach | str:
    """Trace a pattern and find all objects in its way; the reason if the arm cannot follow it or no clearing helps."""
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
    """Configurations (n, 11) outwards along a pattern, without and with the object; None if it cannot be followed."""
    back, up = -query.T_world_tcp[:3, 0], np.array([0.0, 0.0, 1.0])
    empty = _follow(query, ((back, pattern.back), (up, pattern.up)), pattern)
    if empty is None:
        return None
    is_same = pattern.back == pattern.held_back == 0.0 and pattern.up == pattern.held_up
    loaded = empty if is_same else _follow(query, ((up, pattern.held_up), (back, pattern.held_back)), pattern)
    return None if loaded is None else (empty, loaded)


def _follow(query: ContactQuery, lines: tuple[tuple[Array, float], ...], pattern: ApproachPattern) -> Array | None:
    """Configurations (n, 11) from where it stands along (direction, distance [m]) in turn, then out; None as above."""
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
        return None  # a differential base seldom has what is straight out straight ahead
    drive = drive_out(driven_out_of(world.scene, query.body), base, query.T_world_tcp)
    return np.vstack([standing, *(np.concatenate((outside, waypoints[-1])) for outside in drive[1:])])


def _tcp_pose(scene: Scene, base: ArrayLike, q: ArrayLike) -> Array:
    return tcp_pose(scene.robot, RobotState(np.asarray(base, float), np.asarray(q, float), 0.0))
