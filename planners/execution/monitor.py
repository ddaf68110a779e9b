"""Watching execution: is the world still as the plan expects it?"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from assets.robots import RobotSpec
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
    """What can go wrong while a plan is carried out."""

    GRASP_MISSED = "grasp missed"
    SLIPPED = "object_slipped out of the hand"
    TOPPLED = "toppled"
    DISPLACED = "not where it was left"
    BASE_OFF = "base not where expected"
    ARM_OFF = "arm not where expected"


@dataclass(frozen=True)
class Deviation:
    """A surprise, and the object it is about ("" for the robot itself)."""

    surprise: DeviationKind
    object: str = ""

    def __str__(self) -> str:
        return f"{self.object}: {self.surprise}" if self.object else str(self.surprise)


@dataclass(frozen=True)
class MonitorConfig:
    """How far the world may differ from the plan.

    Attributes:
        displacement: [m] of an object nobody should have moved.
        tilt: [rad] of an object that should stand.
        slip: [m] of an object within the hand.
        base: [m] and [rad], `arm`: [m] and [rad] that the joints may lag behind.
    """

    displacement: float = 0.015
    tilt: float = 0.25
    slip: float = 0.02
    base: float = 0.08
    arm: float = 0.12


class Snapshot(NamedTuple):
    """What is looked at every control step: object centres (n, 3), cosines of their tilts (n,), TCP and joints."""

    positions: Array
    uprightness: Array
    T_world_tcp: Array
    drive: Array

    def in_hand(self, index: int) -> Array:
        """(3,) centre of an object in the TCP frame."""
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
    expected: Snapshot, now: Snapshot, names: tuple[str, ...], config: MonitorConfig, ignore: str = ""
) -> Deviation | None:
    """The object that is farthest from where the plan left it, if that is too far, or one that has toppled."""
    away = np.linalg.norm(now.positions - expected.positions, axis=1)
    toppled = (expected.uprightness > np.cos(config.tilt)) & (now.uprightness < np.cos(config.tilt))
    if ignore:
        away[names.index(ignore)] = 0.0
        toppled[names.index(ignore)] = False
    if toppled.any():
        return Deviation(DeviationKind.TOPPLED, names[int(toppled.argmax())])
    if away.size and away.max() > config.displacement:
        return Deviation(DeviationKind.DISPLACED, names[int(away.argmax())])
    return None


def object_slipped(before: Array, now: Array, name: str, config: MonitorConfig) -> Deviation | None:
    """Whether the object in hand has moved within it; both (3,) in the TCP frame."""
    return Deviation(DeviationKind.SLIPPED, name) if float(np.linalg.norm(now - before)) > config.slip else None


def tracking_error(wanted: Array, actual: Array, config: MonitorConfig) -> Deviation | None:
    """Whether base (first three) or arm are far from where they were told to be; whole-body configurations (11,)."""
    error = np.abs(wanted - actual)
    if error[:3].max() > config.base:
        return Deviation(DeviationKind.BASE_OFF)
    return Deviation(DeviationKind.ARM_OFF) if error[3:].max() > config.arm else None
