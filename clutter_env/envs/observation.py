"""What the agent sees: vectors relative to the robot's base, all finite and bounded, without any image."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import NamedTuple

import mujoco
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from clutter_env.scene.layout import TableScene
from clutter_env.simulation.world import Measurements, World

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

_0, _1, _C, _S, _MS, _HC, _HS, _MHS = range(8)
_TURN = np.array(
    [
        (_C, _MS, _0, _0, _0, _0, _0),
        (_S, _C, _0, _0, _0, _0, _0),
        (_0, _0, _1, _0, _0, _0, _0),
        (_0, _0, _0, _HC, _0, _0, _MHS),
        (_0, _0, _0, _0, _HC, _MHS, _0),
        (_0, _0, _0, _0, _HS, _HC, _0),
        (_0, _0, _0, _HS, _0, _0, _HC),
    ]
)
"""Which of 0, 1, cos yaw, sin yaw, -sin yaw, cos yaw/2, sin yaw/2, -sin yaw/2 stands where in `_poses_in_base`."""

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
        self._constant = np.zeros_like(self._bounds)
        self._constant_scene: TableScene | None = None
        edges = np.cumsum([0, *self._sizes.values()]).tolist()
        self._slices = {name: slice(*edge) for name, edge in zip(self._sizes, pairwise(edges), strict=True)}

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
        bounds = {name: self.bounds[place] for name, place in self._slices.items()}
        return spaces.Dict({name: spaces.Box(-bound, bound, dtype=np.float32) for name, bound in bounds.items()})

    def observe(
        self, world: World, measurements: Measurements, target: int, hold_progress: float, lift_left: float
    ) -> Observation:
        """The observation after a step; every call makes new arrays.

        Args:
            world: the world, its kinematics settled.
            measurements: its measurements.
            target: the target's slot.
            hold_progress: share of the holding time that success needs, 0 to 1.
            lift_left: height [m] by which the target must still rise.
        """
        frame = base_frame(world)
        poses = _poses_in_base(frame, np.concatenate((_tcp_pose(world), measurements.poses)))
        flat = self._constant_part(world, target).copy()
        _fill_robot(flat[self._slices["robot"]], world, frame)
        flat[self._slices["tcp"]] = poses[0]
        _fill_gripper(flat[self._slices["gripper"]], world)
        if self._shows_objects:
            rows = flat[self._slices["objects"]].reshape(self._num_slots, len(OBJECT_FIELDS))
            rows[: len(measurements.poses), 2:9] = poses[1:]
            if measurements.held >= 0:
                rows[measurements.held, 13] = 1.0
        if self._shows_goal:
            goal = flat[self._slices["goal"]]
            goal[:3] = poses[1 + target, :3] - poses[0, :3]
            goal[3:] = lift_left, hold_progress
        np.minimum(np.maximum(flat, -self._bounds, out=flat), self._bounds, out=flat)
        small = flat.astype(np.float32)
        return {name: small[place] for name, place in self._slices.items()}

    def _constant_part(self, world: World, target: int) -> Vector:
        """The numbers that stay the same for a whole episode, zeros elsewhere; computed once for each scene."""
        assert world.scene is not None
        if world.scene is not self._constant_scene:
            self._constant = np.zeros_like(self._bounds)
            self._constant_scene = world.scene
            if self._shows_objects:
                rows = self._constant[self._slices["objects"]].reshape(self._num_slots, len(OBJECT_FIELDS))
                _fill_constant_columns(rows, world.scene, target)
        return self._constant


def _object_row_bounds() -> list[float]:
    return [1.0, 1.0, *[POSITION_BOUND] * 3, *[1.0] * 4, *[1.0] * 3, 1.0, 1.0]


def _fill_robot(out: Vector, world: World, frame: BaseFrame) -> None:
    """x, y, sin yaw, cos yaw, torso and arm positions, velocities (base part in the base's frame)."""
    q = world.data.qpos[world.index.drive_qpos]
    qd = world.data.qvel[world.index.drive_dof]
    forward, sideways = float(qd[0]), float(qd[1])
    out[:4] = frame.x, frame.y, frame.sine, frame.cosine
    velocities = out[1 + len(q) :]
    out[4 : 1 + len(q)] = q[3:]
    velocities[:] = qd
    velocities[0] = frame.cosine * forward + frame.sine * sideways
    velocities[1] = frame.cosine * sideways - frame.sine * forward


def _fill_gripper(out: Vector, world: World) -> None:
    """[m] between the pads: as it is, and as commanded."""
    gap = world.robot.finger_gap_closed
    fingers = world.data.qpos[world.index.finger_qpos]
    out[:] = float(fingers[0] + fingers[1]) + gap, 2 * world.controller.state.finger + gap


def _fill_constant_columns(rows: Vector, scene: TableScene, target: int) -> None:
    """Presence, target, size and shape of the objects; rows (num_slots, 14) of absent ones stay zero."""
    present = rows[: scene.num_objects]
    present[:, 0] = 1.0
    if target >= 0:
        present[target, 1] = 1.0
    present[:, 9:12] = scene.half_extents
    present[:, 12] = scene.is_box


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
    turn = np.array((0.0, 1.0, c, s, -s, hc, hs, -hs))[_TURN]
    relative: Vector = poses @ turn
    relative[:, 0] -= c * frame.x + s * frame.y
    relative[:, 1] -= c * frame.y - s * frame.x
    relative[:, 3:] *= np.copysign(1.0, relative[:, 3:4])
    return relative
