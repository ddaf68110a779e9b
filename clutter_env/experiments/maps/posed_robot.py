"""A robot in a MuJoCo model, open and still but for its base, torso and active arm."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from assets.robots import RobotSpec

__all__ = ["PosedRobot"]


class PosedRobot:
    """A compiled model whose robot is put into whole-body configurations.

    Attributes:
        model, data: of MuJoCo; the gripper is open, head and idle arms are in `robot.still_configuration`.
    """

    def __init__(self, spec: mujoco.MjSpec, robot: RobotSpec) -> None:
        self.model: mujoco.MjModel = spec.compile()
        self.data = mujoco.MjData(self.model)
        self._columns = [self.model.joint(name).qposadr[0] for name in robot.drive_joints]
        for joint in robot.finger_joints:
            self.data.joint(joint).qpos = robot.max_finger_position
        for joint, angle in zip(robot.still_joints, robot.still_configuration, strict=True):
            self.data.joint(joint).qpos = angle

    def put(self, base: NDArray[np.float64], q: NDArray[np.float64]) -> None:
        """Write a base pose (3,) x, y [m], yaw [rad], and torso and arm (1 + n,); `data` is not computed anew."""
        self.data.qpos[self._columns] = np.concatenate([base, q])
