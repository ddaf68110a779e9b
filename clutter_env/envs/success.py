"""Success of the retrieval task: has the target been lifted, and was everything else left alone?

An object may travel only in the air, in the gripper. It is held while both fingers press on it from opposite sides and
can carry it. It is carried while it is held, nothing else bears it, and nothing lies on it, in any part of the control
step. It may brush against its neighbours. The events, for each object and since reset:

- fallen: it has toppled and is not held, or has left its support and is not carried. A lying cylinder has toppled when
  it stands up.
- disturbed: the path that it has moved while not carried is longer than `DISTURBED_PATH`. The path is measured in
  chords: a motion is added when it ends one chord away from where the last chord ended. Jitter of an object at rest
  stays within one `CHORD` and never adds up, slow nudging does. Chords of what the robot moves are `FINE_CHORD` long. A
  chord that has begun counts as it is when the object is lifted, and the next one begins where it was last carried.
- cleared: it has been held, moved by more than `DISTURBED_PATH` and put down, and has neither fallen nor been
  disturbed.

The path of an object in a drawer is measured in the drawer's frame, because it moves with the drawer.

The paths of all objects together, except those that have to move for the goal, have the limit `TOTAL_PATH`. Neither
may the robot, or objects it moves, press hard on the furniture, the robot or the ground, see `simulation.pressing`.
"""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clutter_env.config import CONTROL_HZ
from clutter_env.errors import StateError
from clutter_env.scene.layout import TABLE_HEIGHT
from clutter_env.simulation.pressing import is_gentle
from clutter_env.simulation.saved_state import Fields
from clutter_env.simulation.world import Measurements, World

LIFT_HEIGHT = 0.10
"""[m] Height of the target's lowest point above its support from which it is regarded as lifted."""
HOLD_TIME = 0.5
"""[s] Time for which it must stay at this height, held."""
HOLD_STEPS = round(HOLD_TIME * CONTROL_HZ)

OPENED_SHARE = 0.8
"""Share of its range from which a drawer or a door is regarded as open."""

DISTURBED_PATH = 0.05
"""[m] An object that has moved farther while not in hand is disturbed."""
TOTAL_PATH = 0.10
"""[m] Sum of the paths of all objects that need not move for the goal, at most: a row of them is not shoved aside."""
CHORD, FINE_CHORD = 0.005, 0.0005
"""[m] Length of the chords in which a path is measured. The first is far above the jitter and creep of objects at rest.
The second is for an object that the robot touches, itself or through others, because moving to and fro within a longer
chord would not be measured."""
RELEASE_STEPS = 2
"""Control steps without being held after which an object is put down. A single step is contact noise."""

UPRIGHT = 0.9
"""Cosine of the largest tilt of an object that still is as it was placed."""
_MOST_STEPS = 2**31

Array = NDArray[np.float64]


@dataclass
class _Hand:
    """State of a gripper: slot of its object, -1 without one, control steps since it was held, and its positions (3,)
    [m] when it was grasped and when it was last held."""

    in_hand: int = -1
    steps_not_held: int = 0
    grasped_at: Array = field(default_factory=lambda: np.zeros(3))
    last_at: Array = field(default_factory=lambda: np.zeros(3))


