"""A robot drawn: its collision shapes and arm frames, and where its level gripper reaches."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from assets.robots import RobotSpec
from clutter_env.experiments.robots.reach import LevelReach
from irm.chain import BASE, ArmChain, pose_of
from irm.kinematics import fk_frames
from planners.collision.gjk import CYLINDER
from planners.collision.scene_arrays import RobotArrays, robot_arrays

__all__ = ["draw_robot"]

Array = NDArray[np.float64]

_AXIS = 0.08
"""[m] Length of a drawn axis."""
_COLOURS = ("tab:red", "tab:green", "tab:blue")
_ROUND = 16
"""Corners of a drawn circle."""


def draw_robot(robot: RobotSpec, reach: LevelReach, file: Path) -> None:
    """Write one page: the robot at home from two sides, and the reach of its level gripper from above, by height."""
    figure = Figure(figsize=(13, 10))
    parts: Any = figure.subfigures(2, 1, height_ratios=(2.2, 1))
    above, below = parts
    frames = _frames(robot)
    above.suptitle(
        f"{robot.name} at home: collision shapes, frames of the joints and of the TCP (x red, y green, z blue)"
    )
    for column, (elevation, azimuth) in enumerate(((18, -60), (0, -90))):
        axes: Any = above.add_subplot(1, 2, column + 1, projection="3d", proj_type="ortho")
        _draw_shapes(axes, robot_arrays(robot), frames)
        for T in frames:
            for direction, colour in zip(T[:3, :3].T, _COLOURS, strict=True):
                axes.plot(*np.transpose([T[:3, 3], T[:3, 3] + _AXIS * direction]), color=colour, linewidth=1.5)
        axes.set_box_aspect((1, 1, 1.1), zoom=1.25)
        axes.set(xlim=(-0.7, 0.9), ylim=(-0.8, 0.8), zlim=(0, 1.76), xlabel="x [m]", ylabel="y [m]", zlabel="z [m]")
        axes.view_init(elevation, azimuth)
        if elevation == 0:
            axes.set(yticks=[], ylabel="")
    count = reach.z.size
    for k, height in enumerate(reach.z):
        plan = below.add_subplot(1, count, k + 1)
        plan.pcolormesh(reach.y, reach.x, reach.reached[:, :, k], cmap="Greens", vmin=0, vmax=1.4, shading="nearest")
        turn = np.linspace(0, 2 * np.pi, 60)
        plan.plot(robot.base_radius * np.sin(turn), robot.base_radius * np.cos(turn), color="black")
        plan.set(xlim=(0.85, -0.85), ylim=(-0.35, 1.35), aspect="equal", xlabel="y [m]")
        plan.set_title(f"level gripper at {height:.2f} m", fontsize=9)
    file.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(file, dpi=110)


def _frames(robot: RobotSpec) -> list[Array]:
    """Poses (4, 4) of all joints and of the TCP at home, in the base frame."""
    chain = ArmChain.from_robot(robot)
    R, p = np.empty((chain.size + 1, 3, 3)), np.empty((chain.size + 1, 3))
    fk_frames(chain.offsets, chain.axes, chain.tip, np.array(robot.home), R, p)
    return [pose_of(np.concatenate([p[k], R[k].ravel()])) for k in range(chain.size + 1)]


def _draw_shapes(axes: Any, arrays: RobotArrays, frames: list[Array]) -> None:
    for solid in range(arrays.core.size):
        link = int(arrays.link[solid])
        T = (np.eye(4) if link == BASE else frames[link]) @ pose_of(
            np.concatenate([arrays.position[solid], arrays.rotation[solid].ravel()])
        )
        colour = "0.35" if link == BASE else ("tab:orange" if link == len(frames) - 2 else "steelblue")
        for line in _outline(arrays, solid):
            axes.plot(*(line @ T[:3, :3].T + T[:3, 3]).T, color=colour, linewidth=0.6)


def _outline(arrays: RobotArrays, solid: int) -> Iterator[Array]:
    """Lines (n, 3) of a solid in its own frame: edges of a box, circles of what is round."""
    (a, b, c), radius = arrays.half[solid], float(arrays.radius[solid])
    turn = np.linspace(0, 2 * np.pi, _ROUND + 1)
    circle = np.column_stack([np.cos(turn), np.sin(turn), np.zeros_like(turn)])
    if radius > 0.0 or arrays.core[solid] == CYLINDER:
        wide = radius if radius > 0.0 else float(a)
        for height in (-c, 0.0, c):
            yield circle * wide + (0.0, 0.0, height)
        for x, y in ((1, 0), (-1, 0), (0, 1), (0, -1)):
            yield np.array([[x * wide, y * wide, -c], [x * wide, y * wide, c]])
        if radius > 0.0:
            half = circle[: _ROUND // 2 + 1, [0, 2, 1]] * wide
            for sign in (1, -1):
                yield half * (1, 1, sign) + (0.0, 0.0, sign * c)
                yield half[:, [1, 0, 2]] * (1, 1, sign) + (0.0, 0.0, sign * c)
        return
    corners = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1], [1, 1]]) * (a, b)
    for height in (-c, c):
        yield np.column_stack([corners, np.full(5, height)])
    for x, y in corners[:4]:
        yield np.array([[x, y, -c], [x, y, c]])
