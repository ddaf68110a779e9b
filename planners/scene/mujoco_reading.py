"""Reading of the robot, the movable objects and the static obstacles of a MuJoCo simulation, which is not modified."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property
from types import MappingProxyType
from typing import Any, Literal, NamedTuple, TypeAlias, TypeVar

import mujoco
import numpy as np
from numpy.typing import NDArray

from assets.contacts import paired_name
from assets.robots import RobotSpec
from planners.regions import RESTING
from planners.scene.bodies import Body, RobotState, Shape, pose_matrix
from planners.scene.openings import JointKind, Opening, is_handle_name
from planners.scene.robot_names import robot_prefix
from planners.scene.solid import FLOOR, SceneError, Solid, StaticObstacle

Array: TypeAlias = NDArray[np.float64]
SolidT = TypeVar("SolidT", bound=Solid)
Movable: TypeAlias = Iterable[str] | Callable[[str], bool]
"""Movable bodies: their names, or a predicate on the names of free bodies."""
_ADVICE = "leave the body out of `movable`, it is a static obstacle then"
_ON_THE_FLOOR = 0.001
"""[m] and entry of a rotation matrix: largest distance of the base from its ground, and largest tilt."""
_SHAPES: dict[int, Shape] = {
    int(mujoco.mjtGeom.mjGEOM_CYLINDER): "cylinder",
    int(mujoco.mjtGeom.mjGEOM_BOX): "box",
}
IsObstacle: TypeAlias = Callable[[Any], bool]
"""Whether a geom is an obstacle. The argument is MuJoCo's accessor `model.geom(id)`: `.name`, `.group`, `.contype`,
…"""
_AXIS_TOLERANCE = 1e-6
"""Rounding of the entries of a rotation matrix. A box this near to the world's axes is taken to lie along them."""
_GROUND_TOLERANCE = 0.001
"""[m] Greatest height of an upward horizontal plane that is the ground, which every scene has."""
_PLANE = np.array([50.0, 50.0, 0.5])
"""[m] Half extents of the box that replaces a plane: wider than any scene, thicker than any step of a motion."""

_JOINTS: dict[int, JointKind] = {
    int(mujoco.mjtJoint.mjJNT_SLIDE): "slide",
    int(mujoco.mjtJoint.mjJNT_HINGE): "hinge",
}
_OUT_OF_REACH = 2.5
"""[m] Height above which a top, such as a wall's, comes last in a list of supports."""
_LONGEST = {"slide": 10.0, "hinge": 8 * math.pi}
"""[m], [rad] Longest range. A longer one means no range."""
_LEFT_OPEN = (0.8, 0.97)
"""Shares of its range between which an opening is left open."""
_TOO_LITTLE = 0.05
"""[N], [N m] Load that is too small to move an opening during a plan. Axes are level or upright to some thousandths."""
_SLENDER = 0.05
"""[m] Largest thickness (twice the second half extent) of a part that may be a handle without a handle's name."""


def is_object_name(name: str) -> bool:
    """Whether a free body of that name is movable by default."""
    return name.startswith("object_")


def can_touch(model: mujoco.MjModel) -> NDArray[np.bool_]:
    """Mark the geoms (ngeom,) that may have contacts, by their contact bits or by an explicit pair."""
    touches: NDArray[np.bool_] = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
    touches[model.pair_geom1] = True
    touches[model.pair_geom2] = True
    return touches


def robot_bodies(model: mujoco.MjModel, robot: RobotSpec) -> frozenset[int]:
    """Ids of the base body and its descendants. Raises `SceneError` if the model lacks parts of the robot."""
    return _with_attached(model, [model.body(robot_prefix(model, robot) + robot.base_body).id])


def _with_attached(model: mujoco.MjModel, bodies: Iterable[int]) -> frozenset[int]:
    """These bodies and their descendants. MuJoCo numbers parents before their children."""
    found = set(bodies)
    for body in range(model.nbody):
        if int(model.body_parentid[body]) in found:
            found.add(body)
    return frozenset(found)


