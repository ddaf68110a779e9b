"""The visible shapes of a MuJoCo model and the poses of its bodies, as values of a page."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Sequence
from typing import Any

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from planners.drawing.page.arrays import ArrayBlock

__all__ = ["body_poses", "model_values", "moving_bodies", "pose_numbers"]

_SHAPES = {
    mujoco.mjtGeom.mjGEOM_PLANE: "plane",
    mujoco.mjtGeom.mjGEOM_SPHERE: "sphere",
    mujoco.mjtGeom.mjGEOM_CAPSULE: "capsule",
    mujoco.mjtGeom.mjGEOM_ELLIPSOID: "ellipsoid",
    mujoco.mjtGeom.mjGEOM_CYLINDER: "cylinder",
    mujoco.mjtGeom.mjGEOM_BOX: "box",
    mujoco.mjtGeom.mjGEOM_MESH: "mesh",
}
_SIZES = {"sphere": 1, "capsule": 2, "cylinder": 2}
"""How many numbers the size of a shape has; three otherwise."""
_GROUPS = 3
"""Geoms of the groups below this are seen, those from it on only collide."""
_LENGTH, _TURN = 2e-4, 1 / 32767
"""Steps of the 16 bits of a position [m], up to 6.5 m, and of a quaternion's component."""


def model_values(model: mujoco.MjModel, bodies: Sequence[int], arrays: ArrayBlock) -> dict[str, Any]:
    """The shapes to draw: each has the index in `bodies` of the body that it moves with, or -1 and a pose in the world.

    Args:
        model: the scene.
        bodies: that move, as from `moving_bodies`.
        arrays: gets the meshes.
    """
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    geoms = [geom for geom in range(model.ngeom) if _is_visible(model, geom)]
    used = sorted({int(model.geom_dataid[geom]) for geom in geoms if _shape(model, geom) == "mesh"})
    return {
        "geoms": [_geom(model, data, geom, bodies, used) for geom in geoms],
        "meshes": [_mesh(model, mesh, arrays) for mesh in used],
    }


def moving_bodies(model: mujoco.MjModel) -> list[int]:
    """The bodies that are not fixed to the world and have a visible geom."""
    owners = {int(model.geom_bodyid[geom]) for geom in range(model.ngeom) if _is_visible(model, geom)}
    return [body for body in sorted(owners) if model.body_weldid[body] != 0]


def body_poses(
    model: mujoco.MjModel, bodies: Sequence[int], states: Iterable[NDArray[np.floating[Any]]]
) -> NDArray[np.float64]:
    """Positions [m] and quaternions (n, k, 7) of bodies for joint positions (n, nq); no quaternion jumps to -q."""
    data = mujoco.MjData(model)
    rows = []
    for qpos in states:
        data.qpos[:] = qpos
        mujoco.mj_kinematics(model, data)
        rows.append(np.concatenate((data.xpos[bodies], data.xquat[bodies]), axis=1))
    poses = np.array(rows)
    for before, now in itertools.pairwise(poses):
        now[(before[:, 3:] * now[:, 3:]).sum(axis=1) < 0, 3:] *= -1
    return poses


def pose_numbers(poses: NDArray[np.float64]) -> NDArray[np.int16]:
    """Poses (n, k, 7) in steps of 16 bits, (n, 7 k); positions beyond their range are clipped."""
    numbers = np.rint(poses / np.repeat((_LENGTH, _TURN), (3, 4)))
    return numbers.clip(-32767, 32767).astype(np.int16).reshape(len(poses), -1)


def _is_visible(model: mujoco.MjModel, geom: int) -> bool:
    return bool(model.geom_group[geom] < _GROUPS and _rgba(model, geom)[3] > 0 and _shape(model, geom))


def _shape(model: mujoco.MjModel, geom: int) -> str:
    """Name of the shape; "" for one that a page does not draw, such as a height field."""
    return _SHAPES.get(mujoco.mjtGeom(int(model.geom_type[geom])), "")


def _rgba(model: mujoco.MjModel, geom: int) -> NDArray[np.float32]:
    material = int(model.geom_matid[geom])
    rgba: NDArray[np.float32] = model.geom_rgba[geom] if material < 0 else model.mat_rgba[material]
    return rgba


def _geom(
    model: mujoco.MjModel, data: mujoco.MjData, geom: int, bodies: Sequence[int], meshes: Sequence[int]
) -> dict[str, Any]:
    body, shape = int(model.geom_bodyid[geom]), _shape(model, geom)
    position, quaternion = model.geom_pos[geom], model.geom_quat[geom]
    if body not in bodies:
        position, quaternion = data.geom_xpos[geom], np.empty(4)
        mujoco.mju_mat2Quat(quaternion, data.geom_xmat[geom])
    return {
        "name": model.geom(geom).name,
        "body": bodies.index(body) if body in bodies else -1,
        "shape": shape,
        "size": _rounded(model.geom_size[geom][: _SIZES.get(shape, 3)]),
        "position": _rounded(position),
        "quaternion": _rounded(quaternion),
        "colour": _rounded(_rgba(model, geom)),
        "mesh": meshes.index(int(model.geom_dataid[geom])) if shape == "mesh" else -1,
    }


def _mesh(model: mujoco.MjModel, mesh: int, arrays: ArrayBlock) -> dict[str, Any]:
    """A mesh with its corners in 16 bits of its own size."""
    first, faces = model.mesh_vertadr[mesh], model.mesh_faceadr[mesh]
    vertices = model.mesh_vert[first : first + model.mesh_vertnum[mesh]]
    triangles = model.mesh_face[faces : faces + model.mesh_facenum[mesh]]
    step = float(np.abs(vertices).max()) / 32767
    return {
        "step": step,
        "vertices": arrays.add(np.rint(vertices / step), "int16"),
        "triangles": arrays.add(triangles, "int32"),
    }


def _rounded(values: ArrayLike) -> list[float]:
    return [round(float(value), 5) for value in np.asarray(values)]
