"""Small worlds with a container on a table, and something to be put into it."""

from __future__ import annotations

import math
import tempfile
from pathlib import Path
from typing import NamedTuple

import mujoco

from assets import FETCH, RobotSpec
from planners import Scene, insert_robot, prepare

TABLE = 0.72
"""[m] height of the table."""
CAN = '<geom type="cylinder" size=".03 .05" mass=".2"/>'
LOW_CAN = '<geom type="cylinder" size=".03 .038" mass=".2"/>'


class World(NamedTuple):
    """A simulation, and what in it may be moved."""

    model: mujoco.MjModel
    data: mujoco.MjData
    robot: RobotSpec
    movable: tuple[str, ...]
    more_supports: tuple[str, ...] = ()

    def scene(self) -> Scene:
        """As it is now."""
        return Scene.from_mujoco(
            self.model,
            self.data,
            self.robot,
            movable=self.movable,
            support="plate",
            more_supports=self.more_supports,
        )


def box_walls(x: float, y: float, height: float, thick: float = 0.004) -> str:
    """Geoms of a floor and four walls: inner lengths and the height of the walls above the floor [m]."""
    z, bottom = height / 2 + 0.008, 0.004
    a, b = x / 2 + thick, y / 2 + thick
    return "".join(
        f'<geom type="box" size="{size}" pos="{at}" mass="0.05"/>'
        for size, at in (
            (f"{x / 2 + 2 * thick} {y / 2 + 2 * thick} 0.004", f"0 0 {bottom}"),
            (f"{thick} {b + thick} {height / 2}", f"{a} 0 {z}"),
            (f"{thick} {b + thick} {height / 2}", f"{-a} 0 {z}"),
            (f"{x / 2} {thick} {height / 2}", f"0 {b} {z}"),
            (f"{x / 2} {thick} {height / 2}", f"0 {-b} {z}"),
        )
    )


def round_walls(radius: float, height: float, slope: float = 0.0) -> str:
    """Geoms of a disc and sixteen slats around it, wider at the rim by `slope` [rad]."""
    count, z = 16, height / 2 + 0.006
    parts = f'<geom type="cylinder" size="{radius + 0.002} 0.004" pos="0 0 0.004" mass="0.1"/>'
    for k in range(count):
        turn = 2 * math.pi * k / count
        out = radius + 0.002 + math.tan(slope) * height / 2
        wide = (out + math.tan(slope) * height / 2 + 0.003) * math.tan(math.pi / count)
        parts += (
            f'<geom type="box" size="0.0025 {wide:.4f} {height / 2:.4f}" euler="0 {slope} {turn:.4f}" mass="0.015" '
            f'pos="{out * math.cos(turn):.4f} {out * math.sin(turn):.4f} {z:.4f}"/>'
        )
    return parts


def container_world(
    walls: str,
    *,
    free: bool,
    at: tuple[float, float] = (1.0, 0.15),
    yaw: float = 0.0,
    object_: str = CAN,
    half: float = 0.05,
    more: str = "",
    movable: tuple[str, ...] = ("thing",),
    robot: RobotSpec = FETCH,
    more_supports: tuple[str, ...] = (),
) -> World:
    """A table with a container "basket" and an object "thing" beside it, whose lowest point is `half` below it [m]."""
    text = f"""
      <mujoco><compiler angle="radian" eulerseq="XYZ"/><worldbody>
        <geom name="floor" type="plane" size="0 0 1"/>
        <body name="table" pos="1.1 0 {TABLE / 2}"><geom name="plate" type="box" size="0.35 0.5 {TABLE / 2}"/></body>
        <body name="basket" pos="{at[0]} {at[1]} {TABLE + 0.0001}" euler="0 0 {yaw}">
          {"<freejoint/>" * free}{walls}</body>
        <body name="thing" pos="1.0 -0.2 {TABLE + half + 0.0001}"><freejoint/>{object_}</body>{more}
      </worldbody></mujoco>"""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "world.xml")
        path.write_text(text.strip())
        model = prepare(insert_robot(path, robot, base=(-0.3, 0.0, 0.0)), robot).model
    data = mujoco.MjData(model)
    for joint, value in zip(robot.drive_joints[3:], robot.home, strict=True):
        data.joint(joint).qpos = value
    mujoco.mj_forward(model, data)
    return World(model, data, robot, (*movable, *(("basket",) if free else ())), more_supports)
