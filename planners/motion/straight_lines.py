"""Straight lines of the TCP on a standing base, its orientation kept; collisions are not checked here."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planners.collision.straight_line_kernel import track_line
from planners.collision.world import CollisionWorld

Array = NDArray[np.float64]

LINE_STEP = 0.01
"""[m] between samples of a straight line."""
LINE_JUMP = 0.15
"""[rad] that a joint may turn between samples: more means a singularity."""
_VERTICAL = 1e-9
"""By how much the z component of a vertical direction may differ from 1."""


def trace_straight(
    world: CollisionWorld, base: Array, q_start: Array, direction: ArrayLike, distance: float
) -> Array | None:
    """Follow a straight line with torso and arm.

    Args:
        world: whose robot.
        base: (3,) x [m], y [m], yaw [rad].
        q_start: (8,) configuration in which the line starts.
        direction: (3,) unit vector in the world.
        distance: [m].

    Returns:
        waypoints (n, 8) from `q_start` on, without jumps; None where the arm cannot follow the line.
    """
    along = np.asarray(direction, dtype=float)
    c, s = math.cos(base[2]), math.sin(base[2])
    in_base = np.array([c * along[0] + s * along[1], c * along[1] - s * along[0], along[2]])
    speed, start = np.array(world.scene.robot.max_velocity[3:]), np.array(q_start, dtype=float)
    path = track_line(world.robot, start, in_base, distance, LINE_STEP, LINE_JUMP, speed)
    return np.asarray(path) if len(path) == _samples(distance) else None


def trace_by_torso(
    world: CollisionWorld, _base: Array, q_start: Array, direction: ArrayLike, distance: float
) -> Array | None:
    """Follow a vertical line with the torso alone.

    This works in every configuration of the arm, but only within the limits of the torso. Arguments and result as for
    `trace_straight`.
    """
    robot, along = world.robot, np.asarray(direction, dtype=float)
    end = q_start[0] + distance * along[2]
    if abs(along[2]) < 1.0 - _VERTICAL or not robot.lower[0] <= end <= robot.upper[0]:
        return None
    waypoints = np.tile(q_start, (_samples(distance), 1))
    waypoints[:, 0] = np.linspace(q_start[0], end, len(waypoints))
    return waypoints


def _samples(distance: float) -> int:
    """Samples of a line, both ends included."""
    return max(1, math.ceil(distance / LINE_STEP - 1e-9)) + 1
