"""A compiled model takes over a new scene.

A reset writes sizes, masses, inertias, colours and start poses into the model. Every such entry is written every time,
so that the episode depends on this scene alone and not on earlier ones.
"""

from __future__ import annotations

import colorsys
import math
from functools import cache

import mujoco
import numpy as np
from numpy.typing import NDArray

from clutter_env.scene.layout import TABLE_HEIGHT
from clutter_env.scene.table_scene import TableScene
from clutter_env.simulation.model import ModelIndex

_TARGET_COLOUR = (0.87, 0.12, 0.10, 1.0)
_HUES = (0.14, 0.92)
"""Hues of the objects that are not the target: neither red nor the colours of wood."""
_GOLDEN_RATIO = 0.6180339887


def apply_scene(model: mujoco.MjModel, index: ModelIndex, scene: TableScene) -> None:
    """Give the objects of a compiled model the sizes, masses, colours and start poses of `scene`.

    Reset the data afterwards: the objects then start at rest, asleep, on the table.
    """
    if not scene.num_objects:
        return
    _apply_shapes(model, index, scene)
    _apply_masses(model, index, scene)
    model.geom_rgba[index.object_geoms] = _palette(scene.num_objects)
    model.geom_rgba[index.object_geoms.start + scene.target] = _TARGET_COLOUR
    model.qpos0[index.object_qpos] = _start_poses(scene).ravel()


def _apply_shapes(model: mujoco.MjModel, index: ModelIndex, scene: TableScene) -> None:
    """Sizes, bounding boxes and bounding spheres; a free body turns by angles as long as its sphere's radius."""
    half, geoms = scene.half_extents, index.object_geoms
    cylinder_size = half[:, (0, 2, 2)] * (1.0, 1.0, 0.0)
    model.geom_size[geoms] = np.where(scene.is_box[:, None], half, cylinder_size)
    model.geom_aabb[geoms, 3:] = half
    model.bvh_aabb[index.object_bvh, 3:] = half
    x2, y2, z2 = (half**2).T
    radii = np.sqrt(np.where(scene.is_box, x2 + y2, x2) + z2)
    model.geom_rbound[geoms] = radii
    model.dof_length[index.object_dof].reshape(-1, 6)[:, 3:] = radii[:, None]


def _apply_masses(model: mujoco.MjModel, index: ModelIndex, scene: TableScene) -> None:
    """Masses, principal moments of homogeneous cylinders and boxes, and the constants that follow from them.

    An object is a free body whose frame is its principal frame: what `mj_setConst` derives is known in closed form.
    That function would take a quarter of a reset's time, because it also derives the robot's constants again.
    """
    bodies, dof, masses = index.object_bodies, index.object_dof, scene.masses
    x2, y2, z2 = (scene.half_extents**2).T
    box = np.column_stack((y2 + z2, x2 + z2, x2 + y2)) / 3
    side = x2 / 4 + z2 / 3
    cylinder = np.column_stack((side, side, x2 / 2))
    inertias = masses[:, None] * np.where(scene.is_box[:, None], box, cylinder)
    model.body_mass[bodies] = model.body_subtreemass[bodies] = masses
    model.body_subtreemass[0] = model.body_mass.sum()
    model.body_inertia[bodies] = inertias
    diagonal = model.dof_M0[dof].reshape(-1, 2, 3)
    diagonal[:, 0], diagonal[:, 1] = masses[:, None], inertias
    inverse = 1 / diagonal
    mean = (inverse[..., 0] + inverse[..., 1] + inverse[..., 2]) / 3
    model.body_invweight0[bodies] = mean
    model.dof_invweight0[dof].reshape(-1, 2, 3)[:] = mean[..., None]


def _start_poses(scene: TableScene) -> NDArray[np.float64]:
    """Free-joint positions (n, 7): exactly touching table or shelf; a lying cylinder's z axis is horizontal."""
    poses = np.zeros((scene.num_objects, 7))
    poses[:, :2] = scene.positions
    poses[:, 2] = TABLE_HEIGHT + scene.levels + scene.standing_extents[:, 2]
    poses[:, 3], poses[:, 6] = cosine, sine = np.cos(scene.yaws / 2), np.sin(scene.yaws / 2)
    if scene.is_lying.any():
        tipped = math.sqrt(0.5) * np.column_stack((cosine, -sine, cosine, sine))
        poses[scene.is_lying, 3:] = tipped[scene.is_lying]
    return poses


@cache
def _palette(count: int) -> NDArray[np.float64]:
    """Colours (count, 4) of objects that are not the target.

    Hues step by the golden ratio, so that neighbours in number differ most; lightness has a period of three.
    """
    colours = np.ones((count, 4))
    for slot in range(count):
        hue = _HUES[0] + (_HUES[1] - _HUES[0]) * ((slot * _GOLDEN_RATIO) % 1.0)
        colours[slot, :3] = colorsys.hls_to_rgb(hue, (0.50, 0.66, 0.38)[slot % 3], 0.65)
    return colours
