"""Self-collision avoidance for differential inverse kinematics: bounds on how fast shapes may approach."""

from __future__ import annotations

import math

import mujoco
import numpy as np
from numpy.typing import NDArray

from assets import RobotSpec, robot_contacts
from clutter_env.simulation.control import CONTROL_STEP

Vector = NDArray[np.float64]

_DISTANCE = 0.015
"""[m] Distance that shapes keep. The motors lag behind their targets by up to half of it."""
_BRAKING = 0.4
"""Share of the joints' accelerations that is used for braking. The rest is left to the gripper's own path."""


class SelfAvoidance:
    """Inequalities of the joints' displacement for pairs of neighbouring shapes of the robot."""

    def __init__(self, model: mujoco.MjModel, robot: RobotSpec) -> None:
        """Take the pairs that `assets.robot_contacts` selects. `model` is the robot alone, with its file's geoms."""
        self._model, pairs = model, robot_contacts(robot).pairs
        self._segment = np.empty(6)
        self._of_first, self._of_second = np.empty((2, 3, model.nv))
        self._accelerations = _BRAKING * np.array(robot.max_acceleration[3:]) * CONTROL_STEP**2
        self._before = mujoco.MjData(model)
        levers = _levers(model)
        # A joint that moves both shapes alike does not reduce their distance. All joints do that for two shapes of idle
        # arms.
        first, second = levers[pairs[:, 0]], levers[pairs[:, 1]]
        apart = np.where((first > 0.0) != (second > 0.0), np.maximum(first, second), 0.0)
        brakes = (apart * self._accelerations).sum(axis=1)
        counted, self._brakes = pairs[brakes > 0.0], brakes[brakes > 0.0]
        self._pairs = [(one, other) for one, other in counted.tolist()]
        self._double_brakes = 2 * self._brakes
        self._boxes = _Boxes(model, counted)
        self._none = np.empty((0, model.nv)), np.empty(0)

    def inequalities(self, data: mujoco.MjData, qd: Vector, lowest: Vector, highest: Vector) -> tuple[Vector, Vector]:
        """Rows (k, n) and upper bounds (k,) of a step's displacement. In most steps k is 0.

        Args:
            data: with the kinematics of the configuration from which the step starts.
            qd: (n,) velocities of the joints.
            lowest, highest: (n,) displacements between which the joints' own limits keep the step. A bound that they
                cannot keep is replaced by the nearest that they can. The arm then brakes as hard as possible.
        """
        rows, bounds = list[Vector](), list[float]()
        for pair, reach in self._near_pairs(data, qd):
            one, other = self._pairs[pair]
            # Most pairs are far apart. A distance query without the closest points takes half as long.
            if mujoco.mj_geomDistance(self._model, data, one, other, reach, None) >= reach:
                continue
            distance = mujoco.mj_geomDistance(self._model, data, one, other, reach, self._segment)
            row = self._approach(data, one, other, distance)
            braking = mujoco.mju_dot(np.abs(row), self._accelerations)
            left = max(distance - _DISTANCE, 0.0)
            allowed = math.sqrt((braking / 2) ** 2 + 2 * braking * left) - braking / 2
            least = mujoco.mju_dot(np.minimum(row, 0.0), highest) + mujoco.mju_dot(np.maximum(row, 0.0), lowest)
            rows.append(row)
            bounds.append(max(allowed, least))
        return (np.array(rows), np.array(bounds)) if rows else self._none

    def _near_pairs(self, data: mujoco.MjData, qd: Vector) -> list[tuple[int, float]]:
        """Pairs that could collide before the joints have stopped, and the distance [m] within which they could.

        Shapes are replaced by their bounding boxes along the axes of the base. The boxes are assumed to approach as in
        the last step, or a little faster.
        """
        self._before.qpos[:] = data.qpos - qd * CONTROL_STEP
        mujoco.mj_kinematics(self._model, self._before)
        before, gaps = self._boxes.gaps(self._before, data)
        approach = np.maximum(before - gaps, 0.0) + self._brakes
        reach = _DISTANCE + approach + approach * approach / self._double_brakes
        near = (gaps < reach).nonzero()[0]
        return list(zip(near.tolist(), reach[near].tolist(), strict=True))

    def _approach(self, data: mujoco.MjData, one: int, other: int, distance: float) -> Vector:
        """Decrease (n,) of the distance of two geoms per displacement of each joint."""
        start, end = self._segment[:3], self._segment[3:]
        direction = end - start if distance > 0.0 else start - end  # from the first to the second
        mujoco.mju_normalize3(direction)
        mujoco.mj_jac(self._model, data, self._of_first, None, start, int(self._model.geom_bodyid[one]))
        mujoco.mj_jac(self._model, data, self._of_second, None, end, int(self._model.geom_bodyid[other]))
        row: Vector = np.empty(self._model.nv)
        mujoco.mju_mulMatTVec(row, self._of_first - self._of_second, direction)
        return row