@dataclass(frozen=True, eq=False)
class RobotJoints:
    """Addresses of the robot's base and joints in `qpos`.

    Attributes:
        columns: (4 + n,) addresses of base x, y, yaw, torso and arm.
        origin: (3,) x [m], y [m], yaw [rad] of the base in the world with its three joints at 0.
        ground: height of the ground under the base [m]. Exactly 0 if it is within `_ON_THE_FLOOR`.
    """

    columns: NDArray[np.int64]
    origin: Array
    ground: float = 0.0

    @classmethod
    def of(cls, model: mujoco.MjModel, data: mujoco.MjData, robot: RobotSpec) -> RobotJoints:
        """Look up the joints. Raises `SceneError` unless the base stands upright on ground that does not move."""
        prefix = robot_prefix(model, robot)
        columns = np.array([model.joint(prefix + name).qposadr[0] for name in robot.drive_joints])
        body = model.body(prefix + robot.base_body).id
        parent = int(model.body_parentid[body])
        if int(model.body_weldid[parent]) != 0:
            moving = model.body(parent).name
            raise SceneError(f"the base of robot {robot.name!r} is attached to the moving body {moving!r}")
        frame, local = data.xmat[parent].reshape(3, 3), np.empty(9)
        mujoco.mju_quat2Mat(local, model.body_quat[body])
        position, rotation = data.xpos[parent] + frame @ model.body_pos[body], frame @ local.reshape(3, 3)
        reference = model.qpos0[columns[:3]]
        yaw = np.arctan2(rotation[1, 0], rotation[0, 0]) - reference[2]
        origin = np.append(position[:2] - rotation[:2, :2] @ reference[:2], yaw)
        height = float(position[2])
        joints = cls(columns, origin, 0.0 if abs(height) <= _ON_THE_FLOOR else height)
        is_upright = 1 - rotation[2, 2] <= _ON_THE_FLOOR
        is_bolted = robot.base_drive == "fixed"
        if not is_upright or not (joints.ground == 0.0 or is_bolted or _carries(model, data, joints, height)):
            planes = sorted({round(float(data.geom_xpos[plane, 2]), 3) for plane in floor_planes(model, data)})
            raise SceneError(
                f"the base of {robot.name!r} must stand upright on the ground z = 0, on a floor, or on a level top, "
                f"not at {position}; floors are at z = {', '.join(map(str, planes)) or 'none'}"
            )
        return joints

    def read(self, data: mujoco.MjData) -> Array:
        """Read (4 + n,) base pose in the world, x [m], y [m], yaw [rad], then torso [m] and arm [rad]."""
        values = data.qpos[self.columns]
        (x, y, yaw), c, s = self.origin, np.cos(self.origin[2]), np.sin(self.origin[2])
        values[:3] = x + c * values[0] - s * values[1], y + s * values[0] + c * values[1], yaw + values[2]
        return np.asarray(values)

    def positions(self, drive: Array) -> Array:
        """Joint positions (4 + n,) of a whole-body configuration (4 + n,) in the world: the inverse of `read`."""
        values = np.array(drive, dtype=float)
        (x, y, yaw), c, s = self.origin, np.cos(self.origin[2]), np.sin(self.origin[2])
        dx, dy = values[0] - x, values[1] - y
        values[:3] = c * dx + s * dy, c * dy - s * dx, values[2] - yaw
        return values


def _carries(model: mujoco.MjModel, data: mujoco.MjData, joints: RobotJoints, height: float) -> bool:
    """Whether a floor, or the level top of a fixed box, is at a height [m] under the robot's base."""
    if any(abs(float(data.geom_xpos[plane, 2]) - height) <= _ON_THE_FLOOR for plane in floor_planes(model, data)):
        return True
    is_box = (model.geom_type == int(mujoco.mjtGeom.mjGEOM_BOX)) & can_touch(model)
    for geom in np.flatnonzero(is_box & (model.body_weldid[model.geom_bodyid] == 0)).tolist():
        top = _solid(StaticObstacle, model, geom, data.geom_xpos[geom], data.geom_xmat[geom].reshape(3, 3), "")
        if top.has_level_top and abs(top.top - height) <= _ON_THE_FLOOR and top.is_under(joints.read(data)[:2]):
            return True
    return False


def floor_planes(model: mujoco.MjModel, data: mujoco.MjData) -> tuple[int, ...]:
    """Ids of the colliding horizontal planes that face up, at any height."""
    is_floor = (model.geom_type == int(mujoco.mjtGeom.mjGEOM_PLANE)) & can_touch(model)
    return tuple(np.flatnonzero(is_floor & (data.geom_xmat[:, 8] > 1 - _AXIS_TOLERANCE)).tolist())


