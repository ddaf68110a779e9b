"""The arm under a shelf: predicted by the network on the vertical line at a contact, chosen so as to keep clear.

On the drives in and out the arm is rigid, as it is at the contact or as it is when it has lifted the object.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from assets import RobotSpec
from clutter_env.policies.motion.arm import ArmKinematics, is_wrist_flipped, with_wrist_flipped
from clutter_env.policies.motion.control import MAX_SHIFT, MAX_TURN
from clutter_env.policies.motion.network import (
    FREE_JOINTS,
    SKILLS,
    KeyframeNetwork,
    contact_in_base,
    network_input,
    phase_index,
)
from clutter_env.policies.parsed_observation import Cylinders, ParsedObservation, planar_pose, wrapped
from clutter_env.scene.layout import Layout, furniture
from irm import pose_of
from planners import Contact, RobotArrays, robot_arrays

Array = NDArray[np.float64]

_GAIN = 0.8
"""Share of the predicted error by which the network input is changed in a round of correction."""
_MAX_BEND = np.array((0.1, 0.5))
"""[m], [rad] by which the free joints in the input may differ from the wanted ones: the network was fitted to such."""
_ROUNDS = 6
"""Rounds of correction by forward kinematics while arms are compared."""

_KEY_UNITS = np.array((0.01, 0.05, 0.2, 0.2, 0.05))
"""Of skill, x [m], yaws [rad] and distance [m]: differences that count like one another."""
_NEAREST = 16
"""Demonstrated contacts whose free joints are candidates."""
_GRID = np.array(
    [(torso, roll) for torso in (0.05, 0.0, -0.05, -0.1, -0.15) for roll in np.radians(range(-60, 61, 15))]
)
"""Torsos [m] and rolls of the upper arm [rad] from home that are candidates beside the demonstrated ones."""
_UNLIKE_COST, _STRANGE_COST, _FLIPPED_COST = 0.2, 0.5, 0.3
"""Costs for each unit by which the contact where free joints were demonstrated differs; of free joints that are not
among the nearest demonstrated ones; of a wrist bent to the other side (one demonstrated pick in ten, deep inside)."""
_KEPT = 12
"""Candidates at the contact for which lifts are compared."""
_LIFTS = np.array(
    [
        (0.12, 0.12, 0.0),
        (0.12, 0.01, 0.1),
        (0.03, 0.03, 0.2),
        (0.07, 0.07, 0.2),
        (0.07, 0.01, 0.3),
        (0.03, 0.0, 0.3),
    ]
)
"""Heights [m] to which the gripper is lifted, how much the torso does of it [m], and the costs; demonstrated first."""
_CLEARANCE, _TOUCHING = 0.02, 0.004
"""[m] of clearance of the arm that is enough, and below which it is likely to touch; the wrist behind a level gripper
that reaches down to the table has no more than 9 mm."""
_MISS_COST, _CLEARANCE_COST, _HIT_COST = 60.0, 20.0, 300.0
"""Costs of a metre by which the gripper misses its pose, and of a metre that a ball of the arm lacks to a clearance."""
_MAX_RISK = 6.0
"""Cost of lacking clearance up to which an arm is expected to get through."""
_POINT_SPACING = 0.02
"""[m] between points on the gripper's surface, at most."""


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


