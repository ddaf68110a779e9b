"""What the keyframe network learns from: situations of demonstrations, and the keyframes that belong to them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, fields
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from assets import RobotSpec
from clutter_env.learning.contacts.reading import Reading, planar_pose, wrapped
from clutter_env.learning.errors import DatasetError
from clutter_env.learning.keyframes.boards.cutting import cut_at_corners, is_driven
from clutter_env.learning.keyframes.configurations import nearest_home
from clutter_env.learning.keyframes.features import (
    POSTURE_JOINTS,
    contact_in_base,
    features,
    line_distance,
)
from clutter_env.learning.keyframes.motions import Motion
from clutter_env.learning.keyframes.phases import ELSEWHERE, LINES, TOWARDS, phase_index

__all__ = ["Examples", "examples_of", "posture_of"]

Array = NDArray[np.float64]

_AT_CONTACT = ("transit", *LINES, "close", "open")
"""Phases whose arm configuration is that of the contact or of a straight line from it: it moves with the contact."""
_TO_CONTACT = (*TOWARDS, "reach")
"""Phases at whose end the gripper is at the contact."""
_END_REPEATS = 5
"""Examples of the end of a straight line, where accuracy matters most, for one of every step on it."""


@dataclass(frozen=True, eq=False)
class Examples:
    """k situations and their keyframes.

    Attributes:
        features: (k, f) see `features.features`.
        phase: (k,) number of the phase.
        base: (k, 3) where the base is to stand, in its frame at the contact: x, y [m], yaw [rad]; 0 under a board.
        q: (k, 8) torso [m] and arm [rad], angles within a turn of home.
        finger: (k,) [m] position of one finger.
        length: (k,) [m] of the straight line, 0 in other phases.
        at_contact: (k,) whether the keyframe moves with the contact.
        is_under_board: whether the base drives in to the contacts.
    """

    features: Array
    phase: NDArray[np.int64]
    base: Array
    q: Array
    finger: Array
    length: Array
    at_contact: NDArray[np.bool_]
    is_under_board: bool = False

    def __len__(self) -> int:
        return len(self.q)


def examples_of(robot: RobotSpec, motions: Iterable[Motion]) -> Examples:
    """The examples of all phases that are learned.

    Where the base drives in under a board to one of the contacts, motions in the open are left out.

    Raises:
        DatasetError: there are none.
    """
    parts: list[Examples] = []
    every = list(motions)
    under = [motion for motion in every if is_driven(motion)]
    for motion in map(cut_at_corners, under) if under else every:
        posture = posture_of(robot, motion)
        for phase, steps in motion.runs():
            number = None if under and phase in ELSEWHERE else phase_index(motion.contact.skill, phase)
            if number is not None and posture is not None:
                parts.append(_of_phase(robot, motion, _Phase(phase, number, steps), posture, bool(under)))
    if not parts:
        raise DatasetError("the demonstrations show no contact; collect them with `clutter-env collect --canonical`")
    names = [entry.name for entry in fields(Examples) if entry.name != "is_under_board"]
    columns: dict[str, Any] = {name: np.concatenate([getattr(part, name) for part in parts]) for name in names}
    return Examples(**columns, is_under_board=bool(under))


class _Phase(NamedTuple):
    """Name and number of a phase, and its steps."""

    name: str
    number: int
    steps: slice


def posture_of(robot: RobotSpec, motion: Motion) -> Array | None:
    """(2,) torso [m] and upper-arm roll [rad] at the contact, less those of home; None if it was not reached."""
    ends = [motion.keyframes[steps.stop - 1] for phase, steps in motion.runs() if phase in _TO_CONTACT]
    if not ends:
        return None
    return _posture(robot, ends[-1][3:11])


def _posture(robot: RobotSpec, q: Array) -> Array:
    """(..., 2) of configurations (..., 8)."""
    joints = list(POSTURE_JOINTS)
    return np.asarray(nearest_home(robot, q)[..., joints] - np.array(robot.home)[joints])


def _of_phase(robot: RobotSpec, motion: Motion, part: _Phase, posture: Array, is_under_board: bool) -> Examples:
    """The keyframe of one phase; of a straight line of the arm also the configurations on the way."""
    phase, number, steps = part
    contact, keyframe = motion.contact, motion.keyframes[steps.stop - 1]
    base, q = keyframe[None, :3], keyframe[None, 3:11]
    distance, length = np.zeros(1), 0.0
    if phase in LINES:
        on_way = _at(motion.reading, steps)
        far = on_way if phase in TOWARDS else _at(motion.reading, slice(steps.stop, steps.stop + 1))
        length = float(line_distance(far, contact).max())
        last = np.zeros(1) if phase in TOWARDS else np.array([length])
        base = np.concatenate((on_way.base, np.repeat(base, _END_REPEATS, axis=0)))
        q = np.concatenate((on_way.q, np.repeat(q, _END_REPEATS, axis=0)))
        distance = np.concatenate((line_distance(on_way, contact), np.repeat(last, _END_REPEATS)))
    count = len(q)
    # On a line the base has arrived: the contact in its measured frame fits the measured configuration.
    # Under a board, all is told as from the base at the contact, and where else it stands is geometry.
    seen_from = np.broadcast_to(contact.base, base.shape) if phase == "drive" or is_under_board else base
    sizes = np.broadcast_to(motion.reading.sizes(motion.index)[0], (count, 4))
    return Examples(
        features=features(
            number,
            contact_in_base(contact.tcp, seen_from),
            sizes,
            distance,
            _posture(robot, q) if is_under_board else np.tile(posture, (count, 1)),
        ),
        phase=np.full(count, number),
        base=np.zeros((count, 3)) if is_under_board else _relative(base, contact.base),
        q=nearest_home(robot, q),
        finger=np.full(count, keyframe[11]),
        length=np.full(count, length),
        at_contact=np.full(count, phase in _AT_CONTACT),
    )


def _at(reading: Reading, steps: slice) -> Reading:
    """Some steps of a reading."""
    return Reading(**{entry.name: getattr(reading, entry.name)[steps] for entry in fields(Reading)})


def _relative(base: Array, origin: Array) -> Array:
    """(k, 3) bases in the frame of another one (3,)."""
    T = np.linalg.inv(planar_pose(origin))
    position = base[:, :2] @ T[:2, :2].T + T[:2, 3]
    return np.column_stack((position, wrapped(base[:, 2] - origin[2])))
