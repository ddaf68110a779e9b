"""A policy for Search that sees observations alone: it reaches for what looks like the target, or is nearest.

clutter-env evaluate --suite hidden-shelf-10-v2 --policy examples.search_greedily:Greedy --scenes 20
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

Observation = Mapping[str, NDArray[Any]]


class Greedy:
    """Turns its arm aside, drives to the object, closes the fingers around it and lifts it; nothing is put aside."""

    env_keywords = {"control_mode": "ee", "image_size": 96, "frame_every": 10}  # noqa: RUF012  of the protocol

    def reset(self, info: Mapping[str, Any]) -> None:  # noqa: ARG002  of the protocol
        """Begin an episode; of `info` nothing is used."""
        self.steps, self.closing = 0, 0

    @property
    def done(self) -> bool:
        """Whether it has given up, after a minute."""
        return self.steps >= 1200

    def act(self, observation: Observation) -> NDArray[np.float32]:
        """Base (3), TCP (6), gripper, head (2)."""
        self.steps += 1
        action = np.zeros(12, np.float32)
        action[9] = 1.0 if not self.closing else -1.0
        goal = seen_goal(observation)
        if self.steps <= 30:
            action[4] = 1.0  # the arm leaves the image
        elif self.closing:
            self.closing += 1
            action[5] = float(self.closing > 20)  # up, once the fingers have closed
        elif goal is not None:
            away = goal - observation["tcp"][:3]
            action[0] = np.clip(goal[0] - 0.8, -0.3, 0.3)
            action[3:6] = np.clip(5.0 * away, -1.0, 1.0)
            self.closing = int(np.linalg.norm(away) < 0.03)
        return action


class Random(Greedy):
    """Acts at random for as long."""

    def act(self, observation: Observation) -> NDArray[np.float32]:  # noqa: ARG002  of the protocol
        """Numbers from -1 to 1."""
        self.steps += 1
        return np.random.default_rng(self.steps).uniform(-1.0, 1.0, 12).astype(np.float32)


def seen_goal(observation: Observation, camera: str = "head") -> NDArray[np.float64] | None:
    """(3,) [m] in the base's frame: the middle of the mask with the target's colour, else of the nearest mask."""
    masks, depth = observation[f"{camera}_segmentation"][..., 0], observation[f"{camera}_depth"][..., 0]
    K, wanted = observation[f"{camera}_K"], observation["target"][:3] / observation["target"][:3].sum()
    best, goal = np.inf, None
    for label in np.unique(masks[masks >= 3]):
        v, u = np.nonzero(masks == label)
        z = float(np.median(depth[v, u]))
        colour = observation[f"{camera}_rgb"][v, u].mean(axis=0) + 1e-6
        is_target = np.abs(colour / colour.sum() - wanted).max() < 0.12
        if z - 100.0 * is_target < best:
            best = z - 100.0 * is_target
            ray = np.array(((u.mean() - K[0, 2]) / K[0, 0], (v.mean() - K[1, 2]) / K[1, 1], 1.0, 1.0 / z))
            goal = (observation[f"{camera}_T_base_camera"] @ (z * ray))[:3]
    return goal
