"""Arm configurations on the vertical line above a contact, corrected by forward kinematics before the robot moves."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from assets import RobotSpec
from clutter_env.learning.keyframes.aim import MOST_SHIFT, MOST_TURN
from clutter_env.learning.keyframes.features import POSTURE_JOINTS, features
from clutter_env.learning.keyframes.kinematics import ArmKinematics
from clutter_env.learning.keyframes.network import KeyframeNetwork
from clutter_env.learning.keyframes.phases import phase_index

__all__ = ["ArmLine"]

Array = NDArray[np.float64]

_LINE = {"pick": "lift", "place": "lower"}
"""The phase whose straight line leads through a contact."""
_GAIN = 0.8
"""Share of the foreseen error by which the pose that the network is told moves in a round."""
_MOST_BEND = np.array((0.1, 0.5))
"""[m], [rad] by which the posture that it is told may differ from the wanted one: it was fitted to such."""


class ArmLine:
    """What a network says that the arm does around a contact under a board, until the gripper is where it is wanted.

    Where forward kinematics foresees the gripper beside its line, the network is told a contact on the other side, as
    the feedback of a measured error does while the robot moves; and a posture on the other side of a wrong one.
    """

    def __init__(self, network: KeyframeNetwork, robot: RobotSpec) -> None:
        self._network, self._kinematics = network, ArmKinematics(robot)
        self._home = np.array(robot.home)[list(POSTURE_JOINTS)]

    def finger(self, skill: str, phase: str, base_tcp: Array, sizes: Array, posture: Array) -> float:
        """[m] Position of one finger in a phase, for a contact (4, 4) in the frame of the base there."""
        return float(self._predict(skill, phase, base_tcp[None], sizes, np.zeros(1), posture[None])[1][0])

    def tucked(self, skill: str, phase: str, base_tcp: Array, sizes: Array) -> Array:
        """(8,) Torso and arm at the end of a phase outside, for a contact (4, 4) in the frame of the base there."""
        return self._predict(skill, phase, base_tcp[None], sizes, np.zeros(1), np.zeros((1, 2)))[0][0]

    def at(
        self, skill: str, base_tcp: Array, sizes: Array, heights: Array, postures: Array, rounds: int
    ) -> tuple[Array, Array]:
        """Torso and arm (k, 8) with the gripper at heights (k,) [m] above a contact, and its error there (k,) [m].

        Args:
            skill: "pick" or "place".
            base_tcp: (4, 4) of the gripper at the contact, in the base's frame.
            sizes: (4,) of the object, as `Reading.sizes`.
            heights: (k,) above the contact.
            postures: (k, 2) torso [m] and upper-arm roll [rad] there, less those of home.
            rounds: of correction.
        """
        wanted = np.tile(base_tcp, (len(heights), 1, 1))
        wanted[:, 2, 3] += heights
        shift, turn, bend = np.zeros((len(heights), 3)), np.zeros((len(heights), 3)), np.zeros((len(heights), 2))
        for left in range(rounds, -1, -1):
            told = np.tile(base_tcp, (len(heights), 1, 1))
            told[:, :3, 3] += shift
            told[:, :3, :3] = Rotation.from_rotvec(turn).as_matrix() @ told[:, :3, :3]
            q, _ = self._predict(skill, _LINE[skill], told, sizes, heights, postures + bend)
            position, rotation = self._kinematics.tcp(torch.from_numpy(q.astype(np.float32)))
            error = wanted[:, :3, 3] - position.numpy()
            if left:
                off = Rotation.from_matrix(wanted[:, :3, :3] @ rotation.numpy().transpose(0, 2, 1))
                step = Rotation.from_rotvec(_GAIN * off.as_rotvec())
                shift = _limited(shift + _GAIN * error, MOST_SHIFT)
                bend += _GAIN * (postures + self._home - q[:, list(POSTURE_JOINTS)])
                bend = np.clip(bend, -_MOST_BEND, _MOST_BEND)
                turn = _limited((step * Rotation.from_rotvec(turn)).as_rotvec(), MOST_TURN)
        return q, np.linalg.norm(error, axis=1)

    def _predict(
        self, skill: str, phase: str, told: Array, sizes: Array, heights: Array, postures: Array
    ) -> tuple[Array, Array]:
        """Configurations (k, 8) and finger positions (k,) [m] for contacts (k, 4, 4) in the base's frame."""
        number = phase_index(skill, phase)
        assert number is not None
        rows = features(number, told, np.broadcast_to(sizes, (len(told), 4)), heights, postures)
        with torch.no_grad():
            predicted = self._network(torch.from_numpy(rows.astype(np.float32)))
        return predicted.q.numpy().astype(float), predicted.finger.numpy().astype(float)


def _limited(vectors: Array, most: float) -> Array:
    """Vectors (k, 3) shortened to this length where they are longer."""
    lengths = np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-12)
    return vectors * np.minimum(1.0, most / lengths)
