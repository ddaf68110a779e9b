"""What the reference learners learn from: situations of demonstrations, and the next steps that follow."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from assets import RobotSpec
from clutter_env.learning.contacts.reading import Reading, planar_pose, wrapped
from clutter_env.learning.errors import DatasetError
from clutter_env.learning.keyframes.configurations import nearest_home
from clutter_env.learning.keyframes.features import contact_in_base, pose_features
from clutter_env.learning.keyframes.motions import Motion
from planners import Contact

__all__ = ["ROW", "STEPS", "ChunkExamples", "chunk_examples", "situation"]

Array = NDArray[np.float64]

STEPS = 10
"""Control steps in a chunk: half a second."""
ROW = 13
"""Numbers in a step of a chunk: base in the frame of where it is now (3), torso and arm (8), finger action, end."""
_NEAR = (10.0, 50.0)
"""[1/m] of the squashed copies of offsets."""


@dataclass(frozen=True, eq=False)
class ChunkExamples:
    """Features (k, f) of situations, and chunks (k, STEPS, ROW)."""

    features: Array
    chunks: Array


def chunk_examples(robot: RobotSpec, motions: Iterable[Motion]) -> ChunkExamples:
    """All steps of the motions; a chunk that reaches beyond its motion repeats the last step.

    Raises:
        DatasetError: there are no motions.
    """
    features, chunks = [], []
    for motion in motions:
        features.append(situation(robot, motion.reading, motion.contact, motion.index)[:-1])
        chunks.append(_chunks(robot, motion))
    if not features:
        raise DatasetError("the demonstrations show no contact; collect them with `clutter-env collect --canonical`")
    return ChunkExamples(np.concatenate(features), np.concatenate(chunks))


def situation(robot: RobotSpec, reading: Reading, contact: Contact, index: int) -> Array:
    """Features (..., f): the contact as seen from base and gripper, robot and object; no phase, no velocities."""
    base_contact = contact_in_base(contact.tcp, reading.base)
    stand = np.linalg.inv(planar_pose(reading.base)) @ planar_pose(np.array(contact.base))
    from_tcp = np.linalg.inv(reading.base_tcp) @ base_contact
    parts = (
        np.full((*reading.base.shape[:-1], 1), float(contact.skill == "pick")),
        pose_features(base_contact),
        stand[..., :2, 3],
        _near(stand[..., :2, 3]),
        stand[..., :2, 0],
        from_tcp[..., :3, 3],
        _near(from_tcp[..., :3, 3]),
        from_tcp[..., :3, 0],
        from_tcp[..., :3, 1],
        nearest_home(robot, reading.q) - np.array(robot.home),
        20 * reading.widths - 1,
        np.asarray(reading.is_held(index), float)[..., None],
        20 * reading.sizes(index) - 1,
    )
    return np.concatenate(parts, axis=-1)


def _chunks(robot: RobotSpec, motion: Motion) -> Array:
    """(T, STEPS, ROW) of a motion."""
    count = len(motion.actions)
    following = np.minimum(np.arange(count)[:, None] + np.arange(1, STEPS + 1), count)
    bases = motion.reading.base
    relative = np.linalg.inv(planar_pose(bases[:-1]))[:, None] @ planar_pose(bases[following])
    turns = wrapped(bases[following][..., 2] - bases[:-1, None, 2])
    q = nearest_home(robot, motion.reading.q)[following] - np.array(robot.home)
    fingers = motion.actions[np.minimum(following - 1, count - 1), -1]
    is_last = following == count
    return np.concatenate((relative[..., :2, 3], turns[..., None], q, fingers[..., None], is_last[..., None]), axis=-1)


def _near(offset: Array) -> Array:
    """Offsets (..., n) squashed so that decimetres and then centimetres are resolved: (..., 2 n)."""
    return np.concatenate([np.tanh(scale * offset) for scale in _NEAR], axis=-1)