class ArmPredictor:
    """Arm configurations predicted by a network, corrected by forward kinematics before the robot moves.

    Where forward kinematics predicts the gripper beside its line, the contact in the network input is moved to the
    other side, as feedback of the measured error does while the robot moves; and free joints likewise.
    """

    def __init__(self, network: KeyframeNetwork, robot: RobotSpec) -> None:
        self._network, self._kinematics = network, ArmKinematics(robot)
        self._home = np.array(robot.home)[list(FREE_JOINTS)]

    def predict(
        self, skill: str, phase: str, base_tcp: Array, sizes: Array, heights: Array | float, free: Array
    ) -> tuple[Array, Array]:
        """Torso and arm (k, 8) and finger positions (k,) [m] for contacts (k, 4, 4) in the base's frame."""
        rows = network_input(phase_index(skill, phase), base_tcp, sizes, heights, free)
        predicted = self._network.predict(rows)
        return predicted.q.numpy().astype(float), predicted.finger.numpy().astype(float)

    def on_line(
        self, skill: str, base_tcp: Array, sizes: Array, heights: Array, free: Array, rounds: int
    ) -> tuple[Array, Array]:
        """Torso and arm (k, 8) with the gripper at heights (k,) [m] above a contact, and its error there (k,) [m].

        Args:
            skill: "pick" or "place".
            base_tcp: (4, 4) of the gripper at the contact, in the base's frame.
            sizes: (4,) of the object, as `ParsedObservation.sizes`.
            heights: (k,) above the contact.
            free: (k, 2) torso [m] and upper-arm roll [rad] there, less those of home.
            rounds: of correction.
        """
        count, phase = len(heights), "lift" if skill == "pick" else "lower"
        wanted = np.tile(base_tcp, (count, 1, 1))
        wanted[:, 2, 3] += heights
        shift, turn, bend = np.zeros((count, 3)), np.zeros((count, 3)), np.zeros((count, 2))
        for left in range(rounds, -1, -1):
            shifted = np.tile(base_tcp, (count, 1, 1))
            shifted[:, :3, 3] += shift
            shifted[:, :3, :3] = Rotation.from_rotvec(turn).as_matrix() @ shifted[:, :3, :3]
            q, _ = self.predict(skill, phase, shifted, sizes, heights, free + bend)
            position, rotation = self._kinematics.tcp(torch.from_numpy(q.astype(np.float32)))
            error = wanted[:, :3, 3] - position.numpy()
            if left:
                off = Rotation.from_matrix(wanted[:, :3, :3] @ rotation.numpy().transpose(0, 2, 1))
                step = Rotation.from_rotvec(_GAIN * off.as_rotvec())
                shift = _limited(shift + _GAIN * error, MAX_SHIFT)
                bend += _GAIN * (free + self._home - q[:, list(FREE_JOINTS)])
                bend = np.clip(bend, -_MAX_BEND, _MAX_BEND)
                turn = _limited((step * Rotation.from_rotvec(turn)).as_rotvec(), MAX_TURN)
        return q, np.linalg.norm(error, axis=1)


@dataclass(frozen=True, eq=False)
class Surroundings:
    """The furniture of a layout, m boxes, and the objects beside the one that is taken, in the world.

    Attributes:
        centre, half: (m, 3) [m] of the boxes.
        objects: the objects.
    """

    centre: Array
    half: Array
    objects: Cylinders

    def distance(self, points: Array) -> Array:
        """(...) [m] from points (..., 3) to the nearest surface, 0 inside."""
        outside = np.maximum(np.abs(points[..., None, :] - self.centre) - self.half, 0.0)
        return np.minimum(np.linalg.norm(outside, axis=-1).min(axis=-1), self.objects.distance(points))

    def contain(self, points: Array) -> bool:
        """Whether any of the points (..., 3) is inside a box or an object for certain."""
        is_in_box = (np.abs(points[..., None, :] - self.centre) < self.half).all(axis=-1).any()
        return bool(is_in_box) or self.objects.contain(points)


