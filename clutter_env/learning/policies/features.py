"""Observations as one vector for a network: goals relative to the hand, the target first among the objects."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clutter_env.envs.observation import OBJECT_FIELDS

__all__ = ["NEAR_SCALES", "OBJECTS_FROM", "TCP", "feature_vector"]

NEAR_SCALES = (10.0, 50.0)
"""[1/m] of the squashed copies of an offset."""
TCP = slice(23, 26)
OBJECTS_FROM = 32
"""Where a goal environment's vector holds the hand's position and, behind robot, hand and gripper, the objects."""

_SIN_YAW, _COS_YAW = 2, 3
"""Where the robot's vector holds its heading."""
_IS_TARGET = OBJECT_FIELDS.index("is_target")
_POSITION = slice(OBJECT_FIELDS.index("x"), OBJECT_FIELDS.index("z") + 1)
_PRESENT = OBJECT_FIELDS.index("present")
_FAR = 100.0
"""[m] Sorts absent objects behind all others."""

Observation = Mapping[str, NDArray[Any]]


def feature_vector(observation: Observation) -> NDArray[np.float32]:
    """Features (..., f) of an observation whose entries have shapes (..., n): one, or many at once."""
    if "desired_goal" in observation:
        return _goal_features(observation)
    return _retrieve_features(observation)


def _goal_features(observation: Observation) -> NDArray[np.float32]:
    """The observation, and in the base's frame the ways from achieved to desired goal and from hand to target."""
    vector = np.asarray(observation["observation"], np.float64)
    way = np.asarray(observation["desired_goal"] - observation["achieved_goal"], np.float64)
    sine, cosine = vector[..., _SIN_YAW], vector[..., _COS_YAW]
    ahead = cosine * way[..., 0] + sine * way[..., 1]
    left = cosine * way[..., 1] - sine * way[..., 0]
    parts = [vector, _near_and_far(np.stack((ahead, left, way[..., 2]), axis=-1))]
    objects = vector[..., OBJECTS_FROM:]
    if objects.shape[-1]:
        rows = objects.reshape(*objects.shape[:-1], -1, len(OBJECT_FIELDS))
        target = np.sum(rows[..., _POSITION] * rows[..., _IS_TARGET, None], axis=-2)
        parts.append(_near_and_far(target - vector[..., TCP]))
    return np.concatenate(parts, axis=-1).astype(np.float32)


def _retrieve_features(observation: Observation) -> NDArray[np.float32]:
    """Robot, hand, the way to the target near and far, and the objects: the target first, then by distance from it."""
    goal = np.asarray(observation["goal"], np.float64)
    parts = [np.asarray(observation[name], np.float64) for name in ("robot", "tcp", "gripper")]
    parts += [_near_and_far(goal[..., :4]), goal[..., 4:]]
    if "objects" in observation:
        parts.append(_sorted_objects(np.asarray(observation["objects"], np.float64)))
    return np.concatenate(parts, axis=-1).astype(np.float32)


def _near_and_far(way: NDArray[np.float64]) -> NDArray[np.float64]:
    """Offsets (..., n) as they are, then squashed so that decimetres and then centimetres are resolved: (..., 3 n)."""
    return np.concatenate((2 * way, *(np.tanh(scale * way) for scale in NEAR_SCALES)), axis=-1)


def _sorted_objects(flat: NDArray[np.float64]) -> NDArray[np.float64]:
    """Rows of objects (..., n * fields), sorted."""
    rows = flat.reshape(*flat.shape[:-1], -1, len(OBJECT_FIELDS))
    is_target = rows[..., _IS_TARGET]
    target = np.sum(rows[..., _POSITION] * is_target[..., None], axis=-2, keepdims=True)
    distance = np.linalg.norm(rows[..., _POSITION] - target, axis=-1)
    key = np.where(is_target > 0, -1.0, distance + _FAR * (rows[..., _PRESENT] == 0))
    order = np.argsort(key, axis=-1, kind="stable")
    return np.take_along_axis(rows, order[..., None], axis=-2).reshape(flat.shape)
