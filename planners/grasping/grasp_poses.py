"""Grasp poses around an object (Lee & Kim 2019, section 3.3, Figs. 5 and 6)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from assets.robots import RobotSpec
from planners.scene import Body

__all__ = [
    "GraspConfig",
    "GraspKind",
    "GraspPose",
    "UnknownGraspKindError",
    "generate_grasps",
    "grasp_after_move",
    "gripper_opening",
]

Array: TypeAlias = NDArray[np.float64]
GraspKind: TypeAlias = Literal["side", "top"]


_PITCH = {"side": 0.0, "top": math.pi / 2}


class UnknownGraspKindError(ValueError):
    """There is no such kind of grasp; the message lists the valid ones."""


@dataclass(frozen=True)
class GraspConfig:
    """Which grasps to generate.

    Attributes:
        kinds: "side", "top" or both, in order of preference.
        directions: n of the paper: grasps of a round object, 360°/n apart.
        first_yaw: [rad] of the first of them.
        finger_gap: [m] between each finger and the object before the fingers close.
        palm_reach: [m] that the object may extend from the TCP towards the palm; Fetch's palm begins 47 mm behind.
        palm_height: [m] of a level gripper's TCP above the support at least; half of Fetch's palm and 2 mm.
        fingertip_reach: [m] that the fingers extend beyond the TCP, and 4 mm.
        pad_half_height: [m] of a finger pad, which should not extend above the object.
    """

    kinds: tuple[GraspKind, ...] = ("side",)
    directions: int = 6
    first_yaw: float = 0.0
    finger_gap: float = 0.012
    palm_reach: float = 0.045
    palm_height: float = 0.042
    fingertip_reach: float = 0.028
    pad_half_height: float = 0.0135


@dataclass(frozen=True, eq=False)
class GraspPose:
    """One way to grasp one object where it is now.

    Attributes:
        object: its name.
        yaw: [rad] of the approach about the vertical; for a top grasp, of the gripper's z axis.
        pitch: [rad] of the approach below the horizontal.
        kind: "side" (level gripper) or "top" (gripper pointing down).
        T_world_tcp: (4, 4), Rz(yaw) Ry(pitch) and position; read-only.
        opening: [m] between the finger pads before they close.
    """

    object: str
    yaw: float
    pitch: float
    kind: GraspKind
    T_world_tcp: Array
    opening: float

    def __post_init__(self) -> None:
        self.T_world_tcp.setflags(write=False)


def generate_grasps(body: Body, robot: RobotSpec, config: GraspConfig | None = None) -> tuple[GraspPose, ...]:
    """All grasps of an object that fit between the fingers (section 3.3, Figs. 5 and 6).

    A cylinder that stands is grasped from `directions` yaws, anything else across the faces that the fingers can span.
    δ (TCP above the object's lowest point) and ε (TCP short of its main axis) are the robot's, δ adapted to objects
    too low for it and ε to objects too long for the palm.

    Raises:
        UnknownGraspKindError: a kind in `config.kinds` that does not exist.
    """
    config = config or GraspConfig()
    makers = {"side": _side_poses, "top": _top_poses}
    grasps: list[GraspPose] = []
    for kind in config.kinds:
        if kind not in makers:
            raise UnknownGraspKindError(f"no grasp kind {kind!r}; valid kinds: {', '.join(makers)}")
        yaws, half_spans = _yaws(body, config)
        fits = 2 * half_spans < robot.max_opening
        yaws, half_spans = yaws[fits], half_spans[fits]
        poses = makers[kind](body, robot, config, yaws)
        grasps += [
            GraspPose(body.name, float(yaw), _PITCH[kind], kind, pose, gripper_opening(robot, half_span, config))
            for yaw, half_span, pose in zip(yaws, half_spans, poses, strict=True)
        ]
    return tuple(grasps)


def gripper_opening(robot: RobotSpec, half_span: float, config: GraspConfig | None = None) -> float:
    """Opening [m] with which to approach an object that is 2 `half_span` wide between the fingers."""
    return min(2 * (float(half_span) + (config or GraspConfig()).finger_gap), robot.max_opening)


def grasp_after_move(grasp: GraspPose, T_world_before: Array, T_world_after: Array) -> GraspPose:
    """The same grasp of the object once it has moved from one pose (4, 4) to another."""
    T_object_tcp = np.linalg.solve(T_world_before, grasp.T_world_tcp)
    T_world_tcp = T_world_after @ T_object_tcp
    pointing = T_world_tcp[:2, 0] if grasp.kind == "side" else T_world_tcp[:2, 2]
    yaw = math.atan2(pointing[1], pointing[0])
    return GraspPose(grasp.object, yaw, grasp.pitch, grasp.kind, T_world_tcp, grasp.opening)


def _yaws(body: Body, config: GraspConfig) -> tuple[Array, Array]:
    """Yaws [rad] from which the object can be grasped, and its half width [m] between the fingers at each: (n,), (n,).

    The fingers close along the horizontal normal of the approach.
    """
    if body.shape == "cylinder" and body.is_upright:
        steps = np.linspace(0.0, 2 * math.pi, config.directions, endpoint=False)
        yaws = _wrapped(config.first_yaw + steps)
        return yaws, np.full(len(yaws), body.half_width)
    rotation = body.rotation
    level_axes = np.delete(np.arange(3), np.abs(rotation[2]).argmax())
    if body.shape == "cylinder":
        level_axes = np.array([2])
    headings: Array = np.arctan2(rotation[1, level_axes], rotation[0, level_axes])
    yaws = _wrapped(np.concatenate((headings, headings + math.pi)))
    across = np.stack((-np.sin(yaws), np.cos(yaws), np.zeros(len(yaws))), axis=-1)
    return yaws, np.array([body.half_extent_along(direction) for direction in across])


def _side_poses(body: Body, robot: RobotSpec, config: GraspConfig, yaws: Array) -> Array:
    """T_world_tcp (n, 4, 4) of a level gripper."""
    height = body.top - body.bottom
    delta = min(robot.grasp_height, height - config.pad_half_height)
    if not body.is_upright:
        delta = min(delta, height / 2)
    delta = max(delta, config.palm_height)
    approach = np.stack((np.cos(yaws), np.sin(yaws), np.zeros(len(yaws))), axis=-1)
    depth = np.array([body.half_extent_along(direction) for direction in approach])
    epsilon = np.maximum(robot.grasp_axis_offset, depth - config.palm_reach)
    poses = np.tile(np.eye(4), (len(yaws), 1, 1))
    poses[:, :3, 0] = approach
    poses[:, :3, 1] = np.stack((-approach[:, 1], approach[:, 0], np.zeros(len(yaws))), axis=-1)
    poses[:, :3, 3] = body.position - epsilon[:, None] * approach
    poses[:, 2, 3] = body.bottom + delta
    return poses


def _top_poses(body: Body, _robot: RobotSpec, config: GraspConfig, yaws: Array) -> Array:
    """T_world_tcp (n, 4, 4) of a gripper pointing down, as deep as palm and fingertips allow."""
    delta = max(body.top - body.bottom - config.palm_reach, config.fingertip_reach)
    poses = np.tile(np.eye(4), (len(yaws), 1, 1))
    poses[:, :3, 0] = (0.0, 0.0, -1.0)
    poses[:, :3, 1] = np.stack((-np.sin(yaws), np.cos(yaws), np.zeros(len(yaws))), axis=-1)
    poses[:, :3, 2] = np.stack((np.cos(yaws), np.sin(yaws), np.zeros(len(yaws))), axis=-1)
    poses[:, :3, 3] = body.position
    poses[:, 2, 3] = body.bottom + delta
    return poses


def _wrapped(angles: Array) -> Array:
    """Angles [rad] in (-π, π]."""
    return math.pi - np.mod(math.pi - angles, 2 * math.pi)
