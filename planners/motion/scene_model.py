"""A MuJoCo model of a scene for the second collision check; it is never stepped."""

from __future__ import annotations

import mujoco
import numpy as np

from planners.collision.robot_model import link_of_body
from planners.scene import Body, Scene, StaticObstacle

_ROBOT, OTHER = 1, 2
"""Collision bits: the robot collides with itself and all other geoms; of these only held objects with others."""
_OTHER_BITS = {"contype": OTHER, "conaffinity": 0}
OBJECT, _OBSTACLE = "object/", "obstacle/"
"""Prefixes of names in the model, so that an object or obstacle may have the name of a geom or joint of the robot."""
_GEOMS = {
    "box": mujoco.mjtGeom.mjGEOM_BOX,
    "cylinder": mujoco.mjtGeom.mjGEOM_CYLINDER,
    "capsule": mujoco.mjtGeom.mjGEOM_CAPSULE,
    "sphere": mujoco.mjtGeom.mjGEOM_SPHERE,
    "ellipsoid": mujoco.mjtGeom.mjGEOM_ELLIPSOID,
    "hull": mujoco.mjtGeom.mjGEOM_MESH,
}
_NEIGHBOURS = 1
"""Links this far apart in the chain may touch."""


def scene_model(scene: Scene) -> mujoco.MjModel:
    """Robot, ground, static obstacles and free bodies for the objects, with the collision bits of this module."""
    spec = mujoco.MjSpec.from_file(str(scene.robot.mjcf_path))
    for geom in spec.geoms:
        if geom.contype or geom.conaffinity:
            geom.contype, geom.conaffinity = _ROBOT, _ROBOT | OTHER
    _let_neighbours_touch(spec, scene)
    spec.worldbody.add_geom(name="floor", type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0, 0, 1], **_OTHER_BITS)
    for obstacle in scene.static_obstacles:
        _add_obstacle(spec, obstacle)
    for body in scene.objects:
        _add_object(spec, body)
    return spec.compile()


def _add_obstacle(spec: mujoco.MjSpec, obstacle: StaticObstacle) -> None:
    """Its true shape, whatever its contact bits were in the simulation that it was read from."""
    name, half, quaternion = _OBSTACLE + obstacle.name, obstacle.half_extents, np.empty(4)
    mujoco.mju_mat2Quat(quaternion, obstacle.rotation.ravel())
    shape: dict[str, object] = {"type": _GEOMS[obstacle.shape]}
    if obstacle.shape == "hull":
        spec.add_mesh(
            name=name, uservert=obstacle.vertices.ravel(), inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_CONVEX
        )
        shape["meshname"] = name
    elif obstacle.shape == "capsule":
        shape["size"] = [half[0], half[2] - half[0], 0.0]
    elif obstacle.shape == "cylinder":
        shape["size"] = [half[0], half[2], 0.0]
    else:
        shape["size"] = half
    spec.worldbody.add_geom(name=name, pos=obstacle.position, quat=quaternion, **shape, **_OTHER_BITS)


def _add_object(spec: mujoco.MjSpec, body: Body) -> None:
    name, half = OBJECT + body.name, body.half_extents
    size = half if body.shape == "box" else [half[0], half[2], 0.0]
    added = spec.worldbody.add_body(name=name)
    added.add_freejoint(name=name)
    added.add_geom(name=name, type=_GEOMS[body.shape], size=size, **_OTHER_BITS)


def reported_name(name: str) -> str:
    """Name of an object, a static obstacle or a geom of the robot, from that of a geom of the model."""
    return name.removeprefix(OBJECT).removeprefix(_OBSTACLE)


def _let_neighbours_touch(spec: mujoco.MjSpec, scene: Scene) -> None:
    """Exclude contacts between bodies on the same link or on neighbouring links."""
    model = spec.compile()
    links = link_of_body(model, scene.robot)
    bodies = range(1, model.nbody)
    for i, first in enumerate(bodies):
        for second in bodies[i + 1 :]:
            if abs(links[first] - links[second]) <= _NEIGHBOURS:
                spec.add_exclude(bodyname1=model.body(first).name, bodyname2=model.body(second).name)
