"""Read the robot, the movable objects and the static obstacles of a MuJoCo simulation, which is not written."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from typing import Any, NamedTuple, TypeAlias

import mujoco
import numpy as np
from numpy.typing import NDArray

from assets.robots import RobotSpec
from planners.scene.bodies import Body, RobotState, SceneError, Shape
from planners.scene.static_obstacle import FLOOR, StaticObstacle

Array: TypeAlias = NDArray[np.float64]
Movable: TypeAlias = Collection[str] | Callable[[str], bool]
"""The bodies that may be moved: their names, or a predicate that is asked for the name of each free body."""
_ADVICE = "without it in `movable` it is a static obstacle"
_ON_THE_FLOOR = 0.001
"""[m] and rounding of a rotation matrix: how far the base may be off the ground, or tilted."""
_SHAPES: dict[int, Shape] = {
    int(mujoco.mjtGeom.mjGEOM_CYLINDER): "cylinder",
    int(mujoco.mjtGeom.mjGEOM_BOX): "box",
}
IsObstacle: TypeAlias = Callable[[Any], bool]
"""Whether a geom counts; it is asked with MuJoCo's accessor `model.geom(id)`: `.name`, `.group`, `.contype`, …"""
_AXIS_TOLERANCE = 1e-6
"""Rounding of the entries of a rotation matrix: a box this near to the world's axes is taken to lie along them."""
_GROUND_TOLERANCE = 0.001
"""[m] An upward horizontal plane no higher than this is the ground, which every scene has."""
_PLANE = np.array([50.0, 50.0, 0.5])
"""[m] Half extents of the box that stands for a plane: wider than any scene, thicker than any step of a motion."""


def is_object_name(name: str) -> bool:
    """Whether a free body of that name is movable, unless told otherwise."""
    return name.startswith("object_")


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
    return _with_attached(model, [model.body(robot.base_body).id])


def _with_attached(model: mujoco.MjModel, bodies: Iterable[int]) -> frozenset[int]:
    """These bodies and all that are attached to them; MuJoCo numbers parents before their children."""
    found = set(bodies)
    for body in range(model.nbody):
        if int(model.body_parentid[body]) in found:
            found.add(body)
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
            SceneError: the base is attached to something that moves, or does not stand upright on the ground z = 0.
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
                f"the base of robot {robot.name!r} must stand upright on the ground z = 0, not at {position}"
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
        addresses: (n, 7) of the poses of the bodies in `qpos`.
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
            addresses=model.jnt_qposadr[model.body_jntadr[bodies]].reshape(-1, 1).astype(np.int64) + np.arange(7),
            offsets=model.geom_pos[geoms].reshape(-1, 3),
            turns=model.geom_quat[geoms].reshape(-1, 4),
        )

    @cached_property
    def _are_centred(self) -> bool:
        """Whether all geoms have the frames of their bodies."""
        return not self.offsets.any() and bool((self.turns == (1.0, 0.0, 0.0, 0.0)).all())

    def poses(self, data: mujoco.MjData) -> tuple[Array, Array]:
        """Centres (n, 3) [m] and quaternions (n, 4) wxyz of the geoms.

        They are worked out from the joints: `data.xpos` is one time step behind after a step.
        """
        values = data.qpos[self.addresses]
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
        bodies = []
        for name, geom, centre, quaternion in zip(self.names, self.geoms, *self.poses(data), strict=True):
            shape, size = _SHAPES[int(model.geom_type[geom])], model.geom_size[geom]
            half = size if shape == "box" else size[[0, 0, 1]]
            bodies.append(Body(name, shape, half, centre, quaternion))
        return tuple(bodies)


