"""Reading the static obstacles of a simulation: all that can touch and is neither the robot nor movable."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from functools import cache
from typing import Any, NamedTuple, TypeAlias

import mujoco
import numpy as np
from numpy.typing import NDArray

from assets.robots import RobotSpec
from planners.scene.bodies import SceneError
from planners.scene.mujoco_reading import can_touch, robot_bodies
from planners.scene.static_obstacle import StaticObstacle

__all__ = ["SUPPORTS_TUPLE", "FoundObstacle", "IsObstacle", "declared_supports", "find_supports", "static_obstacles_of"]

Array: TypeAlias = NDArray[np.float64]
IsObstacle: TypeAlias = Callable[[Any], bool]
"""Whether a geom counts; it is asked with MuJoCo's accessor `model.geom(id)`: `.name`, `.group`, `.contype`, …"""

SUPPORTS_TUPLE = "supports"
"""Name of the custom tuple in which a model declares the geoms on which objects may be put."""
_AXIS_TOLERANCE = 1e-6
"""Rounding of the entries of a rotation matrix: a box this near to the world's axes is taken to lie along them."""
_FLOOR_TOLERANCE = 0.001
"""[m] An upward horizontal plane no higher than this is the floor, which every scene has."""
_PLANE = np.array([50.0, 50.0, 0.5])
"""[m] Half extents of the box that stands for a plane: wider than any scene, thicker than any step of a motion."""


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
        model: horizontal planes at floor height or below are the floor and are left out, other planes become boxes.
        data: after a step or `mj_forward`.
        robot: which robot it is.
        movable: ids of the movable bodies; what is attached to them goes with them.
        is_obstacle: which geoms count; by default those that can touch something.

    Raises:
        SceneError: a geom that cannot be represented, something deformable, or a geom on the robot that is not its own.
    """
    if model.nflex:
        raise SceneError(f"deformable bodies cannot be represented: {', '.join(_flex_names(model))}")
    on_robot, touches = robot_bodies(model, robot), can_touch(model)
    _check_robot(model, robot, on_robot, touches)
    elsewhere = on_robot | _with_attached(model, movable)
    found: list[FoundObstacle] = []
    for geom in range(model.ngeom):
        body = int(model.geom_bodyid[geom])
        if body in elsewhere or _is_floor(model, data, geom):
            continue
        if touches[geom] if is_obstacle is None else is_obstacle(model.geom(geom)):
            found.append(FoundObstacle(_obstacle(model, data, geom), str(model.body(body).name)))
    return tuple(found)


def _with_attached(model: mujoco.MjModel, bodies: Iterable[int]) -> set[int]:
    """These bodies and all that are attached to them; MuJoCo numbers parents before their children."""
    found = set(bodies)
    for body in range(model.nbody):
        if int(model.body_parentid[body]) in found:
            found.add(body)
    return found


def _check_robot(model: mujoco.MjModel, robot: RobotSpec, on_robot: frozenset[int], touches: NDArray[np.bool_]) -> None:
    """Refuse geoms on the robot that can touch something but are not in its own MJCF: no check would see them."""
    for geom in np.flatnonzero(touches):
        body = int(model.geom_bodyid[geom])
        if body not in on_robot:
            continue
        name = str(model.body(body).name)
        if (name, str(model.geom(geom).name)) not in _own_geoms(robot):
            raise SceneError(
                f"geom {_name(model, int(geom))!r} on body {name!r} moves with the robot, but is not in the MJCF of "
                f"{robot.name!r}"
            )


@cache
def _own_geoms(robot: RobotSpec) -> frozenset[tuple[str, str]]:
    """Names of body and geom of every geom of the robot's own MJCF."""
    model = mujoco.MjModel.from_xml_path(str(robot.mjcf_path))
    bodies = (model.body(model.geom_bodyid[geom]).name for geom in range(model.ngeom))
    return frozenset((str(body), str(model.geom(geom).name)) for geom, body in enumerate(bodies))


def _name(model: mujoco.MjModel, geom: int) -> str:
    """Of the geom; of one without a name, its body's and its number."""
    return str(model.geom(geom).name) or f"{model.body(model.geom_bodyid[geom]).name}/geom_{geom}"


def _flex_names(model: mujoco.MjModel) -> list[str]:
    return [mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_FLEX, i) or f"flex_{i}" for i in range(model.nflex)]


def _is_floor(model: mujoco.MjModel, data: mujoco.MjData, geom: int) -> bool:
    is_plane = int(model.geom_type[geom]) == int(mujoco.mjtGeom.mjGEOM_PLANE)
    faces_up = data.geom_xmat[geom][8] > 1 - _AXIS_TOLERANCE
    return bool(is_plane and faces_up and data.geom_xpos[geom][2] <= _FLOOR_TOLERANCE)


def _obstacle(model: mujoco.MjModel, data: mujoco.MjData, geom: int) -> StaticObstacle:
    name, kind, size = _name(model, geom), mujoco.mjtGeom(int(model.geom_type[geom])), model.geom_size[geom]
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
    index = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_TUPLE, SUPPORTS_TUPLE)
    if index < 0:
        return ()
    entries = slice(model.tuple_adr[index], model.tuple_adr[index] + model.tuple_size[index])
    is_geom = model.tuple_objtype[entries] == int(mujoco.mjtObj.mjOBJ_GEOM)
    return tuple(_name(model, int(geom)) for geom in model.tuple_objid[entries][is_geom])


def find_supports(found: Sequence[FoundObstacle], wanted: Iterable[str]) -> tuple[str, ...]:
    """Names of the obstacles on which objects can be put: each the geom of that name, or the highest level one of that
    body; without duplicates.

    Raises:
        SceneError: there is none of a name; the message lists what objects can stand on.
    """
    return tuple(dict.fromkeys(_find_support(found, name) for name in wanted))


def _find_support(found: Sequence[FoundObstacle], wanted: str) -> str:
    level = [one for one in found if one.obstacle.has_level_top]
    if any(one.obstacle.name == wanted for one in level):
        return wanted
    of_body = [one.obstacle for one in level if one.body == wanted]
    if of_body:
        return max(of_body, key=lambda one: (one.top, float(np.prod(one.extent[:2])))).name
    known = ", ".join(dict.fromkeys(name for one in level for name in (one.obstacle.name, one.body) if name != "world"))
    raise SceneError(f"no support {wanted!r}; geoms and bodies with a level top face: {known or 'none'}")