def measured_from(ground: float, model: mujoco.MjModel, data: mujoco.MjData) -> mujoco.MjData:
    """A state with heights measured from the robot's ground [m], the planner's z = 0.

    It is `data` itself if the ground is at 0. Do not run kinematics on it again: mocap bodies and bodies placed by the
    model would be at their old heights.
    """
    if ground == 0.0:
        return data
    lowered = copy.copy(data)
    for points in (lowered.xpos, lowered.xipos, lowered.geom_xpos, lowered.site_xpos, lowered.xanchor):
        points[:, 2] -= ground
    free = model.jnt_type == int(mujoco.mjtJoint.mjJNT_FREE)
    lowered.qpos[model.jnt_qposadr[free] + 2] -= ground
    return lowered


def robot_state_of(model: mujoco.MjModel, data: mujoco.MjData, robot: RobotSpec) -> RobotState:
    """Read the state of the robot's base, joints and fingers."""
    drive, prefix = RobotJoints.of(model, data, robot).read(data), robot_prefix(model, robot)
    fingers = [data.joint(prefix + name).qpos[0] for name in robot.finger_joints]
    return RobotState(drive[:3], drive[3:], float(np.mean(fingers)))


@dataclass(frozen=True, eq=False)
class MovableBodies:
    """Movable objects of a model, in its order: bodies with a free joint and colliding geoms.

    Attributes:
        names: names of the n bodies.
        bodies: (n,) their ids.
        objects: (n,) the planner's objects, in the frames of the bodies.
        addresses: (n, 7) addresses of the bodies' poses in `qpos`.
    """

    names: tuple[str, ...]
    bodies: NDArray[np.int64]
    objects: tuple[Body, ...]
    addresses: NDArray[np.int64]

    @classmethod
    def of(cls, model: mujoco.MjModel, robot: RobotSpec, movable: Movable = is_object_name) -> MovableBodies:
        """Look up the objects. Raises `SceneError` for a name without a free body, or a body that cannot be
        represented."""
        bodies = _movable_ids(model, robot, movable)
        found = [movable_body(model, body) for body in bodies]
        return cls(
            names=tuple(body.name for body in found),
            bodies=np.array(bodies, dtype=np.int64),
            objects=tuple(found),
            addresses=model.jnt_qposadr[model.body_jntadr[bodies]].reshape(-1, 1).astype(np.int64) + np.arange(7),
        )

    @cached_property
    def _are_centred(self) -> bool:
        """Whether all objects have the frames of their bodies."""
        return not any(one.position.any() or (one.quaternion != (1.0, 0.0, 0.0, 0.0)).any() for one in self.objects)

    def poses(self, data: mujoco.MjData) -> tuple[Array, Array]:
        """Centres (n, 3) [m] and quaternions (n, 4) wxyz of the objects.

        They are computed from the joints, because `data.xpos` is one time step behind after a step.
        """
        values = data.qpos[self.addresses]
        if self._are_centred:
            return values[:, :3].copy(), values[:, 3:].copy()
        centres, quaternions, turned = values[:, :3].copy(), np.empty((len(values), 4)), np.empty(3)
        for i, (one, quaternion) in enumerate(zip(self.objects, values[:, 3:], strict=True)):
            mujoco.mju_rotVecQuat(turned, one.position, quaternion)
            centres[i] += turned
            mujoco.mju_mulQuat(quaternions[i], quaternion, one.quaternion)
        return centres, quaternions

    def read(self, data: mujoco.MjData) -> tuple[Body, ...]:
        """Read all objects at their present poses."""
        return tuple(body.at(*pose) for body, *pose in zip(self.objects, *self.poses(data), strict=True))

    def read_one(self, data: mujoco.MjData, index: int) -> Body:
        """Read one object at its pose of the last step, which is also that of the model's sites."""
        body = int(self.bodies[index])
        return self.objects[index].at_pose(pose_matrix(data.xpos[body], data.xmat[body]) @ self.objects[index].pose)


