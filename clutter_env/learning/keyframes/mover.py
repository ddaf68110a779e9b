"""A mover that goes from keyframe to keyframe as its network says; it sees nothing but observations."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from assets import RobotSpec
from clutter_env.learning.contacts.protocols import Observation
from clutter_env.learning.contacts.reading import Reading, read
from clutter_env.learning.contacts.tracking import action_towards, error_to, stay
from clutter_env.learning.keyframes.aim import Aim, GripperError
from clutter_env.learning.keyframes.boards.guide import BoardGuide
from clutter_env.learning.keyframes.features import line_distance
from clutter_env.learning.keyframes.guide import AHEAD, Guide, Keyframe, gripper_error
from clutter_env.learning.keyframes.network import KeyframeNetwork
from clutter_env.learning.keyframes.open_guide import OpenGuide
from clutter_env.learning.keyframes.phases import AWAY, DRIVEN, FINGERS, TOWARDS
from clutter_env.scene.layout import Layout
from planners import Contact

__all__ = ["KeyframeMover"]

Array = NDArray[np.float64]

_ARRIVED = 0.004
"""[m] from the contact at which the gripper has arrived; it leaves 12 mm on each side of an object."""
_LEFT = 0.015
"""[m] before the end of a line away from a contact at which the next phase begins."""
_FAR_OFF = 0.03
"""[m] from the contact at which an approach that has come to rest has failed."""
_AT_BASE, _AT_ARM, _ON_THE_WAY = 0.008, 0.02, 0.08
"""[m], [rad] from a keyframe at which base and arm have arrived, and arms that need not stop there."""
_AT_CORNER = 0.01
"""[m], [rad] of the base from a corner of its way under a board, at which it goes on."""
_SETTLED = 0.02
"""[m], [rad] of the robot from where it stands at a contact, at which the aim is corrected."""
_NEAR = 0.15
"""[m], [rad] of the joints from a keyframe at which the pose of the gripper is compared with the expected one."""
_SLOW = 0.05
"""[m/s], [rad/s] below which a joint counts as at rest."""
_OPEN, _STILL = 0.002, 0.0005
"""[m] between the measured and the wanted width of open fingers; change of the width in a step of fingers at rest."""
_SETTLE = 4
"""Control steps for which the fingers must be at rest."""
_LONGEST = 120
"""Control steps after which a phase is over, wherever the robot is; the longest straight drives take about 80. A drive
whose next corner, or whose end, takes longer is blocked, and the contact is missed."""


class KeyframeMover:
    """Brings contacts about with the keyframes of a network.

    Every step it reads where the robot and the object are, asks the network for the keyframe of the present phase, and
    goes there. A phase is over when the robot has measurably arrived. Of the postures in which the arm can reach the
    contact one is chosen that keeps clear of the objects. Until the fingers close, the contact of a pick moves with its
    object, and the aim is corrected by the measured error of the gripper.

    Attributes:
        is_done: the motion has ended.
        has_missed: it has ended without the object in the gripper, or, of a placement, still with it or before it.
    """

    def __init__(self, network: KeyframeNetwork) -> None:
        self._network = network.eval()
        self._steps, self._still, self._width, self._stops = 0, 0, 0.0, 1
        self.is_done, self.has_missed = True, False

    @classmethod
    def load(cls, path: Path) -> KeyframeMover:
        """The mover with the weights of a file.

        Raises:
            DatasetError: there is no such file, or it holds no weights.
        """
        return cls(KeyframeNetwork.load(path))

    def reset(self, env: gym.Env[Any, Any], info: Mapping[str, Any]) -> None:  # noqa: ARG002  part of the protocol
        """Start an episode: the robot, the names of the objects and, under a board, the furniture are what is read."""
        self._robot: RobotSpec = env.unwrapped.robot  # type: ignore[attr-defined]  # Retrieve
        layout: Layout = env.unwrapped.layout  # type: ignore[attr-defined]  # Retrieve
        is_under_board = self._network.is_under_board
        self._guide: Guide = (
            BoardGuide(self._network, self._robot, layout) if is_under_board else OpenGuide(self._network, self._robot)
        )
        self._names: tuple[str, ...] = env.unwrapped.object_names  # type: ignore[attr-defined]  # Retrieve
        self.is_done, self.has_missed = True, False

    def start(self, contact: Contact, observation: Observation) -> None:
        """Begin to bring a contact about."""
        reading = read(observation)
        self._planned = self._contact = contact
        self._index = self._names.index(contact.object)
        self._first_seen = reading.position(self._index)
        self._aim, self._phases = Aim(), self._guide.begin(contact, self._index, reading)
        is_dropped = contact.skill == "place" and not reading.is_held(self._index)
        self._has_failed = is_dropped or not self._phases
        self.is_done, self.has_missed = self._has_failed, self._has_failed
        self._begin_phase(reading)

    @property
    def phase(self) -> str:
        """Name of the present phase, "" when the motion has ended."""
        return "" if self.is_done else self._phases[0]

    @property
    def contact(self) -> Contact:
        """The contact that is being brought about, where it is now."""
        return self._contact

    def act(self, observation: Observation) -> Array:
        """The next action."""
        reading = read(observation)
        if not self.is_done:
            self._follow_object(reading)
            keyframe = self._advance(reading)
        if self.is_done:
            return stay(self._robot, reading)
        self._correct_aim(reading, keyframe)
        is_loaded = bool(reading.is_held(self._index))
        return action_towards(self._robot, reading, keyframe.goal, keyframe.finger, is_loaded)

    # Phases.

    def _advance(self, reading: Reading) -> Keyframe:
        """Go on to the phase that the robot is in; its keyframe."""
        keyframe = self._keyframe(reading)
        if keyframe.stops < self._stops:
            self._steps = 0
        self._stops = keyframe.stops
        while not self.is_done and self._is_over(reading, keyframe):
            phase = self._phases.pop(0)
            if phase == "drive" and self._steps >= _LONGEST:
                self._has_failed, self._phases = True, []
            elif self._has_stopped_short(phase, reading, keyframe):
                self._has_failed, self._phases = True, self._phases[1:]
            self.is_done = not self._phases
            if self.is_done:
                is_held = bool(reading.is_held(self._index))
                self.has_missed = self._has_failed or is_held != (self._contact.skill == "pick")
            else:
                self._begin_phase(reading)
                keyframe = self._keyframe(reading)
        self._steps += 1
        self._still = self._still + 1 if abs(reading.widths[0] - self._width) < _STILL else 0
        self._width = float(reading.widths[0])
        return keyframe

    def _has_stopped_short(self, phase: str, reading: Reading, keyframe: Keyframe) -> bool:
        """Whether the gripper is not at the contact although the way there has ended."""
        if phase == "reach":
            return bool(np.linalg.norm(keyframe.expected[:3, 3] - reading.tcp[:3, 3]) > _FAR_OFF)
        return phase in TOWARDS and bool(line_distance(reading, self._contact) > _FAR_OFF)

    def _begin_phase(self, reading: Reading) -> None:
        self._steps = self._still = 0
        self._width = float(reading.widths[0])

    def _is_over(self, reading: Reading, keyframe: Keyframe) -> bool:
        """Whether the robot has measurably come to the end of the present phase, or does not get there."""
        phase = self._phases[0]
        if self._steps >= _LONGEST:
            return True
        if phase in FINGERS:
            is_open = abs(reading.widths[0] - self._robot.opening(keyframe.finger)) < _OPEN
            return self._still >= _SETTLE and (phase == "close" or bool(is_open))
        error = np.abs(error_to(reading, keyframe.goal))
        is_slow = bool((np.abs(reading.velocity) < _SLOW).all()) and self._steps > _SETTLE
        if phase in AWAY:
            return is_slow or float(line_distance(reading, self._contact)) > keyframe.length - _LEFT
        if phase in TOWARDS:
            return is_slow and float(line_distance(reading, self._contact)) < _ARRIVED
        if phase == "drive":
            return keyframe.stops == 1 and bool((error[:3] < _AT_BASE).all())
        if phase == "reach":
            is_there = np.linalg.norm(keyframe.expected[:3, 3] - reading.tcp[:3, 3]) < _ARRIVED
            return is_slow and bool(is_there)
        if phase in DRIVEN:
            return bool((error[:3] < _AT_CORNER).all())
        if phase == "transit":
            is_right = GripperError.between(reading.tcp, keyframe.expected).is_within(keyframe.slack)
            return is_right and bool((error[3:] < _AT_ARM).all())
        return bool((error[3:] < _ON_THE_WAY).all())

    def _keyframe(self, reading: Reading) -> Keyframe:
        """Where the robot goes now."""
        return self._guide.keyframe(self._phases[0], self._contact, self._aim, reading)

    # Feedback.

    def _correct_aim(self, reading: Reading, keyframe: Keyframe) -> None:
        """Correct the aim at both ends of the straight line to a contact, and where the gripper is off the line.

        On the way the arm lags behind, which is no error of the aim.
        """
        phase = self._phases[0]
        error = gripper_error(phase, reading, keyframe.expected, self._contact)
        if phase == "reach":
            is_due = bool(np.abs(error_to(reading, keyframe.goal)).max() < _SETTLED)
        elif phase == "transit":
            is_due = bool(np.abs(error_to(reading, keyframe.goal)[3:]).max() < _NEAR)
        else:
            is_near = bool(line_distance(reading, self._contact) < AHEAD)
            is_due = phase in TOWARDS and (is_near or not error.is_small)
        if is_due:
            self._aim.correct(error)

    def _follow_object(self, reading: Reading) -> None:
        """The contact of a pick moves with the object until the fingers close; the base no longer, once it has come."""
        phase = self._phases[0]
        if self._planned.skill != "pick" or phase not in ("drive", "ready", "transit", "enter", "reach", "approach"):
            return
        shift = reading.position(self._index) - self._first_seen
        base, tcp = np.array(self._planned.base), np.array(self._planned.tcp)
        tcp[:3, 3] += shift
        base = base + shift * (1.0, 1.0, 0.0) if phase == "drive" else self._contact.base
        self._contact = Contact(self._planned.skill, self._planned.object, base, tcp)
