"""Monitoring of an execution: comparison of the measured world with the world that the plan expects."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, fields
from enum import StrEnum
from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from assets.robots import RobotSpec
from planners.execution.errors import check_number
from planners.scene.mujoco_reading import MovableBodies, RobotJoints

__all__ = [
    "Deviation",
    "DeviationKind",
    "MonitorConfig",
    "Sensor",
    "Snapshot",
    "object_moved",
    "object_slipped",
    "tracking_error",
]

Array = NDArray[np.float64]


class DeviationKind(StrEnum):
    """How the world can deviate from the plan."""

    GRASP_MISSED = "grasp missed"
    SLIPPED = "slipped in the gripper"
    TOPPLED = "toppled"
    OBJECT_MOVED = "moved"
    BASE_TRACKING_ERROR = "base tracking error"
    ARM_TRACKING_ERROR = "arm tracking error"


@dataclass(frozen=True)
class Deviation:
    """A difference between world and plan, and the object that it concerns ("" for the robot itself)."""

    kind: DeviationKind
    object: str = ""

    def __str__(self) -> str:
        return f"{self.object}: {self.kind}" if self.object else str(self.kind)


@dataclass(frozen=True)
class MonitorConfig:
    """Tolerances: larger differences between world and plan are deviations.

    Attributes:
        displacement: [m] motion of an object that no action moves.
        tilt: [rad] tilt of an object that should stand.
        slip: [m] motion of a held object in the TCP frame.
        base: [m] and [rad] tracking error of a base joint.
        arm: [m] and [rad] tracking error of torso or arm joint.

    Raises:
        ExpertError: a value that is not a number of at least 0.
    """

    displacement: float = 0.015
    tilt: float = 0.25
    slip: float = 0.02
    base: float = 0.08
    arm: float = 0.12

    def __post_init__(self) -> None:
        for entry in fields(self):
            check_number(entry.name, getattr(self, entry.name), allow_infinity=True)


class Snapshot(NamedTuple):
    """What is measured every control step.

    `positions` (n, 3) [m] of the object centres, `uprightness` (n,) cosines of their tilts, `T_world_tcp` (4, 4),
    `drive` (11,) whole-body configuration [m, rad].
    """

    positions: Array
    uprightness: Array
    T_world_tcp: Array
    drive: Array

    def in_hand(self, index: int) -> Array:
        """(3,) [m] centre of an object in the TCP frame."""
        return np.asarray(self.T_world_tcp[:3, :3].T @ (self.positions[index] - self.T_world_tcp[:3, 3]))


class Sensor:
    """Reads snapshots of a scene's movable objects and robot from a simulation, exactly; it writes nothing."""

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, robot: RobotSpec, names: Sequence[str]) -> None:
        """Look up what to read.

        Args:
            model, data: the simulation.
            robot: which robot it is.
            names: of the movable objects, `Scene.names`.

        Raises:
            SceneError: a name that is no movable object.
        """
        self._data = data
        self._objects = MovableBodies.of(model, robot, names)
        self.names = self._objects.names
        self._joints = RobotJoints.of(model, data, robot)
        self._site = model.site(robot.tcp_site).id

    def read(self) -> Snapshot:
        """The present state."""
        positions, quaternions = self._objects.poses(self._data)
        T = np.eye(4)
        T[:3, :3] = self._data.site_xmat[self._site].reshape(3, 3)
        T[:3, 3] = self._data.site_xpos[self._site]
        uprightness = 1 - 2 * (quaternions[:, 1] ** 2 + quaternions[:, 2] ** 2)
        return Snapshot(positions, uprightness, T, self._joints.read(self._data))


def object_moved(
    expected: Snapshot, now: Snapshot, names: tuple[str, ...], config: MonitorConfig, ignore: Collection[str] = ()
) -> Deviation | None:
    """An object that has toppled, or the object that has moved farthest from where the plan left it, if too far."""
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


def object_slipped(before: Array, now: Array, name: str, config: MonitorConfig) -> Deviation | None:
    """Whether the held object has moved in the gripper; both positions (3,) [m] in the TCP frame."""
    return Deviation(DeviationKind.SLIPPED, name) if float(np.linalg.norm(now - before)) > config.slip else None


def tracking_error(wanted: Array, actual: Array, config: MonitorConfig) -> Deviation | None:
    """Whether base (first three joints) or arm are far from their commands; whole-body configurations (11,)."""
    error = np.abs(wanted - actual)
    if error[:3].max() > config.base:
        return Deviation(DeviationKind.BASE_TRACKING_ERROR)
    return Deviation(DeviationKind.ARM_TRACKING_ERROR) if error[3:].max() > config.arm else None
