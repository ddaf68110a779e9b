"""What the agent sees: vectors relative to the robot's base, all finite and bounded, without any image."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

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
    """Makes the vectors of an observation: "robot", "tcp", "gripper" and, where wanted, "objects" and "goal"."""

    def __init__(self, world: World, num_slots: int, shows_objects: bool, shows_goal: bool) -> None:
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
            self._sizes["objects"] = num_slots * len(OBJECT_FIELDS)
            bounds += _object_row_bounds() * num_slots
        if shows_goal:
            self._sizes["goal"] = 5
            bounds += [POSITION_BOUND] * 4 + [1.0]
        self._shows_objects, self._shows_goal = shows_objects, shows_goal
        self._bounds = np.array(bounds)
        self._edges = np.cumsum([0, *self._sizes.values()])

    @property
    def names(self) -> tuple[str, ...]:
        """The entries of an observation, in order."""
        return tuple(self._sizes)

    @property
    def bounds(self) -> NDArray[np.float32]:
        """What no number of an observation exceeds; all entries, one after the other."""
        return self._bounds.astype(np.float32)

    @property
    def space(self) -> spaces.Dict:
        """One symmetric Box of float32 per entry."""
        parts: dict[str, spaces.Space[Any]] = {}
        for (name, size), start in zip(self._sizes.items(), self._edges, strict=False):
            bound = self.bounds[start : start + size]
            parts[name] = spaces.Box(-bound, bound, dtype=np.float32)
        return spaces.Dict(parts)

    def observe(
        self, world: World, seen: Measurements, target: int, hold_progress: float, lift_left: float
    ) -> Observation:
        """The observation after a step; every call makes new arrays.

        Args:
            world: the world, its kinematics settled.
            seen: its measurements.
            target: the target's slot.
            hold_progress: share of the holding time that success needs, 0 to 1.
            lift_left: height [m] by which the target must still rise.
        """
        frame = base_frame(world)
        poses = _poses_in_base(frame, np.concatenate((_tcp_pose(world), seen.poses)))
        tcp = poses[0]
        parts = [_robot_vector(world, frame), tcp, _gripper_vector(world)]
        if self._shows_objects:
            rows = self._object_rows(world, seen, target, poses[1:])
            parts.append(rows.ravel())
        if self._shows_goal:
            parts += [poses[1 + target, :3] - tcp[:3], (lift_left, hold_progress)]
        flat = np.concatenate(parts)
        flat = np.minimum(np.maximum(flat, -self._bounds), self._bounds).astype(np.float32)
        return {
            name: flat[start : start + size].copy()
            for (name, size), start in zip(self._sizes.items(), self._edges, strict=False)
        }

    def _object_rows(self, world: World, seen: Measurements, target: int, poses: Vector) -> Vector:
        """(num_slots, 14); rows of absent objects are zero."""
        scene = world.scene
        assert scene is not None
        rows = np.zeros((self._num_slots, len(OBJECT_FIELDS)))
        present = rows[: scene.num_objects]
        present[:, 0] = 1.0
        if target >= 0:
            present[target, 1] = 1.0
        present[:, 2:9] = poses
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


def _tcp_pose(world: World) -> Vector:
    """Position [m] and quaternion of the TCP in the world, (1, 7)."""
    pose = np.empty((1, 7))
    pose[0, :3] = world.data.site_xpos[world.index.tcp_site]
    mujoco.mju_mat2Quat(pose[0, 3:], world.data.site_xmat[world.index.tcp_site])
    return pose


def _poses_in_base(frame: BaseFrame, poses: Vector) -> Vector:
    """World poses (n, 7) relative to the base, (n, 7); quaternions get w >= 0.

    A pose is linear in position and quaternion: one product turns both, by the yaw and by half of it.
    """
    c, s, hc, hs = frame.cosine, frame.sine, frame.half_cosine, frame.half_sine
    turn = np.array(
        [
            (c, -s, 0, 0, 0, 0, 0),
            (s, c, 0, 0, 0, 0, 0),
            (0, 0, 1, 0, 0, 0, 0),
            (0, 0, 0, hc, 0, 0, -hs),
            (0, 0, 0, 0, hc, -hs, 0),
            (0, 0, 0, 0, hs, hc, 0),
            (0, 0, 0, hs, 0, 0, hc),
        ]
    )
    relative: Vector = poses @ turn
    relative[:, 0] -= c * frame.x + s * frame.y
    relative[:, 1] -= c * frame.y - s * frame.x
    relative[:, 3:] *= np.where(relative[:, 3:4] < 0, -1.0, 1.0)
    return relative
