"""Picking an object up and putting it down with a standing base: the choreography around one contact posture.

A pick goes from the start posture to a hover posture (free), along a straight line to the grasp, lifts the object
straight, and ends in the carry posture (free). A placement is the same backwards. Straight lines are tried in the order
of `LINES`: from above they need hardly more room than the grasp itself, from the front they pass below a board.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planners.arm_motion import (
    DEFAULT_EFFORT,
    FIXED_BITS,
    ArmPath,
    Obstruction,
    RRTConfig,
    Unreachable,
    nearest_turns,
    plan_arm,
    tcp_pose,
    trace_by_torso,
    trace_straight,
)
from planners.collision import CollisionWorld
from planners.scene import Body, HeldObject, RobotState

__all__ = [
    "LINES",
    "SIDE_CLEARANCE",
    "Line",
    "PickMotion",
    "PlaceMotion",
    "can_leave",
    "can_put_down",
    "grip_opening",
    "plan_pick",
    "plan_place",
]

SIDE_CLEARANCE = 0.012
"""[m] between an open finger and the object, each side."""

Array = NDArray[np.float64]


class Line(NamedTuple):
    """How the hand leaves a contact posture; it arrives the other way round. Lengths in metres.

    Empty and open it moves `back` along its own axis, then `up`. With the object it moves `held_up`, then `held_back`.
    """

    name: str
    back: float
    up: float
    held_up: float
    held_back: float
    by_torso: bool = False
    """Vertical legs are left to the torso: slow, but what the arm is free of below it is free of all the way."""


LINES = (
    Line("above", back=0.0, up=0.25, held_up=0.25, held_back=0.0),
    Line("above", back=0.0, up=0.19, held_up=0.19, held_back=0.0),
    Line("above", back=0.0, up=0.25, held_up=0.25, held_back=0.0, by_torso=True),
    Line("above", back=0.0, up=0.19, held_up=0.19, held_back=0.0, by_torso=True),
    Line("front", back=0.10, up=0.0, held_up=0.25, held_back=0.0),
    Line("front", back=0.10, up=0.0, held_up=0.19, held_back=0.0),
    Line("front", back=0.12, up=0.0, held_up=0.02, held_back=0.14),
)


@dataclass(frozen=True, eq=False)
class PickMotion:
    """Take an object: free `transit`, straight `approach`, (close,) straight `lift`, free `retreat` with it in hand."""

    name: str
    line: Line
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
    line: Line
    transit: ArmPath
    lower: ArmPath
    rise: ArmPath
    retreat: ArmPath
    held: HeldObject

    @property
    def paths(self) -> tuple[ArmPath, ArmPath, ArmPath, ArmPath]:
        """In order of time; the fingers open after the second."""
        return self.transit, self.lower, self.rise, self.retreat


class _Contact(NamedTuple):
    """The situation around a contact posture: worlds without and with the object in hand, openings [m], the object."""

    empty: CollisionWorld
    loaded: CollisionWorld
    base: Array
    q: Array
    opening: float
    grip: float
    held: HeldObject
    ignore: int


class _Option(NamedTuple):
    """One line that the arm can follow: waypoints (n, 8) outwards, empty and loaded, and the objects that it hits."""

    line: Line
    empty: Array
    loaded: Array
    hits: int
    phase: str


def grip_opening(body: Body, finger_direction: ArrayLike, clearance: float = 0.0) -> float:
    """[m] between the pads that hold an object across a world direction (3,), with `clearance` [m] on each side."""
    return 2.0 * (body.half_extent_along(finger_direction) + clearance)


def plan_pick(
    world: CollisionWorld,
    base: ArrayLike,
    q_start: ArrayLike,
    q_grasp: ArrayLike,
    name: str,
    *,
    rng: np.random.Generator,
    q_carry: ArrayLike | None = None,
    lines: tuple[Line, ...] = LINES,
    ignore: int = 0,
    config: RRTConfig = DEFAULT_EFFORT,
) -> PickMotion | Obstruction | Unreachable:
    """Take an object with a given grasp.

    Args:
        world: the scene, compiled.
        base: (3,) where the base stands.
        q_start: (8,) posture at the start.
        q_grasp: (8,) posture in which the fingers close.
        name: which object.
        rng: for the free parts.
        q_carry: (8,) posture at the end, up to whole turns of joints that turn round; the robot's home by default.
        lines: straight lines to try, in order.
        ignore: bits of objects that are not obstacles.
        config: effort of the free parts.

    Returns:
        the motion; the smallest set of objects found to be in its way; or why clearing would not help.

    Raises:
        UnknownObject: no such object.
    """
    q = nearest_turns(world.robot, q_start, q_grasp)
    contact = _grasp_contact(world, base, q, name, ignore)
    end = nearest_turns(world.robot, q, world.scene.robot.home if q_carry is None else q_carry)
    found = _plan_around(contact, (q_start, end), lines, rng, config)
    if not isinstance(found, tuple):
        return found
    line, empty, loaded, transit, retreat = found
    return PickMotion(name, line, transit, empty.reversed(), loaded, retreat, contact.held)


def plan_place(
    world: CollisionWorld,
    base: ArrayLike,
    q_start: ArrayLike,
    q_release: ArrayLike,
    held: HeldObject,
    *,
    rng: np.random.Generator,
    q_end: ArrayLike | None = None,
    lines: tuple[Line, ...] = LINES,
    ignore: int = 0,
    config: RRTConfig = DEFAULT_EFFORT,
) -> PlaceMotion | Obstruction | Unreachable:
    """Put down what is in hand; the object then stands where `q_release` holds it.

    Args:
        world: the scene, compiled; the object's own pose in it does not matter.
        base: (3,) where the base stands.
        q_start: (8,) posture at the start.
        q_release: (8,) posture in which the fingers open.
        held: what is in hand.
        rng, lines, ignore, config: as for `plan_pick`.
        q_end: (8,) posture at the end; the robot's home by default.

    Returns:
        the motion; the smallest set of objects found to be in its way; or why clearing would not help.

    Raises:
        UnknownObject: no such object.
    """
    scene = world.scene
    q = nearest_turns(world.robot, q_start, q_release)
    contact, placed = _release_contact(world, base, q, held, ignore)
    end = nearest_turns(world.robot, q, scene.robot.home if q_end is None else q_end)
    found = _plan_around(contact, (end, q_start), lines, rng, config)
    if not isinstance(found, tuple):
        return found
    line, empty, loaded, retreat, transit = found
    return PlaceMotion(placed, line, transit.reversed(), loaded.reversed(), empty, retreat.reversed(), held)


def can_leave(world: CollisionWorld, base: ArrayLike, q_grasp: ArrayLike, name: str) -> bool:
    """Whether the hand can leave a grasp of that object upwards, if no other object were there."""
    others = world.scene.mask(world.scene.names) & ~world.scene.mask([name])
    contact = _grasp_contact(world, base, np.asarray(q_grasp, dtype=float), name, others)
    lines = LINES if _is_covered(world) else tuple(line for line in LINES if line.up > 0.0)
    return any(isinstance(_trace(contact, line), _Option) for line in lines)


def can_put_down(world: CollisionWorld, base: ArrayLike, q_release: ArrayLike, held: HeldObject) -> bool:
    """Whether the hand can bring an object down to a posture, let go and leave without touching anything."""
    contact, _ = _release_contact(world, base, np.asarray(q_release, dtype=float), held, 0)
    lines = LINES if _is_covered(world) else tuple(line for line in LINES if line.up > 0.0)
    return any(isinstance(option := _trace(contact, line), _Option) and not option.hits for line in lines)


def _is_covered(world: CollisionWorld) -> bool:
    """Whether something above the table keeps the hand from coming from above."""
    table = world.scene.support
    return any(
        box.lower[2] > table.top
        and (np.abs(box.position - table.position) < box.half_extents + table.half_extents)[:2].all()
        for box in world.scene.furniture
        if box.lower[2] < table.top + 0.8
    )


def _grasp_contact(world: CollisionWorld, base: ArrayLike, q: Array, name: str, ignore: int) -> _Contact:
    """The situation around a grasp of an object where it stands."""
    robot, body = world.scene.robot, world.scene.body(name)
    T_world_tcp = tcp_pose(robot, RobotState(np.asarray(base), q, 0.0))
    held = HeldObject(name, np.linalg.inv(T_world_tcp) @ body.pose)
    grip = grip_opening(body, T_world_tcp[:3, 1])
    opening = min(grip + 2 * SIDE_CLEARANCE, robot.max_opening)
    return _Contact(world, world, np.array(base, dtype=float), q, opening, grip, held, ignore)


def _release_contact(
    world: CollisionWorld, base: ArrayLike, q: Array, held: HeldObject, ignore: int
) -> tuple[_Contact, Body]:
    """The situation around a release, and the object as it will stand."""
    scene = world.scene
    T_world_tcp = tcp_pose(scene.robot, RobotState(np.asarray(base), q, 0.0))
    placed = scene.body(held.name).at_pose(T_world_tcp @ held.T_tcp_object)
    after = CollisionWorld.from_scene(scene.with_body(placed), world.padding)
    grip = grip_opening(placed, T_world_tcp[:3, 1])
    opening = min(grip + 2 * SIDE_CLEARANCE, scene.robot.max_opening)
    return _Contact(after, world, np.array(base, dtype=float), q, opening, grip, held, ignore), placed


def _plan_around(
    contact: _Contact,
    ends: tuple[ArrayLike, ArrayLike],
    lines: tuple[Line, ...],
    rng: np.random.Generator,
    config: RRTConfig,
) -> tuple[Line, ArmPath, ArmPath, ArmPath, ArmPath] | Obstruction | Unreachable:
    """The line, outwards empty and loaded, and the free paths: `ends[0]` → hover empty, hover loaded → `ends[1]`."""
    options: list[_Option] = []
    reasons: list[str] = []
    for line in lines:
        option = _trace(contact, line)
        if isinstance(option, str):
            reasons.append(f"{line.name}: {option}")
        else:
            options.append(option)
    refused: list[Obstruction] = []
    for option in sorted(options, key=lambda option: option.hits.bit_count()):
        if refused and option.hits.bit_count() >= min(len(other.blockers) for other in refused):
            break
        free = _connect(contact, option, ends, rng, config)
        if isinstance(free, Unreachable):
            reasons.append(f"{option.line.name}: {free.reason}")
        elif isinstance(free, Obstruction):
            refused.append(free)
        else:
            empty = ArmPath(contact.base, option.empty, contact.opening, None, contact.ignore)
            loaded = ArmPath(contact.base, option.loaded, contact.grip, contact.held, contact.ignore)
            return option.line, empty, loaded, *free
    if refused:
        return min(refused, key=lambda obstruction: (len(obstruction.blockers), sorted(obstruction.blockers)))
    return Unreachable("; ".join(dict.fromkeys(reasons)))


def _trace(contact: _Contact, line: Line) -> _Option | str:
    """Follow a line outwards and see what it hits; or why the arm cannot."""
    back, up = (
        -tcp_pose(contact.empty.scene.robot, RobotState(contact.base, contact.q, 0.0))[:3, 0],
        np.array([0, 0, 1.0]),
    )
    empty = _follow(contact, ((back, line.back), (up, line.up)), line.by_torso)
    loaded = _follow(contact, ((up, line.held_up), (back, line.held_back)), line.by_torso)
    if empty is None or loaded is None:
        return "the arm cannot follow the line"
    here = contact.empty.hits(contact.base, contact.q, contact.opening, None, contact.ignore)
    out = contact.empty.path_hits(_drive(contact, empty), contact.opening, None, contact.ignore)
    away = contact.loaded.path_hits(_drive(contact, loaded), contact.grip, contact.held, contact.ignore)
    hits = out | away
    if hits & FIXED_BITS:
        return f"the line touches {' and '.join(contact.empty.names_of(hits & FIXED_BITS))}"
    if hits >> contact.empty.scene.index(contact.held.name) & 1:
        return f"the open hand does not fit around {contact.held.name}"
    phase = "grasp" if hits == here else ("approach" if hits == out else "lift")
    return _Option(line, empty, loaded, hits, phase)


def _follow(contact: _Contact, legs: tuple[tuple[Array, float], ...], by_torso: bool) -> Array | None:
    """Waypoints (n, 8) from the contact posture along straight legs, None where the arm cannot follow."""
    waypoints = contact.q[None]
    for direction, distance in legs:
        if distance > 0.0:
            trace = trace_by_torso if by_torso and direction[2] == 1.0 else trace_straight
            leg = trace(contact.empty, contact.base, waypoints[-1], direction, distance)
            if leg is None:
                return None
            waypoints = np.vstack([waypoints, leg[1:]])
    return waypoints


def _drive(contact: _Contact, waypoints: Array) -> Array:
    return np.hstack([np.tile(contact.base, (len(waypoints), 1)), waypoints])


def _connect(
    contact: _Contact,
    option: _Option,
    ends: tuple[ArrayLike, ArrayLike],
    rng: np.random.Generator,
    config: RRTConfig,
) -> tuple[ArmPath, ArmPath] | Obstruction | Unreachable:
    """The free paths to and from a line, once the objects that it hits are gone."""
    ignore = contact.ignore | option.hits
    paths: list[ArmPath] = []
    blockers = set(contact.empty.scene.names_of(option.hits))
    for start, goal, is_loaded in _free_parts(option, ends):
        world, opening = (contact.loaded, contact.grip) if is_loaded else (contact.empty, contact.opening)
        held = contact.held if is_loaded else None
        path = plan_arm(world, contact.base, start, goal, opening, held, ignore, rng=rng, config=config, exact=True)
        if isinstance(path, Unreachable):
            return path
        if isinstance(path, Obstruction):
            blockers |= path.blockers
        else:
            paths.append(path)
    if blockers:
        return Obstruction(frozenset(blockers), option.phase if option.hits else "transit")
    return paths[0], paths[1]


def _free_parts(option: _Option, ends: tuple[ArrayLike, ArrayLike]) -> Iterator[tuple[ArrayLike, ArrayLike, bool]]:
    """Start, goal, and whether the object is in hand, of both free paths."""
    yield ends[0], option.empty[-1], False
    yield option.loaded[-1], ends[1], True
