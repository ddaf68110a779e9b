"""Network input of a keyframe: phase, pick or place, object, arm configuration and distance left on a straight line."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from clutter_env.policies.parsed_observation import ParsedObservation, planar_pose
from planners import Contact

Array = NDArray[np.float64]

SKILLS = ("pick", "place")
PHASES: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "pick": ("drive", "ready", "transit", "approach", "close", "lift", "retreat"),
        "place": ("drive", "transit", "lower", "open", "rise", "retreat"),
    }
)
"""Phases of a motion by skill, in their order, as the planner's trajectories name them."""
DRIVEN = ("enter", "reach", "back", "leave")
"""Straight drives of the base under a shelf and out again, the arm rigid: to where the gripper is about to reach around
the object, along the gripper to the contact, and back."""
SHELF_PHASES: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "pick": ("drive", "ready", "transit", "enter", "reach", "close", "lift", "back", "leave", "retreat"),
        "place": ("drive", "transit", "enter", "reach", "lower", "open", "back", "leave", "retreat"),
    }
)
"""The same under a shelf."""
ELSEWHERE = ("transit", *DRIVEN)
"""Phases under a shelf whose arm configuration is one of a straight line at the contact."""
TOWARDS, AWAY = ("approach", "lower"), ("lift", "rise")
LINES = (*TOWARDS, *AWAY)
"""Straight lines of the gripper to a contact, and away from it."""
FINGERS = ("ready", "close", "open")
"""Only the fingers move."""

_LEARNED = tuple((skill, phase) for skill in SKILLS for phase in PHASES[skill])
NUM_PHASES = len(_LEARNED)

CENTRE = np.array((0.75, 0.0, 0.85))
"""[m] in the base's frame: near most contacts, so that features are about zero."""
REACH = 0.15
"""[m] of a contact's position that is one unit of a feature."""
_NEAR = (10.0, 50.0)
"""[1/m] of the squashed copies of the distance on a line."""
POSE = slice(NUM_PHASES, NUM_PHASES + 9)
"""Columns of the pose of the contact: position, and the gripper's x and y axes."""
NUM_FEATURES = POSE.stop + 4 + 1 + len(_NEAR) + 2
FREE = slice(NUM_FEATURES - 2, NUM_FEATURES)
"""Columns of the free joints at the contact."""
FREE_JOINTS = (0, 3)
"""Numbers of the joints, torso lift and upper-arm roll, that are free where the gripper is given."""
FREE_UNITS = (0.1, 0.5)
"""[m], [rad] of the free joints that are one unit of a feature."""


def phase_index(skill: str, phase: str) -> int | None:
    """Number of a phase of a skill among all; None for a phase that is not learned."""
    return _LEARNED.index((skill, phase)) if (skill, phase) in _LEARNED else None


def network_input(
    phase: int | None, base_contact: Array, sizes: Array, distance: Array | float, free: Array
) -> NDArray[np.float64]:
    """(k, NUM_FEATURES) of k situations; arguments with one row are repeated.

    Args:
        phase: number of `phase_index`.
        base_contact: (k, 4, 4) TCP pose at the contact, in the base's frame.
        sizes: (k, 4) of the object, as `ParsedObservation.sizes`.
        distance: (k,) [m] from the contact on a straight line, 0 in other phases.
        free: (k, 2) torso [m] and upper-arm roll [rad], less those of the home configuration: at the contact, or under
            a shelf those of the keyframe itself.
    """
    assert phase is not None
    count = len(base_contact)
    sizes, distance = np.broadcast_to(sizes, (count, 4)), np.broadcast_to(distance, (count,))
    free = np.broadcast_to(free, (count, 2))
    position = (base_contact[..., :3, 3] - CENTRE) / REACH
    pose = np.concatenate((position, base_contact[..., :3, 0], base_contact[..., :3, 1]), axis=-1)
    size = np.concatenate((sizes[..., :3] * 20 - 1, sizes[..., 3:]), axis=-1)
    line = [distance / REACH, *(np.tanh(scale * distance) for scale in _NEAR)]
    one_hot = np.eye(NUM_PHASES)[np.full(count, phase)]
    return np.concatenate((one_hot, pose, size, np.stack(line, axis=-1), free / FREE_UNITS), axis=-1)


def contact_in_base(contact_tcp: Array, base: Array) -> Array:
    """(..., 4, 4) TCP pose of a contact (4, 4) in the frame of bases (..., 3)."""
    return np.asarray(np.linalg.inv(planar_pose(np.asarray(base))) @ contact_tcp)


def line_distance(seen: ParsedObservation, contact: Contact) -> Array:
    """(...) [m] from the measured TCP to a contact."""
    return np.asarray(np.linalg.norm(seen.tcp[..., :3, 3] - contact.tcp[:3, 3], axis=-1))
