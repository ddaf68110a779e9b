"""Robots as data: every name and constant that the rest of the project needs to know about one."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

from assets import path

__all__ = ["FETCH", "ChainLink", "LinkMesh", "RobotSpec", "UnknownRobot", "robot"]


class UnknownRobot(ValueError):
    """No robot of that name; the message lists the known ones."""


class ChainLink(NamedTuple):
    """One joint of the chain torso → arm.

    `offset` [m] is the joint frame's origin in its parent's frame; `axis` is "x", "y" or "z";
    `prismatic` joints move along it.
    """

    joint: str
    offset: tuple[float, float, float]
    axis: str
    lower: float
    upper: float
    prismatic: bool = False


class LinkMesh(NamedTuple):
    """A visual mesh of one body, used only when the `[visuals]` extra is installed."""

    body: str
    file: str
    rgba: tuple[float, float, float, float]
    position: tuple[float, float, float] = (0.0, 0.0, 0.0)
    quaternion: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True)
class RobotSpec:
    """A mobile manipulator: planar base (x, y, yaw), torso lift, arm, parallel gripper.

    Vectors over joints are ordered base x, base y, base yaw, torso, arm; a *configuration* `q` is torso and arm
    only, shape (1 + n,). Units are SI. The TCP frame has x along the approach, y along the finger motion.
    """

    name: str
    mjcf: str
    base_body: str
    base_joints: tuple[str, str, str]
    chain: tuple[ChainLink, ...]
    tcp_offset: tuple[float, float, float]
    tcp_site: str
    gripper_body: str
    finger_joints: tuple[str, str]
    finger_geoms: tuple[str, str]
    head_joints: tuple[str, ...]
    head_configuration: tuple[float, ...]
    cameras: tuple[str, ...]
    home: tuple[float, ...]
    """Posture to start, drive and carry in, shape (1 + n,): torso [m], arm [rad]; gripper level, above the clutter."""
    max_velocity: tuple[float, ...]
    """Shape (4 + n,): base [m/s, m/s, rad/s], torso [m/s], arm [rad/s]."""
    max_acceleration: tuple[float, ...]
    """Shape (4 + n,): like `max_velocity`, per second."""
    max_loaded_yaw_rate: float
    """[rad/s] while something is held; faster turns make it creep out of the fingers."""
    max_tcp_velocity: tuple[float, float]
    """Linear [m/s] and angular [rad/s] TCP speed of a full "ee" action."""
    max_finger_velocity: float
    """[m/s] of one finger."""
    max_finger_position: float
    """[m] of one finger joint; 0 is closed."""
    finger_gap_closed: float
    """[m] between the pads at finger position 0."""
    finger_thickness: float
    """[m] of one finger along its motion."""
    grasp_height: float
    """δ [m]: TCP above the object's lowest point in a side grasp."""
    grasp_axis_offset: float
    """ε [m]: TCP from the object's main axis."""
    base_radius: float
    """[m] of the circle that contains the base footprint."""
    base_height: float
    """[m]."""
    meshes: tuple[LinkMesh, ...] = field(default=(), repr=False)
    mesh_package: str = ""
    mesh_folder: str = ""
    closed_form_ik: str = ""
    """Name of a closed-form solver of `irm.arm.kinematics`, "" for the generic route."""

    @property
    def mjcf_path(self) -> Path:
        """The robot's MJCF file."""
        return path(self.mjcf)

    @property
    def torso_joint(self) -> str:
        """Name of the torso lift joint."""
        return self.chain[0].joint

    @property
    def arm_joints(self) -> tuple[str, ...]:
        """Names of the arm joints, shoulder first."""
        return tuple(link.joint for link in self.chain[1:])

    @property
    def drive_joints(self) -> tuple[str, ...]:
        """Base, torso and arm joints in the order of every (4 + n,) vector."""
        return (*self.base_joints, *(link.joint for link in self.chain))

    @property
    def max_opening(self) -> float:
        """[m] between the pads of the fully open gripper."""
        return self.finger_gap_closed + 2 * self.max_finger_position

    def finger_position(self, opening: float) -> float:
        """Finger joint position [m] at which the pads are `opening` [m] apart, clipped to the joint's range."""
        return min(max((opening - self.finger_gap_closed) / 2, 0.0), self.max_finger_position)


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
    home=(0.25, 0.0, -1.02, 0.0, 2.12, 0.0, -1.10, 0.0),
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

_ROBOTS = {FETCH.name: FETCH}


def robot(name: str) -> RobotSpec:
    """The robot of that name.

    Raises:
        UnknownRobot: no such robot; the message lists the known ones.
    """
    try:
        return _ROBOTS[name]
    except (KeyError, TypeError):
        known = ", ".join(sorted(_ROBOTS))
        raise UnknownRobot(f"no robot {name!r}; known robots: {known}") from None