class ShelfArmChooser:
    """Chooses among arm configurations by what a network and the robot's kinematics predict for each of them.

    The arm is compared with furniture and objects along the whole drive of the base, rigid as it is at the contact and
    rigid as it is when it has lifted: one of them goes in, the other out.
    """

    def __init__(self, network: KeyframeNetwork, robot: RobotSpec, layout: Layout) -> None:
        self._demonstrated = network.shown.numpy().astype(float)
        self._predictor, self._balls = ArmPredictor(network, robot), ArmBalls(robot)
        self._gripper, self._robot, self._boxes = GripperPoints(robot), robot, furniture(layout)

    def choose(
        self, contact: Contact, index: int, seen: ParsedObservation, drive: Array, finger: float = 0.0
    ) -> ArmChoice:
        """The arm at a contact of object `index`: the best that keeps clear, or the one with the least risk.

        Args:
            contact: the pick or place.
            index: of its object.
            seen: the robot and the objects.
            drive: (w, 3) [m] positions of the base on its drive out, less the one at the contact.
            finger: [m] position of each finger of the open gripper.
        """
        around = Surroundings(
            centre=np.array([box.position for box in self._boxes]),
            half=np.array([box.half_extents for box in self._boxes]),
            objects=Cylinders.beside(seen, index, planar_pose(seen.base)),
        )
        # An object in the gripper keeps the wrist on its side.
        sides = (False, True) if contact.skill == "pick" else (is_wrist_flipped(self._robot, seen.q),)
        shown, away = nearest_demonstrated(self._demonstrated, contact)
        unlike = np.concatenate((_UNLIKE_COST * away, np.full(len(_GRID), away[0] * _UNLIKE_COST + _STRANGE_COST)))
        low, flipped = np.tile(np.concatenate((shown, _GRID)), (len(sides), 1)), np.repeat(sides, len(unlike))
        cost = np.tile(unlike, len(sides)) + _FLIPPED_COST * flipped
        sizes = seen.sizes(index)
        risk, miss = self._risks(contact, sizes, around, drive, np.zeros(len(low)), low, flipped)
        best = np.argsort(cost + risk + _MISS_COST * miss, kind="stable")[:_KEPT]
        row, lift = (axis.ravel() for axis in np.meshgrid(best, np.arange(len(_LIFTS)), indexing="ij"))
        height, torso, lift_cost = _LIFTS[lift].T
        high = low[row] + np.column_stack((torso, np.zeros(len(row))))
        also_risk, also_miss = self._risks(contact, sizes, around, drive, height, high, flipped[row])
        risks = risk[row] + also_risk
        found = int(np.argmin(cost[row] + lift_cost + risks + _MISS_COST * (miss[row] + also_miss)))
        of = row[found]
        # The open gripper moves in to a pick, and out from a place.
        gripper = self._gripper.at(finger) @ contact.tcp[:3, :3].T + contact.tcp[:3, 3]
        is_blocked = risks[found] > _MAX_RISK or around.contain(gripper + drive[:, None])
        return ArmChoice(float(height[found]), low[of], high[found], bool(flipped[of]), bool(is_blocked))

    def _risks(
        self,
        contact: Contact,
        sizes: Array,
        around: Surroundings,
        drive: Array,
        heights: Array,
        free: Array,
        flipped: NDArray[np.bool_],
    ) -> tuple[Array, Array]:
        """Risk on the drive, and the gripper's error [m], of arms (k,) at heights [m] above the contact."""
        base_tcp = contact_in_base(contact.tcp, contact.base)
        q, miss = self._predictor.on_line(contact.skill, base_tcp, sizes, heights, free, _ROUNDS)
        q[flipped] = with_wrist_flipped(self._robot, q[flipped])
        T = planar_pose(np.array(contact.base))
        centres = self._balls.centres(q) @ T[:3, :3].T + T[:3, 3]
        clearance = around.distance(centres[:, :, None] + drive).min(axis=2) - self._balls.radius
        lacking = np.maximum(_CLEARANCE - clearance, 0.0), np.maximum(_TOUCHING - clearance, 0.0)
        return (_CLEARANCE_COST * lacking[0] + _HIT_COST * lacking[1]).sum(axis=1), miss


def demonstrated_row(contact: Contact, free: Array) -> Array:
    """(7,) A demonstrated contact under a shelf: its key, then torso [m] and upper-arm roll [rad] less those of home.

    The key is skill, x [m] in the world, yaw of the base and of the gripper against it [rad], distance of both [m].
    """
    away = contact.tcp[:2, 3] - contact.base[:2]
    turn = wrapped(contact.yaw - contact.base[2])
    skill, yaw = SKILLS.index(contact.skill), wrapped(contact.base[2])
    return np.array((skill, contact.tcp[0, 3], yaw, turn, np.linalg.norm(away), *free))


