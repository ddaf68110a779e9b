"""Where each quantity stands in an observation, by name, so that no column number is written anywhere else.

An observation is a dictionary of vectors, its entries. `OBSERVATION_LAYOUT["robot"]["base_velocity"]` is the slice of
the entry "robot" that holds the velocity of the base, `OBSERVATION_LAYOUT["robot"].columns` names every single number
with its unit and its bound. Of "objects" the layout describes the row of one object.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from assets import FETCH, ActingJoints, RobotSpec

__all__ = ["OBJECT_FIELDS", "OBSERVATION_LAYOUT", "Column", "EntryLayout", "entry_slices", "observation_layout"]

POSITION_BOUND = 16.0
"""[m] Clip of relative positions; the diagonal of the floor that the base may use is shorter."""
JOINT_BOUND = 8.0
"""[rad], [m] Clip of joint positions; wider than every joint's range."""
VELOCITY_BOUND = 16.0
"""[m/s], [rad/s] Clip of measured velocities; ordinary ones are a tenth of it."""


class Column(NamedTuple):
    """One number of an observation: its name, its unit ("" without one), the largest magnitude that it can have."""

    name: str
    unit: str
    bound: float


class EntryLayout(Mapping[str, slice]):
    """The layout of one entry: a slice for each named quantity, a `Column` for each index."""

    def __init__(self, quantities: Mapping[str, Sequence[Column]]) -> None:
        edges = np.cumsum([0, *(len(columns) for columns in quantities.values())]).tolist()
        self._slices = {name: slice(*edge) for name, edge in zip(quantities, pairwise(edges), strict=True)}
        self.columns = tuple(column for columns in quantities.values() for column in columns)

    def __getitem__(self, quantity: str) -> slice:
        return self._slices[quantity]

    def __iter__(self) -> Iterator[str]:
        return iter(self._slices)

    def __len__(self) -> int:
        return len(self._slices)

    @property
    def size(self) -> int:
        """How many numbers the entry has."""
        return len(self.columns)

    @property
    def bounds(self) -> NDArray[np.float64]:
        """The largest magnitude of every number, (size,)."""
        return np.array([column.bound for column in self.columns])

    def index(self, column: str) -> int:
        """Index of the column of this name.

        Raises:
            KeyError: there is no such column; the message lists the columns.
        """
        names = [entry.name for entry in self.columns]
        if column not in names:
            raise KeyError(f"no column {column!r}; columns: {', '.join(names)}")
        return names.index(column)


def observation_layout(robot: RobotSpec) -> Mapping[str, EntryLayout]:
    """The layout of the entries "robot", "tcp", "gripper", "objects" (one row of it) and "goal" for a robot.

    Of a robot that acts with several arms the joints and grippers of the others follow those of the active one.
    """
    acting = ActingJoints.of(robot)
    arm = [joint.removesuffix("_joint") for joint in acting.names[len(robot.base_joints) + 1 :]]
    others = [f"{name}_" for name in acting.arms[1:]]
    metres = ("m", POSITION_BOUND)
    quaternion = [Column(f"q{axis}", "", 1.0) for axis in "wxyz"]
    entries = {
        "robot": {
            "base_position": [Column("base_x", *metres), Column("base_y", *metres)],
            "base_heading": [Column("sin_yaw", "", 1.0), Column("cos_yaw", "", 1.0)],
            "torso_position": [Column("torso_position", "m", JOINT_BOUND)],
            "arm_position": [Column(f"{joint}_position", "rad", JOINT_BOUND) for joint in arm],
            "base_velocity": [
                Column("base_forward_velocity", "m/s", VELOCITY_BOUND),
                Column("base_left_velocity", "m/s", VELOCITY_BOUND),
                Column("base_yaw_rate", "rad/s", VELOCITY_BOUND),
            ],
            "torso_velocity": [Column("torso_velocity", "m/s", VELOCITY_BOUND)],
            "arm_velocity": [Column(f"{joint}_velocity", "rad/s", VELOCITY_BOUND) for joint in arm],
        },
        "tcp": {"position": [Column(axis, *metres) for axis in "xyz"], "quaternion": quaternion},
        "gripper": {
            "width": [Column(f"{arm}width", "m", 1.0) for arm in ("", *others)],
            "commanded_width": [Column(f"{arm}commanded_width", "m", 1.0) for arm in ("", *others)],
        },
        "objects": {
            "present": [Column("present", "", 1.0)],
            "is_target": [Column("is_target", "", 1.0)],
            "position": [Column(axis, *metres) for axis in "xyz"],
            "quaternion": quaternion,
            "half_extents": [Column(f"half_{axis}", "m", 1.0) for axis in "xyz"],
            "is_box": [Column("is_box", "", 1.0)],
            "held": [Column("held", "", 1.0)],
        },
        "goal": {
            "tcp_to_target": [Column(axis, *metres) for axis in "xyz"],
            "lift_left": [Column("lift_left", *metres)],
            "hold_progress": [Column("hold_progress", "", 1.0)],
        },
    }
    return MappingProxyType({name: EntryLayout(quantities) for name, quantities in entries.items()})


OBSERVATION_LAYOUT = observation_layout(FETCH)
"""The layout of the default robot's observations."""

OBJECT_FIELDS = tuple(column.name for column in OBSERVATION_LAYOUT["objects"].columns)
"""Columns of one object's row; a cylinder's half extents are radius, radius, half height."""


def entry_slices(layout: Mapping[str, EntryLayout], entries: Sequence[str], num_objects: int) -> dict[str, slice]:
    """Where each entry stands when the entries are written one after the other.

    The vector "observation" of the goal environments is ("robot", "tcp", "gripper", "objects").

    Args:
        layout: of a robot's observations.
        entries: names, in order.
        num_objects: rows of "objects".
    """
    sizes = [layout[name].size * (num_objects if name == "objects" else 1) for name in entries]
    edges = np.cumsum([0, *sizes]).tolist()
    return {name: slice(*edge) for name, edge in zip(entries, pairwise(edges), strict=True)}
