"""Postures under a board: those of the nearest demonstrated contacts, since a board leaves few."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from assets import RobotSpec
from clutter_env.learning.contacts.reading import wrapped
from clutter_env.learning.keyframes.boards.cutting import cut_at_corners
from clutter_env.learning.keyframes.examples import posture_of
from clutter_env.learning.keyframes.motions import Motion
from clutter_env.learning.keyframes.phases import SKILLS
from planners import Contact

__all__ = ["nearest_postures", "shown_postures"]

Array = NDArray[np.float64]

_KEY = np.array((0.01, 0.05, 0.2, 0.2, 0.05))
"""Of skill, x [m], yaws [rad] and distance [m]: differences that count like one another."""
_NEAREST = 16
"""How many demonstrated contacts offer their postures."""


def shown_postures(robot: RobotSpec, motions: Iterable[Motion]) -> Array:
    """(m, 7) Of demonstrated contacts under a board: skill, x [m] in the world, yaw of the base and of the gripper
    against it [rad], distance between both [m]; torso [m] and upper-arm roll [rad] less those of home."""
    rows = []
    for motion in motions:
        posture = posture_of(robot, cut_at_corners(motion))
        if posture is not None:
            rows.append(np.concatenate((_key(motion.contact), posture)))
    return np.array(rows).reshape(-1, 7)


def nearest_postures(shown: Array, contact: Contact) -> tuple[Array, Array]:
    """Postures (k, 2) of the contacts of `shown_postures` nearest to a contact, and how far those are from it (k,)."""
    away = np.linalg.norm((shown[:, :5] - _key(contact)) / _KEY, axis=1)
    nearest = np.argsort(away, kind="stable")[:_NEAREST]
    return shown[nearest, 5:], away[nearest]


def _key(contact: Contact) -> Array:
    base, away = contact.base, contact.tcp[:2, 3] - contact.base[:2]
    turn = wrapped(contact.yaw - base[2])
    return np.array((SKILLS.index(contact.skill), contact.tcp[0, 3], wrapped(base[2]), turn, np.linalg.norm(away)))
