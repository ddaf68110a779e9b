"""The keyframe policy moves between the keyframes that its network predicts. Its only inputs are observations."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import assets
from clutter_env.policies.motion.control import GripperError, IntegralOffset, action_towards, error_to, stay
from clutter_env.policies.motion.keyframe_planner import AHEAD, Keyframe, OpenKeyframePlanner, gripper_error
from clutter_env.policies.motion.network import AWAY, DRIVEN, FINGERS, TOWARDS, KeyframeNetwork, line_distance
from clutter_env.policies.motion.shelf import ShelfKeyframePlanner
from clutter_env.policies.parsed_observation import Observation, ParsedObservation, parse_observation
from clutter_env.policies.protocol import PublicInfo
from clutter_env.policies.weights import WeightsInfo
from clutter_env.scene.layout import find_layout
from planners import Contact

Array = NDArray[np.float64]

_ARRIVED = 0.004
"""[m] Distance from the contact at which the gripper has arrived. It has 12 mm on each side of an object."""
_LEAVING = 0.015
"""[m] before the end of a line away from a contact at which the next phase begins."""
_FAR_OFF = 0.03
"""[m] from the contact at which an approach that has come to rest has failed."""
_AT_BASE, _AT_ARM, _PASSING = 0.008, 0.02, 0.08
"""[m], [rad] from a keyframe at which base and arm have arrived, and arms that need not stop there."""
_AT_CORNER = 0.01
"""[m], [rad] of the base from a corner of its path under a shelf, at which it drives on."""
_SETTLED = 0.02
"""[m], [rad] of the robot from where it stands at a contact, at which the offset is corrected."""
_NEAR = 0.15
"""[m], [rad] of the joints from a keyframe at which the pose of the gripper is compared with the expected one."""
_SLOW = 0.05
"""[m/s], [rad/s] below which a joint is regarded as at rest."""
_OPEN, _STILL = 0.002, 0.0005
"""[m] Difference between measured and desired width of open fingers, and change of the width per step of fingers at
rest."""
_SETTLE = 4
"""Control steps for which the fingers must be at rest."""
_MAX_STEPS = 120
"""Control steps after which a phase ends in any case. The longest straight drives take about 80. A drive that takes
longer to its next corner or its end is blocked, and the motion has failed."""


class KeyframePolicy:
    """Executes picks and places with the keyframes of a network. It is a motion policy, see `two_level`.

    In every step it parses the poses of robot and object, asks the network for the keyframe of the present phase, and
    moves there. A phase ends when the robot's measured state has arrived. Of the arm configurations that reach the
    contact, one is chosen that keeps clear of the objects. Until the fingers close, the contact of a pick moves with
    its object. The network input is offset by the integral of the measured gripper error.

    Attributes:
        info: robot, layout and grasps of its training. It knows the furniture of that layout.
        is_done: the motion has ended.
        has_failed: it was refused or stopped early, or has ended without the object in the gripper (pick) or with it
            (place).
    """

    def __init__(self, network: KeyframeNetwork, info: WeightsInfo) -> None:
        self.info = info
        self._network, self._robot = network.eval(), assets.robot(info.robot)
        self._steps, self._still, self._width, self._stops = 0, 0, 0.0, 1
        self.reset({})

    @classmethod
    def load(cls, path: Path) -> KeyframePolicy:
        """Load the policy from a file of weights. Raise `PolicyError`, see `load_weights`."""
        return cls(*KeyframeNetwork.load(path))

    def check(self, public: PublicInfo) -> None:
        """Refuse an environment with another robot or layout (`PolicyError`)."""
        self.info.check(public)

    def reset(self, info: Mapping[str, Any]) -> None:  # noqa: ARG002  part of the protocol
        """Start an episode."""
        kind = ShelfKeyframePlanner if self._network.is_under_shelf else OpenKeyframePlanner
        self._planner: OpenKeyframePlanner | ShelfKeyframePlanner = kind(
            self._network, self._robot, find_layout(self.info.layout)
        )
        self.is_done, self.has_failed = True, False

    def start(self, contact: Contact, observation: Observation) -> None:
        """Begin to execute a pick or a place."""
        seen = parse_observation(observation)
        tcp = np.array(contact.tcp)
        self._index = seen.index(contact.object)
        tcp[2, 3] += self._planner.raise_pick(contact, self._index, seen) if contact.skill == "pick" else 0.0
        self._planned = self._contact = contact = Contact(contact.skill, contact.object, contact.base, tcp)
        self._first_seen = seen.position(self._index)
        self._offset, self._phases = IntegralOffset(), self._planner.begin(contact, self._index, seen)
        is_dropped = contact.skill == "place" and not seen.is_held(self._index)
        self._has_stopped = is_dropped or not self._phases
        self.is_done, self.has_failed = self._has_stopped, self._has_stopped
        self._begin_phase(seen)

    @property
    def phase(self) -> str:
        """Name of the present phase, "" when the motion has ended."""
        return "" if self.is_done else self._phases[0]

    @property
    def contact(self) -> Contact:
        """The pick or place that is executed, where it is now."""
        return self._contact

    def act(self, observation: Observation) -> Array:
        """The next action."""
        seen = parse_observation(observation)
        if not self.is_done:
            self._follow_object(seen)
            keyframe = self._advance(seen)
        if self.is_done:
            return stay(self._robot, seen)
        self._correct_offset(seen, keyframe)
        is_loaded = bool(seen.is_held(self._index))
        return action_towards(self._robot, seen, keyframe.goal, keyframe.finger, is_loaded)

    # Phases.

    def _advance(self, seen: ParsedObservation) -> Keyframe:
        """Advance to the robot's present phase and return its keyframe."""
        keyframe = self._keyframe(seen)
        if keyframe.stops < self._stops:
            self._steps = 0
        self._stops = keyframe.stops
        while not self.is_done and self._is_over(seen, keyframe):
            phase = self._phases.pop(0)
            if phase == "drive" and self._steps >= _MAX_STEPS:
                self._has_stopped, self._phases = True, []
            elif self._has_stopped_short(phase, seen, keyframe):
                self._has_stopped, self._phases = True, self._phases[1:]
            self.is_done = not self._phases
            if self.is_done:
                is_held = bool(seen.is_held(self._index))
                self.has_failed = self._has_stopped or is_held != (self._contact.skill == "pick")
            else:
                self._begin_phase(seen)
                keyframe = self._keyframe(seen)
        self._steps += 1
        self._still = self._still + 1 if abs(seen.widths[0] - self._width) < _STILL else 0
        self._width = float(seen.widths[0])
        return keyframe

    def _has_stopped_short(self, phase: str, seen: ParsedObservation, keyframe: Keyframe) -> bool:
        """Whether the gripper is not at the contact although the path there has ended."""
        if phase == "reach":
            return bool(np.linalg.norm(keyframe.expected[:3, 3] - seen.tcp[:3, 3]) > _FAR_OFF)
        return phase in TOWARDS and bool(line_distance(seen, self._contact) > _FAR_OFF)

    def _begin_phase(self, seen: ParsedObservation) -> None:
        self._steps = self._still = 0
        self._width = float(seen.widths[0])

    def _is_over(self, seen: ParsedObservation, keyframe: Keyframe) -> bool:
        """Whether the robot has measurably come to the end of the present phase, or does not get there."""
        phase = self._phases[0]
        if self._steps >= _MAX_STEPS:
            return True
        if phase in FINGERS:
            is_open = abs(seen.widths[0] - self._robot.opening(keyframe.finger)) < _OPEN
            return self._still >= _SETTLE and (phase == "close" or bool(is_open))
        error = np.abs(error_to(seen, keyframe.goal))
        is_slow = bool((np.abs(seen.velocity) < _SLOW).all()) and self._steps > _SETTLE
        if phase in AWAY:
            return is_slow or float(line_distance(seen, self._contact)) > keyframe.length - _LEAVING
        if phase in TOWARDS:
            return is_slow and float(line_distance(seen, self._contact)) < _ARRIVED
        if phase == "drive":
            return keyframe.stops == 1 and bool((error[:3] < _AT_BASE).all())
        if phase == "reach":
            is_there = np.linalg.norm(keyframe.expected[:3, 3] - seen.tcp[:3, 3]) < _ARRIVED
            return is_slow and bool(is_there)
        if phase in DRIVEN:
            return bool((error[:3] < _AT_CORNER).all())
        if phase == "transit":
            is_right = GripperError.between(seen.tcp, keyframe.expected).is_small(keyframe.slack)
            return is_right and bool((error[3:] < _AT_ARM).all())
        return bool((error[3:] < _PASSING).all())

    def _keyframe(self, seen: ParsedObservation) -> Keyframe:
        return self._planner.keyframe(self._phases[0], self._contact, self._offset, seen)

    # Feedback.

    def _correct_offset(self, seen: ParsedObservation, keyframe: Keyframe) -> None:
        """Correct the offset at both ends of the straight line to a contact, and where the gripper is off the line.

        In between the arm lags behind, which is no error of the offset.
        """
        phase = self._phases[0]
        if phase not in ("reach", "transit", *TOWARDS):
            return
        error = gripper_error(phase, seen, keyframe.expected, self._contact)
        if phase == "reach":
            is_due = bool(np.abs(error_to(seen, keyframe.goal)).max() < _SETTLED)
        elif phase == "transit":
            is_due = bool(np.abs(error_to(seen, keyframe.goal)[3:]).max() < _NEAR)
        else:
            is_near = bool(line_distance(seen, self._contact) < AHEAD)
            is_due = is_near or not error.is_small()
        if is_due:
            self._offset.correct(error)

    def _follow_object(self, seen: ParsedObservation) -> None:
        """Move the contact of a pick with the object until the fingers close. The base pose is fixed after the base has
        arrived."""
        phase = self._phases[0]
        if self._planned.skill != "pick" or phase not in ("drive", "ready", "transit", "enter", "reach", "approach"):
            return
        shift = seen.position(self._index) - self._first_seen
        base, tcp = np.array(self._planned.base), np.array(self._planned.tcp)
        tcp[:3, 3] += shift
        base = base + shift * (1.0, 1.0, 0.0) if phase == "drive" else self._contact.base
        self._contact = Contact(self._planned.skill, self._planned.object, base, tcp)
