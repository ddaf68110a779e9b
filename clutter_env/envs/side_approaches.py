"""Side grasps that a robot reaches on a layout, from which obstructed targets are recognised.

Robots of the package have tables in `assets/approaches`. Those of any other robot are made with the planner when they
are first needed, and kept in the user's cache.
"""

from __future__ import annotations

import hashlib
import json
import logging
from collections.abc import Callable
from dataclasses import asdict, replace
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from assets import RobotSpec
from clutter_env.reporting.files import written_atomically
from clutter_env.scene.layout import LAYOUTS, Layout
from clutter_env.scene.obstruction import (
    PlannerMargins,
    SideApproaches,
    Solids,
    robots_with_approaches,
    side_approaches,
)
from clutter_env.scene.random_scene import sample_scene
from clutter_env.simulation.world import World

_LOG = logging.getLogger(__name__)
CELL = 0.025
"""[m] Side of the cells of the table top."""


def approaches_of(robot: RobotSpec, layout: Layout) -> SideApproaches:
    """The side approaches of a robot's active arm on a layout.

    For a robot that is not the package's, computing them takes about a CPU minute for each of the package's layouts,
    once. On a layout of the user's own, all directions that `SideApproaches.is_reachable` accepts are used.
    """
    is_of_package = not Path(robot.mjcf).is_absolute() and robot.full_name in robots_with_approaches()
    return side_approaches(robot.full_name) if is_of_package else _computed(robot, layout)


def reachable_yaws(
    robot: RobotSpec, layout: Layout, points: NDArray[np.float64], tick: Callable[[], object] = lambda: None
) -> NDArray[np.bool_]:
    """Whether the planner reaches grasps at TCP positions (k, 2) [m] on the empty table, by yaw: (k, 24)."""
    from planners import Scene, reachable_side_grasps  # the environments do without the planner, see `pyproject.toml`

    world = World(robot, layout, (), image_size=(480, 480), show_meshes=False)
    world.reset(sample_scene(np.random.default_rng(0), layout, 0, "cylinder"))
    scene = Scene.from_mujoco(world.model, world.data, robot)
    return reachable_side_grasps(scene, points, layout.board_height is not None, tick)


def cell_centres(layout: Layout) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Centres of the cells of the table top along x and along y [m]."""
    sizes = np.array((layout.depth, layout.width))
    x, y = ((np.arange(n) + 0.5) * (size / n) - size / 2 for n, size in zip((sizes / CELL).round(), sizes, strict=True))
    return x, y


@cache
def _computed(robot: RobotSpec, layout: Layout) -> SideApproaches:
    from planners import SideGripper  # see `reachable_yaws`

    gripper = SideGripper.of(robot)
    return SideApproaches(
        margins=PlannerMargins(**gripper.margins),
        solids=Solids.of(gripper.solids),
        grasp_height=robot.grasp_height,
        palm_reach=gripper.palm_reach,
        pad_half_height=gripper.pad_half_height,
        reachable={layout.name: _reachable_cached(robot, layout)} if LAYOUTS.get(layout.name) == layout else {},
    )


def _reachable_cached(robot: RobotSpec, layout: Layout) -> NDArray[np.bool_]:
    """Whether grasps are reached by cell and yaw (nx, ny, yaws), from the user's cache if it was computed before."""
    from irm import cache_folder  # see `reachable_yaws`

    content = json.dumps([asdict(replace(robot, mjcf="any")), asdict(layout), CELL])
    digest = hashlib.sha256(content.encode())
    for array in robot.shapes:
        digest.update(np.ascontiguousarray(array).tobytes())
    file = cache_folder() / f"{robot.full_name}-{layout.name}-{digest.hexdigest()[:16]}.npy"
    if file.exists():
        try:
            return np.asarray(np.load(file, allow_pickle=False), np.bool_)
        except (OSError, ValueError) as problem:
            _LOG.warning("%s cannot be read: %s; it is made again", file, problem)
    _LOG.info("side approaches of %s on %r are made with the planner, once", robot.full_name, layout.name)
    x, y = cell_centres(layout)
    points = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)
    reached = reachable_yaws(robot, layout, points).reshape(len(x), len(y), -1)
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        with written_atomically(file) as part, part.open("wb") as draft:
            np.save(draft, reached)
    except OSError as problem:
        _LOG.warning("side approaches could not be kept in %s: %s", file, problem)
    return reached
