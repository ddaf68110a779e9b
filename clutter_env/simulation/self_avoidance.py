"""Keeps differential inverse kinematics from moving the robot into itself: bounds on how fast shapes may approach."""

from __future__ import annotations

import math

import mujoco
import numpy as np
from numpy.typing import NDArray

from assets import RobotSpec, robot_contacts
from clutter_env.simulation.control import CONTROL_STEP

Vector = NDArray[np.float64]

_DISTANCE = 0.015
"""[m] that shapes keep: the motors lag behind their targets by up to half of it."""
_BRAKING = 0.4
"""Share of the joints' accelerations that is counted on for braking; the rest is left to the gripper's own path."""


class SelfAvoidance:
    """Inequalities of the joints' displacement for pairs of the robot's shapes that are near each other."""

    def __init__(self, model: mujoco.MjModel, robot: RobotSpec) -> None:
        """Take the pairs that count by `assets.robot_contacts`; `model` is the robot alone, with its file's geoms."""
        self._model, pairs = model, robot_contacts(robot).pairs
        self._segment = np.empty(6)
        self._of_first, self._of_second = np.empty((2, 3, model.nv))
        self._accelerations = _BRAKING * np.array(robot.max_acceleration[3:]) * CONTROL_STEP**2
        self._before = mujoco.MjData(model)
        levers = _levers(model)
        # A joint that moves both shapes alike brings them no nearer. No joint does that with shapes of arms that stay.
        first, second = levers[pairs[:, 0]], levers[pairs[:, 1]]
        apart = np.where((first > 0.0) != (second > 0.0), np.maximum(first, second), 0.0)
        brakes = (apart * self._accelerations).sum(axis=1)
        self._pairs, self._brakes = pairs[brakes > 0.0], brakes[brakes > 0.0]
        self._geoms, of_pairs = np.unique(self._pairs, return_inverse=True)
        self._first, self._second = of_pairs.reshape(-1, 2).T
        self._centres, self._halves = model.geom_aabb[self._geoms, :3], model.geom_aabb[self._geoms, 3:]
        self._is_off_centre = bool(self._centres.any())

    def inequalities(self, data: mujoco.MjData, qd: Vector, lowest: Vector, highest: Vector) -> tuple[Vector, Vector]:
        """Rows (k, n) and upper bounds (k,) of a step's displacement; k is 0 in most steps.

        Args:
            data: with the kinematics of the configuration from which the step starts.
            qd: (n,) velocities of the joints.
            lowest, highest: (n,) displacements between which the joints' own limits keep the step. A bound that they
                cannot keep becomes the nearest that they can: the arm then brakes as hard as it may.
        """
        rows, bounds = list[Vector](), list[float]()
        for pair, reach in self._near_pairs(data, qd):
            one, other = self._pairs[pair].tolist()
            distance = mujoco.mj_geomDistance(self._model, data, one, other, reach, self._segment)
            if distance >= reach:
                continue
            row = self._approach(data, one, other, distance)
            braking = mujoco.mju_dot(np.abs(row), self._accelerations)
            left = max(distance - _DISTANCE, 0.0)
            allowed = math.sqrt((braking / 2) ** 2 + 2 * braking * left) - braking / 2
            least = mujoco.mju_dot(np.minimum(row, 0.0), highest) + mujoco.mju_dot(np.maximum(row, 0.0), lowest)
            rows.append(row)
            bounds.append(max(allowed, least))
        return np.array(rows).reshape(-1, self._model.nv), np.array(bounds)

    def _near_pairs(self, data: mujoco.MjData, qd: Vector) -> list[tuple[int, float]]:
        """Pairs that could meet before the joints have stopped, and the distance [m] within which they could.

        Shapes are taken as their bounding boxes along the axes of the base, which come nearer as they did in the step
        before, or a little faster.
        """
        self._before.qpos[:] = data.qpos - qd * CONTROL_STEP
        mujoco.mj_kinematics(self._model, self._before)
        before, gaps = self._gaps(self._before, data)
        approach = np.maximum(before - gaps, 0.0) + self._brakes
        reach = _DISTANCE + approach + approach**2 / (2 * self._brakes)
        near = np.flatnonzero(gaps < reach)
        return list(zip(near.tolist(), reach[near].tolist(), strict=True))

    def _gaps(self, *states: mujoco.MjData) -> Vector:
        """Distances (k, p) [m] of the bounding boxes of each pair in k states, negative where they overlap.

        Sums and maxima of three numbers are written out: NumPy's over so short an axis take ten times as long.
        """
        axes = np.array([data.geom_xmat for data in states]).take(self._geoms, axis=1).reshape(len(states), -1, 3, 3)
        boxes = np.empty((len(states), len(self._geoms), 6))  # centres, and half extents along the axes of the base
        centres = boxes[..., :3]
        centres[:] = np.array([data.geom_xpos for data in states]).take(self._geoms, axis=1)
        if self._is_off_centre:
            offsets = axes * self._centres[:, None]
            centres += offsets[..., 0] + offsets[..., 1] + offsets[..., 2]
        halves = np.abs(axes, out=axes) * self._halves[:, None]
        boxes[..., 3:] = halves[..., 0] + halves[..., 1] + halves[..., 2]
        first, second = boxes.take(self._first, axis=1), boxes.take(self._second, axis=1)
        apart = np.abs(first[..., :3] - second[..., :3])
        apart -= first[..., 3:] + second[..., 3:]
        return np.maximum(np.maximum(apart[..., 0], apart[..., 1]), apart[..., 2])

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


def _levers(model: mujoco.MjModel) -> Vector:
    """How far (ngeom, n) each joint can move a point of each geom, at most: [m] per rad or m; 0 where it does not."""
    levers = np.zeros((model.ngeom, model.nv))
    for geom in range(model.ngeom):
        body, length = int(model.geom_bodyid[geom]), float(np.linalg.norm(model.geom_pos[geom]))
        length += float(model.geom_rbound[geom])
        while body:
            for joint in range(model.body_jntadr[body], model.body_jntadr[body] + model.body_jntnum[body]):
                is_slide = int(model.jnt_type[joint]) == int(mujoco.mjtJoint.mjJNT_SLIDE)
                lever = 1.0 if is_slide else length + float(np.linalg.norm(model.jnt_pos[joint]))
                levers[geom, model.jnt_dofadr[joint]] = lever
            length += float(np.linalg.norm(model.body_pos[body]))
            body = int(model.body_parentid[body])
    return levers
