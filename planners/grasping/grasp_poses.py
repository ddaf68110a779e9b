"""Grasp poses around an object, by families (Lee & Kim 2019, section 3.3, Figs. 5 and 6).

A grasp set is what a solve chooses grasps from, and what its minimum number of clearances is exact for. The paper's
experiments use level grasps alone.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from types import MappingProxyType
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from assets.robots import RobotSpec
from planners.collision.world import FINGER_GAP
from planners.grasping.arm_configurations import gripper_arrays
from planners.scene import Body

_PALM_CLEARANCE, _PALM_SIDE, _TIP_CLEARANCE, _PAD_CLEARANCE = 0.003, 0.002, 0.0045, 0.0045
"""[m] that are kept before the palm, below the palm, beyond the fingertips and at the upper edge of the pads."""
_DECIMALS = 6
Array: TypeAlias = NDArray[np.float64]
_STRAIGHT_DOWN = 1e-6
"""Cosine of a pitch below which the gripper points straight down, and sine below which it is level."""


class UnknownGraspSet(ValueError):
    """Neither the name of a grasp set nor families of grasps; the message lists the valid names."""


class InvalidGraspFamily(ValueError):
    """A family of grasps with a value out of range; the message says which."""


@dataclass(frozen=True)
class GraspFamily:
    """Grasps that differ only in the direction they come from. A grasp set is a tuple of families.

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
        max_width: [m] between the fingers of what is grasped so, by default what the gripper spans.

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
        if wrong:
            raise InvalidGraspFamily(
                f"grasp family {self.name!r} has {', '.join(wrong)}; valid: pitch from 0 (level) to π/2 (down) rad, "
                "directions from 1, lengths from 0 m, depth or height"
            )


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
GRASP_SETS: Mapping[str, tuple[GraspFamily, ...]] = MappingProxyType(
    {
        "side": (SIDE,),
        "tilted": (_TILTED[60], _TILTED[40], _TILTED[20]),
        "top": (TOP,),
        "all": (*_CENTRED, *_SHORT_OF),
    }
)
"""By name; the families of a set come in the order in which they are tried."""


Grasps: TypeAlias = str | Sequence[GraspFamily]
"""A grasp set: its name, or families."""


def find_grasp_set(grasps: Grasps) -> tuple[GraspFamily, ...]:
    """The families of a grasp set.

    Raises:
        UnknownGraspSet: neither the name of a set nor families; the message lists the valid names.
    """
    if isinstance(grasps, str) and grasps in GRASP_SETS:
        return GRASP_SETS[grasps]
    families: tuple[GraspFamily, ...] = ()
    if isinstance(grasps, Sequence) and not isinstance(grasps, str):
        families = tuple(grasps)
    if not families or not all(isinstance(family, GraspFamily) for family in families):
        raise UnknownGraspSet(
            f"no grasp set {grasps!r}; valid grasp sets: {', '.join(GRASP_SETS)}, or a tuple of GraspFamily"
        )
    return families


def grasp_set_name(families: Sequence[GraspFamily]) -> str:
    """A grasp set in words: its name, or those of its families."""
    named = (repr(name) for name, known in GRASP_SETS.items() if known == tuple(families))
    return next(named, f"families {', '.join(repr(family.name) for family in families)}")


@dataclass(frozen=True)
class GripperClearances:
    """Lengths of the gripper that grasps depend on [m].

    Attributes:
        palm_reach: that the object may extend from the TCP towards the palm; Fetch's palm begins 47 mm behind.
        palm_height: from the approach axis to the palm's lower face, and 2 mm.
        fingertip_reach: that the fingers extend beyond the TCP, and 4.5 mm.
        pad_half_height: of a finger pad, which should not extend above the object.
        least_depth: of the TCP below the object's highest point, so that the pads hold it.
    """

    palm_reach: float
    palm_height: float
    fingertip_reach: float
    pad_half_height: float
    least_depth: float

    def above_support(self, pitch: float) -> float:
        """[m] of the TCP above the support at least, for fingertips and palm at a pitch [rad] to stay clear of it."""
        down, level = math.sin(pitch), math.cos(pitch)
        fingertips = self.fingertip_reach * down + self.pad_half_height * level
        return max(fingertips, self.palm_height * level - self.palm_reach * down)


@cache
def gripper_clearances(robot: RobotSpec) -> GripperClearances:
    """The lengths of a robot's gripper: of its fingers, and of the palm, the solid behind them that is foremost."""
    arrays = gripper_arrays(robot)  # in the TCP frame
    centre, extent = arrays.position, np.einsum("kij,kj->ki", np.abs(arrays.rotation), arrays.half)
    extent += arrays.radius[:, None]
    front = centre[:, 0] + extent[:, 0]
    fingers, others = np.flatnonzero(arrays.slides), np.flatnonzero(~arrays.slides)
    palm = others[front[others].argmax()]
    pad = float(extent[fingers, 2].max())
    lengths = (
        -float(front[palm]) - _PALM_CLEARANCE,
        float(abs(centre[palm, 2]) + extent[palm, 2]) + _PALM_SIDE,
        float(front[fingers].max()) + _TIP_CLEARANCE,
        pad,
        pad + _PAD_CLEARANCE,
    )
    return GripperClearances(*(round(length, _DECIMALS) for length in lengths))


