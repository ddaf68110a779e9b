"""Keeps differential inverse kinematics from moving the robot into itself: bounds on how fast shapes may approach."""

from __future__ import annotations

import math

import mujoco
import numpy as np
from numpy.typing import NDArray

from assets import RobotSpec, robot_contacts
from clutter_env.simulation.control import CONTROL_STEP

Vector = NDArray[np.float64]

_LOOK_AHEAD = 0.15
"""[m] Shapes that are farther apart approach as they like: an arm at full speed stops within this distance."""
_DISTANCE = 0.015
"""[m] that shapes keep: the motors lag behind their targets by up to half of it."""
_BRAKING = 0.4
"""Share of the joints' accelerations that is counted on for braking; the rest is left to the gripper's own path."""


class SelfAvoidance:
    """Inequalities of the joints' displacement for pairs of the robot's shapes that are near each other."""

    def __init__(self, model: mujoco.MjModel, robot: RobotSpec) -> None:
        """Take the pairs that count by `assets.robot_contacts`; `model` is the robot alone, with its file's geoms."""
        self._model, self._pairs = model, robot_contacts(robot).pairs
        first, second = self._pairs.T
        self._near = model.geom_rbound[first] + model.geom_rbound[second] + _LOOK_AHEAD
        self._near_squared = self._near**2
        self._segment, self._accelerations = np.empty(6), _BRAKING * np.array(robot.max_acceleration[3:])
        self._of_first, self._of_second = np.empty((2, 3, model.nv))

    def inequalities(self, data: mujoco.MjData, lowest: Vector, highest: Vector) -> tuple[Vector, Vector]:
        """Rows (k, n) and upper bounds (k,) of a step's displacement; k is 0 in most steps.

        Args:
            data: with the kinematics of the configuration from which the step starts.
            lowest, highest: (n,) displacements between which the joints' own limits keep the step. A bound that they
                cannot keep becomes the nearest that they can: the arm then brakes as hard as it may.
        """
        model, segment, rows, bounds = self._model, self._segment, list[Vector](), list[float]()
        apart = data.geom_xpos[self._pairs[:, 0]] - data.geom_xpos[self._pairs[:, 1]]
        apart *= apart
        for pair in np.flatnonzero(apart[:, 0] + apart[:, 1] + apart[:, 2] < self._near_squared).tolist():
            one, other = self._pairs[pair].tolist()
            distance = mujoco.mj_geomDistance(model, data, one, other, _LOOK_AHEAD, segment)
            if distance >= _LOOK_AHEAD:
                continue
            row = self._approach(data, one, other, distance)
            braking = mujoco.mju_dot(np.abs(row), self._accelerations) * CONTROL_STEP**2  # [m] a step, per step
            left = max(distance - _DISTANCE, 0.0)
            allowed = math.sqrt((braking / 2) ** 2 + 2 * braking * left) - braking / 2
            least = mujoco.mju_dot(np.minimum(row, 0.0), highest) + mujoco.mju_dot(np.maximum(row, 0.0), lowest)
            rows.append(row)
            bounds.append(max(allowed, least))
        return np.array(rows).reshape(-1, model.nv), np.array(bounds)

    def _approach(self, data: mujoco.MjData, one: int, other: int, distance: float) -> Vector:
        """How much nearer (n,) two geoms come by a displacement of each joint."""
        start, end = self._segment[:3], self._segment[3:]
        direction = end - start if distance > 0.0 else start - end  # from the first to the second
        mujoco.mju_normalize3(direction)
        mujoco.mj_jac(self._model, data, self._of_first, None, start, int(self._model.geom_bodyid[one]))
        mujoco.mj_jac(self._model, data, self._of_second, None, end, int(self._model.geom_bodyid[other]))
        row: Vector = np.empty(self._model.nv)
        mujoco.mju_mulMatTVec(row, self._of_first - self._of_second, direction)
        return row
