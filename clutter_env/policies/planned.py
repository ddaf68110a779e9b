"""Both levels of a policy by the task and motion planner: they read the exact state of the simulation."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from clutter_env.policies.parsed_observation import Observation, parse_observation
from planners import (
    Command,
    Contact,
    Executor,
    Infeasible,
    MonitorConfig,
    MotionLayer,
    NoPath,
    Planner,
    PlanningContext,
    Scene,
    SceneError,
    Sensor,
    contacts,
    controlled_env,
    find_grasp_set,
    find_strategy,
    held_object,
    plan_contact,
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
            outcome = self._planner.solve(_present_scene(self._env), self._target, self._strategy)
        except SceneError as error:
            self.failure = f"the scene is not valid for planning: {error}"
            return
        if isinstance(outcome, Infeasible):
            self.failure = f"{outcome.cause}: {outcome.detail}"
            return
        self._remaining = list(contacts(outcome))


class PlannedMotionPolicy:
    """Executes picks and places with the planner's motion layer, and stops when the world deviates from the plan.

    Attributes:
        is_done: the motion has ended.
        has_failed: it could not be planned, or a deviation has stopped it.
        reason: why it has failed, "" if it has not.
    """

    is_privileged = True

    def __init__(self) -> None:
        self.is_done, self.has_failed, self.reason = True, False, ""
        self._executor: Executor | None = None

    def reset(self, info: Mapping[str, Any], env: gym.Env[Any, Any]) -> None:  # noqa: ARG002  part of the protocol
        """Start an episode."""
        self._env = controlled_env(env)
        self._sensor = Sensor(self._env.model, self._env.data, self._env.robot, self._env.object_names)
        self._executor = None
        finger_position = scene_of(self._env).state.finger_position
        self._last = Command(self._sensor.read().drive, self._env.robot.opening(finger_position))
        self._end("")

    def start(self, contact: Contact, observation: Observation) -> None:  # noqa: ARG002  it reads the simulation
        """Plan the motion of a pick or a place from the present state, and begin it."""
        self._executor = None
        scene = _present_scene(self._env)
        if contact.skill == "place" and contact.object not in scene.held_names:
            self._end(f"{contact.object} is not held")
            return
        try:
            layer = MotionLayer(PlanningContext.of(scene.robot, scene, grasps="side"), np.random.default_rng(0))
            found = plan_contact(layer, scene, contact)
        except SceneError as error:
            self._end(f"the scene is not valid for planning: {error}")
            return
        if not isinstance(found, tuple):
            in_way = "" if isinstance(found, NoPath) else ", ".join(sorted(found.blockers))
            self._end(found.reason if isinstance(found, NoPath) else f"{in_way} in the way")
            return
        self.is_done, self.has_failed, self.reason = False, False, ""
        self._executor = Executor(found, self._env.robot, self._sensor, MonitorConfig())

    def act(self, observation: Observation) -> NDArray[Any]:  # noqa: ARG002  it reads the simulation
        """The next action."""
        if self._executor is not None:
            self._last = self._executor.advance(self._sensor.read())
            if self._executor.is_over:
                deviation, self._executor = self._executor.deviation, None
                self._end("" if deviation is None else str(deviation))
        return np.asarray(self._env.joint_action(self._last.drive, self._last.opening))

    def _end(self, reason: str) -> None:
        self.is_done, self.has_failed, self.reason = True, bool(reason), reason


def scene_of(env: Any, held: str = "") -> Scene:
    """The planner's view of an environment as it is now, with exact poses."""
    own = env.unwrapped
    return Scene.from_mujoco(own.model, own.data, own.robot, held, movable=own.object_names, support=own.support_name)


def _present_scene(env: Any) -> Scene:
    """The scene with what the gripper holds."""
    return scene_of(env, held_object(scene_of(env)))
