"""A mover that plans its motions; it reads the exact state of the simulation."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from clutter_env.learning.contacts.protocols import Observation
from planners import (
    Command,
    Contact,
    ExecutionStatus,
    Executor,
    MonitorConfig,
    MotionLayer,
    NoPath,
    PlanningContext,
    Scene,
    SceneError,
    Sensor,
    controlled_env,
    held_object,
    plan_contact,
)

__all__ = ["PlannedMover"]


class PlannedMover:
    """Brings contacts about with the planner's motion layer, and stops when the world deviates from the plan.

    Attributes:
        is_done: the motion has ended.
        has_missed: it could not be planned, or a deviation has stopped it.
        reason: why it has missed, "" if it has not.
        refused: contacts of this episode for which no motion was found; the robot did not move for them.
    """

    def __init__(self) -> None:
        self.is_done, self.has_missed, self.reason, self.refused = True, False, "", 0
        self._executor: Executor | None = None

    def reset(self, env: gym.Env[Any, Any], info: Mapping[str, Any]) -> None:  # noqa: ARG002  part of the protocol
        """Start an episode."""
        self._env = controlled_env(env)
        self._sensor = Sensor(self._env.model, self._env.data, self._env.robot, self._env.object_names)
        self._executor, self.refused = None, 0
        state = self._scene().state
        self._last = Command(self._sensor.read().drive, self._env.robot.opening(state.finger_position))
        self._end("")

    def start(self, contact: Contact, observation: Observation) -> None:  # noqa: ARG002  it reads the simulation
        """Plan the motion to a contact from the present state, and begin it."""
        self._executor = None
        scene = self._scene(held_object(self._scene()))
        if contact.skill == "place" and contact.object not in scene.held_names:
            self._end(f"{contact.object} is not held")
            return
        try:
            found = plan_contact(self._motion_layer(scene), scene, contact)
        except SceneError as error:
            self._refuse(f"the scene is not valid for planning: {error}")
            return
        if not isinstance(found, tuple):
            self._refuse(
                found.reason if isinstance(found, NoPath) else f"{', '.join(sorted(found.blockers))} in the way"
            )
            return
        self.is_done, self.has_missed, self.reason = False, False, ""
        self._executor = Executor(found, self._env.robot, self._sensor.names, self._sensor.read(), MonitorConfig())

    def act(self, observation: Observation) -> NDArray[Any]:  # noqa: ARG002  it reads the simulation
        """The next action."""
        if self._executor is not None:
            step = self._executor.advance(self._sensor.read())
            self._last = step.command
            if step.status is not ExecutionStatus.RUNNING:
                self._executor = None
                self._end("" if step.deviation is None else str(step.deviation))
        return np.asarray(self._env.joint_action(self._last.drive, self._last.opening))

    def _refuse(self, reason: str) -> None:
        self.refused += 1
        self._end(reason)

    def _end(self, reason: str) -> None:
        self.is_done, self.has_missed, self.reason = True, bool(reason), reason

    def _motion_layer(self, scene: Scene) -> MotionLayer:
        """Plans motions in this scene, one after the other."""
        return MotionLayer(PlanningContext.of(scene, grasps="side"), np.random.default_rng(0))

    def _scene(self, held: str = "") -> Scene:
        """The scene as it is now, with this object in the gripper."""
        env = self._env
        return Scene.from_mujoco(
            env.model, env.data, env.robot, held, movable=env.object_names, support=env.support_name
        )
