"""Keyframes of picks and places under a shelf: the base goes by geometry, the arm as the network predicts."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from assets import RobotSpec
from clutter_env.policies.motion.arm import shorter_turns, with_wrist_flipped
from clutter_env.policies.motion.control import IntegralOffset
from clutter_env.policies.motion.keyframe_planner import AHEAD, Keyframe, drive_goal, gripper_error
from clutter_env.policies.motion.network import SHELF_PHASES, KeyframeNetwork, contact_in_base, line_distance
from clutter_env.policies.motion.shelf_arm import ArmPredictor, ShelfArmChooser
from clutter_env.policies.parsed_observation import ParsedObservation, planar_pose
from clutter_env.scene.layout import TABLE, Layout, furniture
from planners import Contact, StaticObstacle, drive_out

Array = NDArray[np.float64]

_TUCKED = ("drive", "ready", "retreat")
"""Phases outside at whose end the arm is as it is for driving."""
_FINGERS_AS: Mapping[str, Mapping[str, str]] = MappingProxyType(
    {
        "pick": {"enter": "ready", "reach": "ready", "transit": "ready", "back": "lift", "leave": "lift"},
        "place": {"enter": "lower", "reach": "lower", "transit": "lower", "back": "open", "leave": "open"},
    }
)
"""Phases in which the fingers are as in another one."""
_RAISED = {"pick": ("back", "leave"), "place": ("transit", "enter", "reach")}
"""Phases in which the gripper is as high as the object is lifted."""
_ROUNDS = 2
"""Rounds of correction by forward kinematics in a control step."""
_MAX_REFUSALS = 2
"""Times that a contact is refused in an episode; a high-level policy that still asks for it has nothing better."""
_ALIKE = 0.005
"""[m], [rad] by which a contact may differ from the one that was refused before, and is the same."""
_SLACK = 0.4
"""Share of the errors elsewhere that the gripper may have where the base drives in: table and wrist are 3 mm apart."""
_SAME = 1e-4
"""[m] and cosines by which a pose may change before the arm is predicted anew."""
_DRIVE_SPACING = 0.02
"""[m] between points on a drive at which the robot is compared with its surroundings."""


class ShelfKeyframePlanner:
    """Drives in with the arm rigid, straight and then along the gripper, and out again on the same path."""

    def __init__(self, network: KeyframeNetwork, robot: RobotSpec, layout: Layout) -> None:
        self._robot, self._keep_out, self._table = robot, network.keep_out, table_of(layout)
        self._refused: list[Contact] = []
        self._predictor, self._chooser = ArmPredictor(network, robot), ShelfArmChooser(network, robot, layout)

    def begin(self, contact: Contact, index: int, seen: ParsedObservation) -> list[str]:
        """Choose the arm at a contact of object `index`; the phases to go through.

        There are none where arm or gripper would run into something: the pick or place is refused.
        """
        self._sizes = seen.sizes(index)
        finger = self._finger("ready" if contact.skill == "pick" else "open", contact, np.zeros(2))
        drive = drive_points(self._table, contact)
        self._arm = self._chooser.choose(contact, index, seen, drive, finger)
        if self._arm.is_blocked and sum(_is_same(contact, other) for other in self._refused) < _MAX_REFUSALS:
            self._refused.append(contact)
            return []
        self._last = np.zeros((4, 4)), 0.0, seen.q
        return list(SHELF_PHASES[contact.skill])

    def keyframe(self, phase: str, contact: Contact, offset: IntegralOffset, seen: ParsedObservation) -> Keyframe:
        """The goal of a phase; the contact may have moved since."""
        base, stops = base_waypoint(self._table, contact, phase), 1
        here = self._height(phase, contact, seen)
        expected = np.array(contact.tcp)
        expected[2, 3] += here
        if phase in ("transit", "enter"):
            expected = planar_pose(seen.base) @ contact_in_base(expected, contact.base)
        if phase in _TUCKED:
            base_tcp = contact_in_base(contact.tcp, contact.base)[None]
            q = self._flipped(
                self._predictor.predict(contact.skill, phase, base_tcp, self._sizes, 0.0, np.zeros(2))[0][0]
            )
        else:
            ahead = here
            if phase == "lift":
                ahead = min(here + AHEAD, self._arm.height)
            elif phase == "lower" and gripper_error(phase, seen, expected, contact).is_small():
                ahead = max(here - AHEAD, 0.0)
            q = self._q_at(contact, offset, ahead)
        q = shorter_turns(self._robot, seen.q, q)
        if phase == "drive":
            base, stops = drive_goal(seen, list(self._keep_out.path(seen.base, base)), q)
        like = _FINGERS_AS[contact.skill].get(phase, phase)
        finger = self._finger(like, contact, np.zeros(2) if like in _TUCKED else self._arm.low)
        return Keyframe(np.concatenate((base, q)), finger, expected, stops, self._arm.height, _SLACK)

    def _height(self, phase: str, contact: Contact, seen: ParsedObservation) -> float:
        """[m] of the gripper above the contact, as it is or is to be."""
        if phase in ("lift", "lower"):
            return float(line_distance(seen, contact))
        return self._arm.height if phase in _RAISED[contact.skill] else 0.0

    def _q_at(self, contact: Contact, offset: IntegralOffset, height: float) -> Array:
        """(8,) Torso and arm with the gripper at a height [m] above the offset contact, for the base there."""
        base_tcp = contact_in_base(offset.applied_to(contact.tcp), contact.base)
        last_tcp, last_height, _ = self._last
        if height != last_height or np.abs(base_tcp - last_tcp).max() > _SAME:
            free, heights = self._arm.at(height)[None], np.array([height])
            q = self._predictor.on_line(contact.skill, base_tcp, self._sizes, heights, free, _ROUNDS)[0][0]
            self._last = base_tcp, height, self._flipped(q)
        return self._last[2]

    def _flipped(self, q: Array) -> Array:
        """The configuration with the wrist on the chosen side."""
        return with_wrist_flipped(self._robot, q) if self._arm.is_flipped else q

    def _finger(self, phase: str, contact: Contact, free: Array) -> float:
        """[m] Position of one finger in a phase."""
        base_tcp = contact_in_base(contact.tcp, contact.base)[None]
        return float(self._predictor.predict(contact.skill, phase, base_tcp, self._sizes, 0.0, free)[1][0])


def table_of(layout: Layout) -> StaticObstacle:
    """The table on which objects stand."""
    box = next(box for box in furniture(layout) if box.name == TABLE)
    return StaticObstacle(box.name, np.array(box.position), np.array(box.half_extents))


def base_waypoint(table: StaticObstacle, contact: Contact, phase: str) -> Array:
    """(3,) The base at the end of a phase: where the gripper reaches the object, backed off along it, or outside."""
    inside, back, outside = drive_out(table, contact.base, contact.tcp)
    if phase in ("enter", "back"):
        return np.asarray(back)
    return np.asarray(inside if phase in ("reach", "close", "lift", "lower", "open") else outside)


def drive_points(table: StaticObstacle, contact: Contact) -> Array:
    """(w, 3) [m] Positions of the base along its drive out, less the one at the contact, in the world."""
    corners = drive_out(table, contact.base, contact.tcp)[:, :2] - contact.base[:2]
    parts = [
        np.linspace(start, end, max(int(np.ceil(np.linalg.norm(end - start) / _DRIVE_SPACING)), 1) + 1)
        for start, end in pairwise(corners)
    ]
    return np.pad(np.concatenate(parts), ((0, 0), (0, 1)))


def _is_same(contact: Contact, other: Contact) -> bool:
    """Whether it is the same pick or place."""
    if (contact.skill, contact.object) != (other.skill, other.object):
        return False
    return np.allclose(contact.tcp, other.tcp, atol=_ALIKE) and np.allclose(contact.base, other.base, atol=_ALIKE)
