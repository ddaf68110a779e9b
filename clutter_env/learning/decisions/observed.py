"""The scene as an observation shows it: robot, objects and target in the world's frame."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from clutter_env.envs.observation import OBSERVATION_LAYOUT
from clutter_env.learning.contacts.reading import planar_pose, pose_of_quaternion, read
from clutter_env.scene.layout import TABLE_HEIGHT
from clutter_env.scene.table_scene import object_name
from planners import Body, HeldObject

__all__ = ["Changes", "ObservedScene", "are_standing", "observed_scene"]

Array = NDArray[np.float64]

_ROW = OBSERVATION_LAYOUT["objects"]
_MOVED = 0.01
"""[m] An object that is farther than this from where it was has moved."""
_OFF_TABLE = 0.02
"""[m] An object whose lowest point is this far below the table top does not stand on it."""


@dataclass(frozen=True, eq=False)
class ObservedScene:
    """What a decision is made from.

    Attributes:
        base: (3,) x [m], y [m], yaw [rad].
        bodies: the objects present, in the order of the observation's rows.
        slots: row of the observation of each of them.
        target: index among the bodies.
        held: the object in the gripper, None for none.
        held_index: its index among the bodies; -1 for none.
    """

    base: Array
    bodies: tuple[Body, ...]
    slots: tuple[int, ...]
    target: int
    held: HeldObject | None
    held_index: int


class Changes:
    """Notices when objects have moved."""

    def __init__(self) -> None:
        self._before: dict[str, Array] = {}

    def have_moved(self, scene: ObservedScene) -> bool:
        """Whether an object has moved since the last call; False at first."""
        now = {body.name: body.position for body in scene.bodies}
        moved = any(np.linalg.norm(now[name] - self._before.get(name, now[name])) > _MOVED for name in now)
        self._before = now
        return moved


def are_standing(scene: ObservedScene) -> NDArray[np.bool_]:
    """(n,) Which objects stand on the table and are not held."""
    bottom = TABLE_HEIGHT - _OFF_TABLE
    standing = [body.is_upright and body.bottom > bottom for body in scene.bodies]
    return np.array(standing, np.bool_) & (np.arange(len(standing)) != scene.held_index)


def observed_scene(observation: Mapping[str, NDArray[Any]]) -> ObservedScene:
    """Read an observation of `clutter_env/Retrieve-…` (state observations, a robot with Fetch's layout of "objects").

    Objects have the names of the environment: "object_00" is row 0.
    """
    reading = read(observation)
    rows, T_world_base = reading.objects, planar_pose(reading.base)
    slots = np.flatnonzero(rows[:, _ROW.index("present")] > 0.5)
    bodies = tuple(_body(T_world_base, rows[slot], int(slot)) for slot in slots)
    is_target = rows[slots, _ROW.index("is_target")] > 0.5
    held = np.flatnonzero(rows[slots, _ROW.index("held")] > 0.5)
    in_hand = None
    if len(held):
        body = bodies[held[0]]
        in_hand = HeldObject(body.name, np.linalg.inv(reading.tcp) @ body.pose)
    return ObservedScene(
        reading.base,
        bodies,
        tuple(map(int, slots)),
        int(is_target.argmax()),
        in_hand,
        int(held[0]) if len(held) else -1,
    )


def _body(T_world_base: Array, row: Array, slot: int) -> Body:
    shape: Literal["box", "cylinder"] = "box" if row[_ROW.index("is_box")] > 0.5 else "cylinder"
    half = row[_ROW["half_extents"]]
    body = Body(object_name(slot), shape, half, np.zeros(3), np.array((1.0, 0, 0, 0)))
    return body.at_pose(T_world_base @ pose_of_quaternion(row[_ROW["position"]], row[_ROW["quaternion"]]))