class SuccessMonitor:
    """Monitors the objects of one episode, from its first state on. Call `update` after every control step.

    Attributes:
        lift: [m] height of the target's lowest point above its support at reset, 0 without a target.
        is_target_carried: whether the target is held and touches nothing but the gripper.
        is_target_lost: whether the target is below the table top.
        steps_held: consecutive control steps with the target carried and lifted.
        num_fallen: number of objects that have fallen since reset.
        num_disturbed: number of objects that have been disturbed since reset.
        num_cleared: number of objects that have been cleared since reset, without the target.
        newly_disturbed: number of objects that were disturbed or fell in the last control step and never before.
        named: slots of the objects that have to move for the goal. Their paths are no part of `total_path`.
    """

    def __init__(self, world: World, measurements: Measurements, target: int) -> None:
        """Begin with the first state of an episode. `target` is the target's slot, -1 without one."""
        count = len(measurements.poses)
        self._world, self._target = world, target
        self.named: Collection[int] = {target} - {-1}
        self._drawers_at = world.drawer_shifts
        self._chord_starts: Array = measurements.poses[:, :3].copy()
        self._paths: Array = np.zeros(count)
        self._is_fallen = np.zeros(count, dtype=np.bool_)
        self._is_cleared = np.zeros(count, dtype=np.bool_)
        self._hands = [_Hand() for _ in measurements.grip.held]
        self.steps_held = 0
        self._last = measurements
        self._derive()
        self._follow_target(measurements)

    @property
    def lifted(self) -> bool:
        """The target has been held high enough for long enough."""
        return self.steps_held >= HOLD_STEPS

    @property
    def is_clean(self) -> bool:
        """Nothing has fallen or been disturbed since reset, nor has the robot pressed hard on furniture or itself."""
        return not self._num_spoilt and self.total_path <= TOTAL_PATH and self.is_gentle

    @property
    def is_gentle(self) -> bool:
        """The robot has not pressed hard on furniture, on itself or on the ground."""
        return is_gentle(self._world.on_furniture, self._world.on_itself)

    @property
    def total_path(self) -> float:
        """[m] Sum of the paths of the objects that need not move for the goal, while they were not carried."""
        paths = self._paths.tolist()
        return math.fsum(path for slot, path in enumerate(paths) if slot not in self.named) if any(paths) else 0.0

    def update(self, measurements: Measurements) -> None:
        """Process the measurements after one more control step.

        The same measurements once more, with nothing in hand, change nothing.
        """
        last, self._last = self._last, measurements
        is_riding = self._ride(measurements)
        if measurements is last and not is_riding and not any(hand.steps_not_held for hand in self._hands):
            self.newly_disturbed = 0
            return
        before = self._num_spoilt
        positions, carried = measurements.poses[:, :3], measurements.grip.carried
        for hand, held in zip(self._hands, measurements.grip.held, strict=True):
            self._follow_gripper(hand, held, positions)
        offsets = positions - self._chord_starts
        offsets *= offsets
        squared = offsets[:, 0] + offsets[:, 1] + offsets[:, 2]
        longest = self._chord_squared
        if measurements.moved:
            longest = longest.copy()
            moved = list(measurements.moved)
            longest[moved] = np.where(np.isinf(longest[moved]), np.inf, np.minimum(longest[moved], FINE_CHORD**2))
        is_chord = squared > longest
        for slot in carried:
            is_chord[slot] = slot not in last.grip.carried and squared[slot] > 0
        if np.count_nonzero(is_chord):
            self._paths[is_chord] += np.sqrt(squared[is_chord])
            self._chord_starts[is_chord] = positions[is_chord]
            self._derive()
        for slot in carried:
            self._chord_starts[slot] = positions[slot]
        if np.count_nonzero(measurements.is_fallen & ~self._is_fallen):
            self._is_fallen |= measurements.is_fallen
            self._derive()
        self.newly_disturbed = self._num_spoilt - before
        self._follow_target(measurements)
        self.steps_held = self.steps_held + 1 if self.is_target_carried and self.lift >= LIFT_HEIGHT else 0

    def _ride(self, measurements: Measurements) -> bool:
        """Move the chords of objects in a drawer along with it. Return whether a drawer has moved."""
        before, self._drawers_at = self._drawers_at, self._world.drawer_shifts
        if before == self._drawers_at:
            return False
        for number, (old, new) in enumerate(zip(before, self._drawers_at, strict=True)):
            if old != new:
                self._chord_starts[self._world.are_in_drawer(measurements, number), 0] += new - old
        return True

    def memory(self) -> dict[str, Any]:
        """The past that a saved state must keep, as JSON values."""
        return {
            "chord_starts": self._chord_starts.tolist(),
            "paths": self._paths.tolist(),
            "is_fallen": self._is_fallen.tolist(),
            "is_cleared": self._is_cleared.tolist(),
            "hands": [
                [float(hand.in_hand), float(hand.steps_not_held), *hand.grasped_at.tolist(), *hand.last_at.tolist()]
                for hand in self._hands
            ],
            "steps_held": self.steps_held,
        }

    @classmethod
    def recall(cls, memory: dict[str, Any], world: World, measurements: Measurements, target: int) -> SuccessMonitor:
        """The monitor that had this checked `memory` in the state of `world`, bit for bit."""
        monitor = cls(world, measurements, target)
        monitor._chord_starts, monitor._paths = memory["chord_starts"], memory["paths"]
        monitor._is_fallen, monitor._is_cleared = memory["is_fallen"], memory["is_cleared"]
        monitor._hands = memory["hands"]
        monitor.steps_held = memory["steps_held"]
        monitor._derive()
        return monitor

    def _follow_gripper(self, hand: _Hand, held: int, positions: Array) -> None:
        """Begin or end the time in which an object is in hand."""
        if held >= 0:
            if held != hand.in_hand:
                self._put_down(hand)
                hand.in_hand, hand.grasped_at = held, positions[held].copy()
            hand.steps_not_held, hand.last_at = 0, positions[held].copy()
        elif hand.in_hand >= 0:
            hand.steps_not_held += 1
            if hand.steps_not_held >= RELEASE_STEPS:
                self._put_down(hand)

    def _put_down(self, hand: _Hand) -> None:
        """The object in a hand, if there is one, is put down."""
        if hand.in_hand >= 0 and math.dist(hand.last_at, hand.grasped_at) > DISTURBED_PATH:
            self._is_cleared[hand.in_hand] = True
        hand.in_hand, hand.steps_not_held = -1, 0
        self._derive()

    def _follow_target(self, measurements: Measurements) -> None:
        target = self._target
        self.is_target_carried = self.is_target_lost = False
        self.lift = 0.0
        if target >= 0:
            self.is_target_carried = target in measurements.grip.carried
            self.is_target_lost = bool(measurements.is_off[target])
            support = float(TABLE_HEIGHT + self._world.scene.levels[target])  # on which it stood at reset
            self.lift = self._world.lowest_point(measurements, target) - support

    def _derive(self) -> None:
        """Derive the counts from paths and falls, and the square (n,) [m²] of the motion that ends a chord.

        The last chord of a path ends at `DISTURBED_PATH`. The paths of disturbed objects are not followed.
        """
        is_disturbed = self._paths > DISTURBED_PATH
        chords = np.minimum(CHORD, np.maximum(DISTURBED_PATH - self._paths, 0.0))
        self._chord_squared: Array = np.where(is_disturbed, np.inf, chords * chords)
        self.num_disturbed = int(np.count_nonzero(is_disturbed))
        self.num_fallen = int(np.count_nonzero(self._is_fallen))
        is_cleared = self._is_cleared & ~self._is_fallen & ~is_disturbed
        is_cleared[self._target : self._target + 1] = False  # an empty slice without a target
        self.num_cleared = int(np.count_nonzero(is_cleared))
        self._num_spoilt = int(np.count_nonzero(is_disturbed | self._is_fallen))
        self.newly_disturbed = 0


