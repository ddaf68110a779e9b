"""Success of the retrieval task: has the target been lifted, and was everything else left alone?

What counts, for each object and since reset:

- fallen: it has toppled or left its support without being held. A lying cylinder has toppled when it stands up.
- disturbed: the path that it has moved while not in hand is longer than `DISTURBED_PATH`. The path is measured in
  chords of `CHORD`: a motion counts when it ends `CHORD` away from where the last chord ended. Jitter of an object at
  rest stays within one chord and never adds up; slow nudging does.
- cleared: it has been moved in hand by more than `DISTURBED_PATH` and put down, and has not fallen since.

An object is in hand while both fingers touch it, and until they have not for `RELEASE_STEPS` control steps in a row.
Once it is released, its path goes on from where it was last touched by both.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clutter_env.config import CONTROL_HZ
from clutter_env.errors import StateError
from clutter_env.scene.layout import TABLE_HEIGHT
from clutter_env.simulation.state_fields import read_dataclass
from clutter_env.simulation.world import Measurements, World

__all__ = [
    "CHORD",
    "DISTURBED_PATH",
    "HOLD_STEPS",
    "LIFT_HEIGHT",
    "RELEASE_STEPS",
    "Judge",
    "JudgeMemory",
    "is_as_placed",
    "read_memory",
    "written_memory",
]

LIFT_HEIGHT = 0.10
"""[m] above what it stood on at which the target's lowest point counts as lifted."""
HOLD_TIME = 0.5
"""[s] for which it must stay there, held."""
HOLD_STEPS = round(HOLD_TIME * CONTROL_HZ)

DISTURBED_PATH = 0.05
"""[m] An object that has moved farther while not in hand is disturbed."""
CHORD = 0.005
"""[m] Length of the chords in which a path is measured; far above the jitter and creep of objects at rest."""
RELEASE_STEPS = 2
"""Control steps without contact of both fingers after which an object is released; a single one is contact noise."""

UPRIGHT = 0.9
"""Cosine of the largest tilt of an object that still is as it was placed."""

Array = NDArray[np.float64]


@dataclass(frozen=True)
class JudgeMemory:
    """What a judge remembers of the past, for saved states.

    Attributes:
        chord_starts: (n, 3) [m] where the last chord of each object ended.
        paths: (n,) [m] lengths of the chords of each object.
        is_fallen: (n,) whether each object has fallen since reset.
        is_cleared: (n,) whether each object has been carried and put down.
        in_hand: slot of the object in hand, -1 without one.
        steps_without_contact: control steps since both fingers touched it.
        grasped_at: (3,) [m] where it was grasped.
        steps_held: control steps in a row with the target held and lifted.
        other_hands: for each further gripper that acts, `in_hand`, `steps_without_contact` and `grasped_at`.
    """

    chord_starts: tuple[tuple[float, ...], ...]
    paths: tuple[float, ...]
    is_fallen: tuple[bool, ...]
    is_cleared: tuple[bool, ...]
    in_hand: int
    steps_without_contact: int
    grasped_at: tuple[float, ...]
    steps_held: int
    other_hands: tuple[tuple[float, ...], ...] = ()

    def check(self, num_objects: int) -> None:
        """Raise StateError unless the memory is one of so many objects."""
        sizes = {len(self.chord_starts), len(self.paths), len(self.is_fallen), len(self.is_cleared)}
        is_of_points = all(len(point) == 3 for point in (*self.chord_starts, self.grasped_at))
        are_hands = all(len(hand) == 5 and -1 <= hand[0] < num_objects for hand in self.other_hands)
        if sizes != {num_objects} or not is_of_points or not are_hands or not -1 <= self.in_hand < num_objects:
            raise StateError(f"the judge's memory in the state is not one of {num_objects} objects")


def written_memory(memory: JudgeMemory) -> dict[str, Any]:
    """The memory as JSON values; that of a robot with one arm has no entry for others."""
    values = asdict(memory)
    if not memory.other_hands:
        del values["other_hands"]
    return values


