"""How far the robot's base, torso and head extend from the base's centre, from the collision geoms of its model.

The base stops in any direction in front of an obstacle, so the outline is a circle. It depends on the heights of the
obstacle: a torso may extend farther than the base below it.
"""

from __future__ import annotations

from functools import lru_cache
from math import cos, inf, pi
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from irm.errors import QueryError
from irm.robot import Robot

if TYPE_CHECKING:
    import mujoco

Floats = NDArray[np.float64]
_CORNERS = 48
"""Corners of the polygon around a circle; it is 0.2% larger than the circle."""


def robot_radius(robot: Robot, low: float = 0.0, high: float = inf) -> float:
    """Radius of the circle around the base's centre that contains base, torso and head between two heights [m].

    All torso heights count. The arm does not: where it may be depends on its configuration.

    Args:
        robot: with a model.
        low: lowest point of an obstacle above the floor [m].
        high: its highest point [m].

    Returns:
        The radius [m]; 0 if no part of the robot is between these heights.

    Raises:
        QueryError: the heights are not increasing numbers.

    Example:
        table = FreeSpace.from_boxes([(0.0, 0.0, 0.7, 1.0)], radius=robot_radius(FETCH, 0.0, 0.75) + 0.01)
    """
    if not (isinstance(low, int | float | np.number) and isinstance(high, int | float | np.number) and low < high):
        raise QueryError(f"the heights of an obstacle are two increasing numbers [m], not {low!r} and {high!r}")
    radius = 0.0
    for points, lowered, raised in _trunk(robot):
        inside = _clipped(points, float(low) - raised, float(high) - lowered)
        radius = max(radius, float(np.hypot(inside[:, 0], inside[:, 1]).max(initial=0.0)))
    return radius


def _clipped(points: Floats, low: float, high: float) -> Floats:
    """Points whose convex hull is that part of the hull of `points` (n, 3) that is between two heights [m]."""
    kept = [points[(points[:, 2] >= low) & (points[:, 2] <= high)]]
    for height in (low, high):
        below, above = points[points[:, 2] < height], points[points[:, 2] > height]
        if len(below) and len(above):
            share = (height - below[:, None, 2]) / (above[None, :, 2] - below[:, None, 2])
            kept.append((below[:, None] + share[:, :, None] * (above[None] - below[:, None])).reshape(-1, 3))
    return np.concatenate(kept)


@lru_cache(maxsize=8)
def _trunk(robot: Robot) -> tuple[tuple[Floats, float, float], ...]:
    """The geoms that do not move with the arm: corners (n, 3) in the base frame with the torso at 0, and the range of
    heights by which the torso lifts them [m]."""
    import mujoco  # a function needs the simulator, the package does not

    model = mujoco.MjModel.from_xml_path(str(robot.mjcf_path))
    data = mujoco.MjData(model)
    lift = model.joint(robot.torso_joint)
    base, torso, arm = (
        model.body(robot.base_body).id,
        int(lift.bodyid[0]),
        int(model.joint(robot.arm_joints[0]).bodyid[0]),
    )
    data.qpos[lift.qposadr[0]] = 0.0
    mujoco.mj_kinematics(model, data)
    R, origin = data.xmat[base].reshape(3, 3), data.xpos[base]
    parts = []
    for geom in range(model.ngeom):
        ancestors = _ancestors(model, int(model.geom_bodyid[geom]))
        collides = model.geom_contype[geom] or model.geom_conaffinity[geom]
        if collides and base in ancestors and arm not in ancestors:
            corners = geom_corners(model, geom) @ data.geom_xmat[geom].reshape(3, 3).T + data.geom_xpos[geom]
            link = robot.chain[0]
            lifted = (link.lower, link.upper) if torso in ancestors else (0.0, 0.0)
            parts.append(((corners - origin) @ R, *lifted))
    return tuple(parts)


def _ancestors(model: mujoco.MjModel, body: int) -> set[int]:
    """A body and all those that carry it."""
    found = {body}
    while body:
        body = int(model.body_parentid[body])
        found.add(body)
    return found


def geom_corners(model: mujoco.MjModel, geom: int) -> Floats:
    """(n, 3) points in the geom's frame whose convex hull contains the geom."""
    import mujoco  # see `_trunk`

    kind, size = model.geom_type[geom], model.geom_size[geom]
    if kind == mujoco.mjtGeom.mjGEOM_MESH:
        mesh = model.geom_dataid[geom]
        vertices = model.mesh_vert[model.mesh_vertadr[mesh] :][: model.mesh_vertnum[mesh]].astype(float)
        return np.asarray(vertices[ConvexHull(vertices).vertices])
    if kind == mujoco.mjtGeom.mjGEOM_CYLINDER:
        return _prism(size[0], [-size[1], size[1]])
    if kind in (mujoco.mjtGeom.mjGEOM_CAPSULE, mujoco.mjtGeom.mjGEOM_SPHERE):
        half = size[1] if kind == mujoco.mjtGeom.mjGEOM_CAPSULE else 0.0
        return np.concatenate([_ball(size[0]) - (0, 0, half), _ball(size[0]) + (0, 0, half)])
    centre, extent = model.geom_aabb[geom, :3], model.geom_aabb[geom, 3:]
    signs = np.stack(np.meshgrid((-1, 1), (-1, 1), (-1, 1)), axis=-1).reshape(-1, 3)
    return np.asarray(centre + signs * extent)


def _prism(radius: float, heights: list[float]) -> Floats:
    """Corners of a regular prism around a cylinder."""
    angle = np.arange(_CORNERS) * (2 * pi / _CORNERS)
    ring = np.column_stack([np.cos(angle), np.sin(angle)]) * radius / cos(pi / _CORNERS)
    return np.concatenate([np.column_stack([ring, np.full(_CORNERS, height)]) for height in heights])


def _ball(radius: float) -> Floats:
    """Corners of a polyhedron around a ball: rings of latitude, a step of longitude apart."""
    latitudes = np.linspace(-pi / 2, pi / 2, _CORNERS // 2 + 1)
    rings = [_prism(cos(turn), [np.sin(turn)]) for turn in latitudes]
    return np.concatenate(rings) * (radius / cos(pi / _CORNERS))
