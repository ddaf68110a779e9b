"""The scene that an observation shows: robot, objects and target in the world's frame."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from clutter_env.envs.observation import OBSERVATION_LAYOUT
from clutter_env.policies.parsed_observation import Observation, parse_observation, planar_pose, pose_of_quaternion
from clutter_env.scene.layout import TABLE_HEIGHT
from clutter_env.scene.table_scene import object_name
from planners import Body, HeldObject

Array = NDArray[np.float64]

OBJECT_COLUMNS = ("x", "y", "bottom", "radius", "height")
"""Network input of an object: position of its axis, height of its lowest point, radius and height, all [m], world."""
_ROW = OBSERVATION_LAYOUT["objects"]
_OFF_TABLE = 0.02
"""[m] An object whose lowest point is this far below the table top does not stand on it."""


@dataclass(frozen=True, eq=False)
class ObservedScene:
    """What a decision is made from.

    Attributes:
        base: (3,) x [m], y [m], yaw [rad].
        bodies: the objects present, in the order of the observation's rows.
        target: index among the bodies.
        held: the object in the gripper, None for none.
        held_index: its index among the bodies; -1 for none.
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
