"""How far the robot's links, and pairs of them, may have moved along a motion: upper bounds, compiled.

A body that is d away from an obstacle in one state cannot have reached it while it has travelled less than d. So a
motion need be checked only where that leaves it open (Schwarzer, Saha & Latombe, "Adaptive dynamic collision checking
for single and multiple articulated robots in complex environments", IEEE T-RO 2005).

Kinds of pairs have a column each: column v says how far any point of link v has moved in the world, the others how far
any point of a link has moved as seen from an earlier one; see `pair_kind`. Link 0 is the base here, 1 the torso.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from irm.compilation import njit
from irm.kinematics import fk_frames
from planners.collision.scene_arrays import RobotArrays

Array = NDArray[np.float64]


def link_radii(robot: RobotArrays) -> Array:
    """(1 + n,) [m] from the origin of each link's frame to its farthest point; 0 for links without solids."""
    away = np.linalg.norm(robot.position, axis=1) + robot.bound
    return np.array([away[robot.link == link].max(initial=0.0) for link in range(-1, len(robot.axes))])


def pair_kind(first: int, second: int, links: int) -> int:
    """The column for two of `links` links, the base included, or one of them twice."""
    low, high = min(first, second), max(first, second)
    return links + high * (high + 1) // 2 + low


def count_kinds(links: int) -> int:
    """How many columns there are."""
    return links + links * (links + 1) // 2


@njit(cache=True)
def travelled(robot: RobotArrays, radii: Array, reach: Array, states: Array) -> Array:
    """Bounds (m, kinds) [m] of what has been travelled from the first state to each.

    Args:
        robot: with n joints; packed.
        radii: (1 + n,) of the links about the origins of their frames, held objects included.
        reach: (3 + n,) how far each joint moves any point of the robot or of what it holds, per radian or metre.
        states: (m, 4 + n) base pose, torso and arm, and the finger, which moves points of the last link by as much.
    """
    m, n = states.shape[0], robot.axes.shape[0]
    links = n + 1
    bounds = np.zeros((m, links + links * (links + 1) // 2))
    R, p = np.empty((2, n + 1, 3, 3)), np.empty((2, n + 1, 3))
    for row in range(m):
        now, before, x = row % 2, 1 - row % 2, states[row]
        fk_frames(robot.offsets, robot.axes, robot.tip, x[3 : 3 + n], R[now], p[now])
        c, s = math.cos(x[2]), math.sin(x[2])
        for k in range(n):
            a, b = p[now, k, 0], p[now, k, 1]
            p[now, k, 0], p[now, k, 1] = x[0] + c * a - s * b, x[1] + s * a + c * b
            for j in range(3):
                a, b = R[now, k, 0, j], R[now, k, 1, j]
                R[now, k, 0, j], R[now, k, 1, j] = c * a - s * b, s * a + c * b
        if row == 0:
            continue
        last, change = states[row - 1], np.abs(states[row] - states[row - 1])
        finger = change[3 + n]
        # Of the base: its way, and the chord of its turn.
        turn = 2.0 * math.sin(0.5 * min(change[2], math.pi))
        bounds[row, 0] = math.hypot(x[0] - last[0], x[1] - last[1]) + turn * radii[0]
        for k in range(n):
            way = 0.0
            rotated = 0.0
            for i in range(3):
                way += (p[now, k, i] - p[before, k, i]) ** 2
                for j in range(3):
                    rotated += (R[now, k, i, j] - R[before, k, i, j]) ** 2
            bounds[row, k + 1] = math.sqrt(way) + math.sqrt(0.5 * rotated) * radii[k + 1]
        bounds[row, n] += finger
        for high in range(links):
            swing = finger if high == n else 0.0
            for low in range(high, -1, -1):
                bounds[row, links + high * (high + 1) // 2 + low] = swing
                if low > 0:
                    swing += change[2 + low] * reach[2 + low]
        for kind in range(bounds.shape[1]):
            bounds[row, kind] += bounds[row - 1, kind]
    return bounds


@njit(cache=True)
def nearest_of_kinds(distances: Array, geoms: NDArray[np.int32], kinds: NDArray[np.int64], nearest: Array) -> None:
    """Lower `nearest` (kinds + 1,) [m] to the distances (k,) of pairs of geoms (k, 2) of each kind (ngeom, ngeom)."""
    for row in range(distances.shape[0]):
        kind = kinds[geoms[row, 0], geoms[row, 1]]
        nearest[kind] = min(nearest[kind], distances[row])
