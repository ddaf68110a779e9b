"""Side grasps that a robot reaches on each layout without objects, tabulated with the planner: assets/approaches.

    python scripts/side_approaches.py --out assets/approaches
    python scripts/side_approaches.py --robot pr2 --arm left --layouts paper

Scenes with `obstructed=True` are drawn by means of this table; make it again when a robot, a layout or the planner's
choice of grasps and base poses changes.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import tyro
from numpy.typing import NDArray

import clutter_env  # noqa: F401  registers the environments
from assets import robot as find_robot
from assets.robots import RobotSpec
from clutter_env.reporting.files import write_json
from clutter_env.reporting.progress import progress_bar
from clutter_env.scene.layout import LAYOUTS, TABLE_HEIGHT, Layout, find_layout
from irm.chain import pose_of
from planners.collision.scene_arrays import robot_arrays
from planners.collision.world import FINGER_GAP, PADDING, CollisionWorld
from planners.grasping.arm_configurations import ConfigurationGrid, GripperPoses, scan_configurations
from planners.grasping.base_placement import MapPlacer
from planners.grasping.families import SIDE
from planners.grasping.grasp_poses import even_yaws, gripper_clearances, gripper_opening
from planners.scene import Scene
from planners.scene.cover import BACK, HELD_GAP

CELL = 0.025
"""[m] Side of the cells of the table top."""
RADIUS, HEIGHT = 0.03, 0.16
"""[m] of the object that is grasped: the means of the random cylinders."""
PALM_SLACK = 0.001
"""[m] that objects may extend farther towards the palm than the planner allows."""
IN_LINE = 1e-3
"""[m] A link whose origin is this near to the approach axis is in line with the gripper."""
BASES_UNDER_A_BOARD = 8
"""Base poses for each gripper pose, as many as the planner tries there before it calls a target obstructed."""

Array = NDArray[np.float64]


def approach_table(
    robot: RobotSpec, layouts: tuple[str, ...], tick: Callable[[], object] = lambda: None
) -> dict[str, Any]:
    """Make the content of `assets/approaches/<full name>.json`, JSON values.

    Args:
        robot: whose active arm grasps.
        layouts: names of layouts.
        tick: called after every row of cells.

    Returns:
        `planner`: the planner's margins, see `scene.obstruction.PlannerMargins`; `palm_reach`, `pad_half_height`:
        lengths [m] as in `planners.grasping.gripper`; `solids`: gripper and wrist of a level gripper, rows (x0, x1,
        half width, radius, half height, moves with the fingers) in metres, x along the approach from the TCP;
        `grasp_height` [m] of the TCP above the table; `layouts`: for each name rows of cells along x, each cell a bit
        mask of the reachable yaws as six hexadecimal
        digits; bit k is a yaw of 2πk/24.
    """
    gripper = gripper_clearances(robot)
    return {
        "robot": robot.full_name,
        "grasp_height": robot.grasp_height,
        "planner": {
            "yaws": SIDE.directions,
            "padding": PADDING,
            "finger_gap": FINGER_GAP,
            "back": BACK,
            "held_gap": HELD_GAP,
        },
        "palm_reach": round(gripper.palm_reach + PALM_SLACK, 6),
        "pad_half_height": gripper.pad_half_height,
        "solids": _solids(robot),
        "layouts": {name: _rows(robot, find_layout(name), tick) for name in layouts},
    }


def reachable_yaws(robot: RobotSpec, layout: Layout, points: Array) -> NDArray[np.bool_]:
    """Whether the planner reaches grasps at TCP positions (k, 2) [m] on the empty table, by yaw: (k, 24).

    A grasp counts if one of the base poses that the planner offers has an arm configuration that hits neither furniture
    nor the robot itself; under a board, neither on the straight drive to it.
    """
    env: Any = gym.make("clutter_env/Retrieve-o1-v0", layout=layout, robot=robot, disable_env_checker=True).unwrapped
    env.reset(
        seed=0, options={"objects": [{"shape": "cylinder", "radius": RADIUS, "height": HEIGHT, "position": (0.0, 0.0)}]}
    )
    alone = Scene.from_mujoco(env.model, env.data, robot)
    scene, is_driven = replace(alone, objects=()), layout.board_height is not None
    world, placer, opening = CollisionWorld.from_scene(scene), MapPlacer.of_scene(scene), gripper_opening(robot, RADIUS)
    grid = ConfigurationGrid.over(placer.chain)
    yaws = even_yaws(SIDE.directions)
    found = np.zeros((len(points), len(yaws)), np.bool_)
    for index, (x, y) in enumerate(points):
        positions = np.tile((x, y, TABLE_HEIGHT + robot.grasp_height), (len(yaws), 1))
        poses = np.column_stack((positions, yaws, np.zeros(len(yaws))))
        bases, pose_of = placer.bases(poses, BASES_UNDER_A_BOARD if is_driven else 0)
        body = alone.objects[0].at((x, y, TABLE_HEIGHT + HEIGHT / 2))
        for yaw in range(len(yaws)):
            mine = bases[pose_of == yaw]
            if len(mine):
                tried = GripperPoses(mine, np.tile(poses[yaw], (len(mine), 1)))
                configurations = scan_configurations(world, tried, grid, opening, body=body, first_free=True)
                found[index, yaw] = len(configurations.q) > 0
    return found


def _rows(robot: RobotSpec, layout: Layout, tick: Callable[[], object]) -> list[str]:
    xs, ys = (_centres(size) for size in (layout.depth, layout.width))
    rows = []
    for x in xs:
        reached = reachable_yaws(robot, layout, np.column_stack((np.full(len(ys), x), ys)))
        masks = reached @ (1 << np.arange(reached.shape[1]))
        rows.append("".join(f"{int(mask):06x}" for mask in masks))
        tick()
    return rows


def _centres(size: float) -> Array:
    """Centres of the cells along one side of the table."""
    count = round(size / CELL)
    return np.asarray((np.arange(count) + 0.5) * (size / count) - size / 2)


def _solids(robot: RobotSpec) -> list[list[float]]:
    """Outlines of what moves with the level gripper: the last link, and the one before it if it is in line with it.

    The outer faces of the fingers lie beyond the pads by the half width that is given for them.
    """
    arrays = robot_arrays(robot)
    last = len(arrays.offsets) - 1
    T_tcp_last = np.linalg.inv(pose_of(arrays.tip))
    T_tcp_before = T_tcp_last @ np.linalg.inv(pose_of(arrays.offsets[last]))
    is_in_line = float(np.abs(T_tcp_before[1:3, 3]).max()) < IN_LINE
    rows = []
    for solid in np.flatnonzero(arrays.link >= last - is_in_line):
        T = T_tcp_last if arrays.link[solid] == last else T_tcp_before
        half = np.abs(T[:3, :3] @ arrays.rotation[solid]) @ arrays.half[solid]
        x, y = (T[:3, :3] @ arrays.position[solid] + T[:3, 3])[:2]
        is_finger = bool(arrays.slides[solid])
        width = abs(y) + half[1] - arrays.gap / 2 if is_finger else half[1]
        row = (x - half[0], x + half[0], width, arrays.radius[solid], half[2] + arrays.radius[solid])
        rows.append([*(round(float(value), 6) for value in row), int(is_finger)])
    return [row for index, row in enumerate(rows) if row not in rows[:index]]


def main(
    robot: str = "fetch",
    arm: str = "",
    layouts: tuple[str, ...] = tuple(LAYOUTS),
    out: Path = Path("outputs/approaches"),
) -> None:
    """Tabulate and write.

    Args:
        robot: Name of the robot.
        arm: Name of the arm that grasps, of a robot with several; the active one if not given.
        layouts: Names of the layouts.
        out: Directory of the file.
    """
    grasping = find_robot(robot).using(arm) if arm else find_robot(robot)
    with progress_bar(desc="rows of cells") as bar:
        table = approach_table(grasping, layouts, bar.update)
    file = out / f"{grasping.full_name}.json"
    write_json(file, table)
    print(f"written: {file}")


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