class _Boxes:
    """Bounding boxes of pairs of shapes, along the axes of the base, in two states.

    Arrays have a row for each coordinate and a column for each shape or pair, and are allocated once. Allocating small
    arrays, or iterating over rows of three numbers, takes NumPy as long as filling them.
    """

    def __init__(self, model: mujoco.MjModel, pairs: NDArray[np.int64]) -> None:
        """Take pairs (p, 2) of geoms of a model."""
        geoms, of_pairs = np.unique(pairs, return_inverse=True)
        self._first, self._second = np.ascontiguousarray(of_pairs.reshape(-1, 2).T)
        centres, halves = model.geom_aabb[geoms, :3].T, model.geom_aabb[geoms, 3:].T
        self._centres = np.repeat(centres, 3, axis=0) if centres.any() else None
        self._halves = np.repeat([halves] * 2, 3, axis=1)
        self._turn_at = 9 * geoms + np.array((0, 3, 6, 1, 4, 7, 2, 5, 8))[:, None]  # columns of rotation matrices
        self._place_at = 3 * geoms + np.arange(3)[:, None]
        self._turns = np.empty((2, 9, len(geoms)))
        self._boxes = np.empty((4, 3, len(geoms)))  # centres in both states, then half extents in both states
        self._of_first, self._of_second = np.empty((2, 12, len(pairs)))
        self._apart, self._extents = np.empty((2, 6, len(pairs)))

    def gaps(self, *states: mujoco.MjData) -> Vector:
        """Distances (2, p) [m] of the bounding boxes of each pair in two states, negative for an overlap."""
        turns, boxes, first, second, apart = self._turns, self._boxes, self._of_first, self._of_second, self._apart
        for data, turn, centre in zip(states, turns, boxes, strict=False):
            data.geom_xmat.take(self._turn_at, out=turn, mode="clip")
            data.geom_xpos.take(self._place_at, out=centre, mode="clip")
            if self._centres is not None:
                offsets = turn * self._centres
                centre += offsets[:3] + offsets[3:6] + offsets[6:]
        np.abs(turns, out=turns)
        np.multiply(turns, self._halves, out=turns)
        halves = boxes[2:]
        np.add(turns[:, :3], turns[:, 3:6], out=halves)
        np.add(halves, turns[:, 6:], out=halves)
        rows = boxes.reshape(12, -1)
        rows.take(self._first, axis=1, out=first, mode="clip")
        rows.take(self._second, axis=1, out=second, mode="clip")
        np.abs(np.subtract(first[:6], second[:6], out=apart), out=apart)
        np.subtract(apart, np.add(first[6:], second[6:], out=self._extents), out=apart)
        of_axes = apart.reshape(2, 3, -1)
        return np.maximum(np.maximum(of_axes[:, 0], of_axes[:, 1]), of_axes[:, 2])


def _levers(model: mujoco.MjModel) -> Vector:
    """Largest motion (ngeom, n) of a point of each geom per motion of each joint: [m] per rad or m, 0 for joints that
    do not move it."""
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
