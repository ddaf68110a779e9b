"""Driving between base poses with the arm kept still: the whole robot is checked, not only its footprint."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planners.collision.world import STEP, CollisionWorld
from planners.motion.arm import SHORTCUTS
from planners.motion.path import CLEARANCE, NoPath, WholeBodyPath, on_base
from planners.motion.rrt import rrt_connect, shortcut
from planners.scene import HeldObject

_ITERATIONS, _NEAR = 2400, 0.0
"""As for the arm, but detours around static obstacles are far from the straight line: no targets are drawn near it."""
_RETREATS = (0.0, 0.15, 0.35, 0.6, 0.9)
"""[m] that the base backs away from the table before it drives along, tried in this order."""
_ROAM = 1.0
"""[m] beyond start and goal within which a detour is searched for."""

Array = NDArray[np.float64]


def plan_base(
    world: CollisionWorld,
    start: ArrayLike,
    goal: ArrayLike,
    q: ArrayLike,
    *,
    opening: float | None = None,
    held: HeldObject | None = None,
    rng: np.random.Generator | None = None,
) -> WholeBodyPath | NoPath:
    """A collision-free motion of the base: straight if possible, else backing away first, else by RRT-Connect.

    Motions at a distance of `CLEARANCE` from everything come first.

    Args:
        world: the scene, compiled.
        start: (3,) base pose.
        goal: (3,) base pose; its yaw may be any number of turns away.
        q: (8,) configuration of torso and arm on the way.
        opening: of the gripper [m]; by default closed around the held object, fully open without one.
        held: the held object.
        rng: for the random trees; seed 0 if not given.

    Returns:
        the path, or why there is none.
    """
    here, there, configuration = (np.array(v, dtype=float) for v in (start, goal, q))
    if opening is None:
        opening = 0.0 if held is not None else world.scene.robot.max_opening
    there[2] = unwrap_yaw(there[2], here[2])
    for padded in (world.with_padding(CLEARANCE), world):
        for waypoints in _simple_paths(here, there):
            X = on_base(waypoints, configuration)
            if not padded.path_hits(X, opening, held, first_only=True):
                return WholeBodyPath(X, opening, held)
    for name, place in (("start", here), ("goal", there)):
        touched = world.hits(place, configuration, opening, held)
        if touched:
            return NoPath(f"drive: the {name} touches {' and '.join(world.names_of(touched))}")
    X = on_base(np.stack((here, there)), configuration)
    lower, upper = X.min(axis=0), X.max(axis=0)
    lower[:3] -= (_ROAM, _ROAM, math.pi)
    upper[:3] += (_ROAM, _ROAM, math.pi)
    checks, rng = world.query(opening, held, first_only=True), rng or np.random.default_rng(0)
    path = rrt_connect(checks, X[0], X[1:], lower, upper, STEP, _ITERATIONS, _NEAR, rng)
    if len(path):
        path = shortcut(checks, path, STEP, SHORTCUTS, rng)
        if not world.path_hits(path, opening, held):
            return WholeBodyPath(path, opening, held)
    return NoPath("drive: no path around the static obstacles found")


def unwrap_yaw(yaw: float, near: float) -> float:
    """The same yaw [rad], at most half a turn away from another one."""
    return near + math.remainder(yaw - near, 2 * math.pi)


def _simple_paths(start: Array, goal: Array) -> Iterator[Array]:
    """Waypoints (n, 3): turning on the way, before it or after it; then the same after backing away from the table."""
    for retreat in _RETREATS:
        x = min(start[0], goal[0]) - retreat
        first, last = np.array([x, start[1], start[2]]), np.array([x, goal[1], goal[2]])
        if retreat == 0.0:
            yield np.stack((start, goal))
            yield np.stack((start, np.array([*start[:2], goal[2]]), goal))
            yield np.stack((start, np.array([*goal[:2], start[2]]), goal))
        yield np.stack((start, first, last, goal))
        yield np.stack((start, first, np.array([x, start[1], goal[2]]), last, goal))
        yield np.stack((start, first, np.array([x, goal[1], start[2]]), last, goal))
