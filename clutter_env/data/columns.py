"""The columns of a recorded episode: names, units and meaning of every number that is stored."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

import gymnasium as gym

from assets import RobotSpec
from clutter_env.envs.observation import Column, EntryLayout
from clutter_env.simulation.control import STILL


class Columns(NamedTuple):
    """What one array of an episode holds, one row a step.

    Attributes:
        about: the meaning of a row, in words.
        names: of the numbers of a row, flattened; none for images and for MuJoCo's own state.
        units: of each of them; "" without one.
    """

    about: str
    names: tuple[str, ...] = ()
    units: tuple[str, ...] = ()


_POSE = tuple(f"tcp_{row}{column}" for row in "0123" for column in "0123")
_POSE_UNITS = tuple("m" if column == 3 and row < 3 else "" for row in range(4) for column in range(4))


def episode_columns(env: gym.Env, observation: Mapping[str, Any]) -> dict[str, Columns]:
    """The columns of every array that an episode of an environment has, by its name in the file.

    Args:
        env: that the episode is recorded in.
        observation: any one of it.
    """
    robot: RobotSpec = env.get_wrapper_attr("robot")
    layout: Mapping[str, EntryLayout] = env.get_wrapper_attr("observation_layout")
    found = {f"observations/{name}": _observation(name, layout, value) for name, value in observation.items()}
    joints = [link.joint.removesuffix("_joint") for link in robot.chain]
    keyframe = ("base_x", "base_y", "base_yaw", *joints, "finger_position")
    keyframe_units = ("m", "m", "rad", "m", *["rad"] * (len(joints) - 1), "m")
    before = "row t belongs to observation t and action t, the last row to no action"
    action = f"pick-place action that the phase leads to or comes from: 0 none, 1 pick, 2 place; {before}: 0"
    singles = {
        "rewards": ("reward", "reward of the step"),
        "terminations": ("terminated", "whether the step ended the episode by success or failure"),
        "truncations": ("truncated", "whether the step ended the episode early"),
        "infos/is_success": ("is_success", "info is_success, that of reset first"),
        "infos/num_fallen": ("num_fallen", "info num_fallen, that of reset first"),
        "infos/num_disturbed": ("num_disturbed", "info num_disturbed, that of reset first"),
        "infos/skill": ("skill", f"index into expert/skills; {before}: -1"),
        "infos/phase": ("phase", f"phase of the motion, index into expert/phases; {before}: -1"),
        "infos/contact_skill": ("skill", action),
        "infos/contact_object": ("object", f"index of its object as in the observation; {before}; -1 without one"),
    }
    found |= {name: Columns(about, (column,), ("",)) for name, (column, about) in singles.items()}
    control_mode, has_base = str(env.get_wrapper_attr("control_mode")), "observation" not in layout
    return found | {
        "actions": _action(control_mode, joints, has_base, robot.base_drive),
        "infos/state": Columns("MuJoCo's mjSTATE_FULLPHYSICS, that after reset first; for mj_setState"),
        "infos/contact_base": Columns(
            f"base pose at the grasp or release, in the world; {before}; NaN without one",
            ("base_x", "base_y", "base_yaw"),
            ("m", "m", "rad"),
        ),
        "infos/contact_tcp": Columns(
            f"T_world_tcp (4, 4) at the grasp or release; {before}; NaN without one", _POSE, _POSE_UNITS
        ),
        "infos/keyframe": Columns(
            f"whole-body configuration at the end of the phase; {before}; NaN without a plan", keyframe, keyframe_units
        ),
    }


def _observation(name: str, layout: Mapping[str, EntryLayout], value: Any) -> Columns:
    """The columns of one entry of an observation."""
    if name in ("achieved_goal", "desired_goal"):
        about = "from the TCP at the start, along the base's axes" if "observation" in layout else "in the world"
        return Columns(f"{name.partition('_')[0]} point {about}", ("x", "y", "z"), ("m", "m", "m"))
    if name == "observation" and name not in layout:
        rows = (len(value) - sum(layout[entry].size for entry in _OWN)) // layout["objects"].size
        parts = [column._replace(name=f"{entry}.{column.name}") for entry in _OWN for column in layout[entry].columns]
        return _named(
            "the entries robot, tcp, gripper and objects, one after the other",
            [*parts, *_rows(layout, "objects", rows)],
        )
    if name in ("objects", "goals"):
        rows = len(value) // layout[name].size
        return _named("one row of each object, one after the other", _rows(layout, name, rows))
    if name in layout:
        return _named(f"observation entry {name}, relative to the base", layout[name].columns)
    return Columns(f"image {name}")


_OWN = ("robot", "tcp", "gripper")


def _rows(layout: Mapping[str, EntryLayout], entry: str, rows: int) -> list[Column]:
    columns = layout[entry].columns
    return [column._replace(name=f"object_{row}.{column.name}") for row in range(rows) for column in columns]


def _named(about: str, columns: Iterable[Column]) -> Columns:
    every = tuple(columns)
    return Columns(about, tuple(column.name for column in every), tuple(column.unit for column in every))


def _action(control_mode: str, joints: list[str], has_base: bool, base_drive: str) -> Columns:
    """The columns of an action; one for a fixed base moves the TCP without turning it."""
    moves = [f"tcp_velocity_{axis}" for axis in "xyz"]
    if has_base:
        turns = [f"tcp_rotation_{axis}" for axis in "xyz"]
        own = joints if control_mode == "joint" else moves + turns
        every, lacking = ("base_forward", "base_left", "base_yaw_rate"), STILL[base_drive]
        moves = [*(name for index, name in enumerate(every) if index not in lacking), *own]
    about = f"control mode {control_mode}: shares of the greatest velocity, and of the gripper's opening, -1 to 1"
    return Columns(about, (*moves, "gripper"), ("",) * (len(moves) + 1))
