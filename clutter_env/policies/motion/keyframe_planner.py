"""Keyframes of a pick or a place: its phases, and the configuration at the end of each.

`OpenKeyframePlanner` plans contacts in open space, `shelf.ShelfKeyframePlanner` contacts under a shelf.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray

from assets import RobotSpec
from clutter_env.policies.motion.arm import ArmKinematics, gripper_points, shorter_turns
from clutter_env.policies.motion.control import CLOSE, GripperError, IntegralOffset
from clutter_env.policies.motion.network import (
    AWAY,
    LINES,
    PHASES,
    TOWARDS,
    KeyframeNetwork,
    KeyframePredictor,
    Q,
    contact_in_base,
    line_distance,
)
from clutter_env.policies.parsed_observation import (
    ParsedObservation,
    Surroundings,
    base_from,
    distance_to_boxes,
    planar_pose,
)
from clutter_env.scene.layout import TABLE_HEIGHT, Layout, furniture
from planners import Contact

Array = NDArray[np.float64]

AHEAD = 0.06
"""[m] On a straight line the robot goes to the configuration this far ahead, which keeps the gripper on the line."""
_TUCKED = 0.4
"""[m], [rad] of the arm from its configuration for driving within which the base drives."""
_TORSOS = (0.0, -0.05, 0.05, -0.1, 0.1)
"""[m] from home."""
_ROLLS = tuple(np.radians((0, 15, -15, 30, -30, 45, -45, 60, -60)))
"""[rad] of the upper arm from home."""
_GRID = np.array([(torso, roll) for torso in _TORSOS for roll in _ROLLS])
_DISTANCES = np.array((0.0, 0.06, 0.12, 0.18))
"""[m] from the contact on the straight line, at which the arm is compared with the objects."""
_RADIUS, _CLEARANCE = 0.065, 0.02
"""[m] of the forearm, and of clearance around it that is enough."""
RAISE, _TOP_GAP = 0.022, 0.03
"""[m] by which a level gripper takes an object higher than planned, and between TCP and the object's top at least."""
_LEVEL = 0.1
"""Sine of the pitch up to which a gripper is regarded as level."""
_WALL_GAP = 2 * CLOSE
"""[m] between walls and the open gripper on its line: what it may be off the line, twice."""
_TORSO_COST, _MISS_COST, _HIT_COST = 3.0, 30.0, 60.0
"""Costs per metre of the torso from home, of distance between gripper and contact, and of missing clearance. The cost
of a radian of the roll is 1."""
_ELBOW, _WRIST = 4, 7
"""Indices of the joints of elbow and wrist, which bound the forearm and the wrist. The contact gives the pose of the
gripper."""
_SHARES = np.array((0.0, 0.5))
"""Points on the links, as shares of their length."""


class Keyframe(NamedTuple):
    """The goal of a phase.

    Attributes:
        goal: (11,) whole-body configuration.
        finger: position of one finger [m].
        expected: (4, 4) desired TCP pose now, in the world. The contact if the pose does not matter.
        stops: number of base poses left on a drive. It includes the present pose if the arm is tucked in first.
        length: [m] of the straight line that the gripper is on.
        slack: share of the largest permitted small error of the gripper at the end of a transit.
    """

    goal: Array
    finger: float
    expected: Array
    stops: int = 1
    length: float = 0.0
    slack: float = 1.0


