"""A decider that follows the plan of the task and motion planner; it reads the exact state of the simulation."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from clutter_env.learning.contacts.protocols import Observation
from clutter_env.learning.contacts.reading import read
from planners import Contact, Infeasible, Planner, Scene, SceneError, contacts, controlled_env, held_object

__all__ = ["MOST_PLANS", "PlannedDecider"]

MOST_PLANS = 8
"""Plans made in an episode before it gives up."""
_MISPLACED = 0.03
"""[m] from where it was to be put, beyond which an object was not put down as planned."""


class PlannedDecider:
    """The contacts of a plan, one after the other; after one that was missed it plans again.

    Attributes:
        failure: why it gave up, "" if it did not.
        plans: how many plans were made in this episode.
    """

    def __init__(self, grasps: str = "side", canonical: bool = True, strategy: str = "lookahead") -> None:
        self._grasps, self._canonical, self._strategy = grasps, canonical, strategy
        self._planner: Planner | None = None
        self.failure, self.plans = "", 0

    def reset(self, env: gym.Env[Any, Any], info: Mapping[str, Any]) -> None:
        """Start an episode; the first decision plans."""
        self._env = controlled_env(env)
        if self._planner is None or self._planner.robot != self._env.robot:
            self._planner = Planner(self._env.robot, grasps=self._grasps, canonical=self._canonical)
        self._target = str(info["target"])
        self._left: list[Contact] = []
        self._last: Contact | None = None
        self._put_at = np.zeros(3)
        self.failure, self.plans = "", 0

    def decide(self, observation: Observation) -> Contact | None:
        """The next contact of the plan, or the first one of a new plan."""
        if self._last is not None and not self._is_brought_about(self._last, observation):
            self._left = []
        if not self._left:
            self._plan()
        self._last = self._left.pop(0) if self._left else None
        if self._last is not None and self._last.skill == "place":
            self._put_at = self._put_position(self._last, observation)
        return self._last

    def _put_position(self, contact: Contact, observation: Observation) -> NDArray[np.float64]:
        """(3,) [m] where the held object will be put down, as it is held now."""
        reading = read(observation)
        position = reading.position(self._env.object_names.index(contact.object))
        T = contact.tcp @ np.linalg.inv(reading.tcp)
        return np.asarray(T[:3, :3] @ position + T[:3, 3])

    def _is_brought_about(self, contact: Contact, observation: Observation) -> bool:
        """Whether the object is in the gripper, or where it was to be put."""
        reading, index = read(observation), self._env.object_names.index(contact.object)
        if contact.skill == "pick":
            return bool(reading.is_held(index))
        away = float(np.linalg.norm(reading.position(index)[:2] - self._put_at[:2]))
        return not reading.is_held(index) and away < _MISPLACED

    def _plan(self) -> None:
        """Plan from the present state of the simulation."""
        assert self._planner is not None
        if self.plans == MOST_PLANS:
            self.failure = f"gave up after {self.plans} plans"
            return
        self.plans += 1
        try:
            outcome = self._planner.solve(self._scene(held_object(self._scene())), self._target, self._strategy)
        except SceneError as error:
            self.failure = f"the scene is not valid for planning: {error}"
            return
        if isinstance(outcome, Infeasible):
            self.failure = f"{outcome.cause}: {outcome.detail}"
            return
        self._left = list(contacts(outcome))

    def _scene(self, held: str = "") -> Scene:
        """The scene as it is now, with this object in the gripper."""
        env = self._env
        return Scene.from_mujoco(
            env.model, env.data, env.robot, held, movable=env.object_names, support=env.support_name
        )
