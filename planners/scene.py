"""The world as the planner sees it: one immutable snapshot of robot, furniture and objects.

World frame: origin on the floor under the table's centre, x from the robot towards the table, y left, z up.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from assets.robots import RobotSpec

__all__ = [
    "FURNITURE_BIT",
    "MAX_OBJECTS",
    "SELF_BIT",
    "SUPPORT",
    "Body",
    "FurnitureBox",
    "HeldObject",
    "RobotState",
    "Scene",
    "SceneError",
    "UnknownObject",
]

FURNITURE_BIT = 63
"""Bit of a hit mask that stands for furniture and floor."""
SELF_BIT = 62
"""Bit of a hit mask that stands for the robot's own body."""
MAX_OBJECTS = 60
"""Objects in one scene at most: one bit each in a 64-bit word, with room for the bits above."""
SUPPORT = "table_top"
"""The piece of furniture whose top face is R_plane."""
UPRIGHT_TILT = 0.17
"""[rad] An object tilted by less still counts as standing."""
OBJECT_PREFIX = "object_"
AXIS_TOLERANCE = 1e-6
"""Rounding of rotation matrices."""

Shape = Literal["cylinder", "box"]


class SceneError(ValueError):
    """A scene that cannot be: wrong shapes, duplicate names, overlaps, a robot inside the furniture."""


class UnknownObject(SceneError):
    """No object of that name; the message lists the known ones."""


def _frozen(values: ArrayLike, shape: tuple[int, ...], what: str) -> NDArray[np.float64]:
    """A read-only copy of that shape."""
    array = np.array(values, dtype=float)
    if array.shape != shape or not np.isfinite(array).all():
        raise SceneError(f"{what} must be finite with shape {shape}, not {array!r}")
    array.setflags(write=False)
    return array


@dataclass(frozen=True, eq=False)
class Body:
    """A rigid object: an upright or toppled cylinder or box.

    `half_extents` (3,) [m] (a cylinder: radius, radius, half height), `position` (3,) [m] of the centre,
    `quaternion` (4,) wxyz, all in the world.
    """

    name: str
    shape: Shape
    half_extents: NDArray[np.float64]
    position: NDArray[np.float64]
    quaternion: NDArray[np.float64]

    def __post_init__(self) -> None:
        for name, size in (("half_extents", 3), ("position", 3), ("quaternion", 4)):
            object.__setattr__(self, name, _frozen(getattr(self, name), (size,), f"{name} of {self.name!r}"))
        if self.shape not in ("cylinder", "box"):
            raise SceneError(f"{self.name!r} is a {self.shape!r}; known shapes: box, cylinder")
        if (self.half_extents <= 0).any() or not np.linalg.norm(self.quaternion) > 0.5:
            raise SceneError(f"{self.name!r} needs positive half extents and a unit quaternion")

    @cached_property
    def rotation(self) -> NDArray[np.float64]:
        """R_world_body (3, 3)."""
        matrix = np.empty(9)
        mujoco.mju_quat2Mat(matrix, self.quaternion / np.linalg.norm(self.quaternion))
        matrix.setflags(write=False)
        return matrix.reshape(3, 3)

    @property
    def pose(self) -> NDArray[np.float64]:
        """T_world_body (4, 4)."""
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = self.rotation, self.position
        return T

    @property
    def yaw(self) -> float:
        """[rad] of the body's x axis about the vertical."""
        rotation = self.rotation
        return math.atan2(rotation[1, 0], rotation[0, 0])

    def half_extent_along(self, direction: ArrayLike) -> float:
        """[m] from the centre to the farthest plane perpendicular to a world `direction` (3,) of unit length."""
        local = np.asarray(direction, dtype=float) @ self.rotation
        if self.shape == "box":
            return float(np.abs(local) @ self.half_extents)
        return float(abs(local[2]) * self.half_extents[2] + math.hypot(local[0], local[1]) * self.half_extents[0])

    @cached_property
    def radius(self) -> float:
        """[m] of the upright circle about `position` that contains the body's outline from above."""
        vertical = self.rotation[2]
        if self.shape == "cylinder":
            half, radius = self.half_extents[2], self.half_extents[0]
            standing, lying = abs(vertical[2]), math.hypot(vertical[0], vertical[1])
            if half * standing < radius * lying:
                return math.hypot(half, radius)
            return float(lying * half + standing * radius)
        signs = np.array([(a, b, c) for a in (-1, 1) for b in (-1, 1) for c in (-1, 1)], dtype=float)
        corners = (signs * self.half_extents) @ self.rotation.T
        return float(np.hypot(corners[:, 0], corners[:, 1]).max())

    @property
    def half_width(self) -> float:
        """[m] that the fingers must span to each side: a cylinder's radius, half the wider side of a box."""
        return float(self.half_extents[:2].max())

    @cached_property
    def bottom(self) -> float:
        """[m] height of the lowest point."""
        return float(self.position[2]) - self.half_extent_along((0.0, 0.0, 1.0))

    @cached_property
    def top(self) -> float:
        """[m] height of the highest point."""
        return float(self.position[2]) + self.half_extent_along((0.0, 0.0, 1.0))

    @cached_property
    def is_upright(self) -> bool:
        """Whether its own z axis points up, within `UPRIGHT_TILT`."""
        return bool(self.rotation[2, 2] > math.cos(UPRIGHT_TILT))

    def at(self, position: ArrayLike, quaternion: ArrayLike | None = None) -> Body:
        """The same object elsewhere; it keeps its orientation unless told."""
        orientation = self.quaternion if quaternion is None else quaternion
        return replace(self, position=np.asarray(position), quaternion=np.asarray(orientation))

    def at_pose(self, T_world_body: NDArray[np.float64]) -> Body:
        """The same object at a pose (4, 4)."""
        quaternion = np.empty(4)
        mujoco.mju_mat2Quat(quaternion, np.ascontiguousarray(T_world_body[:3, :3]).ravel())
        return self.at(T_world_body[:3, 3], quaternion)


