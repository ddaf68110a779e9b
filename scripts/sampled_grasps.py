"""Answers about grasps beside grasps that are sampled in MuJoCo, without the planner's geometry, maps or kinematics.

    python -m scripts.check_questions --scenes 60 --sampled

For each of the 24 directions base poses are drawn at random around the object, before the table's edge. The arm is
brought to the hand pose by damped least squares on MuJoCo's own Jacobians. What gripper and arm touch there is what
MuJoCo says. A free grasp that is found refutes a "no"; a "yes" without one is counted too, as not found.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from clutter_env.scene.obstruction import side_approaches
from planners import Scene
from scripts.check_questions import Checker

BASES, UNREACHED = 150, 40
"""Base poses for each direction, at most, and those without any arm configuration after which it is given up."""
_MOST = 10_000
"""Draws of them; those in the table are drawn again."""
_NOISE = 0.6
"""[rad], [m] standard deviation of the first joint positions from the robot's arm in front of it."""
_NEAR, _FAR = 0.45, 1.05
"""[m] from the middle of the base to the hand, seen from above."""
_AHEAD = math.radians(70)
"""[rad] between the direction in which the base looks and that of the hand, at most."""
_STEPS = 60
"""Of the kinematics."""
_DAMPING = 1e-3
_LONGEST = 0.3
"""[rad], [m] of one step of a joint."""
_CLOSE = (1e-3, math.radians(0.5))
"""[m], [rad] from the hand pose."""
_SLOTS = slice(3, None)
"""Torso and arm in the joints of the drive."""
_HAND = ("gripper_link", "r_gripper_finger_link", "l_gripper_finger_link")


@dataclass
class SampledChecker(Checker):
    """Checks questions by grasps that are sampled in MuJoCo."""

    rng: np.random.Generator = field(default_factory=lambda: np.random.default_rng(0))
    _scene: tuple[bytes, dict[tuple[str, int], _Direction]] = (b"", {})

    def _is_free_from(self, scene: Scene, name: str, degrees: int) -> bool:
        inner: Any = self.env.unwrapped
        state = inner.data.qpos.tobytes()
        if self._scene[0] != state:
            self._scene = state, {}
        known = self._scene[1]
        if (name, degrees) not in known:
            known[name, degrees] = _Direction(inner, name, degrees, self.rng)
        return known[name, degrees].is_free(frozenset(scene.names) - {name})


