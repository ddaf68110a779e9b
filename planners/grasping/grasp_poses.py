"""Grasp poses around an object (Lee & Kim 2019, section 3.3, Figs. 5 and 6)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from assets.robots import RobotSpec
from planners.grasping.families import SIDE, GraspFamily
from planners.grasping.gripper import FINGER_GAP, GripperClearances, gripper_clearances
from planners.scene import Body

Array: TypeAlias = NDArray[np.float64]

_STRAIGHT_DOWN = 1e-6
"""Cosine of a pitch below which the gripper points straight down."""


@dataclass(frozen=True, eq=False)
class GraspPose:
    """One way to grasp one object where it is now.

    Attributes:
        object: its name.
        yaw: [rad] about the vertical.
        pitch: [rad] of the approach below the horizontal.
        T_world_tcp: (4, 4), Rz(yaw) Ry(pitch) and position; read-only.
        opening: [m] between the finger pads before they close.
    """

    object: str
    yaw: float
    pitch: float
    T_world_tcp: Array
    opening: float

    def __post_init__(self) -> None:
        self.T_world_tcp.setflags(write=False)


def generate_grasps(
    body: Body,
    robot: RobotSpec,
    families: Sequence[GraspFamily] = (SIDE,),
) -> tuple[GraspPose, ...]:
    """All grasps of an object, of some families, that fit between the fingers (section 3.3, Figs. 5 and 6).

    A cylinder that stands is grasped from all directions of a family, anything else across the faces that the fingers
    can span. δ (TCP above the object's lowest point) and ε (TCP short of its main axis) are adapted to objects too low
    or too long for palm and fingertips.
    """
    return tuple(grasp for family in families for grasp in _of_family(body, robot, family))


def even_yaws(count: int) -> Array:
    """Yaws (count,) [rad] in (-π, π], evenly about the vertical: those from which round objects are grasped."""
    return _wrapped(np.linspace(0.0, 2 * math.pi, count, endpoint=False))


def gripper_opening(robot: RobotSpec, half_span: float) -> float:
    """Opening [m] with which to approach an object that is 2 `half_span` wide between the fingers."""
    return min(2 * (float(half_span) + FINGER_GAP), robot.max_opening)


def _of_family(body: Body, robot: RobotSpec, family: GraspFamily) -> list[GraspPose]:
    gripper = gripper_clearances(robot)
    yaws, half_spans = _yaws(body, family)
    return [
        GraspPose(
            body.name, float(yaw), family.pitch, _pose(body, robot, family, gripper, yaw), gripper_opening(robot, half)
        )
        for yaw, half in zip(yaws, half_spans, strict=True)
        if 2 * half < robot.max_opening
    ]


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
        yaws = _wrapped(np.concatenate((headings, headings + math.pi)))
        across = np.stack((-np.sin(yaws), np.cos(yaws), np.zeros(len(yaws))), axis=-1)
        half_spans = np.array([body.half_extent_along(direction) for direction in across])
    count = len(yaws) // 2 if math.cos(family.pitch) < _STRAIGHT_DOWN else len(yaws)
    return yaws[:count], half_spans[:count]


def _pose(body: Body, robot: RobotSpec, family: GraspFamily, gripper: GripperClearances, yaw: float) -> Array:
    """T_world_tcp (4, 4) of the grasp from one direction."""
    down, level = math.sin(family.pitch), math.cos(family.pitch)
    heading = np.array((math.cos(yaw), math.sin(yaw), 0.0))
    approach = level * heading - np.array((0.0, 0.0, down))
    behind = body.half_extent_along(approach) - gripper.palm_reach
    height = body.top - body.bottom
    delta = max(_delta(body, robot, family, gripper, behind), gripper.above_support(family.pitch))
    epsilon = robot.grasp_axis_offset
    if level > _STRAIGHT_DOWN:
        epsilon = max(epsilon, (behind - (delta - height / 2) * down) / level)
    T = np.eye(4)
    T[:3, 0] = approach
    T[:3, 1] = (-heading[1], heading[0], 0.0)
    T[:3, 2] = (down * heading[0], down * heading[1], level)
    T[:3, 3] = body.position - epsilon * heading
    T[2, 3] = body.bottom + delta
    return T


def _delta(body: Body, robot: RobotSpec, family: GraspFamily, gripper: GripperClearances, behind: float) -> float:
    """δ [m] of a grasp; `behind` [m] is how far palm and centre must stay apart along the approach."""
    height = body.top - body.bottom
    if family.depth is None:
        delta = min(robot.grasp_height, height - gripper.pad_half_height)
        return delta if body.is_upright else min(delta, height / 2)
    deepest = height / 2 - behind / math.sin(family.pitch)
    return height - min(max(deepest, gripper.least_depth), family.depth)


def _wrapped(angles: Array) -> Array:
    """Angles [rad] in (-π, π]."""
    return math.pi - np.mod(math.pi - angles, 2 * math.pi)
