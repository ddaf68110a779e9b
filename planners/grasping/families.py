"""Families of grasps, as data, and the grasp sets of them that have names.

A grasp set is what a solve chooses grasps from, and what its minimum number of clearances is exact for. The paper's
experiments (Lee & Kim 2019) use level grasps alone.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import TypeAlias

from planners.scene import Body


class UnknownGraspSet(ValueError):
    """Neither the name of a grasp set nor families of grasps; the message lists the valid names."""


class InvalidGraspFamily(ValueError):
    """A family of grasps with a value out of range; the message says which."""


@dataclass(frozen=True)
class GraspFamily:
    """Grasps of a cylinder or a box that differ only in the direction they come from.

    A grasp set is a tuple of families; see `families_for`.

    The TCP is δ above the object's lowest point and ε short of its main axis (Fig. 5), as far as palm and fingertips
    permit. What is None is the robot's own.

    Example:
        steep = GraspFamily("steep", pitch=math.radians(70), depth=0.03, directions=36)
        solve(scene, "object_03", grasps=(SIDE, steep))

    Attributes:
        name: for messages.
        pitch: [rad] of the gripper; 0 is level, π/2 points straight down.
        directions: n of the paper: grasps of a round object, 360°/n apart. Half of them differ where the gripper points
            straight down.
        depth: [m] of the TCP below the object's highest point, in place of δ.
        height: δ [m], by default the robot's `grasp_height`.
        axis_offset: ε [m], by default the robot's `grasp_axis_offset`; more where the palm would touch the object.
            Straight down it is along the width of the pads, to either side, by default none: pads that are wider than
            the object then fit beside its neighbours.
        max_width: [m] between the fingers of what is grasped so, by default what the gripper spans.
        yaws: [rad] least and greatest yaw of the gripper in the world, from -π to π, for grippers that do not turn
            freely; any by default.
        shape: "cylinder" or "box", of the objects that are grasped so; both by default.

    Raises:
        InvalidGraspFamily: a value out of range, or both `depth` and `height`.
    """

    name: str
    pitch: float
    directions: int = 24
    depth: float | None = None
    height: float | None = None
    axis_offset: float | None = None
    max_width: float | None = None
    yaws: tuple[float, float] | None = None
    shape: str | None = None

    def __post_init__(self) -> None:
        lengths = {name: getattr(self, name) for name in ("depth", "height", "max_width")}
        wrong = [f"{name}={length!r}" for name, length in lengths.items() if length is not None and not length >= 0]
        if not 0 <= self.pitch <= math.pi / 2:
            wrong.append(f"pitch={self.pitch!r}")
        if self.directions < 1:
            wrong.append(f"directions={self.directions!r}")
        if self.axis_offset is not None and not math.isfinite(self.axis_offset):
            wrong.append(f"axis_offset={self.axis_offset!r}")
        if None not in (self.depth, self.height):
            wrong.append("depth together with height")
        if self.shape not in (None, "cylinder", "box"):
            wrong.append(f"shape={self.shape!r}")
        if wrong:
            raise InvalidGraspFamily(
                f"grasp family {self.name!r} has {', '.join(wrong)}; valid: pitch from 0 (level) to π/2 (down) rad, "
                "directions from 1, lengths from 0 m, depth or height, shape 'cylinder' or 'box'"
            )


@dataclass(frozen=True)
class AntipodalFamily:
    """Grasps across two opposite faces of an object of convex pieces: of a handle, a wall below the rim, a neck.

    Level lines are laid through the pieces. A grasp closes along such a line on what lies between two of its ends, if
    both normals there are within the friction cone of the line (force closure, Nguyen 1988), and the open gripper
    touches no piece.

    Example:
        rim = AntipodalFamily("rim", pitch=math.pi / 2, max_width=0.02)
        solve(scene, "bowl", grasps=(SIDE, TOP, rim))

    Attributes:
        name: for messages.
        pitch: [rad] of the gripper; 0 is level, π/2 points straight down.
        directions: of the lines, 360°/n apart; half of them differ where the gripper points straight down.
        friction: coefficient between pads and object, whose arctangent is the half angle of the cone.
        spacing: [m] between the lines through one piece at most; there are no more than seven beside each other.
        most: grasps for each direction; each holds other pieces, those nearest to the centre of mass come first.
        lever: [m] range of the distance between centre of mass and TCP, seen from above, by default any: the weight of
            an object that is held far from it turns it between the pads.
        max_width: [m] between the fingers of what is grasped so, by default what the gripper spans.
        hangs: of what does not stand, such as handles: the fingertips may reach below it.
        inset: [m] of the outermost lines from the ends of a piece, so that the pads find a face. An arm that comes less
            exactly to its grasp needs more.

    Raises:
        InvalidGraspFamily: a value out of range.
    """

    name: str
    pitch: float
    directions: int = 24
    friction: float = 0.3
    spacing: float = 0.02
    most: int = 3
    lever: tuple[float, float] = (0.0, math.inf)
    max_width: float | None = None
    hangs: bool = False
    inset: float = 0.006

    def __post_init__(self) -> None:
        wrong = [f"pitch={self.pitch!r}"] if not 0 <= self.pitch <= math.pi / 2 else []
        wrong += [f"{name}={getattr(self, name)!r}" for name in ("directions", "most") if getattr(self, name) < 1]
        wrong += [f"lever={self.lever!r}"] if not 0 <= self.lever[0] < self.lever[1] else []
        for name in ("friction", "spacing", "max_width", "inset"):
            value = getattr(self, name)
            wrong += [f"{name}={value!r}"] if value is not None and not value > 0 else []
        if wrong:
            raise InvalidGraspFamily(
                f"grasp family {self.name!r} has {', '.join(wrong)}; valid: pitch from 0 (level) to π/2 (down) rad, "
                "directions and most from 1, friction and lengths above 0"
            )


Family: TypeAlias = GraspFamily | AntipodalFamily


SIDE = GraspFamily("side", 0.0)
"""The paper's: a level gripper."""
_TILTED = {degrees: GraspFamily(f"tilted {degrees}°", math.radians(degrees), depth=0.02) for degrees in (20, 40, 60)}
TOP = GraspFamily("top", math.pi / 2, depth=0.02)
"""The gripper points straight down."""
_CENTRED = (SIDE, _TILTED[60], _TILTED[40], TOP, _TILTED[20])
_SHORT_OF = tuple(
    replace(family, name=f"{family.name}, 10 mm short of the axis", axis_offset=0.01) for family in (SIDE, _TILTED[60])
)
"""The fingertips of these reach less far past the object, so that they touch fewer of those behind it. More families
of this kind lowered the minimum in one of 290 scenes."""
_LEVERS = (0.0, 0.04, 0.1, math.inf)
"""[m] Antipodal grasps near the centre of mass come first."""