@dataclass(frozen=True, eq=False)
class GraspPose:
    """A gripper pose around one object where it is now.

    Attributes:
        yaw: [rad] about the vertical.
        pitch: [rad] of the approach below the horizontal.
        T_world_tcp: (4, 4), Rz(yaw) Ry(pitch) and position; read-only.
        opening: [m] between the finger pads before they close.
    """

    yaw: float
    pitch: float
    T_world_tcp: Array
    opening: float

    def __post_init__(self) -> None:
        self.T_world_tcp.setflags(write=False)


def generate_grasps(body: Body, robot: RobotSpec, families: Sequence[GraspFamily] = (SIDE,)) -> tuple[GraspPose, ...]:
    """All grasps of an object, of some families, that fit between the fingers (section 3.3, Figs. 5 and 6).

    A cylinder that stands is grasped from all directions of a family, anything else across the faces that the fingers
    can span. δ (TCP above the object's lowest point) and ε (TCP short of its main axis) are adapted to objects too low
    or too long for palm and fingertips.
    """
    return tuple(
        GraspPose(float(yaw), family.pitch, _pose(body, robot, family, yaw), gripper_opening(robot, half))
        for family in families
        for yaw, half in zip(*_yaws(body, family), strict=True)
        if 2 * half < _widest(robot, family)
    )


def too_wide(body: Body, robot: RobotSpec, families: Sequence[GraspFamily]) -> str:
    """Why no grasp of some families fits around an object, "" if one does."""
    spans = [2 * float(half) for family in families for half in _yaws(body, family)[1]]
    widest = max(_widest(robot, family) for family in families)
    if any(2 * half < _widest(robot, family) for family in families for half in _yaws(body, family)[1]):
        return ""
    across = f"{body.name} is {1000 * min(spans):.0f} mm wide"
    if widest < robot.max_opening:
        return f"{across}, and the families of grasps take {1000 * widest:.0f} mm at most"
    return f"{across}, and the gripper opens {1000 * widest:.0f} mm"


def _widest(robot: RobotSpec, family: GraspFamily) -> float:
    """[m] Objects are grasped by the family if they are less wide."""
    return robot.max_opening if family.max_width is None else min(family.max_width, robot.max_opening)


def even_yaws(count: int) -> Array:
    """Yaws (count,) [rad] in (-π, π], evenly about the vertical: those from which round objects are grasped."""
    return wrap_to_pi(np.linspace(0.0, 2 * math.pi, count, endpoint=False))


def gripper_opening(robot: RobotSpec, half_span: float) -> float:
    """Opening [m] with which to approach an object that is 2 `half_span` wide between the fingers."""
    return min(2 * (float(half_span) + FINGER_GAP), robot.max_opening)


def _yaws(body: Body, family: GraspFamily) -> tuple[Array, Array]:
    """Yaws [rad] from which the object can be grasped, and its half width [m] between the fingers at each: (n,), (n,).

    The fingers close along the horizontal normal of the approach. Straight down, half a turn makes no difference.
    """
    if body.shape == "cylinder" and body.is_upright:
        yaws = even_yaws(family.directions)
        half_spans = np.full(len(yaws), body.half_width)
    else:
        rotation = body.rotation
        level_axes = np.delete(np.arange(3), np.abs(rotation[2]).argmax())
        if body.shape == "cylinder":
            level_axes = np.array([2])
        headings: Array = np.arctan2(rotation[1, level_axes], rotation[0, level_axes])
        yaws = wrap_to_pi(np.concatenate((headings, headings + math.pi)))
        across = np.stack((-np.sin(yaws), np.cos(yaws), np.zeros(len(yaws))), axis=-1)
        half_spans = np.array([body.half_extent_along(direction) for direction in across])
    count = len(yaws) // 2 if math.cos(family.pitch) < _STRAIGHT_DOWN else len(yaws)
    return yaws[:count], half_spans[:count]


def _pose(body: Body, robot: RobotSpec, family: GraspFamily, yaw: float) -> Array:
    """T_world_tcp (4, 4) of the grasp from one direction."""
    gripper, down, level = gripper_clearances(robot), math.sin(family.pitch), math.cos(family.pitch)
    heading = np.array((math.cos(yaw), math.sin(yaw), 0.0))
    approach = level * heading - np.array((0.0, 0.0, down))
    # Palm and centre must stay this far apart along the approach.
    behind = body.half_extent_along(approach) - gripper.palm_reach
    height = body.top - body.bottom
    if family.depth is not None:
        # Level, the palm is behind the object, however deep the fingers are.
        deepest = height / 2 - behind / down if down > _STRAIGHT_DOWN else math.inf
        delta = height - min(max(deepest, gripper.least_depth), max(family.depth, gripper.pad_half_height))
    else:
        delta = min(robot.grasp_height if family.height is None else family.height, height - gripper.pad_half_height)
        delta = delta if body.is_upright else min(delta, height / 2)
    delta = max(delta, gripper.above_support(family.pitch))
    epsilon = robot.grasp_axis_offset if family.axis_offset is None else family.axis_offset
    # Straight down no heading leads away from the axis.
    epsilon = max(epsilon, (behind - (delta - height / 2) * down) / level) if level > _STRAIGHT_DOWN else 0.0
    T = np.eye(4)
    T[:3, 0] = approach
    T[:3, 1] = (-heading[1], heading[0], 0.0)
    T[:3, 2] = (down * heading[0], down * heading[1], level)
    T[:3, 3] = body.position - epsilon * heading
    T[2, 3] = body.bottom + delta
    return T


def wrap_to_pi(angles: Array) -> Array:
    """Angles [rad] in (-π, π]."""
    return math.pi - np.mod(math.pi - angles, 2 * math.pi)
