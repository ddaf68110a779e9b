"""What a saved state says about the environment that it belongs to: names, or the content of the user's own objects."""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict
from typing import Any

import mujoco

from assets import RobotSpec, UnknownRobot
from assets import robot as find_robot
from clutter_env.config import EnvConfig
from clutter_env.scene.layout import LAYOUTS, Layout

__all__ = ["environment_kind", "layout_identity", "robot_identity"]


def environment_kind(task: str, config: EnvConfig, layout: Layout, robot: RobotSpec) -> dict[str, Any]:
    """What a saved state and the environment that restores it must have in common; JSON values."""
    return {
        "task": task,
        "mujoco": mujoco.__version__,
        "num_objects": int(config.num_objects),
        "layout": layout_identity(layout),
        "robot": robot_identity(robot),
        "control_mode": config.control_mode,
    }


def layout_identity(layout: Layout) -> Any:
    """The name of a known layout, all fields of another one; JSON values."""
    if LAYOUTS.get(layout.name) == layout:
        return layout.name
    return json.loads(json.dumps(asdict(layout)))


def robot_identity(robot: RobotSpec) -> str:
    """The name of a known robot; of another one the name and a digest of its fields and its MJCF file."""
    try:
        if find_robot(robot.name) == robot:
            return robot.name
    except UnknownRobot:
        pass
    content = json.dumps(asdict(robot)).encode() + robot.mjcf_path.read_bytes()
    return f"{robot.name} {hashlib.sha256(content).hexdigest()[:16]}"
