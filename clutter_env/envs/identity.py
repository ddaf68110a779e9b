"""What a saved state says about the environment that it belongs to: names, or the content of the user's own objects."""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict
from typing import Any

from assets.robots import RobotSpec, UnknownRobot
from assets.robots import robot as find_robot
from clutter_env.scene.layout import LAYOUTS, Layout

__all__ = ["layout_identity", "robot_identity"]


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