@dataclass(frozen=True, eq=False)
class FurnitureBox:
    """A static axis-aligned box: centre and half extents, each (3,) [m]."""

    name: str
    position: NDArray[np.float64]
    half_extents: NDArray[np.float64]

    def __post_init__(self) -> None:
        for name in ("position", "half_extents"):
            object.__setattr__(self, name, _frozen(getattr(self, name), (3,), f"{name} of {self.name!r}"))

    @property
    def lower(self) -> NDArray[np.float64]:
        """(3,) [m] smallest corner."""
        return self.position - self.half_extents

    @property
    def upper(self) -> NDArray[np.float64]:
        """(3,) [m] largest corner."""
        return self.position + self.half_extents

    @property
    def top(self) -> float:
        """[m] height of the top face."""
        return float(self.upper[2])


@dataclass(frozen=True, eq=False)
class RobotState:
    """Where the robot is: `base` (3,) x [m], y [m], yaw [rad]; `q` (8,) torso [m] and arm [rad]; one finger [m]."""

    base: NDArray[np.float64]
    q: NDArray[np.float64]
    finger_position: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "base", _frozen(self.base, (3,), "base"))
        object.__setattr__(self, "q", _frozen(self.q, (len(self.q),), "q"))
        object.__setattr__(self, "finger_position", float(self.finger_position))


@dataclass(frozen=True, eq=False)
class HeldObject:
    """An object between the fingers: its name and T_tcp_object (4, 4)."""

    name: str
    T_tcp_object: NDArray[np.float64]

    def __post_init__(self) -> None:
        object.__setattr__(self, "T_tcp_object", _frozen(self.T_tcp_object, (4, 4), "T_tcp_object"))