def nearest_demonstrated(shown: Array, contact: Contact) -> tuple[Array, Array]:
    """Free joints (k, 2) of the demonstrated contacts (m, 7) nearest to a contact, and their distances from it (k,)."""
    away = np.linalg.norm((shown[:, :5] - demonstrated_row(contact, np.zeros(2))[:5]) / _KEY_UNITS, axis=1)
    nearest = np.argsort(away, kind="stable")[:_NEAREST]
    return shown[nearest, 5:], away[nearest]


class ArmBalls:
    """b balls along the collision solids of the arm, from its first joint to the wrist, without the gripper.

    Attributes:
        radius: (b,) [m].
    """

    def __init__(self, robot: RobotSpec) -> None:
        arrays = robot_arrays(robot)
        found = [_balls(arrays, solid) for solid in range(arrays.held_from, len(arrays.core)) if arrays.link[solid] > 0]
        self.radius = np.concatenate([np.full(len(centres), radius) for centres, radius, _ in found])
        self._centres = np.concatenate([centres for centres, _, _ in found])
        self._links = np.concatenate([np.full(len(centres), link) for centres, _, link in found])
        self._kinematics = ArmKinematics(robot)

    def centres(self, q: Array) -> Array:
        """(k, b, 3) [m] in the base's frame, at configurations (k, 8)."""
        origins, rotations = self._kinematics.links(torch.from_numpy(q.astype(np.float32)))
        R, p = rotations.numpy().astype(float)[:, self._links], origins.numpy().astype(float)[:, self._links]
        return np.asarray(p + (R @ self._centres[:, :, None])[..., 0])


class GripperPoints:
    """Points on the boxes about palm, fingers and last wrist joint, in the TCP's frame."""

    def __init__(self, robot: RobotSpec) -> None:
        arrays = robot_arrays(robot)
        solids = [(_surface(arrays, solid), arrays.slide[solid]) for solid in range(arrays.held_from)]
        T = np.linalg.inv(pose_of(arrays.tip))
        self._closed = np.concatenate([points for points, _ in solids]) @ T[:3, :3].T + T[:3, 3]
        self._slide = np.concatenate([np.tile(slide, (len(points), 1)) for points, slide in solids]) @ T[:3, :3].T

    def at(self, finger: float) -> Array:
        """(n, 3) [m] with each finger at this position [m]."""
        return np.asarray(self._closed + finger * self._slide)


def _balls(arrays: RobotArrays, solid: int) -> tuple[Array, float, int]:
    """Centres (n, 3) in its link's frame, radius and link of balls along the longest axis of a solid."""
    half = arrays.half[solid]
    longest = int(np.argmax(half))
    radius = float(arrays.radius[solid] + np.linalg.norm(np.delete(half, longest)))
    count = 2 + int(half[longest] / radius)
    along = np.linspace(-half[longest], half[longest], count)[:, None] * arrays.rotation[solid][:, longest]
    return arrays.position[solid] + along, radius, int(arrays.link[solid])


def _surface(arrays: RobotArrays, solid: int) -> Array:
    """(n, 3) Points on the box around a solid, in its link's frame."""
    half = arrays.half[solid] + arrays.radius[solid]
    steps = [np.linspace(-size, size, 1 + max(int(np.ceil(2 * size / _POINT_SPACING)), 1)) for size in half]
    grid = np.array(list(itertools.product(*steps)))
    on_surface = np.isclose(np.abs(grid), half).any(axis=1)
    return np.asarray(arrays.position[solid] + grid[on_surface] @ arrays.rotation[solid].T)


def _limited(vectors: Array, most: float) -> Array:
    """Vectors (k, 3) shortened to this length where they are longer."""
    lengths = np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-12)
    return vectors * np.minimum(1.0, most / lengths)
