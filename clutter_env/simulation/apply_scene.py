"""A compiled model takes over a new scene.

A reset writes sizes, masses, inertias, colours and start poses into the model. Every such entry is written every time,
so that the episode depends on this scene alone and not on earlier ones.
"""

from __future__ import annotations

import colorsys
from functools import cache

import mujoco
import numpy as np
from numpy.typing import NDArray

from clutter_env.scene.layout import TABLE_HEIGHT
from clutter_env.scene.table_scene import TableScene
from clutter_env.simulation.model import ModelIndex

__all__ = ["apply_scene"]

_TARGET_COLOUR = (0.87, 0.12, 0.10, 1.0)
_HUES = (0.14, 0.92)
"""Hues of the objects that are not the target: neither red nor the colours of wood."""
_GOLDEN_RATIO = 0.6180339887


def apply_scene(model: mujoco.MjModel, data: mujoco.MjData, index: ModelIndex, scene: TableScene) -> None:
    """Give the objects of a compiled model the sizes, masses, colours and start poses of `scene`.

    `data` is scratch space; reset it afterwards: the objects then start at rest, asleep, on the table.
    """
    if scene.num_objects:
        _apply_shapes(model, index, scene)
        model.body_mass[index.object_bodies] = scene.masses
        model.body_inertia[index.object_bodies] = _inertias(scene)
        model.qpos0[index.object_qpos] = _start_poses(scene).ravel()
    _set_constants(model, data)


def _set_constants(model: mujoco.MjModel, data: mujoco.MjData) -> None:
    """Derive the model's constants with every body awake: `mj_setConst` leaves those of sleeping bodies alone."""
    sleep = int(mujoco.mjtEnableBit.mjENBL_SLEEP)
    model.opt.enableflags &= ~sleep
    mujoco.mj_setConst(model, data)
    model.opt.enableflags |= sleep


def _apply_shapes(model: mujoco.MjModel, index: ModelIndex, scene: TableScene) -> None:
    half, is_box = scene.half_extents, scene.is_box[:, None]
    cylinder_size = np.column_stack((half[:, 0], half[:, 2], np.zeros(scene.num_objects)))
    model.geom_size[index.object_geoms] = np.where(is_box, half, cylinder_size)
    model.geom_aabb[index.object_geoms, 3:] = half
    model.bvh_aabb[model.body_bvhadr[index.object_bodies], 3:] = half
    model.geom_rbound[index.object_geoms] = np.where(
        scene.is_box, np.linalg.norm(half, axis=1), np.hypot(half[:, 0], half[:, 2])
    )
    model.geom_rgba[index.object_geoms] = _colours(scene)


def _inertias(scene: TableScene) -> NDArray[np.float64]:
    """Principal moments (n, 3) of homogeneous cylinders and boxes."""
    x2, y2, z2 = (scene.half_extents**2).T
    box = np.column_stack((y2 + z2, x2 + z2, x2 + y2)) / 3
    side = x2 / 4 + z2 / 3
    cylinder = np.column_stack((side, side, x2 / 2))
    return scene.masses[:, None] * np.where(scene.is_box[:, None], box, cylinder)


def _start_poses(scene: TableScene) -> NDArray[np.float64]:
    """Free-joint positions (n, 7): standing on the table, exactly touching it."""
    zeros = np.zeros(scene.num_objects)
    return np.column_stack(
        (
            scene.positions,
            TABLE_HEIGHT + scene.half_extents[:, 2],
            np.cos(scene.yaws / 2),
            zeros,
            zeros,
            np.sin(scene.yaws / 2),
        )
    )


def _colours(scene: TableScene) -> NDArray[np.float64]:
    """Colours (n, 4): the target red, the others distinct and not red."""
    colours = np.array([_slot_colour(slot) for slot in range(scene.num_objects)])
    if 0 <= scene.target < scene.num_objects:
        colours[scene.target] = _TARGET_COLOUR
    return colours


@cache
def _slot_colour(slot: int) -> tuple[float, float, float, float]:
    """Hues step by the golden ratio, so that neighbours in number differ most; lightness has a period of three."""
    hue = _HUES[0] + (_HUES[1] - _HUES[0]) * ((slot * _GOLDEN_RATIO) % 1.0)
    lightness = (0.50, 0.66, 0.38)[slot % 3]
    red, green, blue = colorsys.hls_to_rgb(hue, lightness, 0.65)
    return red, green, blue, 1.0
