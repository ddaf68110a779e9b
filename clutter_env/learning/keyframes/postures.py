"""Which posture of the arm at a contact: the plainest one that keeps the forearm clear of the objects."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray

from assets import RobotSpec
from clutter_env.learning.contacts.cylinders import Cylinders
from clutter_env.learning.contacts.reading import Reading, planar_pose
from clutter_env.learning.keyframes.features import contact_in_base, features
from clutter_env.learning.keyframes.kinematics import ArmKinematics
from clutter_env.learning.keyframes.network import KeyframeNetwork
from clutter_env.learning.keyframes.phases import phase_index
from planners import Contact

__all__ = ["PostureChoice"]

Array = NDArray[np.float64]

_TORSOS = (0.0, -0.05, 0.05, -0.1, 0.1)
"""[m] from home."""
_ROLLS = tuple(np.radians((0, 15, -15, 30, -30, 45, -45, 60, -60)))
"""[rad] of the upper arm from home."""
_DISTANCES = (0.0, 0.06, 0.12, 0.18)
"""[m] from the contact on the straight line, at which the arm is compared with the objects."""
_RADIUS, _ROOM = 0.065, 0.02
"""[m] of the forearm, and of free space around it that is enough."""
_TORSO_COST, _MISS_COST, _HIT_COST = 3.0, 30.0, 60.0
"""Costs of a metre of the torso from home, of a metre by which the gripper misses the contact, and of a metre of free
space that is missing; that of a radian of the roll is 1."""
_ELBOW, _WRIST = 4, 7
"""Numbers of the joints between which the forearm and the wrist lie; the gripper beyond is where the contact says."""
_SHARES = np.array((0.0, 0.5))
"""Points on the links, as shares of their length."""


class PostureChoice:
    """Chooses among postures by what a network and the robot's kinematics predict for each of them."""

    def __init__(self, network: KeyframeNetwork, robot: RobotSpec) -> None:
        self._network, self._kinematics = network, ArmKinematics(robot)
        self._grid = np.array([(torso, roll) for torso in _TORSOS for roll in _ROLLS])

    def choose(self, contact: Contact, index: int, reading: Reading) -> Array:
        """(2,) torso [m] and upper-arm roll [rad] at a contact of object `index`, less those of home."""
        is_pick, pose = contact.skill == "pick", contact_in_base(contact.tcp, np.array(contact.base))
        sizes = reading.sizes(index)
        grid = self._grid
        plain = _TORSO_COST * np.abs(grid[:, 0]) + np.abs(grid[:, 1])
        joints = self._joints(grid, contact, "approach" if is_pick else "lower", sizes, np.array(_DISTANCES))
        T = np.linalg.inv(planar_pose(np.array(contact.base))) @ planar_pose(reading.base)
        others = Cylinders.beside(reading, index, T)
        miss = np.linalg.norm(joints[:, 0, -1] - pose[:3, 3], axis=-1)
        lacking = np.maximum(_ROOM + _RADIUS - _distance(joints, others), 0.0)
        return np.asarray(grid[np.argmin(plain + _MISS_COST * miss + _HIT_COST * lacking)])

    def _joints(self, grid: Array, contact: Contact, phase: str, sizes: Array, distances: Array) -> Array:
        """(k, d, 9, 3) [m] Joints and TCP in the base's frame, in k postures (k, 2) at d distances on a line."""
        number = phase_index(contact.skill, phase)
        assert number is not None
        pose = contact_in_base(contact.tcp, np.array(contact.base))
        postures = np.repeat(grid, len(distances), axis=0)
        count = len(postures)
        rows = features(
            number,
            np.broadcast_to(pose, (count, 4, 4)),
            np.broadcast_to(sizes, (count, 4)),
            np.tile(distances, len(grid)),
            postures,
        )
        with torch.no_grad():
            origins, _ = self._kinematics.frames(self._network(torch.from_numpy(rows.astype(np.float32))).q)
        return origins.numpy().astype(float).reshape(len(grid), len(distances), -1, 3)


def _distance(joints: Array, others: Cylinders) -> Array:
    """(k,) [m] from the forearm's axis on the way to the nearest object, for joints (k, d, 9, 3)."""
    starts, ends = joints[:, :, _ELBOW:_WRIST], joints[:, :, _ELBOW + 1 : _WRIST + 1]
    points = np.concatenate([starts + share * (ends - starts) for share in _SHARES], axis=2)
    return np.asarray(others.distance(points).min(axis=(1, 2)))
