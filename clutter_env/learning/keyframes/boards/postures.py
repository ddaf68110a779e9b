"""Which posture of the arm at a contact under a board: one like the demonstrated ones that keeps clear."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from assets import RobotSpec
from clutter_env.learning.contacts.reading import Reading, planar_pose
from clutter_env.learning.keyframes.boards.arm_balls import ArmBalls
from clutter_env.learning.keyframes.boards.arm_line import ArmLine
from clutter_env.learning.keyframes.boards.gripper_points import GripperPoints
from clutter_env.learning.keyframes.boards.shown_postures import nearest_postures
from clutter_env.learning.keyframes.boards.stations import table_of, way_points
from clutter_env.learning.keyframes.boards.surroundings import Surroundings
from clutter_env.learning.keyframes.configurations import is_wrist_turned, with_wrist_turned
from clutter_env.learning.keyframes.features import contact_in_base
from clutter_env.learning.keyframes.network import KeyframeNetwork
from clutter_env.scene.layout import Layout
from planners import Contact

__all__ = ["BoardPosture", "BoardPostures"]

Array = NDArray[np.float64]

_GRID = np.array(
    [(torso, roll) for torso in (0.05, 0.0, -0.05, -0.1, -0.15) for roll in np.radians(range(-60, 61, 15))]
)
"""Torsos [m] and rolls of the upper arm [rad] from home that are offered besides the demonstrated ones."""
_STRANGE = 0.5
"""Cost of a posture that is not one of the nearest demonstrated ones."""
_UNLIKE_COST = 0.2
"""Cost for each unit by which the contact where a posture was demonstrated differs."""
_TURNED_COST = 0.3
"""Cost of a wrist that is bent the other way than at home: one demonstrated pick in ten, deep under the board."""
_KEPT = 12
"""Postures at the contact for which ways to lift are compared."""
_LIFTS = (
    (0.12, 0.12, 0.0),
    (0.12, 0.01, 0.1),
    (0.03, 0.03, 0.2),
    (0.07, 0.07, 0.2),
    (0.07, 0.01, 0.3),
    (0.03, 0.0, 0.3),
)
"""Heights [m] to which the gripper is lifted, how much the torso does of it [m], and the costs; demonstrated first."""
_ROUNDS = 6
"""Rounds of correction by forward kinematics."""
_ROOM, _LEAST_ROOM = 0.02, 0.004
"""[m] of free space about the arm that is enough, and below which it is likely to touch; the wrist behind a level
gripper that reaches down to the table has no more than 9 mm."""
_MISS_COST, _ROOM_COST, _HIT_COST = 60.0, 20.0, 300.0
"""Costs of a metre by which the gripper misses its pose, and of a metre that is missing to either free space about a
ball of the arm."""
_MOST_RISK = 6.0
"""Risk up to which an arm is expected to get through."""


class BoardPosture(NamedTuple):
    """How the arm is held at a contact and above it.

    Attributes:
        height: [m] above the contact at which the object is driven in or out.
        low, high: (2,) torso [m] and upper-arm roll [rad] at the contact and at that height, less those of home.
        is_turned: whether the wrist is bent the other way than at home.
        risk: cost of free space that is missing about the arm on the way, summed over its balls.
        is_blocked: whether the arm or the open gripper would run into something for certain.
    """

    height: float
    low: Array
    high: Array
    is_turned: bool
    risk: float
    is_blocked: bool = False

    def at(self, height: float) -> Array:
        """(2,) at a height [m] above the contact."""
        share = min(max(height / self.height, 0.0), 1.0)
        return np.asarray((1 - share) * self.low + share * self.high)


class _Scene(NamedTuple):
    """A contact, the size (4,) of its object, what stands about it, and the base's way (w, 3) [m] out from there."""

    contact: Contact
    sizes: Array
    around: Surroundings
    way: Array


