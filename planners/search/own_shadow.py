"""Share of its own camera's image that the robot hides, and arm configurations that hide little."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray

from assets.robots import RobotSpec
from planners.scene.mujoco_reading import RobotJoints

Array = NDArray[np.float64]

_RAYS = 16
"""Rays along each side of an image."""
_DRAWN = np.array((1, 1, 1, 0, 0, 0), np.uint8)
"""Groups of geoms that MuJoCo draws by default."""
_FARTHEST = 3.0
"""Largest distance [m] of robot parts in front of its camera."""
_TURNS, _LIFTS = (0.0, 0.3, -0.3, 0.6, -0.6, 0.9, -0.9, 1.2, -1.2, 1.5, -1.5), (0.0, 0.5, 1.0, 1.5)
"""Turns [rad] of the arm's first and second joint from home."""


class OwnShadow:
    """A robot's camera in a model of robot and furniture without objects.

    Args:
        model: the model with the robot at rest.
        robot: the robot.
        camera: name of the camera in the model.
        K: (3, 3) camera matrix.
        shape: (height, width) of the image.
    """

    def __init__(self, model: mujoco.MjModel, robot: RobotSpec, camera: str, K: Array, shape: tuple[int, int]) -> None:
        self._model, self._data, self._camera = model, mujoco.MjData(model), model.camera(camera).id
        mujoco.mj_forward(model, self._data)
        self._joints = RobotJoints.of(model, self._data, robot)
        self._head = [int(model.joint(name).qposadr[0]) for name in robot.head_joints]
        base = model.body(robot.base_body).id
        self._is_robot = model.body_rootid[model.geom_bodyid] == model.body_rootid[base]
        v, u = ((np.indices((_RAYS, _RAYS)) + 0.5) / _RAYS * np.reshape(shape, (2, 1, 1))).reshape(2, -1)
        self._rays = np.column_stack(((u - K[0, 2]) / K[0, 0], (K[1, 2] - v) / K[1, 1], -np.ones(len(u))))

    def share(self, drive: Array, points: Sequence[Array]) -> float:
        """Largest share of the image that the robot hides in a whole-body configuration, over some aims (3,) [m]."""
        model, data, largest = self._model, self._data, 0.0
        data.qpos[self._joints.columns] = self._joints.positions(drive)
        for point in points:
            for is_aimed in (not self._head, True):
                mujoco.mj_kinematics(model, data)
                mujoco.mj_camlight(model, data)
                if is_aimed:
                    break
                x, y, z = self._frame.T @ (point - data.cam_xpos[self._camera])
                data.qpos[self._head] += (-math.atan2(x, -z), math.atan2(-y, math.hypot(x, z)))
            rays = np.ascontiguousarray((self._rays @ self._frame.T).ravel())
            found, away = np.empty(_RAYS**2, np.int32), np.empty(_RAYS**2)
            eye, body = data.cam_xpos[self._camera], int(model.cam_bodyid[self._camera])
            mujoco.mj_multiRay(model, data, eye, rays, _DRAWN, 1, body, found, away, None, _RAYS**2, _FARTHEST)
            largest = max(largest, float((self._is_robot[found] & (found >= 0)).mean()))
        return largest

    @property
    def _frame(self) -> Array:
        """Right, up and back of the camera in the world (3, 3)."""
        return self._data.cam_xmat[self._camera].reshape(3, 3)


def arms_near(arm: Array) -> list[Array]:
    """Arm configurations with the first two joints turned from a given one."""
    found = []
    for turn, lift in itertools.product(_TURNS, _LIFTS):
        found.append(arm.copy())
        found[-1][:2] += turn, lift
    return found
