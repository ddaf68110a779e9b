"""What the project needs to know about a robot: names, geometry and limits, checked when a spec is made."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from numbers import Real
from pathlib import Path
from typing import Any, NamedTuple

from assets import path

__all__ = ["ChainLink", "InvalidRobot", "LinkMesh", "RobotSpec"]


NO_TURN = (1.0, 0.0, 0.0, 0.0)
"""The quaternion, wxyz, of frames that are parallel."""

AXES = {
    "x": (1.0, 0.0, 0.0),
    "y": (0.0, 1.0, 0.0),
    "z": (0.0, 0.0, 1.0),
    "-x": (-1.0, 0.0, 0.0),
    "-y": (0.0, -1.0, 0.0),
    "-z": (0.0, 0.0, -1.0),
}
"""The axes that have names."""

_UNIT = 1e-6
"""By how much the length of a unit vector or quaternion may differ from 1."""


class InvalidRobot(ValueError):
    """The fields of a `RobotSpec` are not those of a robot; the message names the field."""


class ChainLink(NamedTuple):
    """One joint of the chain torso → arm.

    `offset` [m] and `quaternion` (wxyz) are the joint frame's origin and orientation in its parent's frame while the
    joint is at zero; `axis` is "x", "y", "z", "-x", "-y", "-z" or a unit vector of the joint's frame; `prismatic`
    joints move along it.
    """

    joint: str
    offset: tuple[float, float, float]
    axis: str | tuple[float, float, float]
    lower: float
    upper: float
    prismatic: bool = False
    quaternion: tuple[float, float, float, float] = NO_TURN

    @property
    def direction(self) -> tuple[float, float, float]:
        """Unit vector of the axis in the joint's frame."""
        return AXES[self.axis] if isinstance(self.axis, str) else self.axis


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

    Vectors over joints are ordered base x, base y, base yaw, torso, arm; an *arm configuration* `q` is torso and arm
    only, shape (1 + n,). Units are SI. The TCP frame has x along the approach, y along the finger motion.

    Raises:
        InvalidRobot: a field has a wrong length, or a value that cannot be; the message names the field.
    """

    name: str
    mjcf: str
    """The MJCF file: a path below `assets/`, or the absolute path of a file of your own."""
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
    """Configuration to start, drive and carry in, shape (1 + n,): torso [m], arm [rad]; the gripper is level and above
    the objects."""
    max_velocity: tuple[float, ...]
    """Shape (4 + n,): base [m/s, m/s, rad/s], torso [m/s], arm [rad/s]."""
    max_acceleration: tuple[float, ...]
    """Shape (4 + n,): like `max_velocity`, per second."""
    max_loaded_yaw_rate: float
    """[rad/s] while an object is held; in faster turns it slips out of the fingers."""
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
    tcp_quaternion: tuple[float, float, float, float] = NO_TURN
    """wxyz, of the TCP in the last arm frame, as `ChainLink.quaternion`; beside `tcp_offset`."""
    closed_form_ik: str = ""
    """Name of a closed-form solver of `irm.arm.kinematics`, "" for the generic route."""

    def __post_init__(self) -> None:
        for name in ("name", "mjcf", "base_body", "tcp_site", "gripper_body"):
            value = getattr(self, name)
            _require(isinstance(value, str) and value != "", name, f"must be a non-empty string, not {value!r}")
        _check_chain(self.chain)
        links = len(self.chain)
        for name, count in (("base_joints", 3), ("finger_joints", 2), ("finger_geoms", 2)):
            _check_names(name, getattr(self, name), count)
        for name in ("head_joints", "cameras"):
            _check_names(name, getattr(self, name), len(getattr(self, name)))
        _check_numbers("tcp_offset", self.tcp_offset, 3)
        _check_unit("tcp_quaternion", self.tcp_quaternion, 4)
        _check_numbers("head_configuration", self.head_configuration, len(self.head_joints))
        _check_numbers("home", self.home, links)
        _check_numbers("max_velocity", self.max_velocity, 3 + links, positive=True)
        _check_numbers("max_acceleration", self.max_acceleration, 3 + links, positive=True)
        _check_numbers("max_tcp_velocity", self.max_tcp_velocity, 2, positive=True)
        for name in _POSITIVE:
            _check_numbers(name, (getattr(self, name),), 1, positive=True)
        for link, value in zip(self.chain, self.home, strict=True):
            is_inside = link.lower <= value <= link.upper
            _require(is_inside, "home", f"holds {value}, outside {link.joint!r}'s range {link.lower} to {link.upper}")

    @classmethod
    def from_fields(cls, values: Mapping[str, Any]) -> RobotSpec:
        """The robot that `dataclasses.asdict` took apart, also after it was written to JSON and read again.

        Raises:
            InvalidRobot: an unknown or missing field, or a wrong value.
        """
        parts = {name: _as_tuples(value) for name, value in values.items()}
        try:
            parts["chain"] = tuple(ChainLink(*link) for link in parts["chain"])
            parts["meshes"] = tuple(LinkMesh(*mesh) for mesh in parts.get("meshes", ()))
            return cls(**parts)
        except (KeyError, TypeError) as problem:
            known = ", ".join(entry.name for entry in fields(cls))
            raise InvalidRobot(f"these are not the fields of a RobotSpec ({problem}); its fields: {known}") from None

    @classmethod
    def from_mjcf(cls, path: str | Path, **page: Any) -> RobotSpec:
        """The robot of an MJCF file: joints, frames, limits, gripper and footprint are read from it.

        Args:
            path: of the file, below `assets/` or absolute.
            **page: what the file does not say, the fields of `assets.robot_reading.RobotPage`; needed are
                `base_joints`, `tip`, `finger_joints` and `home`.

        Raises:
            FileNotFoundError: there is no such file.
            InvalidRobot: the file lacks what the page names, or they do not describe a robot; the message says what.
        """
        from assets.robot_reading import page_of, read_robot  # a function needs the simulator, the package does not

        return read_robot(path, page_of(page))

    @property
    def mjcf_path(self) -> Path:
        """The robot's MJCF file.

        Raises:
            FileNotFoundError: there is no such file.
        """
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
        return self.opening(self.max_finger_position)

    def opening(self, finger_position: float) -> float:
        """[m] between the pads at a finger joint position [m]."""
        return self.finger_gap_closed + 2 * finger_position

    def finger_position(self, opening: float) -> float:
        """Finger joint position [m] at which the pads are `opening` [m] apart, clipped to the joint's range."""
        return min(max((opening - self.finger_gap_closed) / 2, 0.0), self.max_finger_position)

    def velocity_feedforward(self, model: Any) -> list[float]:
        """[s] for each drive joint: added to a motor's position command per unit of velocity, it cancels all damping.

        Args:
            model: the `mujoco.MjModel`; the robot's position actuators have the names of its joints.
        """
        motors = [(model.joint(name), model.actuator(name)) for name in self.drive_joints]
        return [float((joint.damping.flat[0] - motor.biasprm[2]) / motor.gainprm[0]) for joint, motor in motors]