def _movable_ids(model: mujoco.MjModel, robot: RobotSpec, movable: Movable) -> list[int]:
    free_joints = np.flatnonzero(model.jnt_type == int(mujoco.mjtJoint.mjJNT_FREE))
    bodies, on_robot = model.jnt_bodyid[free_joints], robot_bodies(model, robot)
    free = {str(model.body(body).name): int(body) for body in bodies if int(body) not in on_robot}
    free.pop("", None)  # a plan could not name it
    if callable(movable):
        return [body for name, body in free.items() if movable(name)]
    if isinstance(movable, str):
        raise SceneError(f"movable is a collection of names or a predicate, not one string; use [{movable!r}]")
    wanted = tuple(movable)
    unknown = [name for name in wanted if name not in free]
    if unknown:
        names = {model.body(body).name for body in range(1, model.nbody)} - {model.body(body).name for body in on_robot}
        hint = "" if names.isdisjoint(unknown) else "; what can be moved has one <freejoint/> and no other joint"
        known = ", ".join(free) or "none"
        raise SceneError(f"no free body {', '.join(map(repr, unknown))}; free bodies: {known}{hint}")
    return [body for name, body in free.items() if name in wanted]


def movable_body(model: mujoco.MjModel, body: int) -> Body:
    """Convert a body with a free joint to the planner's object, in its own frame: one cylinder or box, or convex
    pieces.

    Raises:
        SceneError: it has other joints, no colliding geom, or a geom that cannot be represented.
    """
    name, touches = str(model.body(body).name), can_touch(model)
    if model.body_jntnum[model.body_rootid == body].sum() > 1:
        raise SceneError(f"movable body {name!r} has joints besides its free joint; {_ADVICE}")
    # A body with a free joint is a child of the world, so it is the root of its descendants.
    geoms = [int(geom) for geom in np.flatnonzero(touches & (model.body_rootid[model.geom_bodyid] == body))]
    if not geoms:
        raise SceneError(f"movable body {name!r} has no geom that can touch something; {_ADVICE}")
    shape, size = _SHAPES.get(int(model.geom_type[geoms[0]])), model.geom_size[geoms[0]]
    if shape is not None and len(geoms) == 1 and int(model.geom_bodyid[geoms[0]]) == body:
        half = size if shape == "box" else size[[0, 0, 1]]
        return Body(name, shape, half, model.geom_pos[geoms[0]], model.geom_quat[geoms[0]])
    pieces = []
    for geom in geoms:
        position, rotation = _in_root(model, int(model.geom_bodyid[geom]), body, *local_pose(model, "geom", geom))
        pieces.append(_solid(Solid, model, geom, position, rotation, _ADVICE))
    parts = np.flatnonzero((model.body_rootid == body) & (model.body_mass > 0))
    centres = [_in_root(model, int(part), body, model.body_ipos[part], np.eye(3))[0] for part in parts]
    return Body.of_pieces(name, pieces, centre_of_mass=np.average(centres, 0, model.body_mass[parts]))


def _in_root(model: mujoco.MjModel, body: int, root: int, position: Array, rotation: Array) -> tuple[Array, Array]:
    """Transform position (3,) and rotation (3, 3) from the frame of a body to that of its ancestor `root`."""
    while body != root:
        offset, turn = local_pose(model, "body", body)
        position, rotation, body = offset + turn @ position, turn @ rotation, int(model.body_parentid[body])
    return position, rotation


def local_pose(model: mujoco.MjModel, kind: Literal["body", "geom"], index: int) -> tuple[Array, Array]:
    """Position (3,) [m] and rotation (3, 3) of a body in its parent's frame, or of a geom in its body's."""
    rotation = np.empty(9)
    mujoco.mju_quat2Mat(rotation, getattr(model, f"{kind}_quat")[index])
    return np.array(getattr(model, f"{kind}_pos")[index]), rotation.reshape(3, 3)


class FoundObstacle(NamedTuple):
    """Static obstacle, and the name (often empty) and id of its body in the model."""

    obstacle: StaticObstacle
    body: str
    body_id: int


