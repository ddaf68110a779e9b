"""Observations: vectors relative to the robot's base, all finite and bounded, and the names of their numbers.

An observation is a dictionary of vectors, its entries. `OBSERVATION_LAYOUT["robot"]["base_velocity"]` is the slice of
the entry "robot" that holds the velocity of the base. `OBSERVATION_LAYOUT["robot"].columns` names every single number
with its unit and its bound. For "objects" the layout describes the row of one object. Column numbers are defined
nowhere else.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from types import MappingProxyType
from typing import NamedTuple

import mujoco
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from assets import FETCH, ActingJoints, RobotSpec
from clutter_env.scene.household import KINDS
from clutter_env.scene.opening import Opening
from clutter_env.scene.table_scene import TableScene
from clutter_env.simulation.world import Measurements, World

POSITION_BOUND = 16.0
"""[m] Clip of relative positions. The diagonal of the ground that the base may use is shorter."""
JOINT_BOUND = 8.0
"""[rad], [m] Clip of joint positions, wider than every joint's range."""
VELOCITY_BOUND = 16.0
"""[m/s], [rad/s] Clip of measured velocities. Ordinary velocities are a tenth of it."""
OBJECT_KINDS = tuple(KINDS)
"""Meaning of the number in the column "kind" of household objects: their kinds, in order. -1 is no kind."""


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
        """Count of numbers in the entry."""
        return len(self.columns)

    @property
    def bounds(self) -> NDArray[np.float64]:
        """The largest magnitude of every number, (size,)."""
        return np.array([column.bound for column in self.columns])

    def index(self, column: str) -> int:
        """Index of the column of this name.

        Raises:
            KeyError: no such column. The message lists the columns.
        """
        names = [entry.name for entry in self.columns]
        if column not in names:
            raise KeyError(f"no column {column!r}; columns: {', '.join(names)}")
        return names.index(column)


def observation_layout(
    robot: RobotSpec, shows_head: bool = False, shows_kinds: bool = False, openings: Sequence[Opening] = ()
) -> Mapping[str, EntryLayout]:
    """The layout of the entries "robot", "tcp", "gripper", "objects" (one row of it) and "goal" for a robot.

    `shows_head` adds "head", for a commanded head. `shows_kinds` adds a column of `OBJECT_KINDS`. A drawer or a door
    adds "joints". Several drawers follow one another, with their names as prefixes of the columns.

    In a robot that acts with several arms, the joints and grippers of the other arms follow those of the active arm.
    """
    acting = ActingJoints.of(robot)
    arm = [joint.removesuffix("_joint") for joint in acting.names[len(robot.base_joints) + 1 :]]
    others = [f"{name}_" for name in acting.arms[1:]]
    head = [joint.removesuffix("_joint") for joint in robot.head_joints]
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
        "head": {
            "position": [Column(f"{joint}_position", "rad", JOINT_BOUND) for joint in head],
            "velocity": [Column(f"{joint}_velocity", "rad/s", VELOCITY_BOUND) for joint in head],
        },
        "objects": {
            "present": [Column("present", "", 1.0)],
            "is_target": [Column("is_target", "", 1.0)],
            "position": [Column(axis, *metres) for axis in "xyz"],
            "quaternion": quaternion,
            "half_extents": [Column(f"half_{axis}", "m", 1.0) for axis in "xyz"],
            "is_box": [Column("is_box", "", 1.0)],
            "held": [Column("held", "", 1.0)],
            **({"kind": [Column("kind", "", len(OBJECT_KINDS) - 1.0)]} if shows_kinds else {}),
        },
        "goal": {
            "tcp_to_target": [Column(axis, *metres) for axis in "xyz"],
            "lift_left": [Column("lift_left", *metres)],
            "hold_progress": [Column("hold_progress", "", 1.0)],
        },
    }
    if openings:
        entries["joints"] = {}
    for opening in openings:
        unit, own = "m" if opening.is_slide else "rad", f"{opening.name}_" if len(openings) > 1 else ""
        entries["joints"] |= {
            f"{own}position": [Column(f"{own}position", unit, JOINT_BOUND)],
            f"{own}velocity": [Column(f"{own}velocity", f"{unit}/s", VELOCITY_BOUND)],
            f"{own}opened": [Column(f"{own}opened", "", 2.0)],
            f"{own}handle": [Column(f"{own}handle_{axis}", *metres) for axis in "xyz"],
        }
    shown = {name: columns for name, columns in entries.items() if shows_head or name != "head"}
    return MappingProxyType({name: EntryLayout(columns) for name, columns in shown.items()})


