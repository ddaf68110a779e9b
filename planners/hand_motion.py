"""Picking an object up and putting it down with a standing base: the choreography around one contact posture.

A pick goes from the start posture to a hover posture (free), along a straight line to the grasp, lifts the object
straight, and ends in the carry posture (free). A placement is the same backwards. Straight lines are tried in the order
of `hand_lines.LINES`: from above they need hardly more room than the grasp, from the front they pass below a board.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from planners.arm_motion import (
    DEFAULT_EFFORT,
    ArmPath,
    Obstruction,
    RRTConfig,
    Unreachable,
    nearest_turns,
    plan_arm,
)
from planners.collision import CollisionWorld
from planners.hand_lines import (
    LINES,
    Contact,
    Line,
    LineOption,
    free_option,
    grasp_contact,
    lines_of,
    release_contact,
    trace,
)
from planners.scene import Body, HeldObject

__all__ = ["PickMotion", "PlaceMotion", "can_leave", "can_put_down", "plan_pick", "plan_place"]


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


_Composed: TypeAlias = tuple[Line, ArmPath, ArmPath, ArmPath, ArmPath]
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
    contact = grasp_contact(world, base, q, name, ignore)
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
    blame: bool = True,
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
        blame: whether to find out which objects are in the way; without, any obstruction is `Unreachable`, and quick.

    Returns:
        the motion; the smallest set of objects found to be in its way; or why clearing would not help.

    Raises:
        UnknownObject: no such object.
    """
    scene = world.scene
    q = nearest_turns(world.robot, q_start, q_release)
    contact, placed = release_contact(world, base, q, held, ignore)
    end = nearest_turns(world.robot, q, scene.robot.home if q_end is None else q_end)
    found = _plan_around(contact, (end, q_start), lines, rng, config, blame)
    if not isinstance(found, tuple):
        return found
    line, empty, loaded, retreat, transit = found
    return PlaceMotion(placed, line, transit.reversed(), loaded.reversed(), empty, retreat.reversed(), held)


def can_leave(world: CollisionWorld, base: ArrayLike, q_grasp: ArrayLike, name: str) -> bool:
    """Whether the hand can leave a grasp of that object upwards, if no other object were there."""
    others = world.scene.mask(world.scene.names) & ~world.scene.mask([name])
    contact = grasp_contact(world, base, np.asarray(q_grasp, dtype=float), name, others)
    return any(isinstance(trace(contact, line), LineOption) for line in lines_of(world))


def can_put_down(world: CollisionWorld, base: ArrayLike, q_release: ArrayLike, held: HeldObject) -> bool:
    """Whether the hand can bring an object down to a posture, let go and leave without touching anything."""
    contact, _ = release_contact(world, base, np.asarray(q_release, dtype=float), held, 0)
    return any(free_option(contact, line) is not None for line in lines_of(world))


def _plan_around(
    contact: Contact,
    ends: tuple[ArrayLike, ArrayLike],
    lines: tuple[Line, ...],
    rng: np.random.Generator,
    config: RRTConfig,
    blame: bool = True,
) -> _Composed | Obstruction | Unreachable:
    """The line, outwards empty and loaded, and the free paths: `ends[0]` → hover empty, hover loaded → `ends[1]`."""
    for line in lines:
        option = free_option(contact, line)
        free = None if option is None else _connect(contact, option, ends, rng, config, blame=False)
        if option is not None and isinstance(free, tuple):
            return _composed(contact, option, free)
    return _refusal(contact, ends, lines, rng, config) if blame else Unreachable("no free line")


def _composed(contact: Contact, option: LineOption, free: tuple[ArmPath, ArmPath]) -> _Composed:
    empty = ArmPath(contact.base, option.empty, contact.opening, None, contact.ignore)
    loaded = ArmPath(contact.base, option.loaded, contact.grip, contact.held, contact.ignore)
    return option.line, empty, loaded, *free


def _refusal(
    contact: Contact,
    ends: tuple[ArrayLike, ArrayLike],
    lines: tuple[Line, ...],
    rng: np.random.Generator,
    config: RRTConfig,
) -> _Composed | Obstruction | Unreachable:
    """The fewest objects in the way of any line and of the ways to and from it; a motion, should one be found now."""
    traced = [(line, trace(contact, line)) for line in lines]
    reasons = [f"{line.name}: {option}" for line, option in traced if isinstance(option, str)]
    options = [option for _, option in traced if not isinstance(option, str)]
    refused: list[Obstruction] = []
    for option in sorted(options, key=lambda option: option.hits.bit_count()):
        if refused and option.hits.bit_count() >= min(len(other.blockers) for other in refused):
            break
        free = _connect(contact, option, ends, rng, config, blame=True)
        if isinstance(free, Unreachable):
            reasons.append(f"{option.line.name}: {free.reason}")
        elif isinstance(free, Obstruction):
            refused.append(free)
        else:
            return _composed(contact, option, free)
    if refused:
        return min(refused, key=lambda obstruction: (len(obstruction.blockers), sorted(obstruction.blockers)))
    return Unreachable("; ".join(dict.fromkeys(reasons)))


def _connect(
    contact: Contact,
    option: LineOption,
    ends: tuple[ArrayLike, ArrayLike],
    rng: np.random.Generator,
    config: RRTConfig,
    blame: bool,
) -> tuple[ArmPath, ArmPath] | Obstruction | Unreachable:
    """The free paths to and from a line, once the objects that it hits are gone."""
    ignore = contact.ignore | option.hits
    paths: list[ArmPath] = []
    blockers = set(contact.empty.scene.names_of(option.hits))
    for start, goal, is_loaded in _free_parts(option, ends):
        world, opening = (contact.loaded, contact.grip) if is_loaded else (contact.empty, contact.opening)
        held = contact.held if is_loaded else None
        path = plan_arm(
            world, contact.base, start, goal, opening, held, ignore, rng=rng, config=config, exact=True, blame=blame
        )
        if isinstance(path, Unreachable):
            return path
        if isinstance(path, Obstruction):
            blockers |= path.blockers
        else:
            paths.append(path)
    if blockers:
        return Obstruction(frozenset(blockers), option.phase if option.hits else "transit")
    return paths[0], paths[1]


def _free_parts(option: LineOption, ends: tuple[ArrayLike, ArrayLike]) -> Iterator[tuple[ArrayLike, ArrayLike, bool]]:
    """Start, goal, and whether the object is in hand, of both free paths."""
    yield ends[0], option.empty[-1], False
    yield option.loaded[-1], ends[1], True