def static_obstacles_of(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    robot: RobotSpec,
    movable: Iterable[int],
    is_obstacle: IsObstacle | None = None,
) -> tuple[FoundObstacle, ...]:
    """Read every geom that is neither on the robot nor on a movable body, at its present pose, with the name of its
    body.

    Horizontal planes at ground height or below are the ground and are left out. Other planes become boxes. Descendants
    of the movable bodies, given by their ids, belong to these. By default all colliding geoms are obstacles.

    Raises:
        SceneError: a geom that cannot be represented, a deformable body, or a foreign geom on the robot.
    """
    if model.nflex:
        names = [model.flex(i).name or f"flex_{i}" for i in range(model.nflex)]
        raise SceneError(f"deformable bodies cannot be represented: {', '.join(names)}")
    on_robot, touches, prefix = robot_bodies(model, robot), can_touch(model), robot_prefix(model, robot)
    for touching in np.flatnonzero(touches):
        part = model.body(model.geom_bodyid[touching])
        if part.id not in on_robot:
            continue
        # Collision checks would miss a geom that moves with the robot but is not in its MJCF.
        own = part.name.removeprefix(prefix), str(model.geom(touching).name).removeprefix(prefix)
        if own not in _own_geoms(robot):
            raise SceneError(
                f"geom {geom_name(model, int(touching))!r} on body {part.name!r} moves with the robot, but is not in "
                f"the MJCF of {robot.name!r}"
            )
    elsewhere = on_robot | _with_attached(model, movable)
    found: list[FoundObstacle] = []
    ground = _ground_planes(model, data)
    for geom in range(model.ngeom):
        body = int(model.geom_bodyid[geom])
        if body in elsewhere or geom in ground:
            continue
        if touches[geom] if is_obstacle is None else is_obstacle(model.geom(geom)):
            name = str(model.body(body).name)
            found.append(FoundObstacle(replace(_obstacle(model, data, geom), body=name if body else ""), name, body))
    return tuple(found)


def _ground_planes(model: mujoco.MjModel, data: mujoco.MjData) -> tuple[int, ...]:
    """Ids of the horizontal planes that face up, at ground height or below."""
    is_plane = model.geom_type == int(mujoco.mjtGeom.mjGEOM_PLANE)
    is_plane &= (data.geom_xmat[:, 8] > 1 - _AXIS_TOLERANCE) & (data.geom_xpos[:, 2] <= _GROUND_TOLERANCE)
    return tuple(np.flatnonzero(is_plane).tolist())


def require_floor(model: mujoco.MjModel, data: mujoco.MjData, height: float = 0.0) -> None:
    """Raise `SceneError` if all floors are lower than the ground on which a planner would put objects.

    `data` is measured from this ground. `height` [m] is its height in the model, for the message.
    """
    ground = _ground_planes(model, data)
    highest = max(ground, key=lambda plane: float(data.geom_xpos[plane, 2]), default=None)
    if highest is not None and data.geom_xpos[highest, 2] < -RESTING:
        raise SceneError(
            f"no support {FLOOR!r}: it is at z = {height:g}, and plane {geom_name(model, highest)!r} at "
            f"{height + data.geom_xpos[highest, 2]:.3g} m, onto which things would fall; name another support"
        )


@cache
def _own_geoms(robot: RobotSpec) -> frozenset[tuple[str, str]]:
    """Names of body and geom of every geom in the robot's own MJCF. A geom without a name also has its name in
    simulations."""
    model = mujoco.MjModel.from_xml_path(str(robot.mjcf_path))
    bodies = [str(model.body(model.geom_bodyid[geom]).name) for geom in range(model.ngeom)]
    own = {(body, str(model.geom(geom).name)) for geom, body in enumerate(bodies)}
    return frozenset(own | {(body, paired_name(geom)) for geom, body in enumerate(bodies) if not model.geom(geom).name})


def geom_name(model: mujoco.MjModel, geom: int) -> str:
    """Name of a geom, or, without a name, its body's name and its id."""
    return str(model.geom(geom).name) or f"{model.body(model.geom_bodyid[geom]).name}/geom_{geom}"


def _obstacle(model: mujoco.MjModel, data: mujoco.MjData, geom: int) -> StaticObstacle:
    position, rotation = np.array(data.geom_xpos[geom]), data.geom_xmat[geom].reshape(3, 3)
    if int(model.geom_type[geom]) == int(mujoco.mjtGeom.mjGEOM_PLANE):
        return _box(StaticObstacle, geom_name(model, geom), position - _PLANE[2] * rotation[:, 2], _PLANE, rotation)
    return _solid(StaticObstacle, model, geom, position, rotation, "leave it out with `obstacles`")