def checked_memory(value: object, num_objects: int, num_grippers: int) -> dict[str, Any]:
    """Arrays for `SuccessMonitor.recall` from the value of `SuccessMonitor.memory`.

    Raises:
        StateError: it is not the memory of so many objects and grippers.
    """
    read = Fields(value, "monitor", ("chord_starts", "paths", "is_fallen", "is_cleared", "hands", "steps_held"))
    hands = read.numbers("hands", (num_grippers, 8))
    slots, steps = hands[:, :2].T
    if not (np.isin(slots, range(-1, num_objects)) & np.isin(steps, range(RELEASE_STEPS))).all():
        raise StateError(
            f"monitor: hands of the state must hold slots of {num_objects} objects, or -1, "
            f"and be without them for less than {RELEASE_STEPS} steps"
        )
    return {
        "chord_starts": read.numbers("chord_starts", (num_objects, 3)),
        "paths": read.numbers("paths", (num_objects,), 0.0),
        "is_fallen": read.flags("is_fallen", num_objects),
        "is_cleared": read.flags("is_cleared", num_objects),
        "hands": [_Hand(int(row[0]), int(row[1]), row[2:5], row[5:]) for row in hands],
        "steps_held": read.integer("steps_held", 0, _MOST_STEPS),
    }


def is_as_placed(quaternion: ArrayLike, bottom: float, is_lying: bool) -> bool:
    """Whether an object stands, or lies if it was placed so, on the table or is held above it.

    Args:
        quaternion: (4,) w, x, y, z of its pose.
        bottom: [m] height of its lowest point.
        is_lying: whether it was placed lying.
    """
    _, x, y, _ = np.asarray(quaternion)
    up = 1 - 2 * (x * x + y * y)
    is_tilted = abs(up) > math.sqrt(1 - UPRIGHT**2) if is_lying else up <= UPRIGHT
    return bool(not is_tilted and bottom > TABLE_HEIGHT - 0.02)
