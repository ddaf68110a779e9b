"""Lowest points of a robot's shapes."""

from __future__ import annotations

import mujoco
import numpy as np
from mujoco import mjtGeom

from assets.robot_parts import InvalidRobot
from irm.model_reading import hull_corners

SUNK = 1e-4
"""[m] Depth to which a base may reach below the ground, due to rounding."""


def lowest_height(model: mujoco.MjModel, data: mujoco.MjData, geom: int) -> float:
    """Height of the lowest point of a geom above the ground [m]."""
    z, up = float(data.geom_xpos[geom, 2]), data.geom_xmat[geom].reshape(3, 3)[2]
    a, b, c = model.geom_size[geom]
    across = float(np.hypot(up[0], up[1]))
    match mjtGeom(int(model.geom_type[geom])):
        case mjtGeom.mjGEOM_BOX:
            return z - float(np.abs(up) @ (a, b, c))
        case mjtGeom.mjGEOM_ELLIPSOID:
            return z - float(np.linalg.norm(up * (a, b, c)))
        case mjtGeom.mjGEOM_SPHERE:
            return z - float(a)
        case mjtGeom.mjGEOM_CAPSULE:
            return z - float(a + b * abs(up[2]))
        case mjtGeom.mjGEOM_CYLINDER:
            return z - float(a * across + b * abs(up[2]))
        case mjtGeom.mjGEOM_MESH:
            return z + float((hull_corners(model, geom) @ up).min())
        case kind:
            raise InvalidRobot(f"a geom of the kind {kind.name} is no shape of a robot")
