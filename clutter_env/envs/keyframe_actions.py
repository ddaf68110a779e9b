"""Whole-body keyframes as actions: tens of decisions an episode in place of hundreds or thousands of steps.

    env = KeyframeActions(gym.make("clutter_env/Retrieve-o5-v0"))
    observation, reward, terminated, truncated, info = env.step(keyframe)

A keyframe is the next configuration of base, torso, arm and fingers. The environment's own controller goes there, with
all joints synchronised to the slowest one. Demonstrations in this form: `clutter_env.data.keyframes`.
"""

from __future__ import annotations

import math
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from numpy.typing import ArrayLike, NDArray

from assets import ActingJoints
from clutter_env.envs.base import BaseEnv
from clutter_env.errors import ConfigError
from clutter_env.simulation.control import BASE_RANGE, CONTROL_STEP, checked_vector

ARRIVED = 0.004
"""[m], [rad] between the measured and the wanted position of every joint at which a keyframe is reached."""
RESTING = 3
"""[steps] more, in which fingers press and what they hold comes to rest."""
STILL, PATIENCE = 0.002, 10
"""[m], [rad] by which at least one joint moves in so many steps, unless the robot is stuck."""
MOST_STEPS = 400
"""Control steps for a keyframe: 20 s."""
_BRAKING_SHARE = 0.6
"""Share of the greatest acceleration that is counted on for braking."""

Array = NDArray[np.float64]


class KeyframeActions(gym.Wrapper[Any, Any, Any, Any]):
    """An environment with joint control whose action is the next whole-body keyframe.

    An action is (5 + n,): base x, y [m] and yaw [rad] in the world, torso [m] and arm [rad], and the position [m] of
    each finger of the gripper, 0 closed. If several arms act, the joints of the others follow those of the active one,
    and each gripper has one finger position. The base turns the short way round. A step ends when the keyframe is
    reached, when the robot is stuck, after `MOST_STEPS`, or with the episode. Its reward is the sum of those of its
    control steps. The info is that of the last one, and

    - `control_steps` (int): how many there were.
    - `reached` (bool): whether joints and commanded fingers are where the keyframe has them.

    Raises:
        ConfigError: the environment has not joint control.
    """

    def __init__(self, env: gym.Env[Any, Any]) -> None:
        super().__init__(env)
        inner = env.unwrapped
        if not isinstance(inner, BaseEnv) or inner.control_mode != "joint":
            raise ConfigError("KeyframeActions needs an environment of this package with control_mode='joint'")
        self._inner, acting = inner, ActingJoints.of(inner.robot)
        self._limits, self._braking = np.array(acting.velocity), _BRAKING_SHARE * np.array(acting.acceleration)
        fingers = np.full(acting.num_grippers, inner.robot.max_finger_position)
        lower = np.concatenate(((-BASE_RANGE, -BASE_RANGE, -math.pi), acting.lower, 0 * fingers))
        upper = np.concatenate(((BASE_RANGE, BASE_RANGE, math.pi), acting.upper, fingers))
        self._lower, self._upper = lower, upper
        self.action_space = spaces.Box(lower, upper, dtype=np.float64)

    @property
    def present_keyframe(self) -> Array:
        """The keyframe (5 + n,) in which joints and fingers are commanded to be."""
        state = self._inner.world.controller.state
        return np.concatenate((state.target, state.fingers))

    def step(self, action: ArrayLike) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Go to a keyframe, or to the nearest one within the limits of joints and fingers.

        Raises:
            ActionError: not a finite vector of the right shape, or `reset` has not been called. Nothing has changed.
        """
        self._inner.check_started("step()")
        count = len(self._limits)
        keyframe = checked_vector("the keyframe", action, self._lower.shape)
        yaw, present = keyframe[2], self._inner.world.controller.state.target[2]
        keyframe = np.clip(keyframe, self._lower, self._upper)
        keyframe[2] = present + math.remainder(yaw - present, math.tau)
        goal, fingers = keyframe[:count], keyframe[count:]
        widths = [self._inner.robot.opening(finger) for finger in fingers.tolist()]
        total, rested, seen = 0.0, 0, [self._measured]
        while True:
            command = self._inner.joint_action(self._on_the_way(goal), widths)
            observation, reward, terminated, truncated, info = self.env.step(command.astype(np.float32))
            total += float(reward)
            seen.append(self._measured)
            commanded = self._inner.world.controller.state.fingers
            is_there = np.abs(goal - seen[-1]).max() < ARRIVED and np.abs(fingers - commanded).max() < ARRIVED
            rested = rested + 1 if is_there else 0
            is_stuck = len(seen) > PATIENCE and np.abs(seen[-1] - seen[-1 - PATIENCE]).max() < STILL
            if rested > RESTING or is_stuck or terminated or truncated or len(seen) > MOST_STEPS:
                return observation, total, terminated, truncated, self._told(info, len(seen) - 1, bool(is_there))

    @staticmethod
    def _told(info: dict[str, Any], steps: int, is_there: bool) -> dict[str, Any]:
        return {**info, "control_steps": steps, "reached": is_there}

    @property
    def _measured(self) -> Array:
        """Positions of the joints."""
        inner = self._inner
        return np.array(inner.data.qpos[inner.world.index.drive_qpos])

    def _on_the_way(self, goal: Array) -> Array:
        """The joints' targets one step farther on the straight line to the goal, slow enough to brake."""
        start = self._inner.world.controller.state.target
        size = np.abs(goal - start)
        speed = np.minimum(self._limits, np.sqrt(2 * self._braking * size))
        time = float((size / np.maximum(speed, 1e-9)).max())
        return np.asarray(goal if time <= CONTROL_STEP else start + (goal - start) * CONTROL_STEP / time)