def _solid(kind: type[SolidT], model: mujoco.MjModel, geom: int, position: Array, rotation: Array, way: str) -> SolidT:
    """Convert a geom at a pose in some frame. Raises `SceneError` with the advice `way` if it cannot be represented."""
    name, shape, size = geom_name(model, geom), mujoco.mjtGeom(int(model.geom_type[geom])), model.geom_size[geom]
    match shape:
        case mujoco.mjtGeom.mjGEOM_BOX:
            return _box(kind, name, position, size, rotation)
        case mujoco.mjtGeom.mjGEOM_CYLINDER:
            return kind(name, position, size[[0, 0, 1]], "cylinder", rotation)
        case mujoco.mjtGeom.mjGEOM_CAPSULE:
            return kind(name, position, size[[0, 0, 1]] + [0, 0, size[0]], "capsule", rotation)
        case mujoco.mjtGeom.mjGEOM_SPHERE:
            return kind(name, position, size[[0, 0, 0]], "sphere", rotation)
        case mujoco.mjtGeom.mjGEOM_ELLIPSOID:
            return kind(name, position, size, "ellipsoid", rotation)
        case mujoco.mjtGeom.mjGEOM_MESH:
            return kind.hull(name, _mesh_points(model, int(model.geom_dataid[geom])), position, rotation)
    what, body = shape.name.removeprefix("mjGEOM_").lower(), model.body(model.geom_bodyid[geom]).name
    raise SceneError(
        f"geom {name!r} of body {body!r} is of type {what!r}, which cannot be represented; replace it by meshes or "
        f"primitives, or {way}"
    )


def _box(kind: type[SolidT], name: str, position: Array, half: Array, rotation: Array) -> SolidT:
    """Make a box. A box along the axes of the frame gets no rotation."""
    absolute = np.abs(rotation)
    if np.abs(absolute - absolute.round()).max() <= _AXIS_TOLERANCE:
        return kind(name, position, absolute @ half)
    return kind(name, position, half, "box", rotation)


def _mesh_points(model: mujoco.MjModel, mesh: int) -> Array:
    """Vertices (n, 3) of a mesh in its geom's frame [m]. If MuJoCo has its convex hull, only those of the hull."""
    first, graph = int(model.mesh_vertadr[mesh]), int(model.mesh_graphadr[mesh])
    points = np.array(model.mesh_vert[first : first + int(model.mesh_vertnum[mesh])], dtype=float)
    if graph < 0:
        return points
    count = int(model.mesh_graph[graph])
    return points[model.mesh_graph[graph + 2 + count : graph + 2 + 2 * count]]


def declared_supports(model: mujoco.MjModel) -> tuple[str, ...]:
    """Names of the geoms on which objects may be put, by the model's custom tuple "supports". Empty without it."""
    index = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_TUPLE, "supports")
    if index < 0:
        return ()
    entries = slice(model.tuple_adr[index], model.tuple_adr[index] + model.tuple_size[index])
    is_geom = model.tuple_objtype[entries] == int(mujoco.mjtObj.mjOBJ_GEOM)
    return tuple(geom_name(model, int(geom)) for geom in model.tuple_objid[entries][is_geom])


def find_supports(
    found: Sequence[FoundObstacle], wanted: Iterable[str], objects: Sequence[Body] = ()
) -> tuple[str, ...]:
    """Find the names of the obstacles on which objects can be put, by the names of geoms or bodies, without duplicates.
    A body yields its highest level top that is at least half as large as its largest: the floor of a bin, not its rim.

    Raises:
        SceneError: no support of a name. The message lists the possible supports with heights [m], those with `objects`
            first.
    """
    level = [one for one in found if one.obstacle.has_level_top]
    names: list[str] = []
    for name in wanted:
        tops = [one.obstacle for one in level if name == one.obstacle.name]
        tops = tops or [one.obstacle for one in level if name == one.body]
        if tops:
            name = _largest_high(tops).name
        elif name != FLOOR:
            there = [one.obstacle for one in found if name in (one.obstacle.name, one.body)]
            known = ", ".join(_described(level, objects)) or "none"
            raise SceneError(f"no support {name!r}{_why_none(there)}; geoms and bodies with a level top face: {known}")
        names.append(name)
    return tuple(dict.fromkeys(names))