_AXIS = "'x', 'y' or 'z', one of these with a minus sign, or a unit vector"

_POSITIVE = (
    "max_loaded_yaw_rate",
    "max_finger_velocity",
    "max_finger_position",
    "finger_thickness",
    "grasp_height",
    "base_radius",
    "base_height",
)
"""Fields that are one positive number."""


def _require(holds: bool, name: str, problem: str) -> None:
    if not holds:
        raise InvalidRobot(f"RobotSpec: {name} {problem}")


def _check_chain(chain: object) -> None:
    """The chain is a prismatic torso lift and at least one revolute joint, each with an axis and a range."""
    is_chain = isinstance(chain, tuple) and len(chain) >= 2 and all(isinstance(link, ChainLink) for link in chain)
    _require(is_chain, "chain", "must be a tuple of ChainLink: a prismatic torso lift, then revolute arm joints")
    assert isinstance(chain, tuple)
    for index, link in enumerate(chain):
        kind = "prismatic" if index == 0 else "revolute"
        _require(link.prismatic == (index == 0), "chain", f"must have a {kind} joint as entry {index}: {link.joint!r}")
        is_named = isinstance(link.axis, str) and link.axis in AXES
        _require(is_named or not isinstance(link.axis, str), "chain", f"{link.joint!r}: axis must be {_AXIS}")
        _check_unit(f"chain, axis of {link.joint!r}", link.direction, 3)
        _check_unit(f"chain, quaternion of {link.joint!r}", link.quaternion, 4)
        _check_numbers(f"chain, offset of {link.joint!r}", link.offset, 3)
        _check_numbers(f"chain, range of {link.joint!r}", (link.lower, link.upper), 2)
        is_range = link.lower < link.upper or (index == 0 and link.lower == link.upper)
        _require(is_range, "chain", f"{link.joint!r}: lower must be below upper (equal for a robot without a lift)")


def _check_names(name: str, value: object, count: int) -> None:
    is_tuple = isinstance(value, tuple) and all(isinstance(entry, str) and entry for entry in value)
    _require(is_tuple, name, f"must be a tuple of names, not {value!r}")
    assert isinstance(value, tuple)
    _require(len(value) == count == len(set(value)), name, f"must be {count} different names, not {value!r}")


def _check_numbers(name: str, value: object, count: int, positive: bool = False) -> None:
    is_tuple = isinstance(value, tuple) and all(isinstance(entry, Real) for entry in value)
    _require(is_tuple, name, f"must be a tuple of numbers, not {value!r}")
    assert isinstance(value, tuple)
    _require(len(value) == count, name, f"must have {count} numbers, not {len(value)}")
    holds = all(math.isfinite(entry) and (entry > 0 or not positive) for entry in value)
    _require(holds, name, f"must be {'positive' if positive else 'finite'}, not {value!r}")


def _check_unit(name: str, value: object, count: int) -> None:
    _check_numbers(name, value, count)
    assert isinstance(value, tuple)
    _require(abs(math.hypot(*value) - 1.0) < _UNIT, name, f"must have length 1, not {value!r}")


def _as_tuples(value: Any) -> Any:
    """Lists, as JSON makes them, as the tuples that the fields hold."""
    return tuple(_as_tuples(entry) for entry in value) if isinstance(value, list | tuple) else value
