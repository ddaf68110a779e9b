"""Actions that move the robot to a keyframe, from what an observation shows of it."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from assets import RobotSpec
from clutter_env.config import CONTROL_HZ
from clutter_env.learning.contacts.reading import Reading, wrapped

__all__ = ["action_towards", "error_to", "grip_action", "stay"]

Array = NDArray[np.float64]

RESPONSE = 0.12
"""[s] in which the rest of a motion shrinks to 1 / e; the measured joints lag about 0.02 s behind their targets."""
_NOTHING = 1e-4
"""[m], [rad] A joint this near its goal does not determine the pace."""
_BRAKING_SHARE = 0.8
"""Share of the greatest acceleration that is counted on for braking."""


def error_to(reading: Reading, goal: Array) -> Array:
    """(11,) from the measured configuration to a whole-body configuration; x and y in the base's frame."""
    error = goal - reading.whole_body
    error[2] = wrapped(error[2])
    cosine, sine = math.cos(reading.base[2]), math.sin(reading.base[2])
    error[:2] = cosine * error[0] + sine * error[1], cosine * error[1] - sine * error[0]
    return error


def action_towards(robot: RobotSpec, reading: Reading, goal: Array, finger_position: float, is_loaded: bool) -> Array:
    """The "joint" action (12,) towards a keyframe, straight in joint space and with room to brake.

    All joints speed up, go on and arrive together, as the slowest of them can.

    Args:
        robot: its velocity and acceleration limits count.
        reading: where it is.
        goal: (11,) base x, y [m], yaw [rad], torso [m], arm [rad].
        finger_position: [m] of one finger.
        is_loaded: whether an object is held: the base then turns slowly.
    """
    error = error_to(reading, goal)
    limit = np.array(robot.max_velocity)
    if is_loaded:
        limit[2] = min(limit[2], robot.max_loaded_yaw_rate)
    size = np.abs(error)
    braking = np.sqrt(2 * _BRAKING_SHARE * np.array(robot.max_acceleration) * size)
    speed = np.minimum(np.minimum(size / RESPONSE, braking), limit)
    speed = np.minimum(speed, np.abs(reading.velocity) + np.array(robot.max_acceleration) / CONTROL_HZ)
    matters = size > _NOTHING
    time = max(float((size[matters] / speed[matters]).max(initial=0.0)), 1 / CONTROL_HZ)
    action = np.clip(error / time / np.array(robot.max_velocity), -1.0, 1.0)
    return np.append(action, grip_action(robot, finger_position))


def grip_action(robot: RobotSpec, finger_position: float) -> float:
    """The last number of an action, for a position [m] of one finger."""
    return float(np.clip(2 * finger_position / robot.max_finger_position - 1, -1.0, 1.0))


def stay(robot: RobotSpec, reading: Reading) -> Array:
    """The action (12,) that keeps joints and fingers where they are commanded to be."""
    finger_position = robot.finger_position(float(reading.widths[1]))
    return np.append(np.zeros(len(robot.max_velocity)), grip_action(robot, finger_position))
