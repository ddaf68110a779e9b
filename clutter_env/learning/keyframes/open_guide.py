"""The way to contacts with nothing above them: all of it is what the network says."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray

from assets import RobotSpec
from clutter_env.learning.contacts.reading import Reading, base_from
from clutter_env.learning.keyframes.aim import Aim
from clutter_env.learning.keyframes.configurations import shortest_way
from clutter_env.learning.keyframes.features import contact_in_base, features, line_distance
from clutter_env.learning.keyframes.guide import AHEAD, Keyframe, drive_goal, gripper_error
from clutter_env.learning.keyframes.network import KeyframeNetwork
from clutter_env.learning.keyframes.phases import AWAY, LINES, PHASES, TOWARDS, phase_index
from clutter_env.learning.keyframes.postures import PostureChoice
from planners import Contact

__all__ = ["OpenGuide"]

Array = NDArray[np.float64]


class OpenGuide:
    """Asks the network for the keyframe of the present phase, as from where the base stands."""

    def __init__(self, network: KeyframeNetwork, robot: RobotSpec) -> None:
        self._network, self._robot, self._ground = network, robot, network.ground
        self._postures = PostureChoice(network, robot)

    def begin(self, contact: Contact, index: int, reading: Reading) -> list[str]:
        """Choose the posture at a contact of object `index`; the phases to go through."""
        self._sizes = reading.sizes(index)[None]
        self._posture = self._postures.choose(contact, index, reading)
        return [phase for phase in PHASES[contact.skill] if self._network.has_seen(contact.skill, phase)]

    def keyframe(self, phase: str, contact: Contact, aim: Aim, reading: Reading) -> Keyframe:
        """Where the robot goes in a phase; the contact may have moved since."""
        stands = np.array(contact.base) if phase == "drive" else reading.base
        here = float(line_distance(reading, contact)) if phase in LINES else 0.0
        ahead, own, length = here, aim.of(contact.tcp), 0.0
        planned = self._predict(phase, contact, contact.tcp, stands, here)
        expected = np.array(contact.tcp)
        expected[:3, 3] += contact.tcp[:3, :3] @ planned[11:14]
        if phase in AWAY:
            length = float(self._predict(phase, contact, own, stands, here)[15])
            ahead = min(here + AHEAD, length)
        elif phase in TOWARDS and gripper_error(phase, reading, expected, contact).is_small:
            ahead = max(here - AHEAD, 0.0)
        predicted = self._predict(phase, contact, own, stands, ahead)
        base = base_from(contact.base, predicted[:3])
        finger, q = float(predicted[14]), shortest_way(self._robot, reading.q, predicted[3:11])
        stops = 1
        if phase == "drive":
            base, stops = drive_goal(reading, list(self._ground.way(reading.base, base)), q)
        return Keyframe(np.concatenate((base, q)), finger, expected, stops, length)

    def _predict(self, phase: str, contact: Contact, tcp: Array, base: Array, distance: float) -> Array:
        """The network's output as one vector (16,), for a contact that is told to be at `tcp` (4, 4)."""
        number = phase_index(contact.skill, phase)
        assert number is not None
        pose = contact_in_base(tcp, base)
        row = features(number, pose[None], self._sizes, np.array([distance]), self._posture[None])
        with torch.no_grad():
            predicted = self._network(torch.from_numpy(row.astype(np.float32)))
        return np.concatenate([part.numpy().reshape(-1) for part in predicted]).astype(float)
