"""Description of a robot: names, geometry and limits, checked at construction."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from assets.files import folder, path
from assets.robot_parts import (
    ARM_FIELDS,
    NO_TURN,
    ArmSpec,
    ChainLink,
    InvalidRobot,
    LinkMesh,
    check_chain,
    check_names,
    check_numbers,
    check_unit,
    require,
    rotation_of,
)

if TYPE_CHECKING:
    from irm.shapes import Shapes


@dataclass(frozen=True)
class RobotSpec:
    """A mobile manipulator: planar base (x, y, yaw), torso lift, arm, parallel gripper. Or an arm on a `fixed` base.

    A robot with several arms has one active arm, which the fields describe. `using` makes another arm active. The
    others stay in their home configuration with closed grippers. Collision checks include them.

    Vectors over joints are ordered base x, base y, base yaw, torso, arm. An *arm configuration* `q` has only torso and
    arm, shape (1 + n,). Units are SI. The TCP frame has x along the approach, y along the finger motion.

    Raises:
        InvalidRobot: a field has a wrong length, or an impossible value. The message names the field.
    """

    name: str
    mjcf: str
    """MJCF file: a path below `assets/`, or the absolute path of the user's own file."""
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
    """Configuration to start, drive and carry in, shape (1 + n,): torso [m], arm [rad]. The gripper is level and above
    the objects. The arm is beside the view of the head's camera."""
    max_velocity: tuple[float, ...]
    """Shape (4 + n,): base [m/s, m/s, rad/s], torso [m/s], arm [rad/s]."""
    max_acceleration: tuple[float, ...]
    """Shape (4 + n,): like `max_velocity`, per second."""
    max_loaded_yaw_rate: float
    """[rad/s] Limit while an object is held. In faster turns it slips out of the fingers."""
    max_tcp_velocity: tuple[float, float]
    """Linear [m/s] and angular [rad/s] TCP speed of a full "ee" action."""
    max_finger_velocity: float
    """[m/s] Limit of each finger."""
    max_finger_position: float
    """[m] Upper limit of each finger joint. 0 is closed."""
    finger_gap_closed: float
    """[m] between the pads at finger position 0."""
    finger_thickness: float
    """[m] Thickness of a finger along its motion."""
    grasp_height: float
    """δ [m]: TCP above the object's lowest point in a side grasp."""
    grasp_axis_offset: float
    """ε [m]: TCP from the object's main axis."""
    base_radius: float
    """[m] Radius of the circle that contains the base footprint."""
    base_height: float
    """[m] Height of the base."""
    meshes: tuple[LinkMesh, ...] = field(default=(), repr=False)
    mesh_package: str = ""
    mesh_folder: str = ""
    tcp_quaternion: tuple[float, float, float, float] = NO_TURN
    """Orientation wxyz of the TCP in the last arm frame, as `ChainLink.quaternion`. `tcp_offset` is its position."""
    closed_form_ik: str = ""
    """Name of a closed-form solver of `irm.ik.closed_form`, "" for the generic route."""
    arm_name: str = ""
    """Name of the active arm of a robot with several arms."""
    idle_arms: tuple[ArmSpec, ...] = ()
    base_outline: tuple[tuple[float, float], ...] = ()
    """Corners x, y [m] of the convex footprint of a base that is not round."""
    plans_torso: bool = True
    """Whether plans move the torso. A slow torso stays at the height of `home`."""
    finger_gap: float = 0.012
    """[m] Gap between each finger of the open gripper and an object before a grasp, or after a release."""
    acts_with_all_arms: bool = False
    """Whether actions and plans move all arms, one after another, or only the active arm. See `with_all_arms`."""
    ahead: tuple[float, ...] = ()
    """Configuration like `home` with the gripper in front of the middle of the base and the arm unturned. Used for a
    robot of one arm that is aside at home, otherwise (). See `in_front`."""

    def __post_init__(self) -> None:
        for name in ("name", "mjcf", "base_body", "tcp_site", "gripper_body"):
            value = getattr(self, name)
            require(isinstance(value, str) and value != "", name, f"must be a non-empty string, not {value!r}")
        check_chain(self.chain)
        links = len(self.chain)
        for name, count in (("base_joints", 3), ("finger_joints", 2), ("finger_geoms", 2)):
            check_names(name, getattr(self, name), count)
        for name in ("head_joints", "cameras"):
            check_names(name, getattr(self, name))
        check_numbers("tcp_offset", self.tcp_offset, 3)
        check_unit("tcp_quaternion", self.tcp_quaternion, 4)
        check_numbers("head_configuration", self.head_configuration, len(self.head_joints))
        check_numbers("home", self.home, links)
        check_numbers("max_velocity", self.max_velocity, 3 + links, positive=True)
        check_numbers("max_acceleration", self.max_acceleration, 3 + links, positive=True)
        check_numbers("max_tcp_velocity", self.max_tcp_velocity, 2, positive=True)
        for name in _POSITIVE:
            check_numbers(name, (getattr(self, name),), 1, positive=True)
        for link, value in zip(self.chain, self.home, strict=True):
            is_inside = link.lower <= value <= link.upper
            require(is_inside, "home", f"holds {value}, outside {link.joint!r}'s range {link.lower} to {link.upper}")
        for name in ("finger_gap_closed", "grasp_axis_offset"):
            check_numbers(name, (getattr(self, name),), 1)
        for name, kind in _KINDS.items():
            value = getattr(self, name)
            require(isinstance(value, kind), name, f"must be of type {kind.__name__}, not {value!r}")
        for name, entry in (("meshes", LinkMesh), ("idle_arms", ArmSpec)):
            value = getattr(self, name)
            is_tuple = isinstance(value, tuple) and all(isinstance(part, entry) for part in value)
            require(is_tuple, name, f"must be a tuple of {entry.__name__}, not {value!r}")
        if self.ahead:
            check_numbers("ahead", self.ahead, links)
            require(not self.idle_arms, "ahead", "is for robots of one arm")
        require(isinstance(self.base_outline, tuple), "base_outline", f"must be a tuple, not {self.base_outline!r}")
        for corner in self.base_outline:
            check_numbers("base_outline, corner", corner, 2)
        has_arms = bool(self.idle_arms) or not self.acts_with_all_arms
        require(has_arms, "acts_with_all_arms", f"is for robots with several arms; {self.name} has one")

    def __hash__(self) -> int:
        # A hash of few fields, because robots are keys of many caches, some used in every control step.
        return hash((self.name, self.mjcf, self.arm_name, self.home))

    @classmethod
    def from_fields(cls, values: Mapping[str, Any]) -> RobotSpec:
        """Make a robot from the dictionary of `dataclasses.asdict`, also after a round trip through JSON.

        Raises:
            InvalidRobot: an unknown or missing field, or a wrong value.
        """
        try:
            parts = {name: _as_tuples(value) for name, value in values.items()}
            parts["chain"] = tuple(ChainLink(*link) for link in parts["chain"])
            parts["idle_arms"] = tuple(_as_arm(arm) for arm in values.get("idle_arms", ()))
            parts["meshes"] = tuple(LinkMesh(*mesh) for mesh in parts.get("meshes", ()))
            return cls(**parts)
        except (AttributeError, KeyError, TypeError) as problem:
            known = ", ".join(entry.name for entry in fields(cls))
            raise InvalidRobot(f"these are not the fields of a RobotSpec ({problem}); its fields: {known}") from None

    @classmethod
    def from_mjcf(cls, path: str | Path, **page: Any) -> RobotSpec:
        """Read a robot from an MJCF file: joints, frames, limits, gripper and footprint.

        Args:
            path: path of the file. A path below `assets/` names a file of the package.
            **page: data that the file lacks. Required are `base_joints` (names of the joints that move the base along
                x, along y and about z), `tip` (name of the TCP's site), `finger_joints` and `home`. Optional are
                `name`, `finger_geoms`, `head_joints`, `head_configuration`, `grasp_height`, `grasp_axis_offset`,
                `finger_gap`, `ahead`, and the limits. A model has no limits of motion, so they are slow by default.
                `base` is the motion of the base: "holonomic" (the default), "differential" or "fixed". For a robot with
                several arms, `arms` has the fields of each arm by its name: `tip`, `finger_joints`, `home` (with the
                same lift) and optional fields. The first arm is active, see `using` and `with_all_arms`.

        Raises:
            FileNotFoundError: no such file.
            InvalidRobot: the file lacks a name of the page, or both do not describe a robot. The message gives the
                reason.
        """
        from assets.robot_reading import read_fields  # a function needs the simulator, the package does not

        drives = {"holonomic": cls, "differential": _Differential, "fixed": _Fixed}
        base = page.pop("base", "holonomic")
        require(base in drives, "base", f"must be one of {', '.join(map(repr, drives))}, not {base!r}")
        return drives[base](**read_fields(path, page))

    @property
    def mjcf_path(self) -> Path:
        """The robot's MJCF file.

        Raises:
            FileNotFoundError: no such file.
        """
        return path(self.mjcf)

    @property
    def tcp_rotation(self) -> NDArray[np.float64]:
        """(3, 3) orientation of the TCP in the last arm frame."""
        return rotation_of(self.tcp_quaternion)

    @property
    def shapes(self) -> Shapes:
        """Collision shapes of robot, head and idle arms in `still_configuration`, for `irm` and the planner.

        Raises:
            InvalidRobot: the MJCF file has collision geometry of an unknown kind, or lacks a joint.
        """
        return _shapes_of(self)

    def collision_geoms(self, model: Any) -> list[int]:
        """Ids of the robot's collision geoms, in a `mujoco.MjModel` that contains the robot.

        The gripper's come first, then others, then those of idle arms.
        """
        from assets.robot_reading import collision_geoms  # see `from_mjcf`

        return collision_geoms(model, self.base_body, self.drive_joints[3:], self._idle_joints)

    @property
    def _idle_joints(self) -> tuple[str, ...]:
        """Names of the first joints of idle arms."""
        return tuple(arm.joints[0] for arm in self.idle_arms)

    @property
    def map_folder(self) -> Path | None:
        """Folder with reachability maps of the package's robots. `irm.cached_map` finds them by their digest."""
        return folder("maps")

    @property
    def torso_joint(self) -> str:
        """Name of the torso lift joint."""
        return self.chain[0].joint

    @property
    def arm_joints(self) -> tuple[str, ...]:
        """Names of the arm joints, shoulder first."""
        return tuple(link.joint for link in self.chain[1:])

    @property
    def full_name(self) -> str:
        """The name, extended by that of the active arm if the robot has several: "pr2_right"."""
        return f"{self.name}_{self.arm_name}" if self.arm_name else self.name

    @property
    def arms(self) -> tuple[ArmSpec, ...]:
        """All arms, the active one first."""
        arm = {name: getattr(self, name) for name in ARM_FIELDS} | {"name": self.arm_name}
        arm |= {"chain": self.chain[1:], "home": self.home[1:]}
        arm |= {name: getattr(self, name)[4:] for name in ("max_velocity", "max_acceleration")}
        return (ArmSpec(**arm), *self.idle_arms)

    def using(self, arm_name: str) -> RobotSpec:
        """Make the arm of that name active. Returns a new robot.

        Raises:
            InvalidRobot: no such arm. The message lists the arms.
        """
        arms = {arm.name: arm for arm in self.arms}
        if arm_name not in arms:
            raise InvalidRobot(f"{self.name} has no arm {arm_name!r}; its arms: {', '.join(sorted(map(repr, arms)))}")
        chosen = arms.pop(arm_name)
        parts: dict[str, Any] = {name: getattr(chosen, name) for name in ARM_FIELDS}
        parts |= {"chain": (self.chain[0], *chosen.chain), "home": (self.home[0], *chosen.home)}
        for name in ("max_velocity", "max_acceleration"):
            parts[name] = (*getattr(self, name)[:4], *getattr(chosen, name))
        return replace(self, arm_name=arm_name, idle_arms=tuple(arms.values()), **parts)

    @property
    def in_front(self) -> tuple[float, ...]:
        """The configuration (1 + n,) from which the arm works straight ahead: `ahead`, or `home` without one."""
        return self.ahead or self.home

    @property
    def base_drive(self) -> str:
        """Motion of the base: "holonomic" (in all directions), "differential" or "fixed"."""
        return "holonomic"

    def differential(self) -> RobotSpec:
        """The same robot with a base that moves ahead and back and turns about its centre."""
        return self._driving(_Differential)

    def fixed(self) -> RobotSpec:
        """The same robot with a fixed base, as for an arm on a pedestal. Bodies that the base stands on or in are no
        obstacles to the base itself."""
        return self._driving(_Fixed)

    def holonomic(self) -> RobotSpec:
        """The same robot with a base that moves in all directions."""
        return self._driving(RobotSpec)

    def _driving(self, kind: type[RobotSpec]) -> RobotSpec:
        return kind(**{entry.name: getattr(self, entry.name) for entry in fields(self)})

    def with_all_arms(self) -> RobotSpec:
        """The same robot with actions and plans that move all arms, one after another.

        Raises:
            InvalidRobot: the robot has a single arm.
        """
        return replace(self, acts_with_all_arms=True)

    @property
    def acting_arms(self) -> tuple[str, ...]:
        """Names of the arms that actions and plans move, the active arm first. ("",) if the only arm has no name."""
        return tuple(arm.name for arm in self.arms) if self.acts_with_all_arms else (self.arm_name,)

    @property
    def still_joints(self) -> tuple[str, ...]:
        """Joints that no action moves: those of the head, of idle arms, and of their fingers."""
        arms = (name for arm in self.idle_arms for name in (*arm.joints, *arm.finger_joints))
        return (*self.head_joints, *arms)

    @property
    def still_configuration(self) -> tuple[float, ...]:
        """Positions of `still_joints` [rad], [m]: arms at home, fingers closed."""
        arms = (value for arm in self.idle_arms for value in (*arm.home, 0.0, 0.0))
        return (*self.head_configuration, *arms)

    @property
    def drive_joints(self) -> tuple[str, ...]:
        """Base, torso and arm joints in the order of every (4 + n,) vector."""
        return (*self.base_joints, *(link.joint for link in self.chain))

    @property
    def max_opening(self) -> float:
        """Distance between the pads of the fully open gripper [m]."""
        return self.opening(self.max_finger_position)

    def opening(self, finger_position: float) -> float:
        """Distance between the pads at a finger joint position [m]."""
        return self.finger_gap_closed + 2 * finger_position

    def finger_position(self, opening: float) -> float:
        """Finger joint position [m] at which the pads are `opening` [m] apart, clipped to the joint's range."""
        return min(max((opening - self.finger_gap_closed) / 2, 0.0), self.max_finger_position)

    def velocity_feedforward(self, model: Any, joints: tuple[str, ...] = ()) -> list[float]:
        """Time [s] for each drive joint. Added to a motor's position command per unit of velocity, it cancels all
        damping.

        Args:
            model: the `mujoco.MjModel`. The robot's position actuators have the names of its joints.
            joints: names of joints in place of the drive joints.
        """
        motors = [(model.joint(name), model.actuator(name)) for name in joints or self.drive_joints]
        return [float((joint.damping.flat[0] - motor.biasprm[2]) / motor.gainprm[0]) for joint, motor in motors]


