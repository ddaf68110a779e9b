"""Small worlds in which something opens: a drawer, a cupboard, a box with a lid, a knob."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import NamedTuple

import mujoco

from assets import FETCH, RobotSpec
from planners import Scene, insert_robot, prepare

FRONT = 0.93
"""[m] of what opens, along x; the robot stands before it."""
_HANDLES = {"upright": "0.01 0.012 0.06", "level": "0.01 0.06 0.012", "thick": "0.055 0.06 0.06", "none": ""}


class World(NamedTuple):
    """A simulation, and what in it may be moved and put on."""

    model: mujoco.MjModel
    data: mujoco.MjData
    robot: RobotSpec
    movable: tuple[str, ...]
    supports: tuple[str, ...]

    def scene(self) -> Scene:
        """As it is now."""
        first, *more = self.supports
        return Scene.from_mujoco(
            self.model, self.data, self.robot, movable=self.movable, support=first, more_supports=more
        )


def drawer_world(
    robot: RobotSpec = FETCH,
    *,
    handle: str = "upright",
    blocked: bool = False,
    share: float = 0.0,
    height: float = 0.68,
    joint: str = "",
    friction: float = 2.0,
) -> World:
    """A drawer with three cans in it, "red" the farthest, a side table, and, where it is blocked, two bottles."""
    z, travel = height, 0.28
    drawer = f"""
      <body name="drawer" pos="{FRONT} 0 {z}">
        <joint name="drawer_joint" type="slide" axis="-1 0 0" range="0 {travel}" damping="5"
          frictionloss="{friction}" {joint}/>
        <geom name="drawer_front" type="box" size="0.01 0.2 0.08" mass="0.5"/>
        <geom name="drawer_floor" type="box" size="0.16 0.18 0.005" pos="0.16 0 -0.07" mass="0.5"/>
        <geom name="drawer_left" type="box" size="0.16 0.006 0.05" pos="0.16 0.186 -0.025" mass="0.2"/>
        <geom name="drawer_right" type="box" size="0.16 0.006 0.05" pos="0.16 -0.186 -0.025" mass="0.2"/>
        <geom name="drawer_back" type="box" size="0.006 0.18 0.05" pos="0.32 0 -0.025" mass="0.2"/>
        {_handle("drawer_handle", handle, f"{-0.16 if handle == 'thick' else -0.06} 0 0")}
      </body>"""
    box = '<geom name="{0}" type="box" size="{1}" pos="{2}"/>'
    cabinet = "".join(
        box.format(name, size, pos)
        for name, size, pos in (
            ("cabinet_left", f"0.2 0.01 {(z + 0.12) / 2}", f"{FRONT + 0.21} 0.22 {(z + 0.12) / 2}"),
            ("cabinet_right", f"0.2 0.01 {(z + 0.12) / 2}", f"{FRONT + 0.21} -0.22 {(z + 0.12) / 2}"),
            ("cabinet_top", "0.2 0.23 0.01", f"{FRONT + 0.21} 0 {z + 0.13}"),
            ("side_table", "0.3 0.3 0.3", f"{FRONT - 0.05} -0.8 0.3"),
        )
    )
    cans = {"red": (0.16, 0.05), "blue": (0.08, -0.08), "green": (0.07, 0.1)}
    out = share * travel
    free = "".join(_can(name, FRONT + x - out, y, z - 0.03, 0.025, 0.035) for name, (x, y) in cans.items())
    movable, supports = [*cans], ["side_table", "drawer_floor"]
    if blocked:
        cabinet += box.format("board", "0.15 0.35 0.01", f"{FRONT - 0.17} 0 {z - 0.11}")
        for name, x, y in (("one", -0.2, 0.03), ("other", -0.17, -0.08)):
            free += _can(name, FRONT + x, y, z - 0.02, 0.028, 0.08)
            movable.append(name)
        supports.append("board")
    return _world(f"{cabinet}{drawer}{free}", robot, movable, supports, {"drawer_joint": out})


def cupboard_world(
    robot: RobotSpec = FETCH,
    *,
    hinge: str = "left",
    handle: str = "upright",
    angle: float = 0.0,
    base: tuple[float, float, float] = (-0.3, 0.0, 0.0),
) -> World:
    """A cupboard with a door, three cans behind it, "red" behind the others, and a side table."""
    z, side = 0.9, 1 if hinge == "left" else -1
    door = f"""
      <body name="door" pos="{FRONT} {0.25 * side} {z}">
        <joint name="door_joint" type="hinge" axis="0 0 {-side}" range="0 1.65" damping="1" frictionloss="0.5"/>
        <geom name="door_panel" type="box" size="0.01 0.235 0.17" pos="0 {-0.245 * side} 0" mass="1.5"/>
        {_handle("door_handle", handle, f"-0.06 {-0.4 * side} 0")}
      </body>"""
    box = '<geom name="{0}" type="box" size="{1}" pos="{2}"/>'
    x = FRONT + 0.2
    cabinet = "".join(
        box.format(name, size, pos)
        for name, size, pos in (
            ("cupboard_floor", "0.19 0.27 0.01", f"{x} 0 {z - 0.18}"),
            ("cupboard_top", "0.19 0.28 0.01", f"{x} 0 {z + 0.19}"),
            ("cupboard_left", "0.19 0.01 0.2", f"{x} 0.28 {z}"),
            ("cupboard_right", "0.19 0.01 0.2", f"{x} -0.28 {z}"),
            ("cupboard_back", "0.01 0.28 0.2", f"{x + 0.19} 0 {z}"),
            ("cupboard_foot", f"0.15 0.25 {(z - 0.19) / 2}", f"{x + 0.03} 0 {(z - 0.19) / 2}"),
            ("side_table", "0.3 0.3 0.35", f"{FRONT} {-0.95 * side} 0.35"),
        )
    )
    cans = {"red": (0.24, 0.02), "blue": (0.1, -0.1), "green": (0.1, 0.03)}
    free = "".join(_can(name, FRONT + dx, y, z - 0.11, 0.028, 0.06) for name, (dx, y) in cans.items())
    supports = ["side_table", "cupboard_floor"]
    return _world(f"{cabinet}{door}{free}", robot, [*cans], supports, {"door_joint": angle}, base)


def latched_world(robot: RobotSpec = FETCH, *, stiffness: float = 0.3) -> World:
    """A door with a lever, whose bolt is behind a post: it opens when the lever has been turned."""
    z = 0.9
    door = f"""
      <geom name="post" type="box" size="0.01 0.02 0.17" pos="{FRONT} -0.26 {z}"/>
      <body name="door" pos="{FRONT} 0.25 {z}">
        <joint name="door_joint" type="hinge" axis="0 0 -1" range="0 1.65" damping="1" frictionloss="0.5"/>
        <geom name="door_panel" type="box" size="0.01 0.235 0.17" pos="0 -0.245 0" mass="1.5"/>
        <body name="lever" pos="0 -0.42 0">
          <joint name="lever_joint" type="hinge" axis="1 0 0" range="-1.5 1.5" damping="0.05"
            stiffness="{stiffness}"/>
          <geom name="axle" type="box" size="0.035 0.008 0.008" pos="-0.045 0 0" mass="0.05"/>
          <geom name="lever_handle" type="box" size="0.01 0.06 0.01" pos="-0.08 0.06 0" mass="0.05"
            friction="1.5 0.01 0.001"/>
          <geom name="bolt" type="box" size="0.008 0.045 0.01" pos="0.022 -0.045 0" mass="0.05"/>
        </body>
      </body>
      <geom name="wall" type="box" size="0.01 0.3 0.2" pos="{FRONT + 0.4} 0 {z}"/>
      <geom name="side_table" type="box" size="0.3 0.3 0.35" pos="{FRONT} -0.95 0.35"/>"""
    return _world(door, robot, [], ["side_table"], {})


def box_world(robot: RobotSpec = FETCH) -> World:
    """A box on a table, with a lid on a level hinge at its back, and a knob on the lid; a stove's knob beside it."""
    parts = """
      <geom name="table" type="box" size="0.3 0.5 0.35" pos="1.0 0 0.35"/>
      <body name="chest" pos="0.95 0 0.7">
        <geom name="chest_floor" type="box" size="0.1 0.12 0.005" pos="0 0 0.005"/>
        <geom name="chest_front" type="box" size="0.005 0.12 0.05" pos="-0.095 0 0.06"/>
        <geom name="chest_back" type="box" size="0.005 0.12 0.05" pos="0.095 0 0.06"/>
        <geom name="chest_left" type="box" size="0.09 0.005 0.05" pos="0 0.115 0.06"/>
        <geom name="chest_right" type="box" size="0.09 0.005 0.05" pos="0 -0.115 0.06"/>
        <body name="lid" pos="0.1 0 0.115">
          <joint name="lid_joint" type="hinge" axis="0 1 0" range="0 1.7" damping="0.3" frictionloss="0.3"/>
          <geom name="lid_plate" type="box" size="0.1 0.12 0.005" pos="-0.1 0 0" mass="0.1"/>
          <geom name="lid_knob" type="box" size="0.012 0.03 0.02" pos="-0.17 0 0.025" mass="0.05"
            friction="1.5 0.01 0.001"/>
        </body>
      </body>
      <body name="stove" pos="0.9 -0.35 0.7">
        <geom name="stove_plate" type="box" size="0.08 0.08 0.01" pos="0 0 0.01"/>
        <body name="knob" pos="0 0 0.035">
          <joint name="knob_joint" type="hinge" axis="0 0 1" range="0 2" damping="0.02" frictionloss="0.02"/>
          <geom name="knob_grip" type="box" size="0.03 0.01 0.015" mass="0.03" friction="1.5 0.01 0.001"/>
        </body>
      </body>"""
    return _world(parts, robot, [], ["table"], {})