OBSERVATION_LAYOUT = observation_layout(FETCH)
"""The layout of the default robot's observations."""

OBJECT_FIELDS = tuple(column.name for column in OBSERVATION_LAYOUT["objects"].columns)
"""Columns of one object's row. A cylinder's half extents are radius, radius, half height. Household objects also have
"kind"."""


def entry_slices(layout: Mapping[str, EntryLayout], entries: Sequence[str], num_objects: int) -> dict[str, slice]:
    """Slices of the entries in the vector of all entries, one after the other.

    The vector "observation" of the goal environments is ("robot", "tcp", "gripper", "objects").

    Args:
        layout: of a robot's observations.
        entries: names, in order.
        num_objects: rows of "objects".
    """
    sizes = [layout[name].size * (num_objects if name == "objects" else 1) for name in entries]
    edges = np.cumsum([0, *sizes]).tolist()
    return {name: slice(*edge) for name, edge in zip(entries, pairwise(edges), strict=True)}


_ROW = OBSERVATION_LAYOUT["objects"]
_POSE = slice(_ROW["position"].start, _ROW["quaternion"].stop)
_HELD = _ROW.index("held")

_0, _1, _C, _S, _MS, _HC, _HS, _MHS = range(8)
_TURN = np.array(
    [
        (_C, _S, _0, _0, _0, _0, _0),
        (_MS, _C, _0, _0, _0, _0, _0),
        (_0, _0, _1, _0, _0, _0, _0),
        (_0, _0, _0, _HC, _0, _0, _HS),
        (_0, _0, _0, _0, _HC, _HS, _0),
        (_0, _0, _0, _0, _MHS, _HC, _0),
        (_0, _0, _0, _MHS, _0, _0, _HC),
    ]
)
"""Matrix of `_poses_in_base`, each entry an index into 0, 1, cos yaw, sin yaw, -sin yaw, cos yaw/2, sin yaw/2,
-sin yaw/2."""

Vector = NDArray[np.float64]
Observation = dict[str, NDArray[np.float32]]


