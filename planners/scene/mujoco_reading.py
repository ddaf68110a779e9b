"""Reading the robot and the movable objects of a simulation, which is not written."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TypeAlias

import mujoco
import numpy as np
from numpy.typing import NDArray

from assets.robots import RobotSpec
from planners.scene.bodies import Body, RobotState, SceneError, Shape

__all__ = [
    "OBJECT_PREFIX",
    "Movable",
    "MovableBodies",
    "RobotJoints",
    "can_touch",
    "is_object_name",
    "robot_bodies",
    "robot_state_of",
]

Array: TypeAlias = NDArray[np.float64]
Movable: TypeAlias = Collection[str] | Callable[[str], bool]
"""The bodies that may be moved: their names, or a predicate that is asked for the name of each free body."""

OBJECT_PREFIX = "object_"
"""Names of movable bodies begin so, unless told otherwise."""
_ADVICE = "without it in `movable` it is a static obstacle"
_ON_THE_FLOOR = 0.001
"""[m] and rounding of a rotation matrix: how far the base may be off the floor, or tilted."""
_SHAPES: dict[int, Shape] = {
    int(mujoco.mjtGeom.mjGEOM_CYLINDER): "cylinder",
    int(mujoco.mjtGeom.mjGEOM_BOX): "box",
}


def is_object_name(name: str) -> bool:
    """Whether a free body of that name is movable, unless told otherwise."""
    return name.startswith(OBJECT_PREFIX)


def can_touch(model: mujoco.MjModel) -> NDArray[np.bool_]:
    """Which geoms take part in some contact, by their contact bits or by an explicit pair: (ngeom,)."""
    touches: NDArray[np.bool_] = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
    touches[model.pair_geom1] = True
    touches[model.pair_geom2] = True
    return touches


def robot_bodies(model: mujoco.MjModel, robot: RobotSpec) -> frozenset[int]:
    """Ids of the base body and all that is attached to it.

    Raises:
        SceneError: the model lacks a body, joint or site that the robot's specification names.
    """
    kinds = {
        mujoco.mjtObj.mjOBJ_BODY: (robot.base_body,),
        mujoco.mjtObj.mjOBJ_JOINT: (*robot.drive_joints, *robot.finger_joints),
        mujoco.mjtObj.mjOBJ_SITE: (robot.tcp_site,),
    }
    missing = [name for kind, names in kinds.items() for name in names if mujoco.mj_name2id(model, kind, name) < 0]
    if missing:
        raise SceneError(
            f"the model lacks {', '.join(missing)} of robot {robot.name!r}; attach the robot without a name prefix"
        )
    return _with_descendants(model, model.body(robot.base_body).id)


def _with_descendants(model: mujoco.MjModel, body: int) -> frozenset[int]:
    found = {body}
    for other in range(body + 1, model.nbody):
        if int(model.body_parentid[other]) in found:
            found.add(other)
    return frozenset(found)


@dataclass(frozen=True, eq=False)
class RobotJoints:
    """Where the robot's base and joints are found in `qpos`.

    Attributes:
        columns: (4 + n,) addresses of base x, y, yaw, torso and arm.
        origin: (3,) x [m], y [m], yaw [rad] of the base in the world when its three joints are 0.
    """

    columns: NDArray[np.int64]
    origin: Array

    @classmethod
    def of(cls, model: mujoco.MjModel, data: mujoco.MjData, robot: RobotSpec) -> RobotJoints:
        """Look them up.

        Raises:
            SceneError: the base is attached to something that moves, or does not stand upright on the floor z = 0.
        """
        columns = np.array([model.joint(name).qposadr[0] for name in robot.drive_joints])
        body = model.body(robot.base_body).id
        parent = int(model.body_parentid[body])
        if int(model.body_weldid[parent]) != 0:
            raise SceneError(
                f"the base of robot {robot.name!r} is attached to the moving body {model.body(parent).name!r}"
            )
        frame, local = data.xmat[parent].reshape(3, 3), np.empty(9)
        mujoco.mju_quat2Mat(local, model.body_quat[body])
        position, rotation = data.xpos[parent] + frame @ model.body_pos[body], frame @ local.reshape(3, 3)
        if abs(position[2]) > _ON_THE_FLOOR or 1 - rotation[2, 2] > _ON_THE_FLOOR:
            raise SceneError(
                f"the base of robot {robot.name!r} must stand upright on the floor z = 0, not at {position}"
            )
        reference = model.qpos0[columns[:3]]
        yaw = np.arctan2(rotation[1, 0], rotation[0, 0]) - reference[2]
        return cls(columns, np.append(position[:2] - rotation[:2, :2] @ reference[:2], yaw))

    def read(self, data: mujoco.MjData) -> Array:
        """(4 + n,) base pose in the world, x [m], y [m], yaw [rad], then torso [m] and arm [rad]."""
        values = data.qpos[self.columns]
        (x, y, yaw), c, s = self.origin, np.cos(self.origin[2]), np.sin(self.origin[2])
        values[:3] = x + c * values[0] - s * values[1], y + s * values[0] + c * values[1], yaw + values[2]
        return np.asarray(values)

    def positions(self, drive: Array) -> Array:
        """(4 + n,) joint positions of a whole-body configuration (4 + n,) in the world: the inverse of `read`."""
        values = np.array(drive, dtype=float)
        (x, y, yaw), c, s = self.origin, np.cos(self.origin[2]), np.sin(self.origin[2])
        dx, dy = values[0] - x, values[1] - y
        values[:3] = c * dx + s * dy, c * dy - s * dx, values[2] - yaw
        return values


def robot_state_of(model: mujoco.MjModel, data: mujoco.MjData, robot: RobotSpec) -> RobotState:
    """Where its base, joints and fingers are."""
    drive = RobotJoints.of(model, data, robot).read(data)
    fingers = np.array([data.qpos[model.joint(name).qposadr[0]] for name in robot.finger_joints])
    return RobotState(drive[:3], drive[3:], float(fingers.mean()))


@dataclass(frozen=True, eq=False)
class MovableBodies:
    """The movable objects of a model, in its order: bodies with a free joint and one cylinder or box that can touch.

    Attributes:
        names: of the n bodies.
        bodies: (n,) their ids; `geoms` (n,) ids of their cylinders and boxes.
        addresses: (n,) where the poses of the bodies begin in `qpos`.
        offsets: (n, 3) [m] centre of the geom in the body's frame; `turns` (n, 4) its quaternion there, wxyz.
    """

    names: tuple[str, ...]
    bodies: NDArray[np.int64]
    geoms: NDArray[np.int64]
    addresses: NDArray[np.int64]
    offsets: Array
    turns: Array

    @classmethod
    def of(cls, model: mujoco.MjModel, robot: RobotSpec, movable: Movable = is_object_name) -> MovableBodies:
        """Look them up.

        Raises:
            SceneError: a name that is no free body, or a body that is not one cylinder or one box.
        """
        bodies = _movable_ids(model, robot, movable)
        geoms = _object_geoms(model, bodies)
        return cls(
            names=tuple(str(model.body(body).name) for body in bodies),
            bodies=np.array(bodies, dtype=np.int64),
            geoms=np.array(geoms, dtype=np.int64),
            addresses=np.array([model.jnt_qposadr[model.body_jntadr[body]] for body in bodies], dtype=np.int64),
            offsets=model.geom_pos[geoms].reshape(-1, 3),
            turns=model.geom_quat[geoms].reshape(-1, 4),
        )

    @cached_property
    def _columns(self) -> NDArray[np.int64]:
        """(n, 7) addresses of the poses of the bodies in `qpos`."""
        return np.asarray(self.addresses[:, None] + np.arange(7))

    @cached_property
    def _are_centred(self) -> bool:
        """Whether all geoms have the frames of their bodies."""
        return not self.offsets.any() and bool((self.turns == (1.0, 0.0, 0.0, 0.0)).all())

    def poses(self, data: mujoco.MjData) -> tuple[Array, Array]:
        """Centres (n, 3) [m] and quaternions (n, 4) wxyz of the geoms.

        They are worked out from the joints: `data.xpos` is one time step behind after a step.
        """
        values = data.qpos[self._columns]
        if self._are_centred:
            return values[:, :3].copy(), values[:, 3:].copy()
        centres, quaternions, turned = values[:, :3].copy(), np.empty((len(values), 4)), np.empty(3)
        for i, (offset, turn, quaternion) in enumerate(zip(self.offsets, self.turns, values[:, 3:], strict=True)):
            mujoco.mju_rotVecQuat(turned, offset, quaternion)
            centres[i] += turned
            mujoco.mju_mulQuat(quaternions[i], quaternion, turn)
        return centres, quaternions

    def read(self, model: mujoco.MjModel, data: mujoco.MjData) -> tuple[Body, ...]:
        """The objects where they are now."""
        return tuple(
            Body(name, _SHAPES[int(model.geom_type[geom])], _half_extents(model, int(geom)), centre, quaternion)
            for name, geom, centre, quaternion in zip(self.names, self.geoms, *self.poses(data), strict=True)
        )


def _half_extents(model: mujoco.MjModel, geom: int) -> Array:
    size = model.geom_size[geom]
    is_box = _SHAPES[int(model.geom_type[geom])] == "box"
    return np.array(size) if is_box else np.array([size[0], size[0], size[1]])


def _is_free(model: mujoco.MjModel, body: int) -> bool:
    """Whether its one joint is a free joint."""
    kind = int(model.jnt_type[model.body_jntadr[body]]) if model.body_jntnum[body] == 1 else -1
    return kind == int(mujoco.mjtJoint.mjJNT_FREE)


def _movable_ids(model: mujoco.MjModel, robot: RobotSpec, movable: Movable) -> list[int]:
    robot_ids = robot_bodies(model, robot)
    free = {str(model.body(i).name): i for i in range(model.nbody) if i not in robot_ids and _is_free(model, i)}
    if callable(movable):
        return [body for name, body in free.items() if movable(name)]
    if isinstance(movable, str):
        raise SceneError(f"movable is a collection of names or a predicate, not one string; use [{movable!r}]")
    unknown = [name for name in movable if name not in free]
    if unknown:
        raise SceneError(f"no free body {', '.join(map(repr, unknown))}; free bodies: {', '.join(free) or 'none'}")
    return [body for name, body in free.items() if name in movable]


def _object_geoms(model: mujoco.MjModel, bodies: Sequence[int]) -> list[int]:
    """The one geom of each movable body that can touch something."""
    owner = {body: body for body in bodies}
    for body in range(1, model.nbody):
        parent = owner.get(int(model.body_parentid[body]))
        if parent is not None and body not in owner:
            owner[body] = parent
    geoms: dict[int, list[int]] = {body: [] for body in bodies}
    for geom in np.flatnonzero(can_touch(model)):
        root = owner.get(int(model.geom_bodyid[geom]))
        if root is not None:
            geoms[root].append(int(geom))
    for body, movable in owner.items():
        if body != movable and model.body_jntnum[body]:
            raise SceneError(f"movable body {model.body(movable).name!r} has joints besides its free joint; {_ADVICE}")
    return [_the_geom(model, body, geoms[body]) for body in bodies]


def _the_geom(model: mujoco.MjModel, body: int, geoms: Sequence[int]) -> int:
    name = model.body(body).name
    if len(geoms) != 1 or int(model.geom_bodyid[geoms[0]]) != body:
        raise SceneError(
            f"movable body {name!r} must have one geom of its own that can touch, not {len(geoms)}; {_ADVICE}"
        )
    kind = int(model.geom_type[geoms[0]])
    if kind not in _SHAPES:
        shape = mujoco.mjtGeom(kind).name.removeprefix("mjGEOM_").lower()
        raise SceneError(f"movable body {name!r} is a {shape}, not a cylinder or a box; {_ADVICE}")
    return geoms[0]
