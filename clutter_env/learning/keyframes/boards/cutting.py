"""Motions under a board: the planner's straight lines there are drives of the base, cut at their corners into phases.

The base comes from outside with the arm rigid, straight in ("enter"), then along the gripper to the contact ("reach").
On the way out it goes back along the gripper ("back") and straight out ("leave"); see `planners.scene.cover.drive_out`.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from clutter_env.learning.keyframes.motions import Motion
from clutter_env.learning.keyframes.phases import LINES, TOWARDS
from planners import BACK, heading

__all__ = ["cut_at_corners", "is_driven"]

Array = NDArray[np.float64]

_MOVED = 0.005
"""[m] from the contact's base pose from which on the base is on a drive: a measured base is not exact."""
_RIGID = 0.02
"""[m], [rad] by which torso and arm move at most on a drive with the arm rigid: measured ones are not exact."""


def is_driven(motion: Motion) -> bool:
    """Whether the base drives on the straight lines of a motion with the arm rigid: there is a board above the contact.

    In the open, plans that are not canonical begin a line while the base still drives, and the arm moves meanwhile.
    """
    return any(_rigid_drive(motion, steps) > BACK for phase, steps in motion.runs() if phase in LINES)


def cut_at_corners(motion: Motion) -> Motion:
    """The motion with the phases of `phases.BOARD_PHASES`, and keyframes at the corners of its drives."""
    phases, keyframes = list(motion.phases), np.array(motion.keyframes)
    before = keyframes[0]
    for phase, steps in motion.runs():
        end = motion.keyframes[steps.stop - 1]
        if phase in LINES:
            # The arm is rigid as it was when the drive in began, or as it is when the drive out ends.
            rigid = before if phase in TOWARDS else end
            names = _names(phase)
            for step, distance in zip(range(steps.start, steps.stop), _distance(motion, steps), strict=True):
                which = 0 if distance > BACK + _MOVED else 1 if distance > _MOVED else 2
                phases[step] = names[which]
                keyframes[step] = _keyframe(motion, names[which], rigid, end)
        before = end
    return replace(motion, phases=tuple(phases), keyframes=keyframes)


def _names(phase: str) -> tuple[str, str, str]:
    """Names of a line's parts: the base outside, around the contact, and at it."""
    if phase == "approach":
        return "enter", "reach", "reach"
    if phase == "lower":
        return "enter", "reach", "lower"
    return "leave", "back", "lift" if phase == "lift" else "back"


def _keyframe(motion: Motion, name: str, rigid: Array, end: Array) -> Array:
    """(12,) The end of a part, with the arm of `rigid` on drives."""
    if name in ("leave", "lower"):
        return end
    keyframe = np.array(rigid)
    keyframe[:3] = motion.contact.base
    if name in ("enter", "back"):
        keyframe[:2] -= BACK * heading(motion.contact.tcp)
    return keyframe


def _rigid_drive(motion: Motion, steps: slice) -> float:
    """[m] by which the base comes nearer to where it stands at the contact, with the arm as at the farthest point."""
    distance, q = _distance(motion, steps), motion.reading.q[steps]
    is_rigid = np.abs(q - q[distance.argmax()]).max(axis=1) < _RIGID
    return float(np.ptp(distance[is_rigid]))


def _distance(motion: Motion, steps: slice) -> Array:
    """(n,) [m] of the base from where it stands at the contact."""
    return np.asarray(np.linalg.norm(motion.reading.base[steps, :2] - motion.contact.base[:2], axis=1))
