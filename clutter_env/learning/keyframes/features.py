"""What the keyframe network is told: phase, contact, object and the way left on a straight line."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from clutter_env.learning.contacts.reading import Reading, planar_pose
from clutter_env.learning.keyframes.phases import NUM_PHASES
from planners import Contact

__all__ = [
    "CENTRE",
    "NUM_FEATURES",
    "POSE",
    "POSTURE",
    "POSTURE_JOINTS",
    "POSTURE_SIZE",
    "REACH",
    "contact_in_base",
    "features",
    "line_distance",
    "pose_features",
]

Array = NDArray[np.float64]

CENTRE = np.array((0.75, 0.0, 0.85))
"""[m] in the base's frame: near most contacts, so that features are about zero."""
REACH = 0.15
"""[m] of a contact's position that is one unit of a feature."""
_NEAR = (10.0, 50.0)
"""[1/m] of the squashed copies of the distance on a line."""
_POSE_SIZE = 9
POSE = slice(NUM_PHASES, NUM_PHASES + _POSE_SIZE)
"""Where the pose of the contact stands among the features."""
NUM_FEATURES = NUM_PHASES + _POSE_SIZE + 4 + 1 + len(_NEAR) + 2
POSTURE = slice(NUM_FEATURES - 2, NUM_FEATURES)
"""Where the posture at the contact stands among the features."""
POSTURE_JOINTS = (0, 3)
"""Numbers of the joints, torso lift and upper-arm roll, that are free where the gripper is given."""
POSTURE_SIZE = (0.1, 0.5)
"""[m], [rad] of the posture that are one unit of a feature."""


def contact_in_base(contact_tcp: Array, base: Array) -> Array:
    """(..., 4, 4) TCP pose of a contact (4, 4) in the frame of bases (..., 3)."""
    return np.asarray(np.linalg.inv(planar_pose(base)) @ contact_tcp)


def pose_features(base_contact: Array) -> Array:
    """(..., 9) of poses (..., 4, 4) in the base's frame: position, and the gripper's x and y axes."""
    position = (base_contact[..., :3, 3] - CENTRE) / REACH
    return np.concatenate((position, base_contact[..., :3, 0], base_contact[..., :3, 1]), axis=-1)


def features(
    phase: NDArray[np.int64] | int,
    base_contact: Array,
    sizes: Array,
    distance: Array,
    posture: Array,
) -> Array:
    """(k, NUM_FEATURES) of k situations.

    Args:
        phase: (k,) numbers of `phase_index`.
        base_contact: (k, 4, 4) contact in the base's frame.
        sizes: (k, 4) of the object, as `Reading.sizes`.
        distance: (k,) [m] from the contact on a straight line, 0 in other phases.
        posture: (k, 2) torso [m] and upper-arm roll [rad], less those of the home configuration: at the contact, or
            under a board those of the keyframe itself.
    """
    one_hot = np.eye(NUM_PHASES)[np.broadcast_to(phase, (len(base_contact),))]
    way = [distance / REACH, *(np.tanh(scale * distance) for scale in _NEAR)]
    size = np.concatenate((sizes[..., :3] * 20 - 1, sizes[..., 3:]), axis=-1)
    parts = (one_hot, pose_features(base_contact), size, np.stack(way, axis=-1), posture / POSTURE_SIZE)
    return np.concatenate(parts, axis=-1)


def line_distance(reading: Reading, contact: Contact) -> Array:
    """[m] (...) from the measured TCP to a contact."""
    return np.asarray(np.linalg.norm(reading.tcp[..., :3, 3] - contact.tcp[:3, 3], axis=-1))
