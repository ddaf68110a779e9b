"""What each step of an episode is part of: phase, contact and keyframe, as columns."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from planners import StepLabel

__all__ = ["CONTACT_SKILLS", "StepLabels"]

CONTACT_SKILLS = ("", "pick", "place")
"""What the numbers of `StepLabels.skill` stand for."""
_KEYFRAME = 12
"""Numbers of a keyframe: base (3), torso and arm (8), finger position."""


@dataclass(frozen=True, eq=False)
class StepLabels:
    """The labels of T steps, one row each. Without a contact numbers are NaN and indices -1.

    Attributes:
        phases: names (T) of the phase of the motion, "" while the robot waits; see `planners.StepLabel`.
        skill: (T,) index into `CONTACT_SKILLS`: of the contact that the phase leads to or comes from.
        object: (T,) index of the object of the contact, as in the observation.
        contact_base: (T, 3) x [m], y [m], yaw [rad] of the base at the contact, in the world.
        contact_tcp: (T, 4, 4) TCP pose at the contact, in the world.
        keyframe: (T, 12) base, torso and arm [m, rad], finger position [m] at the end of the phase; NaN for experts
            that have no plan.
    """

    phases: tuple[str, ...]
    skill: NDArray[np.int64]
    object: NDArray[np.int64]
    contact_base: NDArray[np.float64]
    contact_tcp: NDArray[np.float64]
    keyframe: NDArray[np.float64]

    @classmethod
    def of(cls, labels: Sequence[StepLabel | None], objects: Sequence[str], size: int = _KEYFRAME) -> StepLabels:
        """The labels of an expert's steps; None where it has none.

        Args:
            labels: of each step.
            objects: names of the objects, in the order of the observation.
            size: numbers of a keyframe.
        """
        steps, contacts = len(labels), [None if label is None else label.contact for label in labels]
        found = cls(
            tuple("" if label is None else label.phase for label in labels),
            np.zeros(steps, np.int64),
            np.full(steps, -1, np.int64),
            np.full((steps, 3), np.nan),
            np.full((steps, 4, 4), np.nan),
            np.full((steps, size), np.nan),
        )
        for step, (label, contact) in enumerate(zip(labels, contacts, strict=True)):
            if label is not None:
                found.keyframe[step] = label.keyframe
            if contact is not None:
                found.skill[step] = CONTACT_SKILLS.index(contact.skill)
                found.object[step] = objects.index(contact.object)
                found.contact_base[step], found.contact_tcp[step] = contact.base, contact.tcp
        return found

    def __len__(self) -> int:
        return len(self.phases)
