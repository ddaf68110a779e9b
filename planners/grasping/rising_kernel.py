"""Does the arm lift the gripper straight up? For robots whose torso stays where it is, compiled."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from irm.compilation import njit
from planners.collision.configuration_kernel import CollisionQuery, configuration_hits
from planners.collision.straight_line_kernel import follow_line
from planners.scene.masks import SELF_BIT

Array = NDArray[np.float64]

_SELF, _NONE = np.uint64(1 << SELF_BIT), np.uint64(0)
_RISE, _RISE_STEP, _RISE_JUMP = 0.19, 0.01, 0.15
"""Where the torso stays, only configurations count from which the arm lifts the gripper so far straight up [m], in
steps [m] in which no joint turns farther than this [rad]: it could not take the object away in others."""


@njit(cache=True)
def can_rise(query: CollisionQuery, base: Array, q: Array) -> bool:
    """Whether the arm lifts the gripper straight up by `_RISE` without touching the robot."""
    robot, up = query.robot, np.array((0.0, 0.0, 1.0))
    path = follow_line(robot, q, up, _RISE, _RISE_STEP, _RISE_JUMP, np.ones(q.shape[0]))
    if path.shape[0] < math.ceil(_RISE / _RISE_STEP - 1e-9) + 1:
        return False
    for k in range(path.shape[0] - 1, 0, -3):
        if configuration_hits(query, query.active & _SELF, base, path[k]) != _NONE:
            return False
    return True
