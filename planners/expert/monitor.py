"""Measurement of the world during execution, and its comparison with the plan."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from types import MappingProxyType
from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from assets.robots import RobotSpec
from planners.expert.config import MonitorConfig
from planners.goals import height_below
from planners.motion.arm import tcp_pose
from planners.scene import Scene
from planners.scene.bodies import pose_matrix
from planners.scene.mujoco_reading import MovableBodies, RobotJoints, opening_joints
from planners.scene.robot_names import robot_prefix

Array = NDArray[np.float64]

_OFF_SUPPORT = 0.01
"""Height [m] above the support. A lower object may still stand on it."""
_BETWEEN_PADS = 0.01
"""Width [m] of the fingers' opening beyond the object at which they touch it, or are about to."""
_REACH = 0.02
"""Distance [m] of the TCP outside the object at which the object may be gripped at its edge."""


class DeviationKind(StrEnum):
    """Kinds of deviations of the world from the plan."""

    GRASP_MISSED = "grasp missed"
    NOT_OPENED = "not moved as far as planned"
    SLIPPED = "slipped in the gripper"
    TOPPLED = "toppled"
    OBJECT_MOVED = "moved"
    OBJECT_UNSURE = "not seen well enough"
    BASE_TRACKING_ERROR = "base tracking error"
    ARM_TRACKING_ERROR = "arm tracking error"


@dataclass(frozen=True)
class Deviation:
    """A difference between world and plan, and the object that it concerns ("" for the robot itself)."""

    kind: DeviationKind
    object: str = ""

    def __str__(self) -> str:
        return f"{self.object}: {self.kind}" if self.object else str(self.kind)


class Snapshot(NamedTuple):
    """Measurements of one control step.

    Objects: `positions` (n, 3) [m] of their centres, `uprightness` (n,) cosines of their tilts, `quaternions`
    (n, 4) wxyz.
    Robot: `T_world_tcp` (4, 4), `drive` (11,) whole-body configuration [m, rad]. `openings`: positions [m] or [rad] by
    the names of drawers and doors.
    """

    positions: Array
    uprightness: Array
    quaternions: Array
    T_world_tcp: Array
    drive: Array
    openings: Mapping[str, float] = MappingProxyType({})

    def in_hand(self, index: int) -> Array:
        """Centre (3,) [m] of an object in the TCP frame."""
        return np.asarray(self.T_world_tcp[:3, :3].T @ (self.positions[index] - self.T_world_tcp[:3, 3]))


class Sensor:
    """Exact sensor of a scene's movable objects and robot in a simulation, which it only reads.

    Heights are measured from the ground under the robot, as in the scene.
    """

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, robot: RobotSpec, names: Sequence[str]) -> None:
        """Look up the joints and bodies to read. Raises `SceneError` for a name that is no movable object."""
        self._data = data
        self._objects = MovableBodies.of(model, robot, names)
        self.names = self._objects.names
        self._joints = RobotJoints.of(model, data, robot)
        self._site = model.site(robot_prefix(model, robot) + robot.tcp_site).id
        self._ground = np.array((0.0, 0.0, self._joints.ground))
        joints = opening_joints(model, robot)
        self._openings = {name: int(model.jnt_qposadr[joint]) for name, joint in joints.items()}

    def read(self) -> Snapshot:
        """Present snapshot."""
        positions, quaternions = self._objects.poses(self._data)
        positions -= self._ground
        T = pose_matrix(self._data.site_xpos[self._site] - self._ground, self._data.site_xmat[self._site])
        _, x, y, _ = quaternions.T
        openings = {name: float(self._data.qpos[at]) for name, at in self._openings.items()}
        return Snapshot(positions, 1 - 2 * (x**2 + y**2), quaternions, T, self._joints.read(self._data), openings)


def turn_between(before: Array, after: Array) -> float:
    """Turn [rad] about the vertical from one orientation to another, quaternions (4,) wxyz.

    Unlike a difference of yaws, it is also defined for what lies with its own x axis upright.
    """
    w, x, y, z = before
    return 2.0 * math.remainder(math.atan2(after @ (-z, -y, x, w), after @ (w, x, y, z)), math.pi)


def object_moved(
    expected: Snapshot, now: Snapshot, names: tuple[str, ...], config: MonitorConfig, ignore: Collection[str] = ()
) -> Deviation | None:
    """Deviation for a toppled object, or for the object farthest from where the plan left it, if too far."""
    away = np.linalg.norm(now.positions - expected.positions, axis=1)
    toppled = (expected.uprightness > np.cos(config.tilt)) & (now.uprightness < np.cos(config.tilt))
    for name in ignore:
        away[names.index(name)] = 0.0
        toppled[names.index(name)] = False
    if toppled.any():
        return Deviation(DeviationKind.TOPPLED, names[int(toppled.argmax())])
    if away.size and away.max() > config.displacement:
        return Deviation(DeviationKind.OBJECT_MOVED, names[int(away.argmax())])
    return None


def tracking_error(wanted: Array, actual: Array, config: MonitorConfig) -> Deviation | None:
    """Deviation if base (first three joints) or arm are far from their commands: whole-body configurations (11,)."""
    error = np.abs(wanted - actual)
    if error[:3].max() > config.base:
        return Deviation(DeviationKind.BASE_TRACKING_ERROR)
    return Deviation(DeviationKind.ARM_TRACKING_ERROR) if error[3:].max() > config.arm else None


def held_object(scene: Scene) -> str:
    """Name of the object between closed fingers and off the support, "" for none.

    Args:
        scene: a scene without a held object, so that the finger position is the measured one.
    """
    T_world_tcp = tcp_pose(scene.robot, scene.state)
    gap = scene.robot.opening(scene.state.finger_position)
    for body in scene.objects:
        tcp_in_body = body.rotation.T @ (T_world_tcp[:3, 3] - body.position)
        is_around_tcp = bool((np.abs(tcp_in_body) < body.half_extents + _REACH).all())
        is_gripped = gap < body.width_in_gripper(np.linalg.inv(T_world_tcp) @ body.pose) + _BETWEEN_PADS
        if is_around_tcp and is_gripped and body.bottom > height_below(scene, body) + _OFF_SUPPORT:
            return body.name
    return ""
