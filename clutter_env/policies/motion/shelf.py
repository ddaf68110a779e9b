"""Picks and places under a shelf: the base moves by geometry, the arm as the network predicts.

On the drives in and out the arm is rigid, in its configuration at the contact or after the lift. It is chosen to keep
clear of furniture and objects on the whole drive.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray

from assets import RobotSpec
from clutter_env.policies.motion.arm import (
    ArmKinematics,
    gripper_points,
    is_wrist_flipped,
    shorter_turns,
    with_wrist_flipped,
)
from clutter_env.policies.motion.control import MAX_SHIFT, MAX_TURN, IntegralOffset, limited
from clutter_env.policies.motion.keyframe_planner import AHEAD, Keyframe, drive_goal, gripper_error
from clutter_env.policies.motion.network import (
    FREE_JOINTS,
    SHELF_PHASES,
    SKILLS,
    KeyframeNetwork,
    KeyframePredictor,
    Q,
    contact_in_base,
    line_distance,
)
from clutter_env.policies.parsed_observation import ParsedObservation, Surroundings, planar_pose, wrapped
from clutter_env.scene.layout import TABLE, Layout, furniture
from irm.rotations import rotation_vectors, rotations_by
from planners import Contact, StaticObstacle, drive_out, robot_arrays

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
"""Times that a contact is refused in an episode. A high-level policy that still asks for it has no better candidate."""
_ALIKE = 0.005
"""[m], [rad] Largest difference between contacts that are regarded as the same refused contact."""
_SLACK = 0.4
"""Share of the errors elsewhere that the gripper may have where the base drives in: table and wrist are 3 mm apart."""
_SAME = 1e-4
"""[m] and cosines: change of a pose after which the arm is predicted again."""
_DRIVE_SPACING = 0.02
"""[m] between points on a drive at which the robot is compared with its surroundings."""


_GAIN = 0.8
"""Share of the predicted error by which the network input is changed in a round of correction."""
_MAX_BEND = np.array((0.1, 0.5))
"""[m], [rad] Largest difference of the free joints in the input from the desired joints, as in the training of the
network."""
_CHOOSING_ROUNDS = 6
"""The same while arms are compared."""

_KEY_UNITS = np.array((0.01, 0.05, 0.2, 0.2, 0.05))
"""Of skill, x [m], yaws [rad] and distance [m]: equivalent differences."""
_NEAREST = 16
"""Demonstrated contacts whose free joints are candidates."""
_GRID = np.array(
    [(torso, roll) for torso in (0.05, 0.0, -0.05, -0.1, -0.15) for roll in np.radians(range(-60, 61, 15))]
)
"""Torsos [m] and rolls of the upper arm [rad] from home that are candidates besides the demonstrated ones."""
_UNLIKE_COST, _STRANGE_COST, _FLIPPED_COST = 0.2, 0.5, 0.3
"""Costs. The first is per unit of difference from the contact at which the free joints were demonstrated. The second is
for free joints that are not among the nearest demonstrated ones. The third is for a wrist bent to the other side (one
demonstrated pick in ten, deep inside)."""
_KEPT = 12
"""Candidates at the contact for which lifts are compared."""
_LIFTS = np.array(
    [(0.12, 0.12, 0.0), (0.12, 0.01, 0.1), (0.03, 0.03, 0.2), (0.07, 0.07, 0.2), (0.07, 0.01, 0.3), (0.03, 0.0, 0.3)]
)
"""Lift heights of the gripper [m], the torso's share of them [m], and the costs. The demonstrated lift comes first."""
_CLEARANCE, _TOUCHING = 0.02, 0.004
"""[m] Sufficient clearance of the arm, and clearance below which it probably touches. The wrist of a level gripper near
the table has at most 9 mm."""
_MISS_COST, _CLEARANCE_COST, _HIT_COST = 60.0, 20.0, 300.0
"""Costs of a metre by which the gripper misses its pose, and of a metre that a ball of the arm lacks to a clearance."""
_MAX_RISK = 6.0
"""Cost of lacking clearance up to which an arm is expected to get through."""