class _Direction:
    """Grasps of an object from one direction, sampled when they are asked for."""

    def __init__(self, inner: Any, name: str, degrees: int, rng: np.random.Generator) -> None:
        self._inner, self._name, self._rng = inner, name, rng
        self._model, self._index = inner.model, inner.world.index
        self._data = mujoco.MjData(self._model)
        self._data.qpos[:] = inner.data.qpos
        slot = inner.world.names.index(name)
        half, yaw = inner.world.scene.half_extents[slot], math.radians(degrees)
        towards = np.array((math.cos(yaw), math.sin(yaw), 0.0))
        known = side_approaches(inner.robot.full_name)
        position = inner.data.body(name).xpos
        height = min(known.grasp_height, 2 * half[2] - known.pad_half_height)
        self._hand = position - max(half[0] - known.palm_reach, 0.0) * towards
        self._hand[2] = position[2] - half[2] + height
        left = np.array((-towards[1], towards[0], 0.0))
        self._turn = np.column_stack((towards, left, (0.0, 0.0, 1.0)))
        opening = min(2 * (half[0] + known.margins.finger_gap), inner.robot.max_opening)
        self._data.qpos[self._index.finger_qpos] = (opening - _closed(inner)) / 2
        self._by_hand: frozenset[str] | None = None
        self._touched: list[frozenset[str]] = []
        self._grasps = self._sampled()

    def is_free(self, others: frozenset[str]) -> bool:
        """Whether a grasp is found that touches none of these objects."""
        if any(not touched & others for touched in self._touched):
            return True
        for touched in self._grasps if not (self._by_hand or frozenset()) & others else ():
            self._touched.append(touched)
            if not touched & others:
                return True
            if self._by_hand and self._by_hand & others:
                return False
        return False

    def _sampled(self) -> Iterator[frozenset[str]]:
        """What each grasp touches that reaches the hand pose and neither the table nor the robot itself."""
        model, data, index = self._model, self._data, self._index
        robot = Scene.from_mujoco(self._inner.model, self._inner.data, self._inner.robot).robot
        edge = -self._inner.layout.depth / 2 - robot.base_radius
        low, high = model.jnt_range[model.dof_jntid[index.drive_dof[_SLOTS]]].T
        tried = reached = 0
        for _ in range(_MOST):
            bearing = self._rng.uniform(-math.pi / 2, math.pi / 2)
            at = self._hand[:2] - self._rng.uniform(_NEAR, _FAR) * np.array((math.cos(bearing), math.sin(bearing)))
            if at[0] > edge:
                continue
            if tried == BASES or (tried == UNREACHED and not reached):
                return
            tried += 1
            start = np.clip(robot.in_front + self._rng.normal(0.0, _NOISE, len(low)), low, high)
            data.qpos[index.drive_qpos] = (*at, bearing + self._rng.uniform(-_AHEAD, _AHEAD), *start)
            if self._is_reached(low, high):
                reached += 1
                if (touched := self._contacts()) is not None:
                    yield touched

    def _is_reached(self, low: NDArray[np.float64], high: NDArray[np.float64]) -> bool:
        """Bring the arm to the hand pose, by damped least squares; whether it is there."""
        model, data, index = self._model, self._data, self._index
        linear, angular = np.empty((3, model.nv)), np.empty((3, model.nv))
        joints, dofs = index.drive_qpos[_SLOTS], index.drive_dof[_SLOTS]
        for _ in range(_STEPS):
            mujoco.mj_kinematics(model, data)
            mujoco.mj_comPos(model, data)
            site = data.site(index.tcp_site)
            turn = site.xmat.reshape(3, 3)
            away = self._hand - site.xpos
            turned = 0.5 * np.cross(turn.T, self._turn.T).sum(axis=0)
            is_upside_down = np.trace(turn.T @ self._turn) < 0.0
            if np.linalg.norm(away) < _CLOSE[0] and np.linalg.norm(turned) < _CLOSE[1] and not is_upside_down:
                return True
            if is_upside_down:  # the vector above is zero at half a turn
                turned = turned / max(float(np.linalg.norm(turned)), 1e-3)
            mujoco.mj_jacSite(model, data, linear, angular, index.tcp_site)
            jacobian = np.vstack((linear[:, dofs], angular[:, dofs]))
            wanted = np.concatenate((away, turned))
            step = jacobian.T @ np.linalg.solve(jacobian @ jacobian.T + _DAMPING * np.eye(6), wanted)
            step *= min(1.0, _LONGEST / float(np.abs(step).max()))
            data.qpos[joints] = np.clip(data.qpos[joints] + step, low, high)
        return False

    def _contacts(self) -> frozenset[str] | None:
        """Names of the objects that the robot touches but the grasped one, None if it touches anything else."""
        model, data = self._model, self._data
        mujoco.mj_collision(model, data)
        root, objects = model.body_rootid[self._index.base_body], set(self._inner.world.names)
        by_hand, touched = set[str](), set[str]()
        for pair in model.geom_bodyid[data.contact.geom]:
            of_robot = [body for body in pair if model.body_rootid[body] == root]
            others = {model.body(body).name for body in pair} - {model.body(body).name for body in of_robot}
            if not of_robot or others == {self._name}:
                continue
            if not others <= objects or not others:
                return None
            touched |= others
            if model.body(of_robot[0]).name in _HAND:
                by_hand |= others
        self._by_hand = frozenset(by_hand)
        return frozenset(touched)


def _closed(inner: Any) -> float:
    """[m] between the closed fingers."""
    return float(Scene.from_mujoco(inner.model, inner.data, inner.robot).robot.finger_gap_closed)
