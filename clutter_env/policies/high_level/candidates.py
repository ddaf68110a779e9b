"""Candidate picks and places: a finite set for every object and every place, from a fixed geometric rule.

Grasps come from `generate_grasps`. The base faces the gripper, as near as table and arm permit. The gripper may be
turned against the base by an angle of `TURNS`.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from assets import RobotSpec
from clutter_env.envs.observation import OBSERVATION_LAYOUT
from clutter_env.policies.parsed_observation import Observation, parse_observation, planar_pose, pose_of_quaternion
from clutter_env.scene.layout import TABLE_HEIGHT, Layout
from clutter_env.scene.table_scene import object_name
from planners import Body, Contact, HeldObject, find_grasp_set, generate_grasps, gripper_poses, release_pitch, rotated

Array = NDArray[np.float64]

TURNS = tuple(math.radians(degrees) for degrees in (0, -20, 20, -40, 40, -60, 60))
"""[rad] of the gripper's yaw against the base's."""
MIN_STANDOFF, MAX_STANDOFF = 0.75, 1.02
"""[m] from the centre of the base to the TCP, of a level gripper."""
_PITCHES = np.radians((0.0, 20.0, 40.0, 60.0, 90.0))
_MIN, _MAX = (MIN_STANDOFF, 0.86, 0.86, 0.80, 0.75), (MAX_STANDOFF, 1.02, 1.02, 0.95, 0.78)
"""[m] The same at these pitches [rad]: Fetch can raise the gripper straight by 0.19 m from there."""
_WIDEST_YAW = math.radians(80.0)
"""The base deviates by less than this from straight ahead where the table has front access alone."""
_EDGE_GAP = 0.021
"""[m] between the base and the front edge of the table: 1 mm more than a plan keeps."""
_PUT_DOWN_GAP = 0.001
"""[m] between a held object and the support when the fingers open."""
CLEARANCE = 0.08
"""[m] of clearance around a place that is enough."""
_PLACING_YAWS = 24
"""Directions of the gripper at a place, evenly about the vertical."""
OBJECT_COLUMNS = ("x", "y", "bottom", "radius", "height")
"""Network input of an object: position of its axis, height of its lowest point, radius and height, all [m], world."""
_ROW = OBSERVATION_LAYOUT["objects"]
_OFF_TABLE = 0.02
"""[m] An object whose lowest point is this far below the table top does not stand on it."""


@dataclass(frozen=True, eq=False)
class Candidates:
    """m picks or places to choose from.

    Attributes:
        index: (m,) of the object, or of the place.
        tcp: (m, 5) x, y, z [m] of the TCP, yaw and pitch [rad].
        base: (m, 3) x [m], y [m], yaw [rad].
        turn: (m,) [rad] of the gripper's yaw against the base's.
    """

    index: NDArray[np.int64]
    tcp: Array
    base: Array
    turn: Array

    def __len__(self) -> int:
        return len(self.index)

    def take(self, rows: NDArray[np.generic] | slice) -> Candidates:
        """Some of them."""
        return Candidates(self.index[rows], self.tcp[rows], self.base[rows], self.turn[rows])

    def contact(self, row: int, skill: str, name: str) -> Contact:
        """One of them, as a motion policy executes it."""
        x, y, z, yaw, pitch = self.tcp[row]
        tcp = rotated(yaw, pitch)
        tcp[:3, 3] = x, y, z
        return Contact(skill, name, self.base[row], tcp)


@dataclass(frozen=True)
class CandidateRule:
    """The rule. It reads only the observation and the sizes of the table.

    Attributes:
        robot: of the environment.
        layout: table and surroundings.
        grasps: name of the grasp set.
    """

    robot: RobotSpec
    layout: Layout
    grasps: str = "side"

    def picks(self, bodies: Sequence[Body]) -> Candidates:
        """Candidate picks of objects. `index` is that of the body."""
        # The grasps of demonstrations: through the main axis, or as far off it as the robot needs.
        families = [family for family in find_grasp_set(self.grasps) if getattr(family, "axis_offset", None) is None]
        poses = [gripper_poses(generate_grasps(body, self.robot, families)) for body in bodies]
        index = np.repeat(np.arange(len(bodies)), [len(rows) for rows in poses])
        return self._with_bases(index, np.concatenate(poses) if poses else np.empty((0, 5)))

    def places(self, body: Body, held: HeldObject, points: Array) -> Candidates:
        """Candidate places of a held object. `index` is that of the point.

        Args:
            body: the object. Its pose does not matter.
            held: grasp of the object.
            points: (k, 3) [m] on supports, for the object's axis.
        """
        pitch = release_pitch(body, held)
        T_release_object = rotated(0.0, pitch) @ held.T_tcp_object
        offset = T_release_object[:3, 3]
        half_height = body.at_pose(T_release_object).half_extent_along((0.0, 0.0, 1.0))
        yaws = np.arange(_PLACING_YAWS) * (2 * math.pi / _PLACING_YAWS)
        cosine, sine = np.cos(yaws), np.sin(yaws)
        shift = np.stack((cosine * offset[0] - sine * offset[1], sine * offset[0] + cosine * offset[1]), axis=-1)
        index = np.repeat(np.arange(len(points)), _PLACING_YAWS)
        rows = np.empty((len(index), 5))
        rows[:, :2] = points[index, :2] - np.tile(shift, (len(points), 1))
        rows[:, 2] = points[index, 2] + half_height + _PUT_DOWN_GAP - offset[2]
        rows[:, 3] = np.tile(np.remainder(yaws + math.pi, 2 * math.pi) - math.pi, len(points))
        rows[:, 4] = pitch
        return self._with_bases(index, rows)

    def points(self, spacing: float = 0.06, margin: float = 0.045) -> Array:
        """Points (k, 3) [m] of a grid on the table where an object may be put, symmetric in y."""
        from_centre = [
            np.linspace(-size / 2 + margin, size / 2 - margin, round((size - 2 * margin) / spacing) + 1)
            for size in (self.layout.depth, self.layout.width)
        ]
        x, y = (axis.ravel() for axis in np.meshgrid(*from_centre, indexing="ij"))
        return np.column_stack((x, y, np.full(len(x), TABLE_HEIGHT)))

    def _with_bases(self, index: NDArray[np.int64], tcp: Array) -> Candidates:
        """With all base poses of the rule, for TCP poses (k, 5)."""
        turns = np.array(TURNS)
        yaw = np.remainder(tcp[:, 3:4] - turns + math.pi, 2 * math.pi) - math.pi
        standoff = np.repeat(np.interp(tcp[:, 4:5], _PITCHES, _MIN), len(turns), axis=1)
        is_possible = np.ones(yaw.shape, dtype=np.bool_)
        if self.layout.is_front_only:
            front = -self.layout.depth / 2 - self.robot.base_radius - _EDGE_GAP
            is_possible = np.abs(yaw) < _WIDEST_YAW
            ahead = np.where(is_possible, np.cos(yaw), 1.0)
            standoff = np.maximum(standoff, (tcp[:, :1] - front) / ahead)
        is_possible &= standoff <= np.interp(tcp[:, 4:5], _PITCHES, _MAX)
        x, y = tcp[:, :1] - standoff * np.cos(yaw), tcp[:, 1:2] - standoff * np.sin(yaw)
        row, column = np.nonzero(is_possible)
        bases = np.stack((x, y, yaw), axis=-1)[row, column]
        return Candidates(index[row], tcp[row], bases, turns[column])


def crowding(points: Array, radius: float, others: NDArray[np.floating]) -> Array:
    """(k,) crowding, from 0 where an object of that radius [m] has `CLEARANCE` around it to 1 where it touches another.

    Args:
        points: (k, 2) or more columns, x and y [m] first.
        radius: of the object.
        others: (n, 4) or more columns, x, y, any and radius [m]: `OBJECT_COLUMNS`.
    """
    if not len(others):
        return np.zeros(len(points))
    gaps = np.linalg.norm(points[:, None, :2] - others[None, :, :2], axis=2) - others[:, 3] - radius
    return np.asarray(np.clip(1.0 - gaps.min(axis=1) / CLEARANCE, 0.0, 1.0))


@dataclass(frozen=True, eq=False)
class ObservedScene:
    """Input of a decision.

    Attributes:
        base: (3,) x [m], y [m], yaw [rad].
        bodies: the objects present, in the order of the observation's rows.
        target: index among the bodies.
        held: the object in the gripper, None without one.
        held_index: its index among the bodies, -1 without one.
    """

    base: Array
    bodies: tuple[Body, ...]
    target: int
    held: HeldObject | None
    held_index: int

    @property
    def is_standing(self) -> NDArray[np.bool_]:
        """(n,) whether each object stands on the table and is not held."""
        bottom = TABLE_HEIGHT - _OFF_TABLE
        standing = [body.is_upright and body.bottom > bottom for body in self.bodies]
        return np.array(standing, np.bool_) & (np.arange(len(standing)) != self.held_index)


def observed_scene(observation: Observation) -> ObservedScene:
    """Read an observation of `clutter_env/Retrieve-…` (state observations, a robot with Fetch's layout of "objects").

    Objects have the names of the environment: "object_00" is row 0.
    """
    seen = parse_observation(observation)
    rows, T_world_base = seen.objects, planar_pose(seen.base)
    slots = np.flatnonzero(rows[:, _ROW.index("present")] > 0.5)
    bodies = tuple(_body(T_world_base, rows[slot], int(slot)) for slot in slots)
    is_target = rows[slots, _ROW.index("is_target")] > 0.5
    held = np.flatnonzero(rows[slots, _ROW.index("held")] > 0.5)
    if not len(held):
        return ObservedScene(seen.base, bodies, int(is_target.argmax()), None, -1)
    body = bodies[held[0]]
    in_gripper = HeldObject(body.name, np.linalg.inv(seen.tcp) @ body.pose)
    return ObservedScene(seen.base, bodies, int(is_target.argmax()), in_gripper, int(held[0]))


def object_rows(bodies: Iterable[Body]) -> NDArray[np.float32]:
    """`OBJECT_COLUMNS` (n, 5) of objects that stand."""
    rows = [(*body.position[:2], body.bottom, body.radius, body.top - body.bottom) for body in bodies]
    return np.array(rows, np.float32).reshape(-1, len(OBJECT_COLUMNS))


def _body(T_world_base: Array, row: Array, slot: int) -> Body:
    shape: Literal["box", "cylinder"] = "box" if row[_ROW.index("is_box")] > 0.5 else "cylinder"
    half = row[_ROW["half_extents"]]
    body = Body(object_name(slot), shape, half, np.zeros(3), np.array((1.0, 0, 0, 0)))
    return body.at_pose(T_world_base @ pose_of_quaternion(row[_ROW["position"]], row[_ROW["quaternion"]]))
