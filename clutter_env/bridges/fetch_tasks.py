"""Gymnasium-Robotics' FetchPickAndPlace, solved through its action of four numbers.

    task = FetchTask(seed=0)
    expert = TampExpert(task.world, grasps=DOWN)
    expert.reset()
    while not (expert.done or task.world.is_over):
        task.world.step(expert.act())
    print(task.finish())

The action moves the gripper, which always points down. It does not decide how the arm follows. So only the positions of
the TCP are played, and the arm counts as where it was commanded: `act` takes steps until the gripper is there.
"""

from __future__ import annotations

import warnings
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import gymnasium as gym
import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from assets import FETCH
from planners import ControlledWorld, Goal, GraspFamily, RobotState, goals, insert_robot, tcp_pose

Array = NDArray[np.float64]

_PREFIX = "robot0:"
_SPEED = 0.05
"""[m] that the gripper moves in a step by an action of 1."""
_STILL = 0.001
"""[m] that a finger moves in a step, or its opening changes, that counts as standing."""
_NEAR, _PRECISE = 0.012, 0.006
"""[m] that the gripper may be off its target on the way, and where the fingers close or open."""
_BESIDE = 0.1
"""[m] from the cube, within which the open gripper must not be off its way."""
_MOST = 8
"""Steps at most for one command."""
DOWN = (GraspFamily("down", np.pi / 2, depth=0.02, yaws=(-0.5, 0.5)),)
"""The gripper's one orientation."""
_STANDING = 0.03
"""[m] above the table up to which a goal is one for a cube that stands: it counts from 5 cm on."""


class FetchTask:
    """One episode: a `Controller`, and the world in which the expert plans.

    Attributes:
        world: for `TampExpert`, with the goal of the episode.
        dt: [s] of the plan in one `act`, which is several steps of 0.04 s: the episode has 50.
        done: the episode is over.
        is_solved: what the environment's own check said after the last step.
        steps: taken so far.
    """

    dt = 0.4

    def __init__(self, seed: int, id: str = "FetchPickAndPlace-v4") -> None:
        """Reset the environment."""
        self._env = make(id)
        observation, _ = self._env.reset(seed=seed)
        inner: Any = self._env.unwrapped
        self._model, self._data = inner.model, inner.data
        self.done, self.steps, self.is_solved = False, 0, False
        names = FETCH.drive_joints[3:]
        x, y = self._data.body(_PREFIX + "base_link").xpos[:2]
        arm = np.array([float(self._data.joint(_PREFIX + name).qpos[0]) for name in names])
        self._gripper, self._base = observation["observation"][:3], np.array([x, y, 0.0])
        home = _pointing_down(self._gripper, self._base, arm)
        self.robot = replace(FETCH.fixed(), home=tuple(home))
        file = Path(inner.fullpath)
        model = insert_robot(file, self.robot, (x, y, 0.0), without=[_PREFIX + "mocap", _PREFIX + "base_link"])
        self._object = int(model.joint("object0:joint").qposadr[0])
        self._columns = [int(model.joint(name).qposadr[0]) for name in names]
        self._fingers = [int(model.joint(name).qposadr[0]) for name in FETCH.finger_joints]
        self._qpos, self._q, self._opening = model.qpos0.copy(), home, 0.0
        self._grip, self._target = 1.0, self._gripper
        self.world = ControlledWorld(
            self, model, self.robot, movable=["object0"], support="table0", goal=self._goal(observation)
        )

    def _goal(self, observation: dict[str, Array]) -> Goal:
        wanted, stands_at = observation["desired_goal"], float(observation["achieved_goal"][2])
        if wanted[2] < stands_at + _STANDING:
            return goals.at("object0", wanted[:2])
        return goals.holding("object0", wanted)

    def observe(self) -> Array:
        """(nq,) the object where it is, the arm where it was commanded."""
        start = int(self._model.joint("object0:joint").qposadr[0])
        self._qpos[self._object : self._object + 7] = self._data.qpos[start : start + 7]
        if self._grip < 0:  # what is held moves with the gripper, which may be behind its command
            self._qpos[self._object : self._object + 3] += self._target - self._gripper
        self._qpos[self._columns] = self._q
        self._qpos[self._fingers] = [float(self._data.joint(_PREFIX + name).qpos[0]) for name in FETCH.finger_joints]
        return self._qpos

    def act(self, configuration: Array, opening: float) -> None:
        """Steps of the environment until the gripper is where it should be."""
        target = tcp_pose(self.robot, RobotState(configuration[:3], configuration[3:], 0.0))[:3, 3]
        stays = float(np.linalg.norm(target - self._target)) < _PRECISE
        changes, self._target = stays and abs(opening - self._opening) > _STILL, target
        if opening != self._opening:  # all the way: the action has no other opening to keep
            self._grip = 1.0 if opening > self._opening else -1.0
        cube = self._data.joint("object0:joint").qpos[:3]
        beside = self._grip > -1 and float(np.linalg.norm(target - cube)) < _BESIDE
        for count in range(_MOST):
            finger = float(self._data.joint(_PREFIX + FETCH.finger_joints[0]).qpos[0])
            self._step(np.append(np.clip((target - self._gripper) / _SPEED, -1, 1), self._grip))
            moved = abs(float(self._data.joint(_PREFIX + FETCH.finger_joints[0]).qpos[0]) - finger)
            is_near = np.linalg.norm(target - self._gripper) < (_PRECISE if changes or beside else _NEAR)
            if self.done or (is_near and not (changes and (moved > _STILL or count == 0))):
                break
        self._q, self._opening = configuration[3:], opening

    def _step(self, action: Array) -> None:
        observation, _, terminated, truncated, info = self._env.step(action.astype(np.float32))
        self._gripper, self.steps = observation["observation"][:3], self.steps + 1
        self.done, self.is_solved = terminated or truncated, bool(info["is_success"])

    def finish(self) -> bool:
        """Stay until the episode is over, and return the result of its own check at the last step."""
        while not self.done:
            self._step(np.array([0.0, 0.0, 0.0, self._grip]))
        return self.is_solved