def _movable_ids(model: mujoco.MjModel, robot: RobotSpec, movable: Movable) -> list[int]:
    free_joints = np.flatnonzero(model.jnt_type == int(mujoco.mjtJoint.mjJNT_FREE))
    bodies, on_robot = model.jnt_bodyid[free_joints], robot_bodies(model, robot)
    free = {str(model.body(body).name): int(body) for body in bodies if int(body) not in on_robot}
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
    touching, found = np.flatnonzero(can_touch(model)), []
    for body in bodies:
        name = model.body(body).name
        if model.body_jntnum[model.body_rootid == body].sum() > 1:
            raise SceneError(f"movable body {name!r} has joints besides its free joint; {_ADVICE}")
        # A body with a free joint is a child of the world, so that it is the root of all that is attached to it.
        geoms = [int(geom) for geom in touching[model.body_rootid[model.geom_bodyid[touching]] == body]]
        if len(geoms) != 1 or int(model.geom_bodyid[geoms[0]]) != body:
            raise SceneError(
                f"movable body {name!r} must have one geom of its own that can touch, not {len(geoms)}; {_ADVICE}"
            )
        kind = int(model.geom_type[geoms[0]])
        if kind not in _SHAPES:
            shape = mujoco.mjtGeom(kind).name.removeprefix("mjGEOM_").lower()
            raise SceneError(f"movable body {name!r} is a {shape}, not a cylinder or a box; {_ADVICE}")
        found.append(geoms[0])
    return found


class FoundObstacle(NamedTuple):
    """A static obstacle and the name of the body that it belongs to in the model."""

    obstacle: StaticObstacle
    body: str


def static_obstacles_of(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    robot: RobotSpec,
    movable: Iterable[int],
    is_obstacle: IsObstacle | None = None,
) -> tuple[FoundObstacle, ...]:
    """Every geom that is neither on the robot nor on a movable body, where it is now, with the name of its body.

    Args:
        model: horizontal planes at ground height or below are the ground and are left out, other planes become boxes.
        data: after a step or `mj_forward`.
        robot: which robot it is.
        movable: ids of the movable bodies; what is attached to them goes with them.
        is_obstacle: which geoms count; by default those that can touch something.

    Raises:
        SceneError: a geom that cannot be represented, something deformable, or a geom on the robot that is not its own.
    """
    if model.nflex:
        flexes = [mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_FLEX, i) or f"flex_{i}" for i in range(model.nflex)]
        raise SceneError(f"deformable bodies cannot be represented: {', '.join(flexes)}")
    on_robot, touches = robot_bodies(model, robot), can_touch(model)
    for touching in np.flatnonzero(touches):
        part = model.body(model.geom_bodyid[touching])
        # No check would see what moves with the robot but is not in its MJCF.
        if part.id in on_robot and (part.name, str(model.geom(touching).name)) not in _own_geoms(robot):
            raise SceneError(
                f"geom {geom_name(model, int(touching))!r} on body {part.name!r} moves with the robot, but is not in "
                f"the MJCF of {robot.name!r}"
            )
    elsewhere = on_robot | _with_attached(model, movable)
    found: list[FoundObstacle] = []
    for geom in range(model.ngeom):
        body = int(model.geom_bodyid[geom])
        is_plane = int(model.geom_type[geom]) == int(mujoco.mjtGeom.mjGEOM_PLANE)
        faces_up = data.geom_xmat[geom][8] > 1 - _AXIS_TOLERANCE
        is_ground = is_plane and faces_up and data.geom_xpos[geom][2] <= _GROUND_TOLERANCE
        if body in elsewhere or is_ground:
            continue
        if touches[geom] if is_obstacle is None else is_obstacle(model.geom(geom)):
            found.append(FoundObstacle(_obstacle(model, data, geom), str(model.body(body).name)))
    return tuple(found)


@cache
def _own_geoms(robot: RobotSpec) -> frozenset[tuple[str, str]]:
    """Names of body and geom of every geom of the robot's own MJCF."""
    model = mujoco.MjModel.from_xml_path(str(robot.mjcf_path))
    bodies = (model.body(model.geom_bodyid[geom]).name for geom in range(model.ngeom))
    return frozenset((str(body), str(model.geom(geom).name)) for geom, body in enumerate(bodies))


def geom_name(model: mujoco.MjModel, geom: int) -> str:
    """Of the geom; of one without a name, its body's and its number."""
    return str(model.geom(geom).name) or f"{model.body(model.geom_bodyid[geom]).name}/geom_{geom}"


