"""The robots that the project knows by name."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

from assets.pr2 import PR2
from assets.robot_parts import ArmSpec, ChainLink, InvalidRobot, LinkMesh, rotation_of
from assets.robot_spec import ActingJoints, RobotSpec

__all__ = [
    "FETCH",
    "PR2",
    "ActingJoints",
    "ArmSpec",
    "ChainLink",
    "InvalidRobot",
    "LinkMesh",
    "RobotSpec",
    "UnknownRobot",
    "robot",
    "rotation_of",
]


class UnknownRobot(ValueError):
    """No robot of that name; the message lists the known ones."""


_GREY = (0.356, 0.361, 0.376, 1.0)
_BLUE = (0.086, 0.506, 0.767, 1.0)
_WHITE = (0.95, 0.95, 0.95, 1.0)

FETCH = RobotSpec(
    name="fetch",
    mjcf="mjcf/fetch.xml",
    base_body="base_link",
    base_joints=("base_x", "base_y", "base_yaw"),
    chain=(
        ChainLink("torso_lift_joint", (-0.086875, 0.0, 0.37743), "z", 0.0386, 0.3861, prismatic=True),
        ChainLink("shoulder_pan_joint", (0.119525, 0.0, 0.34858), "z", -1.6056, 1.6056),
        ChainLink("shoulder_lift_joint", (0.117, 0.0, 0.06), "y", -1.221, 1.518),
        ChainLink("upperarm_roll_joint", (0.219, 0.0, 0.0), "x", -2 * math.pi, 2 * math.pi),
        ChainLink("elbow_flex_joint", (0.133, 0.0, 0.0), "y", -2.251, 2.251),
        ChainLink("forearm_roll_joint", (0.197, 0.0, 0.0), "x", -2 * math.pi, 2 * math.pi),
        ChainLink("wrist_flex_joint", (0.1245, 0.0, 0.0), "y", -2.16, 2.16),
        ChainLink("wrist_roll_joint", (0.1385, 0.0, 0.0), "x", -2 * math.pi, 2 * math.pi),
    ),
    tcp_offset=(0.16645 + 0.015, 0.0, 0.0),
    tcp_site="tcp",
    gripper_body="gripper_link",
    finger_joints=("r_gripper_finger_joint", "l_gripper_finger_joint"),
    finger_geoms=("r_finger", "l_finger"),
    head_joints=("head_pan_joint", "head_tilt_joint"),
    head_configuration=(0.0, 0.55),
    cameras=("head", "gripper"),
    home=(0.25, 0.689904, -0.78961, 0.523599, 1.76253, 0.972079, -1.521048, -0.745371),
    ahead=(0.25, 0.0, -1.02, 0.0, 2.12, 0.0, -1.10, 0.0),
    max_velocity=(1.0, 1.0, 1.5, 0.1, 1.256, 1.0, 1.57, 1.5, 1.57, 2.26, 2.26),
    max_acceleration=(1.0, 1.0, 2.0, 0.5, 1.5, 1.0, 1.5, 1.5, 1.5, 2.5, 2.5),
    max_loaded_yaw_rate=0.6,
    max_tcp_velocity=(0.3, 1.0),
    max_finger_velocity=0.05,
    max_finger_position=0.05,
    finger_gap_closed=0.0018,
    finger_thickness=0.014,
    grasp_height=0.065,
    grasp_axis_offset=0.0,
    base_radius=0.29,
    base_height=0.36,
    mesh_package="gymnasium_robotics",
    mesh_folder="envs/assets/stls/fetch",
    meshes=(
        LinkMesh("base_link", "base_link_collision.stl", _GREY),
        LinkMesh("base_link", "torso_fixed_link.stl", _BLUE, (-0.086875, 0.0, 0.37743)),
        LinkMesh("torso_lift_link", "torso_lift_link_collision.stl", _WHITE),
        LinkMesh("head_pan_link", "head_pan_link_collision.stl", _GREY),
        LinkMesh("head_tilt_link", "head_tilt_link_collision.stl", _BLUE),
        LinkMesh("shoulder_pan_link", "shoulder_pan_link_collision.stl", _WHITE),
        LinkMesh("shoulder_lift_link", "shoulder_lift_link_collision.stl", _BLUE),
        LinkMesh("upperarm_roll_link", "upperarm_roll_link_collision.stl", _WHITE),
        LinkMesh("elbow_flex_link", "elbow_flex_link_collision.stl", _BLUE),
        LinkMesh("forearm_roll_link", "forearm_roll_link_collision.stl", _WHITE),
        LinkMesh("wrist_flex_link", "wrist_flex_link_collision.stl", _BLUE),
        LinkMesh("wrist_roll_link", "wrist_roll_link_collision.stl", _WHITE),
        LinkMesh("gripper_link", "gripper_link.stl", _GREY),
    ),
    closed_form_ik="fetch",
)

_ROBOTS = {spec.name: spec for spec in (FETCH, PR2)}

_PAGES: dict[str, dict[str, Any]] = {
    "panda_mobile": {
        "base_joints": ("base_x", "base_y", "base_yaw"),
        "tip": "tcp",
        "finger_joints": ("finger_joint1", "finger_joint2"),
        "home": (0.3, -2.491677, 0.395856, 1.000799, -2.417575, 1.445889, 1.880598, 1.3),
        "ahead": (0.42, -1.558926, 1.035545, 1.238437, -2.647503, 2.776566, 2.026612, -0.08),
        "max_velocity": (1.0, 1.0, 1.5, 0.1, 1.5, 1.5, 1.5, 1.5, 2.0, 2.0, 2.0),
        "max_acceleration": (1.0, 1.0, 2.0, 0.5, 2.0, 2.0, 2.0, 2.0, 2.5, 2.5, 2.5),
        "grasp_height": 0.08,
    }
}
"""By name, what is said of a robot beside its MJCF file `mjcf/<name>.xml`; see `docs/add_a_robot.md`."""


def robot_names() -> tuple[str, ...]:
    """Names of the package's robots."""
    return tuple(sorted((*_ROBOTS, *_PAGES)))