def read_memory(value: Any) -> JudgeMemory:
    """The memory that `written_memory` wrote; raises StateError if it is not valid."""
    is_of_one_arm = isinstance(value, dict) and "other_hands" not in value
    return read_dataclass(JudgeMemory, {**value, "other_hands": []} if is_of_one_arm else value, "judge")


@dataclass
class _Hand:
    """A gripper over time: the slot of the object in hand, -1 without one, and what `JudgeMemory` says of it."""

    in_hand: int = -1
    steps_without_contact: int = 0
    grasped_at: Array = field(default_factory=lambda: np.zeros(3))


class Judge:
    """Follows the objects of one episode, from its first state on; call `update` after every control step.

    Attributes:
        lift: [m] height of the target's lowest point above what it stood on at reset; 0 without a target.
        is_target_held: whether both fingers touch the target.
        is_target_lost: whether the target is below the table top.
        steps_held: control steps in a row with the target held and lifted.
        num_fallen: number of objects that have fallen since reset.
        num_disturbed: number of objects that have been disturbed since reset.
        num_cleared: number of objects that have been cleared since reset, the target not counted.
        newly_disturbed: number of objects that were disturbed or fell in the last control step and never before.
    """

    def __init__(self, world: World, measurements: Measurements, target: int) -> None:
        """Begin with the first state of an episode; `target` is the target's slot, -1 without one."""
        count = len(measurements.poses)
        self._world, self._target = world, target
        self._chord_starts: Array = measurements.poses[:, :3].copy()
        self._paths: Array = np.zeros(count)
        self._is_fallen = np.zeros(count, dtype=np.bool_)
        self._is_cleared = np.zeros(count, dtype=np.bool_)
        self._hands = [_Hand() for _ in measurements.all_held]
        self.steps_held = 0
        self._last: Measurements | None = None
        self._derive()
        self._follow_target(measurements)

    @property
    def lifted(self) -> bool:
        """The target has been held high enough for long enough."""
        return self.steps_held >= HOLD_STEPS

    @property
    def is_clean(self) -> bool:
        """No object has fallen or been disturbed since reset."""
        return not self._num_spoilt

    def update(self, measurements: Measurements) -> None:
        """Take into account what was measured after one more control step.

        The same measurements once more, with nothing in hand, change nothing.
        """
        if measurements is self._last and not self._in_hand:
            self.newly_disturbed = 0
            return
        self._last = measurements
        before = self._num_spoilt
        positions = measurements.poses[:, :3]
        for hand, held in zip(self._hands, measurements.all_held, strict=True):
            self._follow_gripper(hand, held, positions)
        offsets = positions - self._chord_starts
        offsets *= offsets
        squared = offsets[:, 0] + offsets[:, 1] + offsets[:, 2]
        is_chord = squared > self._chord_squared
        for slot in self._in_hand:
            is_chord[slot] = False
        if np.count_nonzero(is_chord):
            self._paths[is_chord] += np.sqrt(squared[is_chord])
            self._chord_starts[is_chord] = positions[is_chord]
            self._derive()
        if np.count_nonzero(measurements.is_fallen):
            self._note_falls(measurements.is_fallen)
        self.newly_disturbed = self._num_spoilt - before
        self._follow_target(measurements)
        self.steps_held = self.steps_held + 1 if self.is_target_held and self.lift >= LIFT_HEIGHT else 0

    def memory(self) -> JudgeMemory:
        """What has to be kept of the past."""
        return JudgeMemory(
            chord_starts=tuple(map(tuple, self._chord_starts.tolist())),
            paths=tuple(self._paths.tolist()),
            is_fallen=tuple(self._is_fallen.tolist()),
            is_cleared=tuple(self._is_cleared.tolist()),
            in_hand=self._hands[0].in_hand,
            steps_without_contact=self._hands[0].steps_without_contact,
            grasped_at=tuple(self._hands[0].grasped_at.tolist()),
            steps_held=self.steps_held,
            other_hands=tuple(
                (float(hand.in_hand), float(hand.steps_without_contact), *hand.grasped_at.tolist())
                for hand in self._hands[1:]
            ),
        )

    @classmethod
    def recall(cls, memory: JudgeMemory, world: World, measurements: Measurements, target: int) -> Judge:
        """The judge that had this `memory` in the state of `world`, bit for bit."""
        judge = cls(world, measurements, target)
        count = len(measurements.poses)
        judge._chord_starts = np.array(memory.chord_starts, dtype=np.float64).reshape(count, 3)
        judge._paths = np.array(memory.paths, dtype=np.float64)
        judge._is_fallen = np.array(memory.is_fallen, dtype=np.bool_)
        judge._is_cleared = np.array(memory.is_cleared, dtype=np.bool_)
        others = [_Hand(int(hand[0]), int(hand[1]), np.array(hand[2:])) for hand in memory.other_hands]
        first = _Hand(memory.in_hand, memory.steps_without_contact, np.array(memory.grasped_at, dtype=np.float64))
        judge._hands = [first, *others]
        judge.steps_held = memory.steps_held
        judge._derive()
        return judge

    @property
    def _in_hand(self) -> list[int]:
        """Slots of the objects in hand."""
        return [hand.in_hand for hand in self._hands if hand.in_hand >= 0]

    def _follow_gripper(self, hand: _Hand, held: int, positions: Array) -> None:
        """Begin or end the time in which an object is in hand; its motion until the last contact is not counted."""
        if held >= 0:
            if held != hand.in_hand:
                self._release(hand)
                hand.in_hand, hand.grasped_at = held, positions[held].copy()
            hand.steps_without_contact = 0
            self._chord_starts[held] = positions[held]
        elif hand.in_hand >= 0:
            hand.steps_without_contact += 1
            if hand.steps_without_contact >= RELEASE_STEPS:
                self._release(hand)

    def _release(self, hand: _Hand) -> None:
        """The object in a hand, if there is one, is put down; its path continues from where contact was lost."""
        if hand.in_hand < 0:
            return
        x, y, z = (float(value) for value in self._chord_starts[hand.in_hand] - hand.grasped_at)
        if math.sqrt(x * x + y * y + z * z) > DISTURBED_PATH:
            self._is_cleared[hand.in_hand] = True
        hand.in_hand, hand.steps_without_contact = -1, 0
        self._derive()

    def _note_falls(self, is_fallen: NDArray[np.bool_]) -> None:
        """Keep in mind which objects lie or have left their support; not the one in hand."""
        fallen = is_fallen & ~self._is_fallen
        for slot in self._in_hand:
            fallen[slot] = False
        if np.count_nonzero(fallen):
            self._is_fallen |= fallen
            self._derive()

    def _follow_target(self, measurements: Measurements) -> None:
        """Measure the target."""
        target = self._target
        self.is_target_held = target >= 0 and target in measurements.all_held
        self.is_target_lost = target >= 0 and bool(measurements.is_off[target])
        self.lift = self._world.lowest_point(measurements, target) - self._support_height() if target >= 0 else 0.0

    def _support_height(self) -> float:
        """[m] of the surface on which the target stood at reset."""
        assert self._world.scene is not None
        return float(TABLE_HEIGHT + self._world.scene.levels[self._target])

    def _derive(self) -> None:
        """What follows from paths and falls: the counts, and the square (n,) [m²] of the motion that ends a chord.

        The last chord of a path ends at `DISTURBED_PATH`; the paths of disturbed objects are not followed.
        """
        is_disturbed = self._paths > DISTURBED_PATH
        chords = np.minimum(CHORD, np.maximum(DISTURBED_PATH - self._paths, 0.0))
        self._chord_squared: Array = np.where(is_disturbed, np.inf, chords * chords)
        self.num_disturbed = int(np.count_nonzero(is_disturbed))
        self.num_fallen = int(np.count_nonzero(self._is_fallen))
        is_cleared = self._is_cleared & ~self._is_fallen
        is_cleared[self._target : self._target + 1] = False  # an empty slice without a target
        self.num_cleared = int(np.count_nonzero(is_cleared))
        self._num_spoilt = int(np.count_nonzero(is_disturbed | self._is_fallen))
        self.newly_disturbed = 0


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
