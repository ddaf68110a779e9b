"""A plan as one trajectory of joints, base and grippers, for a robot's controllers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from assets.robots import RobotSpec
from planners.motion.trajectory import Trajectory
from planners.scene import Scene

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class JointTrajectory:
    """Commands of a plan in order, linear in between. Arrays are read-only.

    Attributes:
        joint_names: (m,) torso, then the joints of every arm that the plan uses.
        times: (n,) [s] from 0.
        positions: (n, m) [m, rad].
        velocities: (n, m) [m/s, rad/s], central differences of the positions, 0 at both ends.
        base: (n, 3) x [m], y [m], yaw [rad] in the world. The yaw is not wrapped.
        arms: (g,) names of the arms that the plan uses, "" for a robot with one arm.
        gripper: (n, g) opening between the finger pads of each gripper [m].
    """

    joint_names: tuple[str, ...]
    times: Array
    positions: Array
    velocities: Array
    base: Array
    arms: tuple[str, ...]
    gripper: Array

    def __post_init__(self) -> None:
        for name in ("times", "positions", "velocities", "base", "gripper"):
            getattr(self, name).setflags(write=False)


class MotionInScene(Protocol):
    """A motion with the scene in which it begins, as in `BoundAction`."""

    # fmt: off
    @property
    def trajectory(self) -> Trajectory: ...
    @property
    def scene(self) -> Scene: ...
    # fmt: on


def joint_trajectory(actions: Sequence[MotionInScene]) -> JointTrajectory:
    """Join the trajectories of bound actions in order.

    An inactive arm stays where it was left. At first it is in its home or parked configuration, with its gripper
    closed.

    Raises:
        ValueError: no actions.
    """
    if not actions:
        raise ValueError("the plan has no actions: there is nothing to export")
    robots: dict[str, RobotSpec] = {action.scene.robot.arm_name: action.scene.robot for action in actions}
    first = actions[0].scene.robot
    states = {arm: np.array((*robot.home[1:], robot.opening(0.0))) for arm, robot in robots.items()}
    for parked in actions[0].scene.parked:
        if parked.arm in states:
            states[parked.arm][:-1] = parked.q
    times, start = [np.zeros(0)], 0.0
    drives: list[Array] = []
    rows: dict[str, list[Array]] = {arm: [] for arm in robots}
    for action in actions:
        trajectory, active = action.trajectory, action.scene.robot.arm_name
        new = slice(1 if drives else 0, None)  # the first sample repeats the last one of the action before
        times.append(trajectory.times[new] + start)
        start += trajectory.duration
        drives.append(np.column_stack((trajectory.base, trajectory.q[:, 0]))[new])
        opening = np.array([action.scene.robot.opening(float(finger)) for finger in trajectory.finger_position])
        moving = np.column_stack((trajectory.q[:, 1:], opening))[new]
        for arm, known in states.items():
            rows[arm].append(moving if arm == active else np.tile(known, (len(moving), 1)))
        if len(moving):
            states[active] = moving[-1]
    at, base = np.concatenate(times), np.concatenate(drives)
    arms = {arm: np.concatenate(parts) for arm, parts in rows.items()}
    positions = np.column_stack((base[:, 3], *(states[:, :-1] for states in arms.values())))
    velocities = np.gradient(positions, at, axis=0) if len(at) > 1 else np.zeros_like(positions)
    velocities[[0, -1]] = 0.0
    names = [first.drive_joints[3], *(name for robot in robots.values() for name in robot.arm_joints)]
    gripper = np.column_stack([states[:, -1] for states in arms.values()])
    return JointTrajectory(tuple(names), at, positions, velocities, base[:, :3].copy(), tuple(arms), gripper)
