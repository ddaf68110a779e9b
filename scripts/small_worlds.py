"""Simulations of a robot before a small world that a script has drawn."""

from __future__ import annotations

import tempfile
from pathlib import Path

import mujoco

from assets import RobotSpec
from planners import insert_robot, prepare

BASE = (-0.3, 0.0, 0.0)
"""x, y [m], yaw [rad] of the base."""


def simulated(text: str, robot: RobotSpec, base: tuple[float, ...] = BASE) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """The model of an MJCF text with a robot in it, and its data with the robot in its home configuration."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "world.xml")
        path.write_text(text)
        model = prepare(insert_robot(path, robot, base=base), robot).model
    data = mujoco.MjData(model)
    for joint, value in zip(robot.drive_joints[3:], robot.home, strict=True):
        data.joint(joint).qpos = value
    mujoco.mj_forward(model, data)
    return model, data
