"""The way to contacts under a board: the base goes by geometry, the arm as the network says."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from assets import RobotSpec
from clutter_env.learning.contacts.reading import Reading, planar_pose
from clutter_env.learning.keyframes.aim import Aim
from clutter_env.learning.keyframes.boards.arm_line import ArmLine
from clutter_env.learning.keyframes.boards.postures import BoardPostures
from clutter_env.learning.keyframes.boards.stations import Stations, table_of
from clutter_env.learning.keyframes.configurations import shortest_way, with_wrist_turned
from clutter_env.learning.keyframes.features import contact_in_base, line_distance
from clutter_env.learning.keyframes.guide import AHEAD, Keyframe, drive_goal, gripper_error
from clutter_env.learning.keyframes.network import KeyframeNetwork
from clutter_env.learning.keyframes.phases import BOARD_PHASES
from clutter_env.scene.layout import Layout
from planners import Contact

__all__ = ["BoardGuide"]

Array = NDArray[np.float64]

_TUCKED = ("drive", "ready", "retreat")
"""Phases outside at whose end the arm is as it is for driving."""
_FINGERS = {"enter": "ready", "reach": "ready", "transit": "ready", "back": "lift", "leave": "lift"}
_PLACING_FINGERS = {"enter": "lower", "reach": "lower", "transit": "lower", "back": "open", "leave": "open"}
"""Phases in which the fingers are as in another one."""
_ROUNDS = 2
"""Rounds of correction by forward kinematics in a control step."""
_REFUSALS = 2
"""Times that a contact is refused in an episode; a decider that still asks for it has nothing better."""
_ALIKE = 0.005
"""[m], [rad] by which a contact may differ from the one that was refused before, and is the same."""
_SLACK = 0.4
"""Share of the errors elsewhere that the gripper may have where the base drives in: table and wrist are 3 mm apart."""
_SAME = 1e-4
"""[m] and cosines by which a pose may change before the arm is asked for anew."""


class _Arm(NamedTuple):
    """Torso and arm (8,) with the gripper at a height [m] above a pose (4, 4) in the base's frame."""

    base_tcp: Array
    height: float
    q: Array


class BoardGuide:
    """Drives in with the arm rigid, straight and then along the gripper, and out again in the same way."""

    def __init__(self, network: KeyframeNetwork, robot: RobotSpec, layout: Layout) -> None:
        self._robot, self._ground, self._table = robot, network.ground, table_of(layout)
        self._refused: list[Contact] = []
        self._line, self._postures = ArmLine(network, robot), BoardPostures(network, robot, layout)

    def begin(self, contact: Contact, index: int, reading: Reading) -> list[str]:
        """Choose the posture at a contact of object `index`; the phases to go through.

        There are none where arm or gripper would run into something: the contact is refused.
        """
        self._sizes = reading.sizes(index)
        base_tcp = contact_in_base(contact.tcp, np.array(contact.base))
        opened = "ready" if contact.skill == "pick" else "open"
        finger = self._line.finger(contact.skill, opened, base_tcp, self._sizes, np.zeros(2))
        self._posture = self._postures.choose(contact, index, reading, finger)
        if self._posture.is_blocked and sum(_is_same(contact, other) for other in self._refused) < _REFUSALS:
            self._refused.append(contact)
            return []
        self._last = _Arm(np.zeros((4, 4)), 0.0, reading.q)
        return list(BOARD_PHASES[contact.skill])

    def keyframe(self, phase: str, contact: Contact, aim: Aim, reading: Reading) -> Keyframe:
        """Where the robot goes in a phase; the contact may have moved since."""
        base, stops = Stations(self._table, contact).at_end(phase), 1
        here = self._height(phase, contact, reading)
        expected = np.array(contact.tcp)
        expected[2, 3] += here
        if phase in ("transit", "enter"):
            expected = planar_pose(reading.base) @ contact_in_base(expected, np.array(contact.base))
        if phase in _TUCKED:
            base_tcp = contact_in_base(contact.tcp, np.array(contact.base))
            q = self._turned(self._line.tucked(contact.skill, phase, base_tcp, self._sizes))
        else:
            ahead = here
            if phase == "lift":
                ahead = min(here + AHEAD, self._posture.height)
            elif phase == "lower" and gripper_error(phase, reading, expected, contact).is_small:
                ahead = max(here - AHEAD, 0.0)
            q = self._arm(contact, aim, ahead)
        q = shortest_way(self._robot, reading.q, q)
        if phase == "drive":
            base, stops = drive_goal(reading, list(self._ground.way(reading.base, base)), q)
        finger = self._finger(phase, contact)
        return Keyframe(np.concatenate((base, q)), finger, expected, stops, self._posture.height, _SLACK)

    def _height(self, phase: str, contact: Contact, reading: Reading) -> float:
        """[m] Where the gripper is, or is to be, above the contact."""
        if phase in ("lift", "lower"):
            return float(line_distance(reading, contact))
        is_high = phase in (("back", "leave") if contact.skill == "pick" else ("transit", "enter", "reach"))
        return self._posture.height if is_high else 0.0

    def _arm(self, contact: Contact, aim: Aim, height: float) -> Array:
        """(8,) Torso and arm with the gripper at a height [m] above the aim, as from the base at the contact."""
        base_tcp = contact_in_base(aim.of(contact.tcp), np.array(contact.base))
        if height != self._last.height or np.abs(base_tcp - self._last.base_tcp).max() > _SAME:
            posture = self._posture.at(height)[None]
            q = self._line.at(contact.skill, base_tcp, self._sizes, np.array([height]), posture, _ROUNDS)[0][0]
            self._last = _Arm(base_tcp, height, self._turned(q))
        return self._last.q

    def _turned(self, q: Array) -> Array:
        """The form of a configuration that the posture wants."""
        return with_wrist_turned(self._robot, q) if self._posture.is_turned else q

    def _finger(self, phase: str, contact: Contact) -> float:
        """[m] Position of one finger."""
        like = (_FINGERS if contact.skill == "pick" else _PLACING_FINGERS).get(phase, phase)
        base_tcp = contact_in_base(contact.tcp, np.array(contact.base))
        posture = np.zeros(2) if like in _TUCKED else self._posture.low
        return self._line.finger(contact.skill, like, base_tcp, self._sizes, posture)


def _is_same(contact: Contact, other: Contact) -> bool:
    """Whether it is the same contact."""
    if (contact.skill, contact.object) != (other.skill, other.object):
        return False
    return np.allclose(contact.tcp, other.tcp, atol=_ALIKE) and np.allclose(contact.base, other.base, atol=_ALIKE)