class BoardPostures:
    """Chooses among postures by what a network and the robot's kinematics predict for each of them.

    The arm is compared with furniture and objects along the whole way of the base, rigid as it is at the contact and
    rigid as it is when it has lifted: one of them goes in, the other out.
    """

    def __init__(self, network: KeyframeNetwork, robot: RobotSpec, layout: Layout) -> None:
        self._shown = network.shown.numpy().astype(float)
        self._line, self._balls = ArmLine(network, robot), ArmBalls(robot)
        self._gripper = GripperPoints(robot)
        self._robot, self._layout, self._table = robot, layout, table_of(layout)

    def choose(self, contact: Contact, index: int, reading: Reading, finger: float = 0.0) -> BoardPosture:
        """The posture at a contact of object `index`: the best that keeps clear, or the one with the least risk.

        The open gripper has each finger at `finger` [m].
        """
        shown, away = nearest_postures(self._shown, contact)
        plain = np.concatenate((_UNLIKE_COST * away, np.full(len(_GRID), away[0] * _UNLIKE_COST + _STRANGE)))
        forms = self._forms(contact, reading)
        low, turned = np.tile(np.concatenate((shown, _GRID)), (len(forms), 1)), np.repeat(forms, len(plain))
        cost = np.tile(plain, len(forms)) + _TURNED_COST * turned
        way = np.pad(way_points(self._table, contact), ((0, 0), (0, 1)))
        scene = _Scene(contact, reading.sizes(index), Surroundings.of(self._layout, reading, index), way)
        risk, miss = self._judge(scene, np.zeros(len(low)), low, turned)
        best = np.argsort(cost + risk + _MISS_COST * miss, kind="stable")[:_KEPT]
        row, lift = (axis.ravel() for axis in np.meshgrid(best, np.arange(len(_LIFTS)), indexing="ij"))
        height, torso, dear = np.array(_LIFTS)[lift].T
        high = low[row] + np.column_stack((torso, np.zeros(len(row))))
        also_risk, also_miss = self._judge(scene, height, high, turned[row])
        risks = risk[row] + also_risk
        found = int(np.argmin(cost[row] + dear + risks + _MISS_COST * (miss[row] + also_miss)))
        of = row[found]
        is_blocked = risks[found] > _MOST_RISK or self._is_gripper_blocked(scene, finger)
        return BoardPosture(
            float(height[found]), low[of], high[found], bool(turned[of]), float(risks[found]), bool(is_blocked)
        )

    def _is_gripper_blocked(self, scene: _Scene, finger: float) -> bool:
        """Whether the open gripper runs into something on its way: in to a pick, out from a placement."""
        tcp = scene.contact.tcp
        points = self._gripper.at(finger) @ tcp[:3, :3].T + tcp[:3, 3]
        return scene.around.contain(points + scene.way[:, None])

    def _forms(self, contact: Contact, reading: Reading) -> tuple[bool, ...]:
        """Which ways the wrist may be bent, as `BoardPosture.is_turned`: with an object in the gripper as it is now."""
        return (False, True) if contact.skill == "pick" else (is_wrist_turned(self._robot, reading.q),)

    def _judge(self, scene: _Scene, heights: Array, postures: Array, turned: NDArray[np.bool_]) -> tuple[Array, Array]:
        """Risk on the way, and the gripper's error [m], of arms (k,) at heights [m] above the contact."""
        contact, base = scene.contact, np.array(scene.contact.base)
        base_tcp = contact_in_base(contact.tcp, base)
        q, miss = self._line.at(contact.skill, base_tcp, scene.sizes, heights, postures, _ROUNDS)
        q[turned] = with_wrist_turned(self._robot, q[turned])
        T = planar_pose(base)
        centres = self._balls.centres(q) @ T[:3, :3].T + T[:3, 3]
        room = scene.around.distance(centres[:, :, None] + scene.way).min(axis=2) - self._balls.radius
        costs = _ROOM_COST * np.maximum(_ROOM - room, 0.0) + _HIT_COST * np.maximum(_LEAST_ROOM - room, 0.0)
        return costs.sum(axis=1), miss