def robot(robot: str | RobotSpec | Mapping[str, Any]) -> RobotSpec:
    """The robot of that name, or of an MJCF file that has its page beside it, `arm.xml` and `arm.json`.

    A `RobotSpec` is returned as it is, its fields as a dictionary make one.

    Raises:
        UnknownRobot: no robot of that name, or no such file or page; the message lists the known names.
        InvalidRobot: the dictionary does not hold the fields of a `RobotSpec`, or the files do not describe a robot.
    """
    if isinstance(robot, RobotSpec):
        return robot
    if isinstance(robot, Mapping):
        return RobotSpec.from_fields(robot)
    if isinstance(robot, str) and robot in _PAGES:
        return _read(robot)
    if isinstance(robot, str) and robot.endswith(".xml"):
        files = Path(robot), Path(robot).with_suffix(".json")
        if not all(file.is_file() for file in files):
            raise UnknownRobot(f"no robot {robot!r}: a file needs its page {files[1].name} beside it")
        return _of_files(*files, *(file.stat().st_mtime_ns for file in files))
    if not isinstance(robot, str) or robot not in _ROBOTS:
        known = ", ".join(robot_names())
        raise UnknownRobot(f"no robot {robot!r}; known robots: {known}; or give an MJCF file or an assets.RobotSpec")
    return _ROBOTS[robot]


@cache
def _read(name: str) -> RobotSpec:
    """A robot that is described by its file and its page, read once."""
    return RobotSpec.from_mjcf(f"mjcf/{name}.xml", name=name, **_PAGES[name])


@cache
def _of_files(file: Path, page: Path, *_changed: int) -> RobotSpec:
    """A robot of the user's own files, read once, and again when they have changed."""
    try:
        return RobotSpec.from_mjcf(file, **json.loads(page.read_text(encoding="utf-8")))
    except (ValueError, TypeError) as problem:
        raise InvalidRobot(f"{page}: {problem}") from problem