def _antipodal(*degrees: int) -> tuple[AntipodalFamily, ...]:
    """Families of these pitches, the nearest to the centre of mass first."""
    near_first = itertools.product(itertools.pairwise(_LEVERS), degrees)
    return tuple(
        AntipodalFamily(f"antipodal {pitch}°, {1000 * lever[0]:.0f} mm off", math.radians(pitch), lever=lever)
        for lever, pitch in near_first
    )


GRASP_SETS: Mapping[str, tuple[Family, ...]] = MappingProxyType(
    {
        "side": (SIDE, *_antipodal(0)),
        "tilted": (_TILTED[60], _TILTED[40], _TILTED[20], *_antipodal(60, 40, 20)),
        "top": (TOP, *_antipodal(90)),
        "all": (*_CENTRED, *_SHORT_OF, *_antipodal(0, 90, 60, 40, 20)),
    }
)
"""By name; the families of a set come in the order in which they are tried."""


Grasps: TypeAlias = str | Sequence[Family]
"""A grasp set: its name, or families."""


def find_grasp_set(grasps: Grasps) -> tuple[Family, ...]:
    """The families of a grasp set.

    Raises:
        UnknownGraspSet: neither the name of a set nor families; the message lists the valid names.
    """
    if isinstance(grasps, str) and grasps in GRASP_SETS:
        return GRASP_SETS[grasps]
    families: tuple[Family, ...] = ()
    if isinstance(grasps, Sequence) and not isinstance(grasps, str):
        families = tuple(grasps)
    if not families or not all(isinstance(family, Family) for family in families):
        raise UnknownGraspSet(
            f"no grasp set {grasps!r}; valid grasp sets: {', '.join(GRASP_SETS)}, or a tuple of GraspFamily and "
            "AntipodalFamily"
        )
    return families


def grasp_set_name(families: Sequence[Family]) -> str:
    """A grasp set in words: its name, or those of its families."""
    known = {tuple(some): repr(name) for name, some in GRASP_SETS.items()}
    set_first = (first for first in known if tuple(families[: len(first)]) == first)
    longest = max(set_first, key=len, default=())
    others = ", ".join(repr(family.name) for family in families[len(longest) :])
    return " and ".join(filter(None, (known.get(longest), f"families {others}" if others else "")))


def families_for(body: Body, families: Sequence[Family]) -> tuple[Family, ...]:
    """The families of a grasp set by which an object is grasped.

    Objects of several pieces are grasped by antipodal families. Cylinders and boxes are by the others, or, where a set
    has none of these, by antipodal ones too.
    """
    antipodal = tuple(family for family in families if isinstance(family, AntipodalFamily))
    centred = tuple(family for family in families if isinstance(family, GraspFamily))
    if body.shape == "pieces" or not centred:
        return antipodal
    return tuple(family for family in centred if family.shape in (None, body.shape))
