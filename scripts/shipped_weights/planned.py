"""A high-level policy by the planner, with which learned motions are measured; it reads the exact state."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import gymnasium as gym
import numpy as np

from clutter_env.policies.parsed_observation import Observation, parse_observation
from clutter_env.training.grasp_labels import scene_of
from planners import (
    Contact,
    Infeasible,
    Planner,
    SceneError,
    contacts,
    controlled_env,
    find_grasp_set,
    find_strategy,
    held_object,
)

MAX_PLANS = 8
"""Plans made in an episode before it gives up."""
_MISPLACED = 0.03
"""[m] from where it was to be put, beyond which an object was not put down as planned."""


class PlannedHighLevelPolicy:
    """The picks and places of a plan, one after the other; after one that failed it plans again.

    Attributes:
        failure: why it gave up, "" if it did not.
        plans: how many plans were made in this episode.
    """

    is_privileged = True

    def __init__(self, grasps: str = "side", canonical: bool = True, strategy: str = "lookahead") -> None:
        find_grasp_set(grasps)  # raises for one that there is not, before an episode is played
        self.grasps, self._canonical, self._strategy = grasps, canonical, find_strategy(strategy)
        self._planner: Planner | None = None
        self.failure, self.plans = "", 0

    def reset(self, info: Mapping[str, Any], env: gym.Env[Any, Any]) -> None:
        """Start an episode; the first decision plans."""
        self._env = controlled_env(env)
        if self._planner is None or self._planner.robot != self._env.robot:
            self._planner = Planner(self._env.robot, grasps=self.grasps, canonical=self._canonical)
        self._target = str(info["target"])
        self._remaining: list[Contact] = []
        self._last: Contact | None = None
        self._put_at = np.zeros(3)
        self.failure, self.plans = "", 0

    def decide(self, observation: Observation) -> Contact | None:
        """The next pick or place of the plan, or the first one of a new plan."""
        if self._last is not None and not self._is_executed(self._last, observation):
            self._remaining = []
        if not self._remaining:
            self._plan()
        self._last = self._remaining.pop(0) if self._remaining else None
        if self._last is not None and self._last.skill == "place":
            # The object is put down as it is held now, which may differ from the plan.
            seen = parse_observation(observation)
            position = seen.position(self._env.object_names.index(self._last.object))
            T = self._last.tcp @ np.linalg.inv(seen.tcp)
            self._put_at = np.asarray(T[:3, :3] @ position + T[:3, 3])
        return self._last

    def _is_executed(self, contact: Contact, observation: Observation) -> bool:
        """Whether the object is in the gripper, or where it was to be put."""
        seen, index = parse_observation(observation), self._env.object_names.index(contact.object)
        if contact.skill == "pick":
            return bool(seen.is_held(index))
        away = float(np.linalg.norm(seen.position(index)[:2] - self._put_at[:2]))
        return not seen.is_held(index) and away < _MISPLACED

    def _plan(self) -> None:
        """Plan from the present state of the simulation."""
        assert self._planner is not None
        if self.plans == MAX_PLANS:
            self.failure = f"gave up after {self.plans} plans"
            return
        self.plans += 1
        try:
            outcome = self._planner.solve(
                scene_of(self._env, held_object(scene_of(self._env))), self._target, self._strategy
            )
        except SceneError as error:
            self.failure = f"the scene is not valid for planning: {error}"
            return
        if isinstance(outcome, Infeasible):
            self.failure = f"{outcome.cause}: {outcome.detail}"
            return
        self._remaining = list(contacts(outcome))
