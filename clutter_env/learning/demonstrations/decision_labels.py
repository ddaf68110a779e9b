"""The decisions of a plan: the scene before each, the contact chosen, and all that would have been as good."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from clutter_env.envs.observation import OBJECT_FIELDS, OBSERVATION_LAYOUT
from clutter_env.learning.demonstrations.decision_file import KINDS
from planners import (
    DIRECTION_CLASSES,
    Alternatives,
    BoundAction,
    Contact,
    Scene,
    Solution,
    contact_of,
    direction_class,
    tcp_pose,
)

__all__ = ["decisions_of", "object_rows"]

Array = NDArray[np.float64]

_ROW = OBSERVATION_LAYOUT["objects"]
_ON_CELL = 1e-4
"""[m] within which an object is put exactly on a cell."""


class _Choice(NamedTuple):
    """One decision of a plan: the action that carries it out, its contact, the scene before the robot drives there,
    the objects that the plan still puts down, and the target."""

    action: BoundAction
    contact: Contact
    before: Scene
    left: int
    target: str

    @property
    def is_pick(self) -> bool:
        """Whether an object is taken."""
        return self.contact.skill == "pick"


def decisions_of(solution: Solution, alternatives: Alternatives, num_objects: int) -> Iterator[dict[str, Any]]:
    """The decisions of a plan, in order: before every grasp and every put-down; see `decision_file.DECISION_COLUMNS`.

    Args:
        solution: a canonical plan.
        alternatives: the canonical contacts among the scene's static obstacles.
        num_objects: rows of the observation's objects.
    """
    for number, choice in enumerate(_choices(solution)):
        contact, scene = choice.contact, choice.before
        yield {
            "number": number,
            "objects": object_rows(scene, choice.target, num_objects),
            "base": scene.state.base,
            "target": scene.index(choice.target),
            "held": scene.index(scene.held.name) if scene.held else -1,
            "kind": KINDS.index(contact.skill),
            "subject": scene.index(contact.object),
            "direction": direction_class(contact.yaw),
            "contact_base": contact.base,
            "contact_tcp": contact.tcp,
            "is_straight": contact.is_straight,
            "clearances_left": choice.left,
            **_grasp_labels(choice, alternatives, num_objects),
            **_cell_labels(choice, alternatives),
        }


def _choices(solution: Solution) -> Iterator[_Choice]:
    """The decisions of a plan; the scene before a decision is that in which the action before ends."""
    left, before = len(solution.clearances), solution.actions[0].scene if solution.actions else None
    for action, following in pairwise((*solution.actions, None)):
        contact = None if action is None else contact_of(action)
        if action is None or contact is None or before is None:
            continue
        yield _Choice(action, contact, before, left, solution.target)
        left -= action.is_clearance
        before = None if following is None else following.scene


def object_rows(scene: Scene, target: str, num_objects: int) -> NDArray[np.float32]:
    """The rows (num_objects, fields) of a scene's objects as the observation has them, relative to the base."""
    rows = np.zeros((num_objects, len(OBJECT_FIELDS)), np.float32)
    x, y, yaw = scene.state.base
    c, s, hc, hs = np.cos(yaw), np.sin(yaw), np.cos(yaw / 2), np.sin(yaw / 2)
    for row, body in zip(rows, scene.objects, strict=False):
        is_held = scene.held is not None and scene.held.name == body.name
        if is_held and scene.held is not None:
            body = body.at_pose(tcp_pose(scene.robot, scene.state) @ scene.held.T_tcp_object)
        away, q = body.position - (x, y, 0.0), body.quaternion
        turned = np.array([hc * q[0] + hs * q[3], hc * q[1] + hs * q[2], hc * q[2] - hs * q[1], hc * q[3] - hs * q[0]])
        row[_ROW["present"]], row[_ROW["is_target"]], row[_ROW["held"]] = 1.0, body.name == target, is_held
        row[_ROW["position"]] = c * away[0] + s * away[1], c * away[1] - s * away[0], away[2]
        row[_ROW["quaternion"]] = turned * np.copysign(1.0, turned[0])
        row[_ROW["half_extents"]], row[_ROW["is_box"]] = body.half_extents, body.shape == "box"
    return rows


def _grasp_labels(choice: _Choice, alternatives: Alternatives, num_objects: int) -> dict[str, Any]:
    """Which grasps are free, and which of them are as good as the plan's; of a put-down none."""
    families, scene = alternatives.grasps.families, choice.before
    is_free = np.zeros((num_objects, len(families), DIRECTION_CLASSES), np.bool_)
    if not choice.is_pick:
        return {"family": -1, "is_free": is_free, "is_optimal": is_free}
    free = alternatives.free_grasps(scene)
    is_free[: len(free)] = free
    is_optimal = np.zeros_like(is_free)
    is_optimal[: len(free)] = alternatives.as_good(scene, choice.target, free, choice.left)
    downwards = -np.arcsin(np.clip(choice.contact.tcp[2, 0], -1.0, 1.0))
    family = int(np.argmin([abs(entry.pitch - downwards) for entry in families]))
    is_optimal[scene.index(choice.contact.object), family, direction_class(choice.contact.yaw)] = True
    return {"family": family, "is_free": is_free, "is_optimal": is_optimal}


def _cell_labels(choice: _Choice, alternatives: Alternatives) -> dict[str, Any]:
    """The cells where the object can be put, and the chosen one; of a grasp none."""
    cells = alternatives.cells(choice.before)
    released = choice.action.released
    if choice.is_pick or released is None:
        nothing = np.full(len(cells), -1)
        return {"cell": -1, "on_cell": False, "cell_is_free": nothing >= 0, "cell_direction": nothing}
    directions = alternatives.free_cells(choice.before, choice.action.surfaces)
    distances = np.linalg.norm(cells - (*released.position[:2], released.bottom), axis=1)
    cell = int(distances.argmin())
    on_cell = bool(np.linalg.norm(cells[cell, :2] - released.position[:2]) < _ON_CELL)
    return {"cell": cell, "on_cell": on_cell, "cell_is_free": directions >= 0, "cell_direction": directions}
