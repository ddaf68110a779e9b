"""Straight lines of the TCP on a standing base, its orientation kept."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planners.collision.world import CollisionWorld
from planners.motion.arm import FIXED_BITS, ArmPath, BlockedBy, NoPath, named_bits, on_base
from planners.motion.straight_line_kernel import track_line
from planners.scene import HeldObject

__all__ = ["plan_straight", "trace_by_torso", "trace_straight"]

LINE_STEP = 0.01
"""[m] between samples of a straight line."""
LINE_JUMP = 0.15
"""[rad] that a joint may turn between them: more means a singularity."""


def plan_straight(
    world: CollisionWorld,
    base: ArrayLike,
    q_start: ArrayLike,
    direction: ArrayLike,
    distance: float,
    opening: float,
    held: HeldObject | None = None,
    ignore: int = 0,
    *,
    phase: str = "approach",
) -> ArmPath | BlockedBy | NoPath:
    """A straight line of the TCP, its orientation kept.

    Args:
        world: the scene, compiled.
        base: (3,) where the base stands.
        q_start: (8,) where the line starts; the path continues it without jumps.
        direction: (3,) in the world, unit length.
        distance: [m].
        opening, held, ignore, phase: as for `plan_arm`.

    Returns:
        the path; exactly the objects that the line hits; or why clearing would not help.
    """
    place, start = np.array(base, dtype=float), np.array(q_start, dtype=float)
    waypoints = trace_straight(world, place, start, direction, distance)
    if waypoints is None:
        return NoPath(f"{phase}: the arm cannot follow a straight line of {distance:.2f} m")
    hits = world.path_hits(on_base(place, waypoints), opening, held, ignore)
    if hits & FIXED_BITS:
        return NoPath(f"{phase}: the line touches {named_bits(world, hits & FIXED_BITS)}")
    if hits:
        return BlockedBy(frozenset(world.scene.names_of(hits)), phase)
    return ArmPath(place, waypoints, opening, held, ignore)


def trace_straight(
    world: CollisionWorld,
    base: NDArray[np.float64],
    q_start: NDArray[np.float64],
    direction: ArrayLike,
    distance: float,
) -> NDArray[np.float64] | None:
    """Waypoints (n, 8) of a straight line, obstacles not looked at; None where the arm cannot follow."""
    along = np.asarray(direction, dtype=float)
    c, s = math.cos(base[2]), math.sin(base[2])
    in_base = np.array([c * along[0] + s * along[1], c * along[1] - s * along[0], along[2]])
    speed = np.array(world.scene.robot.max_velocity[3:])
    path = track_line(world.robot, q_start, in_base, distance, LINE_STEP, LINE_JUMP, speed)
    samples = max(1, math.ceil(distance / LINE_STEP - 1e-9)) + 1
    return np.asarray(path) if len(path) == samples else None


def trace_by_torso(
    world: CollisionWorld,
    _base: NDArray[np.float64],
    q_start: NDArray[np.float64],
    direction: ArrayLike,
    distance: float,
) -> NDArray[np.float64] | None:
    """As `trace_straight` for a vertical line, with the torso alone: in any configuration of the arm, but with its
    limits."""
    robot, along = world.robot, np.asarray(direction, dtype=float)
    end = q_start[0] + distance * along[2]
    if abs(along[2]) < 1.0 - 1e-9 or not robot.lower[0] <= end <= robot.upper[0]:
        return None
    waypoints = np.tile(q_start, (max(1, math.ceil(distance / LINE_STEP - 1e-9)) + 1, 1))
    waypoints[:, 0] = np.linspace(q_start[0], end, len(waypoints))
    return waypoints