def likely_support(found: Sequence[FoundObstacle], objects: Sequence[Body]) -> str:
    """Name of the obstacle with most objects on its level top, the largest of several. The floor if no object stands on
    one."""
    level = [one.obstacle for one in found if one.obstacle.has_level_top]
    best = max(level, key=lambda top: (_standing(top, objects), _area(top)), default=None)
    return FLOOR if best is None or not _standing(best, objects) else best.name


def support_bodies(found: Sequence[FoundObstacle], supports: Sequence[str]) -> tuple[tuple[str, str], ...]:
    """Names of bodies with exactly one support among their parts, each with the name of this support."""
    own: dict[str, list[str]] = {}
    for one in found:
        if one.obstacle.name in supports and one.body not in ("", "world", one.obstacle.name):
            own.setdefault(one.body, []).append(one.obstacle.name)
    return tuple((body, names[0]) for body, names in own.items() if len(names) == 1)


def _described(level: Sequence[FoundObstacle], objects: Sequence[Body]) -> list[str]:
    """Descriptions of the possible supports, those with most objects first. The body's name is added if it selects the
    support."""
    ranked = sorted(
        level,
        key=lambda one: (-_standing(one.obstacle, objects), one.obstacle.top > _OUT_OF_REACH, -_area(one.obstacle)),
    )
    lines = []
    for one in ranked:
        own = [other.obstacle for other in level if other.body == one.body != "world"]
        means_it = bool(own) and _largest_high(own) is one.obstacle and one.body != one.obstacle.name
        count = _standing(one.obstacle, objects)
        about = [f"{one.obstacle.top:.2f} m", *[f"body {one.body}"] * means_it]
        about += [f"with {count} object{'s' * (count > 1)}"] * (count > 0)
        lines.append(f"{one.obstacle.name} ({', '.join(about)})")
    return lines


def _largest_high(tops: Sequence[StaticObstacle]) -> StaticObstacle:
    """The highest level top of a body at least half as large as its largest: the floor of a bin."""
    largest = max(map(_area, tops))
    return max((top for top in tops if _area(top) >= largest / 2), key=lambda top: (top.top, _area(top), top.name))


def _area(top: StaticObstacle) -> float:
    return float(np.prod(top.extent[:2]))


def _standing(top: StaticObstacle, objects: Sequence[Body]) -> int:
    """Number of objects on a level top."""
    return sum(abs(body.bottom - top.top) <= RESTING and bool(top.is_under(body.position[:2])) for body in objects)


def _why_none(there: Sequence[StaticObstacle]) -> str:
    """Reason why the obstacles with a support's name are no supports."""
    axes = [np.abs(one.rotation[2]).max() for one in there if one.shape == "box"]
    axes += [abs(one.rotation[2, 2]) for one in there if one.shape == "cylinder"]
    if axes:
        return f", which is tilted by {np.degrees(np.arccos(min(max(axes), 1.0))):.2g} degrees"
    return ", which has no flat top: boxes and upright cylinders have one" if there else ""


def openings_of(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    robot: RobotSpec,
    found: Sequence[FoundObstacle],
    handles: Mapping[str, Sequence[str]] = MappingProxyType({}),
) -> tuple[Opening, ...]:
    """Find openings: bodies on one slide or hinge with a range, on a fixed body or on another opening.

    Args:
        model, data: the simulation.
        robot: robot, whose joints are no openings.
        found: the static obstacles, with the names of their bodies.
        handles: names of each body's handle geoms, by the body's name.

    Raises:
        SceneError: a body with handles that is no opening, or a handle that is not a part of it.
    """
    openings = [
        _opening(model, data, int(model.jnt_bodyid[joint]), joint, found, handles.get(name))
        for name, joint in opening_joints(model, robot).items()
    ]
    known = [one.name for one in openings]
    if unknown := [name for name in handles if name not in known]:
        raise SceneError(
            f"handles of {', '.join(unknown)}, which do not open; what opens: {', '.join(known) or 'none'}"
        )
    return tuple(one for one in openings if one.parts)


def opening_joints(model: mujoco.MjModel, robot: RobotSpec) -> dict[str, int]:
    """Ids of the joints of openings, by the names of the bodies, see `openings_of`."""
    on_robot, found = robot_bodies(model, robot), dict[str, int]()
    for body in range(1, model.nbody):
        joint = int(model.body_jntadr[body])
        if body in on_robot or int(model.body_jntnum[body]) != 1 or int(model.jnt_type[joint]) not in _JOINTS:
            continue
        low, high = map(float, model.jnt_range[joint])
        has_range = model.jnt_limited[joint] and high - low <= _LONGEST[_JOINTS[int(model.jnt_type[joint])]]
        if has_range and _hangs_on_openings(model, int(model.body_parentid[body])):
            found[opening_name(model, body)] = joint
    return found


