"""What the agent sees: vectors relative to the robot's base, all finite and bounded, without any image."""

from __future__ import annotations

import math
from typing import NamedTuple

import mujoco
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from clutter_env.world import Measurements, World

__all__ = ["OBJECT_FIELDS", "BaseFrame", "Observer", "base_frame"]

POSITION_BOUND = 16.0
"""[m] Clip of relative positions; the arena's diagonal is shorter."""
JOINT_BOUND = 8.0
"""[rad], [m] Clip of joint positions; wider than every joint's range."""
VELOCITY_BOUND = 16.0
"""[m/s], [rad/s] Clip of measured velocities; ordinary ones are a tenth of it."""

OBJECT_FIELDS = (
    "present", "is_target", "x", "y", "z", "qw", "qx", "qy", "qz", "half_x", "half_y", "half_z", "is_box", "held",
)  # fmt: skip
"""Columns of one object's row; a cylinder's half extents are radius, radius, half height."""

Vector = NDArray[np.float64]
Observation = dict[str, NDArray[np.float32]]


class BaseFrame(NamedTuple):
    """The robot's base on the floor: x, y [m], cosine and sine of its yaw and of half of it."""

    x: float
    y: float
    cosine: float
    sine: float
    half_cosine: float
    half_sine: float


def base_frame(world: World) -> BaseFrame:
    """Where the base is now."""
    x, y, yaw = (float(value) for value in world.data.qpos[world.index.drive_qpos[:3]])
    return BaseFrame(x, y, math.cos(yaw), math.sin(yaw), math.cos(yaw / 2), math.sin(yaw / 2))


class Observer:
    """Makes the vectors of an observation: "robot", "tcp", "gripper" and, with objects, "objects" and "goal"."""

    def __init__(self, world: World, num_slots: int, shows_objects: bool = True) -> None:
        joints = len(world.robot.drive_joints)
        self._num_slots = num_slots
        self._sizes = {"robot": 4 + (joints - 3) + joints, "tcp": 7, "gripper": 2}
        bounds = [
            *(POSITION_BOUND, POSITION_BOUND, 1.0, 1.0),
            *([JOINT_BOUND] * (joints - 3)),
            *([VELOCITY_BOUND] * joints),
            *([POSITION_BOUND] * 3 + [1.0] * 4),
            *(1.0, 1.0),
        ]
        if shows_objects:
            self._sizes |= {"objects": num_slots * len(OBJECT_FIELDS), "goal": 5}
            bounds += [*_object_row_bounds() * num_slots, *([POSITION_BOUND] * 4 + [1.0])]
        self._shows_objects = shows_objects
        self._bounds = np.array(bounds)
        self._edges = np.cumsum([0, *self._sizes.values()])

    @property
    def space(self) -> spaces.Dict:
        """One symmetric Box of float32 per entry."""
        parts = {}
        for (name, size), start in zip(self._sizes.items(), self._edges, strict=False):
            bound = self._bounds[start : start + size].astype(np.float32)
            parts[name] = spaces.Box(-bound, bound, dtype=np.float32)
        return spaces.Dict(parts)

    def observe(self, world: World, seen: Measurements, target: int, hold_progress: float, lift_left: float) -> Observation:
        """The observation after a step; every call makes new arrays.

        Args:
            world: the world, its kinematics settled.
            seen: its measurements.
            target: the target's slot.
            hold_progress: share of the holding time that success needs, 0 to 1.
            lift_left: height [m] by which the target must still rise.
        """
        frame = base_frame(world)
        tcp = _tcp_in_base(world, frame)
        parts = [_robot_vector(world, frame), tcp, _gripper_vector(world)]
        if self._shows_objects:
            rows = self._object_rows(world, frame, seen, target)
            parts += [rows.ravel(), rows[target, 2:5] - tcp[:3], (lift_left, hold_progress)]
        flat = np.concatenate(parts)
        flat = np.clip(flat, -self._bounds, self._bounds, out=flat).astype(np.float32)
        return {
            name: flat[start : start + size].copy()
            for (name, size), start in zip(self._sizes.items(), self._edges, strict=False)
        }

    def _object_rows(self, world: World, frame: BaseFrame, seen: Measurements, target: int) -> Vector:
        """(num_slots, 14); rows of absent objects are zero."""
        scene = world.scene
        assert scene is not None
        rows = np.zeros((self._num_slots, len(OBJECT_FIELDS)))
        present = rows[: scene.num_objects]
        present[:, 0] = 1.0
        present[target, 1] = 1.0
        _poses_in_base(frame, seen.poses, present[:, 2:9])
        present[:, 9:12] = scene.half_extents
        present[:, 12] = scene.is_box
        if seen.held >= 0:
            present[seen.held, 13] = 1.0
        return rows


def _object_row_bounds() -> list[float]:
    return [1.0, 1.0, *[POSITION_BOUND] * 3, *[1.0] * 4, *[1.0] * 3, 1.0, 1.0]


def _robot_vector(world: World, frame: BaseFrame) -> Vector:
    """x, y, sin yaw, cos yaw, torso and arm positions, velocities (base part in the base's frame)."""
    q = world.data.qpos[world.index.drive_qpos]
    qd = world.data.qvel[world.index.drive_dof]
    forward = frame.cosine * qd[0] + frame.sine * qd[1]
    sideways = frame.cosine * qd[1] - frame.sine * qd[0]
    return np.concatenate(((frame.x, frame.y, frame.sine, frame.cosine), q[3:], (forward, sideways), qd[2:]))


def _gripper_vector(world: World) -> tuple[float, float]:
    """[m] between the pads: as it is, and as commanded."""
    gap = world.robot.finger_gap_closed
    fingers = world.data.qpos[world.index.finger_qpos]
    return float(fingers[0] + fingers[1]) + gap, 2 * world.controller.state.finger + gap


def _tcp_in_base(world: World, frame: BaseFrame) -> Vector:
    """Position [m] and quaternion of the TCP in the base frame, (7,)."""
    pose = np.empty((1, 7))
    pose[0, :3] = world.data.site_xpos[world.index.tcp_site]
    mujoco.mju_mat2Quat(pose[0, 3:], world.data.site_xmat[world.index.tcp_site])
    out = np.empty((1, 7))
    _poses_in_base(frame, pose, out)
    return out[0]


def _poses_in_base(frame: BaseFrame, poses: Vector, out: Vector) -> None:
    """Write world poses (n, 7) relative to the base into `out` (n, 7); quaternions get w >= 0."""
    dx, dy = poses[:, 0] - frame.x, poses[:, 1] - frame.y
    out[:, 0] = frame.cosine * dx + frame.sine * dy
    out[:, 1] = frame.cosine * dy - frame.sine * dx
    out[:, 2] = poses[:, 2]
    cosine, sine = frame.half_cosine, frame.half_sine
    w, x, y, z = poses[:, 3], poses[:, 4], poses[:, 5], poses[:, 6]
    out[:, 3] = cosine * w + sine * z
    out[:, 4] = cosine * x + sine * y
    out[:, 5] = cosine * y - sine * x
    out[:, 6] = cosine * z - sine * w
    out[:, 3:] *= np.where(out[:, 3:4] < 0, -1.0, 1.0)
