"""Reading a scene out of a simulation, which is not written."""

from __future__ import annotations

from collections.abc import Iterable

import mujoco
import numpy as np
from numpy.typing import NDArray

from assets.robots import RobotSpec
from planners.scene.bodies import Body, FurnitureBox, RobotState, SceneError

__all__ = ["OBJECT_PREFIX", "furniture_of", "objects_of", "robot_state_of"]

OBJECT_PREFIX = "object_"
AXIS_TOLERANCE = 1e-6
"""Rounding of rotation matrices."""


def objects_of(model: mujoco.MjModel, data: mujoco.MjData) -> tuple[Body, ...]:
    """The free bodies that are objects by name, in the order of the model."""
    named = (body for body in range(model.nbody) if str(model.body(body).name).startswith(OBJECT_PREFIX))
    return tuple(_object(model, data, body) for body in named)


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


def furniture_of(model: mujoco.MjModel, data: mujoco.MjData) -> Iterable[FurnitureBox]:
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


def robot_state_of(model: mujoco.MjModel, data: mujoco.MjData, robot: RobotSpec) -> RobotState:
    """Where its base, joints and fingers are."""

    def positions(joints: Iterable[str]) -> NDArray[np.float64]:
        return np.array([data.qpos[model.joint(name).qposadr[0]] for name in joints])

    drive = positions(robot.drive_joints)
    return RobotState(drive[:3], drive[3:], float(positions(robot.finger_joints).mean()))
