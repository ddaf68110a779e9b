"""Actions of an environment for the commands of an executor."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planners.expert.executor import Command
from planners.expert.interfaces import ControlledEnv
from planners.motion.arm import tcp_pose
from planners.scene import RobotState

Array = NDArray[np.float64]


class Actions:
    """Converter of commands to actions in the environment's control mode. Inactive arms keep their last targets."""

    def __init__(self, env: ControlledEnv, last: Command) -> None:
        """Begin with all arms at home, except the arm of the last command."""
        self._env = env
        self._arm_targets = {arm.name: np.array(arm.home) for arm in env.robot.arms}
        self._arm_targets[last.arm] = last.drive[4:]

    def of(self, command: Command) -> Array:
        """Action for a command."""
        env, robot = self._env, self._env.robot
        if env.control_mode == "ee":
            T_world_tcp = tcp_pose(robot, RobotState(command.drive[:3], command.drive[3:], 0.0))
            return np.asarray(env.ee_action(command.drive[:3], T_world_tcp, command.opening))
        if not robot.acts_with_all_arms:
            return np.asarray(env.joint_action(command.drive, command.opening))
        self._arm_targets[command.arm] = command.drive[4:]
        arms = robot.acting_arms
        q_target = np.concatenate((command.drive[:4], *(self._arm_targets[arm] for arm in arms)))
        # grippers of inactive arms stay closed
        widths = [command.opening if arm == command.arm else robot.opening(0.0) for arm in arms]
        return np.asarray(env.joint_action(q_target, np.array(widths)))
