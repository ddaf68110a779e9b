"""The robot's meshes, shown in place of its primitives where the package that has them is installed."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import mujoco

from assets import RobotSpec

VISUAL_GROUP, HIDDEN_GROUP = 1, 3
"""Geom groups of the meshes shown and of the primitives that they replace."""


def mesh_folder(robot: RobotSpec) -> Path | None:
    """Where the robot's meshes are installed (found without importing their package), None if they are not."""
    spec = importlib.util.find_spec(robot.mesh_package) if robot.mesh_package else None
    if spec is None or not spec.submodule_search_locations:
        return None
    folder = Path(spec.submodule_search_locations[0]) / robot.mesh_folder
    return folder if folder.is_dir() else None


def has_visuals(robot: RobotSpec) -> bool:
    """Whether every mesh of the robot is installed."""
    folder = mesh_folder(robot)
    return folder is not None and bool(robot.meshes) and all((folder / mesh.file).is_file() for mesh in robot.meshes)


def add_meshes(spec: mujoco.MjSpec, robot: RobotSpec) -> None:
    """Add meshes without mass and contacts and hide the primitives of their bodies."""
    folder = mesh_folder(robot)
    assert folder is not None
    covered = {mesh.body for mesh in robot.meshes}
    for name in covered:
        for geom in spec.body(name).geoms:
            geom.group = HIDDEN_GROUP
    for index, mesh in enumerate(robot.meshes):
        name = f"visual_{index}"
        spec.add_mesh(name=name, file=str(folder / mesh.file))
        spec.body(mesh.body).add_geom(
            name=name,
            type=mujoco.mjtGeom.mjGEOM_MESH,
            meshname=name,
            pos=mesh.position,
            quat=mesh.quaternion,
            rgba=mesh.rgba,
            mass=0,
            contype=0,
            conaffinity=0,
            group=VISUAL_GROUP,
        )
