"""The fixed controller of the end-to-end policy: it goes to one keyframe after the other.

Joint lines for drives and free motions of the arm, straight lines of the gripper at contacts. It knows nothing of
objects, furniture or the task.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from assets import RobotSpec
from clutter_env.envs.observation import OBSERVATION_LAYOUT
from clutter_env.policies.end_to_end.differential_ik import DifferentialIK
from clutter_env.policies.motion.arm import shorter_turns
from clutter_env.policies.motion.control import action_towards, error_to
from clutter_env.policies.parsed_observation import ParsedObservation, planar_pose

Array = NDArray[np.float64]

PHASES = ("drive", "ready", "transit", "approach", "close", "lift", "retreat", "lower", "open", "rise")
"""Names of the phases, as the planner's trajectories name them."""
LINES = ("approach", "lift", "lower", "rise")
"""Straight lines of the gripper."""
FINGERS = ("ready", "close", "open")
"""Only the fingers move."""

_HELD = OBSERVATION_LAYOUT["objects"].index("held")
_AHEAD = 0.05
"""[m] On a line the gripper goes to the point this far ahead."""
_BACK = 1.0
"""Share of the distance from the line that is added to the way back to it: the joints lag behind their goals."""
_AT_BASE, _AT_ARM, _PASSING = 0.006, 0.03, 0.06
"""[m], [rad] from a keyframe at which the base, the arm, and an arm that need not stop there have arrived."""
_AT_CONTACT, _AWAY = 0.006, 0.02
"""[m] from the end of a line at which the gripper has arrived, towards a contact and away from it."""
_SLOW = 0.05
"""[m/s], [rad/s] below which a joint is regarded as at rest."""
_STILL, _STILL_STEPS, _FINGER_STEPS = 0.0005, 4, 8
"""[m] by which the width of fingers at rest changes in a step, steps at rest, and steps for them in any case."""
_MOST_STEPS = 160
"""Control steps after which a keyframe is given up."""


@dataclass(frozen=True, eq=False)
class Keyframe:
    """Where to go next.

    Attributes:
        phase: one of `PHASES`; it says which of the other attributes count.
        base: (3,) x, y [m], yaw [rad] in the world, of a drive.
        tcp: (4, 4) gripper pose in the world, of a transit or a line.
        q: (8,) torso [m] and arm [rad], of a drive or a retreat; else the reference of inverse kinematics.
        finger: [m] position of each finger.
    """

    phase: str
    base: Array
    tcp: Array
    q: Array
    finger: float


class Controller:
    """Goes to keyframes by measured positions.

    Attributes:
        is_over: whether the last keyframe has been reached or given up.
        has_stopped: whether it was given up.
    """

    def __init__(self, robot: RobotSpec) -> None:
        self._robot, self._ik = robot, DifferentialIK(robot)
        self.reset()

    def reset(self) -> None:
        """Start an episode."""
        self.is_over, self.has_stopped = True, False
        self._last_tcp: Array | None = None

    def start(self, keyframe: Keyframe, seen: ParsedObservation) -> None:
        """Begin to go to a keyframe."""
        self._keyframe, self._start = keyframe, seen
        if keyframe.phase == "drive":
            self._last_tcp = None
        self._line_from = seen.tcp[:3, 3] if self._last_tcp is None else self._last_tcp[:3, 3]
        if keyframe.phase in ("transit", *LINES):
            self._last_tcp = keyframe.tcp
        self._steps = self._still = 0
        self._width = float(seen.widths[0])
        self._posture: Array | None = None
        self.is_over = self.has_stopped = False

    def act(self, seen: ParsedObservation) -> Array:
        """The next action (12,) of "joint" control."""
        keyframe, goal = self._keyframe, self._goal(seen)
        self._steps += 1
        is_loaded = bool((seen.objects[:, _HELD] > 0).any())
        return action_towards(self._robot, seen, goal, self._finger(seen), is_loaded and keyframe.phase == "drive")

    def update(self, seen: ParsedObservation) -> None:
        """Compare the observation after an action with the keyframe."""
        width = float(seen.widths[0])
        self._still = self._still + 1 if abs(width - self._width) < _STILL else 0
        self._width = width
        self.has_stopped = self._steps >= _MOST_STEPS
        self.is_over = self.has_stopped or self._is_reached(seen)

    def _finger(self, seen: ParsedObservation) -> float:
        """[m] Position of each finger: only in phases of the fingers another one than commanded before."""
        if self._keyframe.phase in FINGERS:
            return self._keyframe.finger
        return self._robot.finger_position(float(seen.widths[1]))

    def _goal(self, seen: ParsedObservation) -> Array:
        """(11,) Whole-body configuration to go towards now."""
        keyframe, goal = self._keyframe, self._start.whole_body.copy()
        if keyframe.phase == "drive":
            goal[:3], goal[3:] = keyframe.base, keyframe.q
        elif keyframe.phase == "retreat":
            goal[3:] = keyframe.q
        elif keyframe.phase == "transit":
            near, iterations = (keyframe.q, 12) if self._posture is None else (self._posture, 1)
            self._posture = self._ik.solve(near, _in_base(seen, keyframe.tcp), keyframe.q, iterations)
            goal[3:] = self._posture
        elif keyframe.phase in LINES:
            goal[3:] = self._ik.solve(self._near(seen, keyframe.q), self._ahead(seen), keyframe.q)
        goal[3:] = shorter_turns(self._robot, seen.q, goal[3:])
        return goal

    def _near(self, seen: ParsedObservation, reference: Array) -> Array:
        """(8,) The measured configuration, its endless joints within half a turn of a reference."""
        return shorter_turns(self._robot, reference, seen.q)

    def _ahead(self, seen: ParsedObservation) -> Array:
        """(4, 4) Gripper pose in the base's frame, ahead on the straight line from the last keyframe."""
        tcp, start = np.array(self._keyframe.tcp), self._line_from
        line = tcp[:3, 3] - start
        length = float(np.linalg.norm(line))
        if length > _AHEAD:
            along = line / length
            come = float((seen.tcp[:3, 3] - start) @ along)
            beside = start + along * come - seen.tcp[:3, 3]
            tcp[:3, 3] = start + along * min(length, max(come, 0.0) + _AHEAD) + _BACK * beside
        return _in_base(seen, tcp)

    def _is_reached(self, seen: ParsedObservation) -> bool:
        phase = self._keyframe.phase
        if phase in FINGERS:
            return self._still >= _STILL_STEPS and self._steps >= _FINGER_STEPS
        is_slow = bool((np.abs(seen.velocity) < _SLOW).all()) and self._steps > _STILL_STEPS
        if phase in LINES:
            distance = float(np.linalg.norm(seen.tcp[:3, 3] - self._keyframe.tcp[:3, 3]))
            limit = _AT_CONTACT if phase in ("approach", "lower") else _AWAY
            return distance < limit and (is_slow or phase in ("lift", "rise"))
        error = np.abs(error_to(seen, self._goal(seen)))
        if phase == "drive":
            return bool((error[:3] < _AT_BASE).all() and (error[3:] < _AT_ARM).all())
        if phase == "transit":
            distance = float(np.linalg.norm(seen.tcp[:3, 3] - self._keyframe.tcp[:3, 3]))
            return bool((error[3:] < _AT_ARM).all()) and (distance < _AT_CONTACT or is_slow)
        return bool((error[3:] < _PASSING).all())


def _in_base(seen: ParsedObservation, tcp: Array) -> Array:
    """A gripper pose (4, 4) in the frame of the measured base."""
    return np.asarray(np.linalg.inv(planar_pose(seen.base)) @ tcp)