class ShelfKeyframePlanner:
    """Drives in with the arm rigid, straight and then along the gripper, and out again on the same path."""

    def __init__(self, network: KeyframeNetwork, robot: RobotSpec, layout: Layout) -> None:
        self._robot, self._keep_out, self._table = robot, network.keep_out, table_of(layout)
        self._refused: list[Contact] = []
        self._keyframes, self._arms = KeyframePredictor(network), ShelfArm(network, robot, layout)

    def raise_pick(self, *_: object) -> float:
        """0 m: a board is above."""
        return 0.0

    def begin(self, contact: Contact, index: int, seen: ParsedObservation) -> list[str]:
        """Choose the arm configuration at a contact of object `index`. Return the phases to go through.

        The list is empty if arm or gripper would collide. The pick or place is then refused.
        """
        self._sizes = seen.sizes(index)
        opens = "ready" if contact.skill == "pick" else "open"
        self._arm = self._arms.choose(contact, index, seen, float(self._predict(opens, contact, np.zeros(2))[14]))
        if self._arm.is_blocked and sum(_is_same(contact, other) for other in self._refused) < _MAX_REFUSALS:
            self._refused.append(contact)
            return []
        self._last = np.zeros((4, 4)), 0.0, seen.q
        self._driven = contact, drive_out(self._table, contact.base, contact.tcp)
        return list(SHELF_PHASES[contact.skill])

    def keyframe(self, phase: str, contact: Contact, offset: IntegralOffset, seen: ParsedObservation) -> Keyframe:
        """Goal of a phase. The contact may have moved since the last call."""
        if self._driven[0] is not contact:
            self._driven = contact, drive_out(self._table, contact.base, contact.tcp)
        base, stops = base_waypoint(self._driven[1], phase), 1
        here = self._height(phase, contact, seen)
        expected = np.array(contact.tcp)
        expected[2, 3] += here
        if phase in ("transit", "enter"):
            expected = planar_pose(seen.base) @ contact_in_base(expected, contact.base)
        like = _FINGERS_AS[contact.skill].get(phase, phase)
        predicted = self._predict(like, contact, np.zeros(2) if like in _TUCKED else self._arm.low)
        if phase in _TUCKED:
            q = self._flipped(predicted[Q])
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
        goal = np.concatenate((base, q))
        return Keyframe(goal, float(predicted[14]), expected, stops, self._arm.height, _SLACK)

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
            q = self._arms.on_line(contact.skill, base_tcp, self._sizes, heights, free, _ROUNDS)[0][0]
            self._last = base_tcp, height, self._flipped(q)
        return self._last[2]

    def _flipped(self, q: Array) -> Array:
        return with_wrist_flipped(self._robot, q) if self._arm.is_flipped else q

    def _predict(self, phase: str, contact: Contact, free: Array) -> Array:
        base_tcp = contact_in_base(contact.tcp, contact.base)[None]
        return self._keyframes.predict(contact.skill, phase, base_tcp, self._sizes, 0.0, free)[0]


def table_of(layout: Layout) -> StaticObstacle:
    """The table on which objects stand."""
    box = next(box for box in furniture(layout) if box.name == TABLE)
    return StaticObstacle(box.name, np.array(box.position), np.array(box.half_extents))


def base_waypoint(drive: Array, phase: str) -> Array:
    """(3,) The base at the end of a phase, of the poses of `drive_out`: inside, backed off, or outside."""
    inside, back, outside = drive
    if phase in ("enter", "back"):
        return np.asarray(back)
    return np.asarray(inside if phase in ("reach", "close", "lift", "lower", "open") else outside)


def drive_points(table: StaticObstacle, contact: Contact) -> Array:
    """(w, 3) [m] Positions of the base along its drive out, relative to the pose at the contact, in the world."""
    corners = drive_out(table, contact.base, contact.tcp)[:, :2] - contact.base[:2]
    steps = [max(int(np.ceil(np.linalg.norm(leg) / _DRIVE_SPACING)), 1) for leg in np.diff(corners, axis=0)]
    parts = [np.linspace(*ends, count + 1) for ends, count in zip(itertools.pairwise(corners), steps, strict=True)]
    return np.pad(np.concatenate(parts), ((0, 0), (0, 1)))


def _is_same(contact: Contact, other: Contact) -> bool:
    if (contact.skill, contact.object) != (other.skill, other.object):
        return False
    return np.allclose(contact.tcp, other.tcp, atol=_ALIKE) and np.allclose(contact.base, other.base, atol=_ALIKE)


