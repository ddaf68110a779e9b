"""What a learner that corrects an imitation of `Pick` sees, and how near to the goal it is."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from assets import FETCH
from clutter_env.envs.observation import OBSERVATION_LAYOUT
from clutter_env.policies.scripted import FINGER_ROOM, HOVER, grasp_height
from clutter_env.learning.policies.features import NEAR_SCALES, OBJECT_ROW, OBJECTS_FROM, TCP_POSITION

__all__ = ["progress", "remaining_steps", "shows_target", "target_features"]

STEPS_PER_METRE = 100.0
"""Steps for a metre of way: 0.1 m/s, a third of the gripper's greatest velocity."""
STEPS_TO_GRASP = 10.0
"""Steps of closing the fingers, and what letting the object go costs."""
BESIDE = (0.015, 0.035)
"""[m] From the object's axis: within the first, the gripper may descend; from the second on it must be above first."""
AT_GRASP = 0.04
"""[m] of way to the grasp from which on the gripper should be open."""

_ROBOT = OBSERVATION_LAYOUT["robot"]
_VELOCITIES = slice(_ROBOT["base_velocity"].start, _ROBOT["arm_velocity"].stop)
_WIDTHS = slice(OBJECTS_FROM - OBSERVATION_LAYOUT["gripper"].size, OBJECTS_FROM)
_OFFSETS = 2 * 3 * (1 + len(NEAR_SCALES))
"""Features of the two offsets, at the end of the features: from target to goal, and from TCP to target."""
_HEIGHT = 2

Observation = Mapping[str, NDArray[Any]]


def shows_target(observation: Observation) -> bool:
    """Whether an observation is one of a goal environment with objects."""
    return "desired_goal" in observation and observation["observation"].shape[-1] > OBJECTS_FROM


def target_features(features: NDArray[np.float32]) -> NDArray[np.float32]:
    """Those features (..., n) of `feature_vector` that do not tell one scene from another: (..., m).

    They are the offsets, velocities, the height and the width of the gripper, the target's size, and whether it is
    held. With all features corrections drove the base in one direction throughout an episode.
    """
    target = _target(features[..., :-_OFFSETS])
    parts = (
        features[..., -_OFFSETS:],
        target[..., OBJECT_ROW["half_extents"]],
        target[..., OBJECT_ROW["held"]],
        features[..., TCP_POSITION][..., _HEIGHT:],
        features[..., _WIDTHS],
        features[..., _VELOCITIES],
    )
    return np.concatenate(parts, axis=-1)


def progress(before: Observation, after: Observation) -> NDArray[np.float64]:
    """By how much the remaining steps (...,) have become fewer."""
    return np.asarray(remaining_steps(before) - remaining_steps(after))


def remaining_steps(observation: Observation) -> NDArray[np.float64]:
    """Estimate (...,) of the steps until the goal is reached, from observations of `Pick` with entries (..., n).

    Until the target is held, they contain the way to the grasp: over the target first where the gripper is beside it,
    then down. A gripper that is still too narrow for the target has to open on the way.
    """
    vector = np.asarray(observation["observation"], np.float64)
    target = _target(vector)
    half_extents = target[..., OBJECT_ROW["half_extents"]]
    half_width, half_height = half_extents[..., 1], half_extents[..., _HEIGHT]
    at_grasp = grasp_height(FETCH, half_height)
    offset = vector[..., TCP_POSITION] - target[..., OBJECT_ROW["position"]]
    aside = np.hypot(offset[..., 0], offset[..., 1])
    height = offset[..., _HEIGHT] + half_height - at_grasp
    above = HOVER + 2 * half_height - at_grasp
    beside = np.clip((aside - BESIDE[0]) / (BESIDE[1] - BESIDE[0]), 0.0, 1.0)
    narrow = np.maximum(2 * (half_width + FINGER_ROOM) - vector[..., _WIDTHS.start], 0.0)
    way = aside + np.abs(height) + beside * 2 * np.maximum(above - np.maximum(height, 0.0), 0.0)
    way += narrow * np.clip((aside + np.abs(height)) / AT_GRASP, 0.0, 1.0)
    away = np.linalg.norm(observation["desired_goal"] - observation["achieved_goal"], axis=-1)
    is_free = 1 - target[..., OBJECT_ROW.index("held")]
    return np.asarray(STEPS_PER_METRE * away + is_free * (STEPS_PER_METRE * way + STEPS_TO_GRASP))


def _target(vector: NDArray[Any]) -> NDArray[Any]:
    """The row (..., k) of the target in vectors (..., n) that end with the rows of the objects."""
    rows = vector[..., OBJECTS_FROM:].reshape(*vector.shape[:-1], -1, OBJECT_ROW.size)
    return np.asarray(np.sum(rows * rows[..., OBJECT_ROW["is_target"]], axis=-2))