class OpenKeyframePlanner:
    """Keyframes as the network predicts them, in the current base frame."""

    def __init__(self, network: KeyframeNetwork, robot: RobotSpec, layout: Layout) -> None:
        self._network, self._robot, self._keep_out = network, robot, network.keep_out
        self._keyframes, self._kinematics = KeyframePredictor(network), ArmKinematics(robot)
        self._furniture = np.array([(box.position, box.half_extents) for box in furniture(layout)])
        self._walls = self._furniture[self._furniture[:, :, 2].sum(axis=1) > TABLE_HEIGHT]

    def begin(self, contact: Contact, index: int, seen: ParsedObservation) -> list[str]:
        """Choose the arm configuration at a contact of object `index`. Return the phases to go through.

        The list is empty if the open gripper would come too near to furniture next to the table. The pick or place is
        then refused.
        """
        self._sizes = seen.sizes(index)
        self._free = self.free_joints(contact, index, seen)
        opens = "ready" if contact.skill == "pick" else "open"
        finger = float(self._predict(opens, contact, contact_in_base(contact.tcp, contact.base), 0.0)[14])
        gripper = gripper_points(self._robot, finger) - _DISTANCES[:, None, None] * (1.0, 0.0, 0.0)
        gripper = gripper @ contact.tcp[:3, :3].T + contact.tcp[:3, 3]
        if distance_to_boxes(gripper, *self._walls.swapaxes(0, 1)).min() < _WALL_GAP:
            return []
        return [phase for phase in PHASES[contact.skill] if self._network.has_seen(contact.skill, phase)]

    def raise_pick(self, contact: Contact, index: int, seen: ParsedObservation) -> float:
        """Height [m] by which object `index` is grasped higher than planned.

        The distance of table and wrist of a level gripper is hardly larger than the gripper's permitted error. The
        fingers stay below the object's top.
        """
        if contact.tcp[2, 0] < -_LEVEL:
            return CLOSE
        top = float(seen.position(index)[2] + seen.sizes(index)[2])
        return min(max(top - _TOP_GAP - float(contact.tcp[2, 3]), 0.0), RAISE)

    def free_joints(self, contact: Contact, index: int, seen: ParsedObservation) -> Array:
        """(2,) torso [m] and upper-arm roll [rad] at a contact of object `index`, less those of home.

        Of a grid those nearest to home are chosen for which network and kinematics predict a forearm clear of the
        objects and above the furniture: there without more clearance, which the wrist of a level gripper never has.
        """
        phase = "approach" if contact.skill == "pick" else "lower"
        pose = contact_in_base(contact.tcp, contact.base)
        poses = np.broadcast_to(pose, (len(_GRID) * len(_DISTANCES), 4, 4))
        distances, free = np.tile(_DISTANCES, len(_GRID)), np.repeat(_GRID, len(_DISTANCES), axis=0)
        q = self._keyframes.predict(contact.skill, phase, poses, seen.sizes(index), distances, free)[:, Q]
        origins = self._kinematics.links(torch.from_numpy(q.astype(np.float32)))[0].numpy().astype(float)
        joints = origins.reshape(len(_GRID), len(_DISTANCES), -1, 3)
        starts, ends = joints[:, :, _ELBOW:_WRIST], joints[:, :, _ELBOW + 1 : _WRIST + 1]
        points = np.concatenate([starts + share * (ends - starts) for share in _SHARES], axis=2)
        T_world_base = planar_pose(np.array(contact.base))
        T = np.linalg.inv(T_world_base) @ planar_pose(seen.base)
        clearance = Surroundings.beside(seen, index, T).distance(points).min(axis=(1, 2))
        in_world = points @ T_world_base[:3, :3].T + T_world_base[:3, 3]
        above = distance_to_boxes(in_world, *self._furniture.swapaxes(0, 1)).min(axis=(1, 2))
        from_home = _TORSO_COST * np.abs(_GRID[:, 0]) + np.abs(_GRID[:, 1])
        miss = np.linalg.norm(joints[:, 0, -1] - pose[:3, 3], axis=-1)
        lacking = np.maximum(_CLEARANCE + _RADIUS - clearance, 0.0) + np.maximum(_RADIUS - above, 0.0)
        return np.asarray(_GRID[np.argmin(from_home + _MISS_COST * miss + _HIT_COST * lacking)])

    def keyframe(self, phase: str, contact: Contact, offset: IntegralOffset, seen: ParsedObservation) -> Keyframe:
        """Goal of a phase. The contact may have moved since the last call."""
        T_base_world = np.linalg.inv(planar_pose(np.asarray(contact.base) if phase == "drive" else seen.base))
        here = float(line_distance(seen, contact)) if phase in LINES else 0.0
        ahead, length, planned, expected = here, 0.0, None, np.array(contact.tcp)
        shifted = T_base_world @ offset.applied_to(contact.tcp)
        if phase == "transit" or phase in TOWARDS:
            planned = self._predict(phase, contact, T_base_world @ contact.tcp, here)
            expected[:3, 3] += contact.tcp[:3, :3] @ planned[11:14]
            if phase in TOWARDS and gripper_error(phase, seen, expected, contact).is_small():
                ahead = max(here - AHEAD, 0.0)
        elif phase in AWAY:
            length = float(self._predict(phase, contact, shifted, here)[15])
            ahead = min(here + AHEAD, length)
        if planned is None or offset.is_any or ahead != here:
            planned = self._predict(phase, contact, shifted, ahead)
        base = base_from(contact.base, planned[:3])
        finger, q = float(planned[14]), shorter_turns(self._robot, seen.q, planned[Q])
        stops = 1
        if phase == "drive":
            base, stops = drive_goal(seen, list(self._keep_out.path(seen.base, base)), q)
        return Keyframe(np.concatenate((base, q)), finger, expected, stops, length)

    def _predict(self, phase: str, contact: Contact, base_contact: Array, distance: float) -> Array:
        """The network's output as one vector (16,), for a contact that is said to be at a pose (4, 4) in its base."""
        return self._keyframes.predict(contact.skill, phase, base_contact[None], self._sizes, distance, self._free)[0]


def gripper_error(phase: str, seen: ParsedObservation, expected: Array, contact: Contact) -> GripperError:
    """Error of the gripper. On a straight line the component along the line is left out, because that distance is
    measured."""
    error = GripperError.between(seen.tcp, expected)
    if phase in ("transit", "reach"):
        return error
    return error.across(expected[:3, 3] - contact.tcp[:3, 3])


def drive_goal(seen: ParsedObservation, path: list[Array], q: Array) -> tuple[Array, int]:
    """Goal of the base (3,) on a path of base poses while the arm moves to q (8,), and the number of poses left.

    The base drives after the arm is tucked in.
    """
    if np.abs(q - seen.q).max() <= _TUCKED:
        return path[0], len(path)
    return seen.base, 1 + len(path)