@dataclass(frozen=True, eq=False)
class Scene:
    """Everything the planner may know, at one instant. Object i of `objects` is bit i of every mask."""

    robot: RobotSpec
    state: RobotState
    objects: tuple[Body, ...]
    furniture: tuple[FurnitureBox, ...]
    held: HeldObject | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "objects", tuple(self.objects))
        object.__setattr__(self, "furniture", tuple(self.furniture))
        if len(self.objects) > MAX_OBJECTS:
            raise SceneError(f"{len(self.objects)} objects; at most {MAX_OBJECTS} fit a mask")
        for kind in (self.names, tuple(box.name for box in self.furniture)):
            if len(set(kind)) != len(kind):
                raise SceneError(f"duplicate names among {', '.join(kind)}")
        if self.held is not None:
            self.index(self.held.name)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Object names in the order of their bits."""
        return tuple(body.name for body in self.objects)

    def index(self, name: str) -> int:
        """Bit of an object.

        Raises:
            UnknownObject: no such object; the message lists the known ones.
        """
        names = self.names
        if name not in names:
            raise UnknownObject(f"no object {name!r}; known objects: {', '.join(names) or 'none'}")
        return names.index(name)

    def body(self, name: str) -> Body:
        """The object of that name; raises `UnknownObject`."""
        return self.objects[self.index(name)]

    @property
    def support(self) -> FurnitureBox:
        """The table top; raises `SceneError` where there is none."""
        for box in self.furniture:
            if box.name == SUPPORT:
                return box
        raise SceneError(f"no furniture {SUPPORT!r}; known: {', '.join(box.name for box in self.furniture) or 'none'}")

    def mask(self, names: Iterable[str]) -> int:
        """The bits of these objects."""
        return sum({1 << self.index(name) for name in names})

    def names_of(self, mask: int) -> tuple[str, ...]:
        """The objects whose bits are set; furniture and self bits are not objects and are left out."""
        return tuple(body.name for i, body in enumerate(self.objects) if int(mask) >> i & 1)

    def with_state(self, state: RobotState) -> Scene:
        """The same scene with the robot elsewhere."""
        return replace(self, state=state)

    def with_body(self, body: Body) -> Scene:
        """The same scene with the object of that name replaced."""
        index = self.index(body.name)
        return replace(self, objects=(*self.objects[:index], body, *self.objects[index + 1 :]))

    def with_held(self, held: HeldObject | None) -> Scene:
        """The same scene with another object, or none, in hand."""
        return replace(self, held=held)

    @classmethod
    def from_mujoco(cls, model: mujoco.MjModel, data: mujoco.MjData, robot: RobotSpec, held: str = "") -> Scene:
        """A snapshot of a simulation; neither `model` nor `data` is written.

        Args:
            model: objects are bodies "object_…" with a free joint and one geom; furniture is box geoms of static
                bodies; the robot has the names of `robot`.
            data: after a step or `mj_forward`.
            robot: which robot it is.
            held: name of the object in hand, "" for none.

        Raises:
            SceneError: an object that is neither cylinder nor box, or furniture that is not axis-aligned.
            UnknownObject: no object named `held`.
        """
        objects = tuple(_object(model, data, i) for i in range(model.nbody) if _is_object(model, i))
        scene = cls(robot, _robot_state(model, data, robot), objects, tuple(_furniture(model, data)))
        if not held:
            return scene
        scene.index(held)
        T_world_tcp, T_world_object = np.eye(4), np.eye(4)
        site, body = data.site(robot.tcp_site), data.geom(held)
        T_world_tcp[:3, :3], T_world_tcp[:3, 3] = site.xmat.reshape(3, 3), site.xpos
        T_world_object[:3, :3], T_world_object[:3, 3] = body.xmat.reshape(3, 3), body.xpos
        return scene.with_held(HeldObject(held, np.linalg.inv(T_world_tcp) @ T_world_object))


def _is_object(model: mujoco.MjModel, body: int) -> bool:
    return str(model.body(body).name).startswith(OBJECT_PREFIX)


def _object(model: mujoco.MjModel, data: mujoco.MjData, body: int) -> Body:
    """The pose is read from the joint: after a step, `data.xpos` lags by one."""
    name = model.body(body).name
    if model.body_geomnum[body] != 1 or model.body_jntnum[body] != 1:
        raise SceneError(f"{name!r} must have one geom and one free joint")
    geom = int(model.body_geomadr[body])
    kind, size = int(model.geom_type[geom]), model.geom_size[geom]
    start = int(model.jnt_qposadr[model.body_jntadr[body]])
    position, quaternion = data.qpos[start : start + 3], data.qpos[start + 3 : start + 7]
    if kind == int(mujoco.mjtGeom.mjGEOM_CYLINDER):
        return Body(name, "cylinder", np.array([size[0], size[0], size[1]]), position, quaternion)
    if kind == int(mujoco.mjtGeom.mjGEOM_BOX):
        return Body(name, "box", size, position, quaternion)
    raise SceneError(f"{name!r} is neither a cylinder nor a box")


def _furniture(model: mujoco.MjModel, data: mujoco.MjData) -> Iterable[FurnitureBox]:
    """Every box fixed to the world that something can touch."""
    for geom in range(model.ngeom):
        is_static = int(model.body_weldid[model.geom_bodyid[geom]]) == 0
        touches = bool(model.geom_contype[geom] or model.geom_conaffinity[geom])
        if not (is_static and touches and int(model.geom_type[geom]) == int(mujoco.mjtGeom.mjGEOM_BOX)):
            continue
        name = model.geom(geom).name or f"furniture_{geom}"
        rotation = np.abs(data.geom_xmat[geom].reshape(3, 3))
        if np.abs(rotation - rotation.round()).max() > AXIS_TOLERANCE:
            raise SceneError(f"furniture {name!r} is not axis-aligned")
        yield FurnitureBox(name, data.geom_xpos[geom], rotation @ model.geom_size[geom])


def _robot_state(model: mujoco.MjModel, data: mujoco.MjData, robot: RobotSpec) -> RobotState:
    def positions(joints: Iterable[str]) -> NDArray[np.float64]:
        return np.array([data.qpos[model.joint(name).qposadr[0]] for name in joints])

    drive = positions(robot.drive_joints)
    return RobotState(drive[:3], drive[3:], float(positions(robot.finger_joints).mean()))