class Observer:
    """Makes the vectors of an observation: "robot", "tcp", "gripper", and optionally "head", "objects", "goal",
    "joints".

    Attributes:
        bounds: largest magnitudes of all numbers of an observation, one entry after the other.
    """

    def __init__(
        self,
        world: World,
        num_slots: int,
        *,
        shows_objects: bool,
        shows_goal: bool,
        shows_head: bool = False,
        shows_kinds: bool = False,
    ) -> None:
        self._num_slots, self._shows_kinds = num_slots, shows_kinds
        self.layout = observation_layout(world.robot, shows_head, shows_kinds, world.openings)
        shown = {"head": shows_head, "objects": shows_objects, "goal": shows_goal, "joints": bool(world.openings)}
        self._bars = [world.model.geom(one.bar).id for one in world.openings]
        names = ["robot", "tcp", "gripper", *(name for name, is_shown in shown.items() if is_shown)]
        self._slices = entry_slices(self.layout, names, num_slots)
        rows = {name: num_slots if name == "objects" else 1 for name in names}
        bounds = np.concatenate([np.tile(self.layout[name].bounds, rows[name]) for name in names])
        self.bounds = bounds.astype(np.float32)
        self._lowest = -self.bounds
        self._own = slice(0, self._slices["head" if shows_head else "gripper"].stop)
        joints = [world.model.joint(name) for name in world.robot.head_joints] if shows_head else []
        self._head_qpos = [int(joint.qposadr[0]) for joint in joints]
        self._head_dof = [int(joint.dofadr[0]) for joint in joints]
        self._own_qpos = np.concatenate((world.index.drive_qpos, world.index.finger_qpos))
        self._shows_objects, self._shows_goal = shows_objects, shows_goal
        self._constant = np.zeros_like(self.bounds)
        self._constant_scene: TableScene | None = None

    @property
    def names(self) -> tuple[str, ...]:
        """The entries of an observation, in order."""
        return tuple(self._slices)

    @property
    def space(self) -> spaces.Dict:
        """One symmetric Box of float32 per entry."""
        bounds = {name: self.bounds[place] for name, place in self._slices.items()}
        return spaces.Dict({name: spaces.Box(-bound, bound, dtype=np.float32) for name, bound in bounds.items()})

    def observe(
        self, world: World, measurements: Measurements, target: int, hold_progress: float, lift_left: float
    ) -> Observation:
        """The observation after a step. Every call makes new arrays.

        Args:
            world: the world, its kinematics settled.
            measurements: its measurements.
            target: the target's slot.
            hold_progress: holding time as a share of that required for success, 0 to 1.
            lift_left: height [m] by which the target must still rise.
        """
        data, index, num_joints = world.data, world.index, len(world.index.drive_qpos)
        positions = data.qpos[self._own_qpos].tolist()
        base_x, base_y, yaw, *joints = positions[:num_joints]
        cosine, sine = math.cos(yaw), math.sin(yaw)
        poses = np.empty((1 + len(measurements.poses), 7))  # of the TCP, then of the objects
        poses[0, :3] = data.site_xpos[index.tcp_site]
        mujoco.mju_mat2Quat(poses[0, 3:], data.site_xmat[index.tcp_site])
        poses[1:] = measurements.poses
        relative = _poses_in_base(base_x, base_y, yaw, poses)
        tcp = relative[:, 0].tolist()
        forward, sideways, *rates = data.qvel[index.drive_dof].tolist()
        ahead, left = cosine * forward + sine * sideways, cosine * sideways - sine * forward
        fingers, gap = positions[num_joints:], world.robot.finger_gap_closed
        widths = [one + other + gap for one, other in zip(fingers[::2], fingers[1::2], strict=True)]
        commanded = map(world.robot.opening, world.controller.state.fingers)
        flat = self._constant_part(world, target).copy()
        head = [*data.qpos[self._head_qpos].tolist(), *data.qvel[self._head_dof].tolist()] if self._head_qpos else ()
        own = [base_x, base_y, sine, cosine, *joints, ahead, left, *rates, *tcp, *widths, *commanded, *head]
        flat[self._own] = own
        if self._shows_objects:
            rows = flat[self._slices["objects"]].reshape(self._num_slots, -1)
            rows[: len(measurements.poses), _POSE] = relative.T[1:]
            for slot in measurements.grip.held:
                if slot >= 0:
                    rows[slot, _HELD] = 1.0
        if self._shows_goal:
            x, y, z, *_ = relative[:, 1 + target].tolist()
            flat[self._slices["goal"]] = [x - tcp[0], y - tcp[1], z - tcp[2], lift_left, hold_progress]
        if self._bars:
            positions, rates = data.qpos[index.opening_qpos].tolist(), data.qvel[index.opening_dof].tolist()
            numbers: list[float] = []
            for bar, *joint in zip(self._bars, positions, rates, world.opened_shares, strict=True):
                x, y, z = data.geom_xpos[bar].tolist()
                x, y = x - base_x, y - base_y
                numbers += *joint, cosine * x + sine * y, cosine * y - sine * x, z
            flat[self._slices["joints"]] = numbers
        np.minimum(np.maximum(flat, self._lowest, out=flat), self.bounds, out=flat)
        return {name: flat[place] for name, place in self._slices.items()}

    def _constant_part(self, world: World, target: int) -> NDArray[np.float32]:
        """The numbers that stay the same for a whole episode, zeros elsewhere. They are computed once for each
        scene."""
        if world.scene is not self._constant_scene:
            self._constant = np.zeros_like(self.bounds)
            self._constant_scene = world.scene
            if self._shows_objects:
                rows = self._constant[self._slices["objects"]].reshape(self._num_slots, -1)
                present = rows[: world.scene.num_objects]
                present[:, _ROW["present"]] = 1.0
                if target >= 0:
                    present[target, _ROW["is_target"]] = 1.0
                present[:, _ROW["half_extents"]] = world.scene.half_extents
                present[:, _ROW["is_box"]] = world.scene.is_box[:, None]
                if self._shows_kinds:
                    kinds = [OBJECT_KINDS.index(shape) if shape in KINDS else -1 for shape in world.scene.shapes]
                    present[:, -1] = kinds
        return self._constant


def _poses_in_base(x: float, y: float, yaw: float, poses: Vector) -> Vector:
    """World poses (n, 7) relative to a base at x, y [m], yaw [rad], as columns (7, n). Quaternions get w >= 0.

    A pose is linear in position and quaternion, so a single product turns both, by the yaw and by half of it. MuJoCo's
    product has the same digits on every processor, unlike NumPy's.
    """
    c, s, hc, hs = math.cos(yaw), math.sin(yaw), math.cos(yaw / 2), math.sin(yaw / 2)
    relative = np.empty((7, len(poses)))
    mujoco.mju_mulMatMatT(relative, np.array((0.0, 1.0, c, s, -s, hc, hs, -hs)).take(_TURN), poses)
    across, along, quaternions = relative[0], relative[1], relative[3:]
    np.subtract(across, c * x + s * y, out=across)
    np.subtract(along, c * y - s * x, out=along)
    np.multiply(quaternions, np.copysign(1.0, relative[3]), out=quaternions)
    return relative