def opening_name(model: mujoco.MjModel, body: int) -> str:
    """Name of an opening: its body's name, or "opening_12" with the body's id."""
    return str(model.body(body).name) or f"opening_{body}"


def _hangs_on_openings(model: mujoco.MjModel, body: int) -> bool:
    """Whether a body and its ancestors are fixed, or have a single slide or hinge each."""
    while body:
        joints = int(model.body_jntnum[body])
        if joints > 1 or (joints and int(model.jnt_type[model.body_jntadr[body]]) not in _JOINTS):
            return False
        body = int(model.body_parentid[body])
    return True


def _opening(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    body: int,
    joint: int,
    found: Sequence[FoundObstacle],
    named: Sequence[str] | None,
) -> Opening:
    """Make the opening of a body in its present state."""
    along = _with_attached(model, [body])
    parts = [one for one in found if one.body_id in along]
    name, names = opening_name(model, body), [one.obstacle.name for one in parts]
    if isinstance(named, str):
        raise SceneError(f"handles of {name!r} are a list of names, such as {[named]!r}, not {named!r}")
    if named is not None and (missing := [one for one in named if one not in names]):
        raise SceneError(f"{name!r} has no part {', '.join(missing)}; its parts: {', '.join(names) or 'none'}")
    if named is None:
        called = [one.obstacle.name for one in parts if is_handle_name(one.obstacle.name) or is_handle_name(one.body)]
        slender = [one.obstacle for one in parts if 2 * float(np.sort(one.obstacle.half_extents)[1]) <= _SLENDER]
        named = called or [one.name for one in sorted(slender, key=lambda one: float(one.half_extents.max()))]
    low, high = map(float, model.jnt_range[joint])
    at_rest, dof = float(model.qpos0[model.jnt_qposadr[joint]]), int(model.jnt_dofadr[joint])
    shut, wide = (low, high) if abs(at_rest - low) <= abs(high - at_rest) else (high, low)
    relaxed, stiffness = float(model.qpos_spring[model.jnt_qposadr[joint]]), float(model.jnt_stiffness[joint])
    spring = stiffness * ((low + high) / 2 - relaxed)
    spring += math.copysign(1.0, wide - shut) * _weight_towards_shut(model, data, joint, along, (shut, wide))
    return Opening(
        name,
        _JOINTS[int(model.jnt_type[joint])],
        data.xaxis[joint],
        data.xanchor[joint],
        float(data.qpos[model.jnt_qposadr[joint]]),
        shut,
        wide,
        tuple(names),
        tuple(named),
        float(model.dof_frictionloss[dof]),
        spring,
        stiffness,
        relaxed,
    )


def _weight_towards_shut(
    model: mujoco.MjModel, data: mujoco.MjData, joint: int, along: Iterable[int], ends: tuple[float, float]
) -> float:
    """Least force [N] or torque [N m] by which its weight shuts an opening that is left open. 0 if it is too small."""
    if model.opt.disableflags & int(mujoco.mjtDisableBit.mjDSBL_GRAVITY):
        return 0.0
    shut, wide = ends
    bodies = [*along]
    masses = model.body_mass[bodies] * (1.0 - model.body_gravcomp[bodies])
    arm = masses @ (data.xipos[bodies] - data.xanchor[joint])
    axis, position = data.xaxis[joint], float(data.qpos[model.jnt_qposadr[joint]])
    weights = []
    for share in _LEFT_OPEN:
        if model.jnt_type[joint] == int(mujoco.mjtJoint.mjJNT_SLIDE):
            force = float(masses.sum() * model.opt.gravity @ axis)
        else:
            by = shut + share * (wide - shut) - position
            across = arm - (arm @ axis) * axis
            turned = np.cos(by) * across + np.sin(by) * np.cross(axis, across)
            force = float(np.cross(turned, model.opt.gravity) @ axis)
        weights.append(-math.copysign(1.0, wide - shut) * force)
    least = min(weights)
    return least if abs(least) >= _TOO_LITTLE else 0.0