class ArmChoice(NamedTuple):
    """Arm configuration at a contact and above it.

    Attributes:
        height: [m] above the contact at which the object is driven in or out.
        low, high: (2,) torso [m] and upper-arm roll [rad] at the contact and at that height, less those of home.
        is_flipped: whether the wrist is bent to the other side than at home.
        is_blocked: whether the arm or the open gripper would run into something for certain.
    """

    height: float
    low: Array
    high: Array
    is_flipped: bool
    is_blocked: bool

    def at(self, height: float) -> Array:
        """(2,) torso and roll at a height [m] above the contact."""
        share = min(max(height / self.height, 0.0), 1.0)
        return np.asarray((1 - share) * self.low + share * self.high)


class ShelfArm:
    """The arm as network and kinematics predict it, chosen among its configurations.

    The arm is compared with furniture and objects along the whole drive of the base. It is rigid in its configuration
    at the contact on one drive, and after the lift on the other. It is modelled as b balls along its collision solids,
    from the first joint to the wrist, and the gripper as points on its surface.
    """

    def __init__(self, network: KeyframeNetwork, robot: RobotSpec, layout: Layout) -> None:
        self._keyframes, self._kinematics, self._robot = KeyframePredictor(network), ArmKinematics(robot), robot
        # Of the network, which was trained on one; the robot may start in another.
        self._home = network.home.numpy().astype(float)[list(FREE_JOINTS)]
        self._demonstrated = network.shown.numpy().astype(float)
        self._table, self._boxes = table_of(layout), furniture(layout)
        arrays, centres, radii, links = robot_arrays(robot), [], [], []
        for solid in range(arrays.held_from, len(arrays.core)):
            if arrays.link[solid] > 0:
                half = arrays.half[solid]
                longest = int(np.argmax(half))
                radius = float(arrays.radius[solid] + np.linalg.norm(np.delete(half, longest)))
                count = 2 + int(half[longest] / radius)
                along = np.linspace(-half[longest], half[longest], count)[:, None] * arrays.rotation[solid][:, longest]
                centres.append(arrays.position[solid] + along)
                radii += [radius] * count
                links += [int(arrays.link[solid])] * count
        self._radius, self._centres, self._links = np.array(radii), np.concatenate(centres), np.array(links)

    def choose(self, contact: Contact, index: int, seen: ParsedObservation, finger: float = 0.0) -> ArmChoice:
        """The arm at a contact of object `index`: the best that keeps clear, or that with the least risk.

        Args:
            contact: the pick or place.
            index: of its object.
            seen: the robot and the objects.
            finger: [m] position of each finger of the open gripper.
        """
        around = Surroundings.beside(seen, index, planar_pose(seen.base), self._boxes)
        drive, sizes = drive_points(self._table, contact), seen.sizes(index)

        def risks(heights: Array, free: Array, flipped: NDArray[np.bool_]) -> tuple[Array, Array]:
            """Risk on the drive, and the gripper's error [m], of arms (k,) at heights [m] above the contact."""
            base_tcp = contact_in_base(contact.tcp, contact.base)
            q, miss = self.on_line(contact.skill, base_tcp, sizes, heights, free, _CHOOSING_ROUNDS)
            q[flipped] = with_wrist_flipped(self._robot, q[flipped])
            T = planar_pose(np.array(contact.base))
            centres = self.ball_centres(q) @ T[:3, :3].T + T[:3, 3]
            clearance = around.distance(centres[:, :, None] + drive).min(axis=2) - self._radius
            lacking = np.maximum(_CLEARANCE - clearance, 0.0), np.maximum(_TOUCHING - clearance, 0.0)
            return (_CLEARANCE_COST * lacking[0] + _HIT_COST * lacking[1]).sum(axis=1), miss

        # An object in the gripper keeps the wrist on its side.
        sides = (False, True) if contact.skill == "pick" else (is_wrist_flipped(self._robot, seen.q),)
        away = (self._demonstrated[:, :5] - demonstrated_row(contact, np.zeros(2))[:5]) / _KEY_UNITS
        unlike = _UNLIKE_COST * np.linalg.norm(away, axis=1)
        nearest = np.argsort(unlike, kind="stable")[:_NEAREST]
        unlike = np.append(unlike[nearest], np.full(len(_GRID), unlike[nearest[0]] + _STRANGE_COST))
        free = np.concatenate((self._demonstrated[nearest, 5:], _GRID))
        low, flipped = np.tile(free, (len(sides), 1)), np.repeat(sides, len(free))
        cost = np.tile(unlike, len(sides)) + _FLIPPED_COST * flipped
        risk, miss = risks(np.zeros(len(low)), low, flipped)
        best = np.argsort(cost + risk + _MISS_COST * miss, kind="stable")[:_KEPT]
        row, lift = (axis.ravel() for axis in np.meshgrid(best, np.arange(len(_LIFTS)), indexing="ij"))
        height, torso, lift_cost = _LIFTS[lift].T
        high = low[row] + np.column_stack((torso, np.zeros(len(row))))
        risk_above, miss_above = risks(height, high, flipped[row])
        risk = risk[row] + risk_above
        found = int(np.argmin(cost[row] + lift_cost + risk + _MISS_COST * (miss[row] + miss_above)))
        of = row[found]
        # The open gripper moves in to a pick, and out from a place.
        gripper = gripper_points(self._robot, finger) @ contact.tcp[:3, :3].T + contact.tcp[:3, 3]
        is_blocked = risk[found] > _MAX_RISK or around.contain(gripper + drive[:, None])
        return ArmChoice(float(height[found]), low[of], high[found], bool(flipped[of]), bool(is_blocked))

    def on_line(
        self, skill: str, base_tcp: Array, sizes: Array, heights: Array, free: Array, rounds: int
    ) -> tuple[Array, Array]:
        """Torso and arm (k, 8) with the gripper at heights (k,) [m] above a contact, and its error there (k,) [m].

        They are predicted, and corrected by forward kinematics before the robot moves. If the predicted gripper is off
        its line, the contact in the network input is moved to the other side. Feedback of the measured error does the
        same while the robot moves. Free joints are corrected alike.

        Args:
            skill: "pick" or "place".
            base_tcp: (4, 4) of the gripper at the contact, in the base's frame.
            sizes: (4,) of the object, as `ParsedObservation.sizes`.
            heights: (k,) above the contact.
            free: (k, 2) torso [m] and upper-arm roll [rad] there, relative to home.
            rounds: number of corrections.
        """
        count, phase = len(heights), "lift" if skill == "pick" else "lower"
        wanted = np.tile(base_tcp, (count, 1, 1))
        wanted[:, 2, 3] += heights
        shift, turn, bend = np.zeros((count, 3)), np.zeros((count, 3)), np.zeros((count, 2))
        for left in range(rounds, -1, -1):
            shifted = np.tile(base_tcp, (count, 1, 1))
            shifted[:, :3, 3] += shift
            shifted[:, :3, :3] = rotations_by(turn) @ shifted[:, :3, :3]
            q = self._keyframes.predict(skill, phase, shifted, sizes, heights, free + bend)[:, Q]
            position, rotation = self._kinematics.tcp(torch.from_numpy(q.astype(np.float32)))
            error = wanted[:, :3, 3] - position.numpy()
            if left:
                off = wanted[:, :3, :3] @ rotation.numpy().transpose(0, 2, 1)
                # Rotations in single precision are orthogonal to 1e-7; a step of Newton's method for the nearest one.
                off = rotation_vectors(off @ (1.5 * np.eye(3) - 0.5 * off.transpose(0, 2, 1) @ off))
                shift = limited(shift + _GAIN * error, MAX_SHIFT)
                bend += _GAIN * (free + self._home - q[:, list(FREE_JOINTS)])
                bend = np.clip(bend, -_MAX_BEND, _MAX_BEND)
                turn = limited(rotation_vectors(rotations_by(_GAIN * off) @ rotations_by(turn)), MAX_TURN)
        return q, np.linalg.norm(error, axis=1)

    def ball_centres(self, q: Array) -> Array:
        """(k, b, 3) [m] Centres of the balls in the base's frame, at configurations (k, 8)."""
        origins, rotations = self._kinematics.links(torch.from_numpy(q.astype(np.float32)))
        R, p = rotations.numpy().astype(float)[:, self._links], origins.numpy().astype(float)[:, self._links]
        return np.asarray(p + (R @ self._centres[:, :, None])[..., 0])


def demonstrated_row(contact: Contact, free: Array) -> Array:
    """(7,) A demonstrated contact under a shelf: its key, then torso [m] and upper-arm roll [rad] less those of home.

    The key is skill, x [m] in the world, yaw of the base and of the gripper against it [rad], distance of both [m].
    """
    away = contact.tcp[:2, 3] - contact.base[:2]
    turn = wrapped(contact.yaw - contact.base[2])
    skill, yaw = SKILLS.index(contact.skill), wrapped(contact.base[2])
    return np.array((skill, contact.tcp[0, 3], yaw, turn, np.linalg.norm(away), *free))