def _obstacle(model: mujoco.MjModel, data: mujoco.MjData, geom: int) -> StaticObstacle:
    name, kind, size = geom_name(model, geom), mujoco.mjtGeom(int(model.geom_type[geom])), model.geom_size[geom]
    position, rotation = np.array(data.geom_xpos[geom]), data.geom_xmat[geom].reshape(3, 3)
    kinds = mujoco.mjtGeom
    if kind == kinds.mjGEOM_BOX:
        return _box(name, position, size, rotation)
    if kind == kinds.mjGEOM_PLANE:
        return _box(name, position - _PLANE[2] * rotation[:, 2], _PLANE, rotation)
    if kind == kinds.mjGEOM_CYLINDER:
        return StaticObstacle(name, position, size[[0, 0, 1]], "cylinder", rotation)
    if kind == kinds.mjGEOM_CAPSULE:
        return StaticObstacle(name, position, size[[0, 0, 1]] + [0, 0, size[0]], "capsule", rotation)
    if kind == kinds.mjGEOM_SPHERE:
        return StaticObstacle(name, position, size[[0, 0, 0]], "sphere", rotation)
    if kind == kinds.mjGEOM_ELLIPSOID:
        return StaticObstacle(name, position, size, "ellipsoid", rotation)
    if kind == kinds.mjGEOM_MESH:
        return StaticObstacle.hull(name, _mesh_points(model, int(model.geom_dataid[geom])), position, rotation)
    shape, body = kind.name.removeprefix("mjGEOM_").lower(), model.body(model.geom_bodyid[geom]).name
    raise SceneError(
        f"geom {name!r} of body {body!r} is of type {shape!r}, which cannot be represented; replace it by meshes or "
        "primitives, or leave it out with `obstacles`"
    )


def _box(name: str, position: Array, half: Array, rotation: Array) -> StaticObstacle:
    """A box along the world's axes is written as one without rotation."""
    absolute = np.abs(rotation)
    if np.abs(absolute - absolute.round()).max() <= _AXIS_TOLERANCE:
        return StaticObstacle(name, position, absolute @ half)
    return StaticObstacle(name, position, half, "box", rotation)


def _mesh_points(model: mujoco.MjModel, mesh: int) -> Array:
    """(n, 3) [m] vertices of a mesh in its geom's frame; those of its convex hull where MuJoCo has worked them out."""
    first, graph = int(model.mesh_vertadr[mesh]), int(model.mesh_graphadr[mesh])
    points = np.array(model.mesh_vert[first : first + int(model.mesh_vertnum[mesh])], dtype=float)
    if graph < 0:
        return points
    count = int(model.mesh_graph[graph])
    return points[model.mesh_graph[graph + 2 + count : graph + 2 + 2 * count]]


def declared_supports(model: mujoco.MjModel) -> tuple[str, ...]:
    """Names of the geoms on which objects may be put, by the model's custom tuple "supports"; none without it."""
    index = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_TUPLE, "supports")
    if index < 0:
        return ()
    entries = slice(model.tuple_adr[index], model.tuple_adr[index] + model.tuple_size[index])
    is_geom = model.tuple_objtype[entries] == int(mujoco.mjtObj.mjOBJ_GEOM)
    return tuple(geom_name(model, int(geom)) for geom in model.tuple_objid[entries][is_geom])


def find_supports(found: Sequence[FoundObstacle], wanted: Iterable[str]) -> tuple[str, ...]:
    """Names of the obstacles on which objects can be put: each the geom of that name, or the highest level one of that
    body; without duplicates.

    Raises:
        SceneError: there is none of a name; the message lists what objects can stand on.
    """
    level = [one for one in found if one.obstacle.has_level_top]
    names: list[str] = []
    for name in wanted:
        tops = [one.obstacle for one in level if name == one.obstacle.name]
        tops = tops or [one.obstacle for one in level if name == one.body]
        if not tops and name == FLOOR:
            names.append(name)
            continue
        if not tops:
            both = (known for one in level for known in (one.obstacle.name, one.body) if known != "world")
            known = ", ".join(dict.fromkeys(both)) or "none"
            raise SceneError(f"no support {name!r}; geoms and bodies with a level top face: {known}")
        names.append(max(tops, key=lambda top: (top.top, float(np.prod(top.extent[:2])))).name)
    return tuple(dict.fromkeys(names))