@cache
def _shapes_of(robot: RobotSpec) -> Shapes:
    """`RobotSpec.shapes`, read once."""
    from assets.robot_reading import read_shapes  # see `RobotSpec.from_mjcf`

    fingers = dict.fromkeys(robot.finger_joints, robot.max_finger_position)
    still = dict(zip(robot.still_joints, robot.still_configuration, strict=True))
    return read_shapes(robot.mjcf_path, robot.base_body, robot.chain, fingers, still, robot._idle_joints)


@dataclass(frozen=True)
class _Differential(RobotSpec):
    """A robot with a differential base. The drive is no field, because it would then be in every record of robots."""

    @property
    def base_drive(self) -> str:
        return "differential"


@dataclass(frozen=True)
class _Fixed(RobotSpec):
    """A robot whose base does not move, like `_Differential`."""

    @property
    def base_drive(self) -> str:
        return "fixed"


@dataclass(frozen=True)
class ActingJoints:
    """Joints that actions move, in their order: base, torso and the active arm (4 + n), then other acting arms.

    Attributes:
        names: of the joints.
        velocity, acceleration: their limits [m/s], [rad/s], and the same per second.
        lower, upper: ranges of torso and arms, without the base [m], [rad].
        home: of torso and arms.
        arms: names of the arms, the active one first.
        finger_joints, finger_geoms: of each arm's gripper.
    """

    names: tuple[str, ...]
    velocity: tuple[float, ...]
    acceleration: tuple[float, ...]
    lower: tuple[float, ...]
    upper: tuple[float, ...]
    home: tuple[float, ...]
    arms: tuple[str, ...]
    finger_joints: tuple[tuple[str, str], ...]
    finger_geoms: tuple[tuple[str, str], ...]

    @classmethod
    def of(cls, robot: RobotSpec) -> ActingJoints:
        """The joints of a robot."""
        others = robot.idle_arms if robot.acts_with_all_arms else ()
        links = (*robot.chain, *(link for arm in others for link in arm.chain))
        return cls(
            names=(*robot.base_joints, *(link.joint for link in links)),
            velocity=(*robot.max_velocity, *(value for arm in others for value in arm.max_velocity)),
            acceleration=(*robot.max_acceleration, *(value for arm in others for value in arm.max_acceleration)),
            lower=tuple(link.lower for link in links),
            upper=tuple(link.upper for link in links),
            home=(*robot.home, *(value for arm in others for value in arm.home)),
            arms=robot.acting_arms,
            finger_joints=(robot.finger_joints, *(arm.finger_joints for arm in others)),
            finger_geoms=(robot.finger_geoms, *(arm.finger_geoms for arm in others)),
        )

    @property
    def num_grippers(self) -> int:
        """Number of acting grippers."""
        return len(self.arms)


_POSITIVE = (
    "max_loaded_yaw_rate",
    "max_finger_velocity",
    "max_finger_position",
    "finger_thickness",
    "finger_gap",
    "grasp_height",
    "base_radius",
    "base_height",
)
"""Fields with one positive number."""


_KINDS = {
    "mesh_package": str,
    "mesh_folder": str,
    "closed_form_ik": str,
    "arm_name": str,
    "plans_torso": bool,
    "acts_with_all_arms": bool,
}
"""Fields with a text or a flag."""


def _as_arm(values: Mapping[str, Any]) -> ArmSpec:
    parts = {name: _as_tuples(value) for name, value in values.items()}
    return ArmSpec(**{**parts, "chain": tuple(ChainLink(*link) for link in parts["chain"])})


def _as_tuples(value: Any) -> Any:
    """Convert the lists of JSON to the tuples of the fields."""
    return tuple(_as_tuples(entry) for entry in value) if isinstance(value, list | tuple) else value
