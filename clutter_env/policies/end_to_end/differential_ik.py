"""Differential inverse kinematics: damped least squares that stays near a reference configuration."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from assets import RobotSpec
from irm import PRISMATIC, ArmChain
from irm.kinematics import link_frames
from irm.rotations import rotation_vectors

Array = NDArray[np.float64]

_TURN = 0.3
"""[m] that an error of one radian counts as."""
_DAMPING = 1e-4
"""Weight of a step of the joints against the squared error of the gripper."""
_LARGEST_STEP = 0.25
"""[rad], [m] of a joint in one iteration."""
_TORSO_STEP = 0.5
"""Step of the torso [m] that costs as much as one radian of the arm: it is slow."""


class DifferentialIK:
    """Moves torso and arm towards a gripper pose, step by step. What the pose leaves free goes towards a reference."""

    def __init__(self, robot: RobotSpec) -> None:
        self._chain = ArmChain.from_robot(robot)
        self._lower = np.array([link.lower for link in robot.chain])
        self._upper = np.array([link.upper for link in robot.chain])
        self._step = np.ones(self._chain.size)
        self._step[0] = _TORSO_STEP

    def solve(self, q: Array, T_base_tcp: Array, reference: Array, iterations: int = 3) -> Array:
        """Configuration (n,) near `q` (n,) whose gripper pose is nearer to T_base_tcp (4, 4).

        Args:
            q: torso [m] and arm [rad].
            T_base_tcp: of the gripper that is wanted.
            reference: (n,) that free joints go towards.
            iterations: of the linearised problem.
        """
        q = np.array(q)
        for _ in range(iterations):
            R, p = link_frames(self._chain, q)
            error = np.concatenate((T_base_tcp[:3, 3] - p[-1], _TURN * rotation_vectors(T_base_tcp[:3, :3] @ R[-1].T)))
            J = self._jacobian(R, p) * self._step
            towards = (reference - q) / self._step
            A = J.T @ J + _DAMPING * np.eye(len(q))
            step = self._step * np.linalg.solve(A, J.T @ error + _DAMPING * towards)
            q = np.clip(q + np.clip(step, -_LARGEST_STEP, _LARGEST_STEP), self._lower, self._upper)
        return q

    def _jacobian(self, R: Array, p: Array) -> Array:
        """(6, n) of the TCP in the base's frame, linear rows first, the angular ones in `_TURN` metres."""
        axes = self._chain.axes
        along = np.take_along_axis(R[:-1], (axes % PRISMATIC)[:, None, None], axis=2)[..., 0]
        slides = (axes >= PRISMATIC)[:, None]
        linear = np.where(slides, along, np.cross(along, p[-1] - p[:-1]))
        return np.concatenate((linear, _TURN * np.where(slides, 0.0, along)), axis=1).T
