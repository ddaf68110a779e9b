"""A mover that carries out chunks of steps from a network: the reference learners' share of a policy."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol

import gymnasium as gym
import numpy as np
import torch
from numpy.typing import NDArray

from assets import RobotSpec
from clutter_env.config import CONTROL_HZ
from clutter_env.learning.chunking.examples import situation
from clutter_env.learning.contacts.protocols import Observation
from clutter_env.learning.contacts.reading import Reading, planar_pose, read
from clutter_env.learning.contacts.tracking import error_to, stay
from clutter_env.learning.keyframes.configurations import shortest_way
from planners import Contact

__all__ = ["ChunkMover", "Chunker"]

Array = NDArray[np.float64]

_CARRIED_OUT = 4
"""Steps of a chunk that are carried out before the next one is predicted."""
_LONGEST = 400
"""Control steps after which a motion is over; the expert's take about 200."""
_END = 0.5
"""The end flag above which a motion is over."""


class Chunker(Protocol):
    """Predicts chunks: `ChunkNetwork`, `FlowNetwork`."""

    def chunk(self, features: torch.Tensor) -> torch.Tensor:
        """The next steps (STEPS, ROW) of one situation (f,)."""
        ...


class ChunkMover:
    """Brings contacts about with chunks of steps; it sees nothing but observations.

    Attributes:
        is_done: the motion has ended.
        has_missed: it has ended without the object in the gripper, or, of a placement, still with it.
    """

    def __init__(self, network: Chunker) -> None:
        self._network = network
        self.is_done, self.has_missed = True, False

    def reset(self, env: gym.Env[Any, Any], info: Mapping[str, Any]) -> None:  # noqa: ARG002  part of the protocol
        """Start an episode: only the robot's limits and the names of the objects are read from the environment."""
        self._robot: RobotSpec = env.unwrapped.robot  # type: ignore[attr-defined]  # Retrieve
        self._names: tuple[str, ...] = env.unwrapped.object_names  # type: ignore[attr-defined]  # Retrieve
        self.is_done, self.has_missed = True, False

    def start(self, contact: Contact, observation: Observation) -> None:  # noqa: ARG002  part of the protocol
        """Begin to bring a contact about."""
        self._contact, self._index = contact, self._names.index(contact.object)
        self._steps, self._rows = 0, np.zeros((0, 0))
        self.is_done, self.has_missed = False, False

    def act(self, observation: Observation) -> Array:
        """The next action."""
        reading = read(observation)
        if not self.is_done and not len(self._rows):
            self._predict(reading)
        if self.is_done:
            return stay(self._robot, reading)
        goal, self._rows = self._rows[0], self._rows[1:]
        self._steps += 1
        velocity = error_to(reading, goal[:11]) * CONTROL_HZ
        action = np.append(velocity / np.array(self._robot.max_velocity), goal[11])
        return np.clip(action, -1.0, 1.0)

    def _predict(self, reading: Reading) -> None:
        """The next steps, as whole-body configurations in the world and finger actions; or the end."""
        features = situation(self._robot, reading, self._contact, self._index)
        with torch.no_grad():
            chunk = self._network.chunk(torch.tensor(features, dtype=torch.float32)).numpy().astype(float)
        if chunk[0, 12] > _END or self._steps >= _LONGEST:
            self.is_done = True
            self.has_missed = bool(reading.is_held(self._index)) != (self._contact.skill == "pick")
            return
        T, rows = planar_pose(reading.base), chunk[:_CARRIED_OUT, :12].copy()
        rows[:, :2] = rows[:, :2] @ T[:2, :2].T + T[:2, 3]
        rows[:, 2] += reading.base[2]
        rows[:, 3:11] += np.array(self._robot.home)
        rows[:, 3:11] = shortest_way(self._robot, reading.q, rows[:, 3:11])
        self._rows = rows
