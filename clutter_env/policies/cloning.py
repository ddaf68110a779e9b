"""Cloned policies: a network from features of the observation to an action in [-1, 1].

Features are one vector: goals relative to the gripper, the target first among the objects.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from clutter_env.envs.observation import OBSERVATION_LAYOUT, entry_slices
from clutter_env.policies.weights import damage_refused, read_arrays, tensors, write_arrays

POLICY_FILE = "policy.npz"

_NEAR_SCALES = (10.0, 50.0)
"""[1/m] of the squashed copies of an offset."""
_SIN_YAW = OBSERVATION_LAYOUT["robot"].index("sin_yaw")
_COS_YAW = OBSERVATION_LAYOUT["robot"].index("cos_yaw")
_OBJECT_ROW = OBSERVATION_LAYOUT["objects"]
"""Layout of the row of one object."""

_ENTRIES = entry_slices(OBSERVATION_LAYOUT, ("robot", "tcp", "gripper", "objects"), num_objects=0)
"""The parts of a goal environment's vector, which begins with the entry "robot"."""
_POSITION_IN_TCP = OBSERVATION_LAYOUT["tcp"]["position"]
_TCP_POSITION = slice(_ENTRIES["tcp"].start + _POSITION_IN_TCP.start, _ENTRIES["tcp"].start + _POSITION_IN_TCP.stop)
"""Where the vector of a goal environment holds the position of the TCP."""
_OBJECTS_FROM = _ENTRIES["objects"].start
"""Where the vector of a goal environment holds the rows of the objects, up to its end."""

_GOAL = OBSERVATION_LAYOUT["goal"]
_FAR = 100.0
"""[m] Added to the distance of absent objects, so that they are sorted behind all others."""


class ClonedPolicy(nn.Module):
    """Three linear layers from features to an action, which tanh squashes into [-1, 1].

    The features are not normalised. Division by their standard deviation in the data enlarges features that hardly vary
    there, so that they dominate the others when they do vary: clones of `Pick` then succeed less often.
    """

    def __init__(self, num_features: int, num_actions: int, width: int = 256) -> None:
        super().__init__()
        self.shape = (num_features, num_actions, width)
        self.layers = nn.Sequential(
            nn.Linear(num_features, width), nn.ReLU(), nn.Linear(width, width), nn.ReLU(), nn.Linear(width, num_actions)
        )

    def forward(self, features: torch.Tensor) -> torch.Tensor:
        """Actions (k, a) of features (k, f)."""
        return torch.tanh(self.layers(features))

    def reset(self, info: Mapping[str, Any]) -> None:
        """Start an episode; nothing is remembered of the last one."""

    def act(self, observation: Mapping[str, NDArray[Any]]) -> NDArray[np.float32]:
        """The action (a,) for one observation."""
        with torch.no_grad():
            action = self(torch.from_numpy(feature_vector(observation)))
        return np.asarray(action.numpy(), np.float32)

    def save(self, path: Path, provenance: Mapping[str, Any] | None = None) -> None:
        """Write shape, weights and what they were made with; the file is complete, or the old one stays.

        Raises:
            OSError: the disk is full or cannot be written.
        """
        weights = {name: value.numpy() for name, value in self.state_dict().items()}
        write_arrays(path, weights, {"shape": self.shape, "provenance": dict(provenance or {})})

    @classmethod
    def load(cls, path: Path) -> ClonedPolicy:
        """The policy that `save` wrote.

        Raises:
            PolicyError: there is no such file, it is damaged, or it holds something else.
        """
        arrays, about = read_arrays(path)
        with damage_refused(path):
            policy = cls(*about["shape"])
            policy.load_state_dict(tensors(arrays))
        return policy


def feature_vector(observation: Mapping[str, NDArray[Any]]) -> NDArray[np.float32]:
    """Features (..., f) of an observation with entries (..., n): of one observation, or of many at once.

    Goal environments must have the default robot, whose `OBSERVATION_LAYOUT` their vector follows.
    """
    if "desired_goal" in observation:
        return _goal_features(observation)
    return _retrieve_features(observation)


def _goal_features(observation: Mapping[str, NDArray[Any]]) -> NDArray[np.float32]:
    """The observation, and in the base's frame the offsets from achieved to desired goal and from TCP to target."""
    vector = np.asarray(observation["observation"], np.float64)
    offset = np.asarray(observation["desired_goal"] - observation["achieved_goal"], np.float64)
    sine, cosine = vector[..., _SIN_YAW], vector[..., _COS_YAW]
    ahead = cosine * offset[..., 0] + sine * offset[..., 1]
    left = cosine * offset[..., 1] - sine * offset[..., 0]
    parts = [vector, _near_and_far(np.stack((ahead, left, offset[..., 2]), axis=-1))]
    objects = vector[..., _OBJECTS_FROM:]
    if objects.shape[-1]:
        rows = objects.reshape(*objects.shape[:-1], -1, _OBJECT_ROW.size)
        target = np.sum(rows[..., _OBJECT_ROW["position"]] * rows[..., _OBJECT_ROW["is_target"]], axis=-2)
        parts.append(_near_and_far(target - vector[..., _TCP_POSITION]))
    return np.concatenate(parts, axis=-1).astype(np.float32)


def _retrieve_features(observation: Mapping[str, NDArray[Any]]) -> NDArray[np.float32]:
    """Robot, TCP, gripper, the offset to the target, and the objects: the target first, then by distance from it."""
    goal = np.asarray(observation["goal"], np.float64)
    offsets = slice(_GOAL["tcp_to_target"].start, _GOAL["lift_left"].stop)
    parts = [np.asarray(observation[name], np.float64) for name in ("robot", "tcp", "gripper")]
    parts += [_near_and_far(goal[..., offsets]), goal[..., _GOAL["hold_progress"]]]
    if "objects" in observation:
        parts.append(_sorted_objects(np.asarray(observation["objects"], np.float64)))
    return np.concatenate(parts, axis=-1).astype(np.float32)


def _near_and_far(offset: NDArray[np.float64]) -> NDArray[np.float64]:
    """Offsets (..., n) as they are, then squashed so that decimetres and then centimetres are resolved: (..., 3 n)."""
    return np.concatenate((2 * offset, *(np.tanh(scale * offset) for scale in _NEAR_SCALES)), axis=-1)


def _sorted_objects(flat: NDArray[np.float64]) -> NDArray[np.float64]:
    """Rows of objects (..., n * fields), sorted."""
    rows = flat.reshape(*flat.shape[:-1], -1, _OBJECT_ROW.size)
    position, is_target = rows[..., _OBJECT_ROW["position"]], rows[..., _OBJECT_ROW["is_target"]]
    target = np.sum(position * is_target, axis=-2, keepdims=True)
    distance = np.linalg.norm(position - target, axis=-1, keepdims=True)
    key = np.where(is_target > 0, -1.0, distance + _FAR * (rows[..., _OBJECT_ROW["present"]] == 0))
    order = np.argsort(key, axis=-2, kind="stable")
    return np.take_along_axis(rows, order, axis=-2).reshape(flat.shape)