def _handle(name: str, kind: str, place: str) -> str:
    """The bar that is taken by the hand; "thick" is wider than any hand opens, "none" is none."""
    size = _HANDLES[kind]
    bar = f'<geom name="{name}" type="box" size="{size}" pos="{place}" mass="0.1" friction="1.5 0.01 0.001"/>'
    return bar if size else ""


def _can(name: str, x: float, y: float, z: float, radius: float, half: float) -> str:
    return (
        f'<body name="{name}" pos="{x} {y} {z}"><freejoint/>'
        f'<geom type="cylinder" size="{radius} {half}" mass="0.15"/></body>'
    )


def _world(
    parts: str,
    robot: RobotSpec,
    movable: list[str],
    supports: list[str],
    joints: dict[str, float],
    base: tuple[float, float, float] = (-0.3, 0.0, 0.0),
) -> World:
    """The simulation of a piece of furniture, with the robot before it."""
    text = f'<mujoco><worldbody><geom name="floor" type="plane" size="0 0 1"/>{parts}</worldbody></mujoco>'
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "world.xml")
        path.write_text(text.replace("<mujoco>", '<mujoco><compiler angle="radian"/>'))
        model = prepare(insert_robot(path, robot, base=base), robot).model
    data = mujoco.MjData(model)
    for joint, value in {**dict(zip(robot.drive_joints[3:], robot.home, strict=True)), **joints}.items():
        data.joint(joint).qpos = value
    mujoco.mj_forward(model, data)
    return World(model, data, robot, tuple(movable), tuple(supports))
