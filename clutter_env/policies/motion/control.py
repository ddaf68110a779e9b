"""Control towards a keyframe: "joint" actions, and feedback from the measured gripper pose."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from assets import RobotSpec
from clutter_env.config import CONTROL_HZ
from clutter_env.policies.parsed_observation import ParsedObservation, wrapped
from irm.rotations import rotation_vectors, rotations_by

Array = NDArray[np.float64]

_RESPONSE = 0.12
"""[s] Time in which the remaining motion shrinks to 1 / e. The measured joints lag about 0.02 s behind their
targets."""
_NOTHING = 1e-4
"""[m], [rad] A joint this near its goal does not determine the pace."""
_BRAKING_SHARE = 0.8
"""Share of the greatest acceleration that is counted on for braking."""

_GAIN = 0.15
"""Share of the measured error by which the offset changes in a control step. The arm follows in 0.1 s."""
MAX_SHIFT, MAX_TURN = 0.06, 0.3
"""[m], [rad] of the offset at most: the network was fitted to such."""
CLOSE, _ALIGNED = 0.008, 0.08
"""[m], [rad] Largest error of a gripper that continues along a straight line, which has 12 mm of clearance on each
side."""
_SHORT = 0.02
"""[m] from the contact up to which the error along the line is included."""


def error_to(seen: ParsedObservation, goal: Array) -> Array:
    """Difference (11,) from the measured to a whole-body configuration, with x and y in the base's frame."""
    error = goal - seen.whole_body
    error[2] = wrapped(error[2])
    cosine, sine = math.cos(seen.base[2]), math.sin(seen.base[2])
    error[:2] = cosine * error[0] + sine * error[1], cosine * error[1] - sine * error[0]
    return error


def action_towards(
    robot: RobotSpec, seen: ParsedObservation, goal: Array, finger_position: float, is_loaded: bool
) -> Array:
    """The "joint" action (12,) towards a keyframe, straight in joint space and slow enough to brake in time.

    All joints are synchronised to the slowest one.

    Args:
        robot: for its velocity and acceleration limits.
        seen: where it is.
        goal: (11,) base x, y [m], yaw [rad], torso [m], arm [rad].
        finger_position: [m] of one finger.
        is_loaded: whether an object is held: the base then turns slowly.
    """
    error = error_to(seen, goal)
    velocity, acceleration = np.array(robot.max_velocity), np.array(robot.max_acceleration)
    size = np.abs(error)
    braking = np.sqrt(2 * _BRAKING_SHARE * acceleration * size)
    speed = np.minimum(np.minimum(size / _RESPONSE, braking), velocity)
    if is_loaded:
        speed[2] = min(speed[2], robot.max_loaded_yaw_rate)
    speed = np.minimum(speed, np.abs(seen.velocity) + acceleration / CONTROL_HZ)
    matters = size > _NOTHING
    time = max(float((size[matters] / speed[matters]).max(initial=0.0)), 1 / CONTROL_HZ)
    action = np.minimum(np.maximum(error / time / velocity, -1.0), 1.0)  # faster than clip
    return np.concatenate((action, (grip_action(robot, finger_position),)))


def grip_action(robot: RobotSpec, finger_position: float) -> float:
    """The last number of an action, for a position [m] of one finger."""
    return min(max(2 * finger_position / robot.max_finger_position - 1, -1.0), 1.0)


def stay(robot: RobotSpec, seen: ParsedObservation) -> Array:
    """The action (12,) that keeps joints and fingers where they are commanded to be."""
    finger_position = robot.finger_position(float(seen.widths[1]))
    return np.append(np.zeros(len(robot.max_velocity)), grip_action(robot, finger_position))


@dataclass(frozen=True, eq=False)
class GripperError:
    """From the measured to the expected gripper pose.

    Attributes:
        shift: (3,) [m] in the world.
        rotation: (3, 3) in the world.
    """

    shift: Array
    rotation: Array

    @classmethod
    def between(cls, measured: Array, expected: Array) -> GripperError:
        """The error of two TCP poses (4, 4) in the world."""
        return cls(expected[:3, 3] - measured[:3, 3], expected[:3, :3] @ measured[:3, :3].T)

    def across(self, line: Array) -> GripperError:
        """The error without its component along a line (3,) [m] from the contact. For a short line: the whole error."""
        length = math.hypot(*line)
        if length < _SHORT:
            return self
        along = line / length
        return GripperError(self.shift - (self.shift @ along) * along, self.rotation)

    def is_small(self, share: float = 1.0) -> bool:
        """Whether the gripper may continue along its line, or the error is at most a share of the greatest such
        error."""
        is_aligned = self.rotation.trace() > 1.0 + 2.0 * math.cos(share * _ALIGNED)
        return bool(is_aligned and math.hypot(*self.shift) < share * CLOSE)


class IntegralOffset:
    """Integral offset correction: the contact in the network input is shifted by the integral of the error."""

    is_any = False  # whether it has been shifted at all

    def __init__(self) -> None:
        self._shift, self._rotation = np.zeros(3), np.eye(3)

    def correct(self, error: GripperError) -> None:
        """Change the offset by a share of an error."""
        self.is_any = True
        self._shift = limited(self._shift + _GAIN * error.shift, MAX_SHIFT)
        turned = rotations_by(_GAIN * rotation_vectors(error.rotation)) @ self._rotation
        self._rotation = rotations_by(limited(rotation_vectors(turned), MAX_TURN))

    def applied_to(self, contact: Array) -> Array:
        """The shifted TCP pose (4, 4) of a contact (4, 4), both in the world."""
        shifted = np.array(contact)
        shifted[:3, :3] = self._rotation @ contact[:3, :3]
        shifted[:3, 3] += self._shift
        return shifted


def limited(vectors: Array, most: float) -> Array:
    """Vectors (..., 3) shortened to this length where they are longer."""
    lengths = np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-12)
    return vectors * np.minimum(1.0, most / lengths)