def reach(seed: int, id: str = "FetchReach-v4") -> bool:
    """Whether an episode of FetchReach ends with success. It has no objects, so the gripper goes straight to the
    goal."""
    env = make(id)
    observation, _ = env.reset(seed=seed)
    is_over, info = False, {"is_success": False}
    while not is_over:
        ahead = (observation["desired_goal"] - observation["achieved_goal"]) / _SPEED
        observation, _, terminated, truncated, info = env.step(np.append(np.clip(ahead, -1, 1), 0).astype(np.float32))
        is_over = terminated or truncated
    return bool(info["is_success"])


def _pointing_down(position: Array, base: Array, start: Array) -> Array:
    """A configuration (8,) with the TCP at a position [m], straight down, near another, which may be off our limits."""
    links = FETCH.chain
    lower, upper = (np.array([max(min(getattr(link, name), 7), -7) for link in links]) for name in ("lower", "upper"))

    def residual(q: Array) -> Array:
        T = tcp_pose(FETCH, RobotState(base, q, 0.0))
        return np.concatenate((10 * (T[:3, 3] - position), T[:3, 0] - (0, 0, -1), T[:3, 1] - (0, 1, 0)))

    inside = np.clip(start, lower + 0.01, upper - 0.01)
    return np.asarray(least_squares(residual, inside, bounds=(lower + 1e-3, upper - 1e-3)).x)


def make(id: str, **options: Any) -> gym.Env:
    """Environment of Gymnasium-Robotics with its options.

    Its own comparison of joint types fails with MuJoCo 4's enumerations.
    """
    import gymnasium_robotics
    from gymnasium_robotics.utils import mujoco_utils

    kinds = SimpleNamespace(**{name: int(kind) for name, kind in mujoco.mjtJoint.__members__.items()})
    mujoco_utils.mujoco = SimpleNamespace(**{**vars(mujoco), "mjtJoint": kinds})
    gym.register_envs(gymnasium_robotics)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return gym.make(id, **options)
