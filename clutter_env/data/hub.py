"""Vectors of environments as LeRobot's evaluation wants them: `make_env`, the entry point of an environment hub.

A repository on the hub needs one line in its env.py: `from clutter_env.data.hub import make_env`.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from functools import partial
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from gymnasium.vector import AsyncVectorEnv, AutoresetMode, SyncVectorEnv, VectorEnv
from numpy.typing import NDArray

from clutter_env.errors import ConfigError
from clutter_env.task import Task, family

ENV_ID = "clutter_env/Retrieve-o15-v0"
TASKS = {
    "retrieve": "take the target out of the clutter",
    **dict.fromkeys(("reach", "armreach"), "reach the point with the gripper"),
    **dict.fromkeys(("pick", "armpick"), "lift the object to the point"),
    "skill": "take the target out of the clutter, one skill after the other",
}
"""What to do, in words, by the family of the environment."""
_AGENT = ("robot", "tcp", "gripper", "observation")
_ENVIRONMENT = ("objects", "goal", "achieved_goal", "desired_goal")
"""The order of the entries is the same for environments and for files, which sort their names."""
_COLOUR = "_rgb"


def agent_entries(names: Collection[str]) -> list[str]:
    """The entries of an observation about the robot itself; in goal environments "observation" has the objects too."""
    return [name for name in _AGENT if name in names]


def environment_entries(names: Collection[str]) -> list[str]:
    """The entries about objects and goals, known exactly."""
    return [name for name in _ENVIRONMENT if name in names]


def image_entries(names: Collection[str]) -> dict[str, str]:
    """The entries with colour images, by the names of the cameras."""
    return {name.removesuffix(_COLOUR): name for name in names if name.endswith(_COLOUR)}


class HubObservation(gym.ObservationWrapper):
    """Observations with the keys "agent_pos", "environment_state" and, with cameras, "pixels".

    Attributes:
        task, task_description: what to do, in words.
    """

    def __init__(self, env: gym.Env) -> None:
        super().__init__(env)
        assert isinstance(env.observation_space, spaces.Dict)
        assert env.spec is not None
        self.task = self.task_description = TASKS[family(env.spec.id)]
        parts = env.observation_space.spaces
        self._agent, self._environment = agent_entries(parts), environment_entries(parts)
        self._images = image_entries(parts)
        found: dict[str, spaces.Space[Any]] = {"agent_pos": _joined(parts, self._agent)}
        if self._environment:
            found["environment_state"] = _joined(parts, self._environment)
        if self._images:
            found["pixels"] = spaces.Dict({camera: parts[name] for camera, name in self._images.items()})
        self.observation_space = spaces.Dict(found)

    def observation(self, observation: Mapping[str, NDArray[Any]]) -> dict[str, Any]:
        """The observation with its entries grouped."""
        found: dict[str, Any] = {"agent_pos": np.concatenate([observation[name] for name in self._agent])}
        if self._environment:
            found["environment_state"] = np.concatenate([observation[name] for name in self._environment])
        if self._images:
            found["pixels"] = {camera: observation[name] for camera, name in self._images.items()}
        return found


def make_env(
    n_envs: int = 1, use_async_envs: bool = False, cfg: Mapping[str, Any] | None = None
) -> dict[str, dict[int, VectorEnv]]:
    """A vector of environments, reset in the step that ends an episode (SAME_STEP); `info["is_success"]` is success.

    Args:
        n_envs: environments in the vector.
        use_async_envs: whether each of them gets a process of its own.
        cfg: "env_id", by default clutter_env/Retrieve-o15-v0, and keyword arguments of the environment, such as
            "control_mode" or obs_mode="rgbd" for cameras in place of exact object poses.

    Returns:
        The vector, under the environment's id and the number 0 of its only task.

    Raises:
        ConfigError: a number of environments below 1.
        UnknownTask: no environment of that id, or not with these keyword arguments.
    """
    keywords = dict(cfg or {})
    env_id = keywords.pop("env_id", ENV_ID)
    if n_envs < 1:
        raise ConfigError(f"n_envs={n_envs} is not valid; it must be at least 1")
    task = Task(env_id, keywords)
    task.make().close()
    makers = [partial(_make_one, task)] * n_envs
    if use_async_envs:
        vector: VectorEnv = AsyncVectorEnv(makers, context="spawn", autoreset_mode=AutoresetMode.SAME_STEP)
    else:
        vector = SyncVectorEnv(makers, autoreset_mode=AutoresetMode.SAME_STEP)
    return {env_id: {0: vector}}


def _make_one(task: Task) -> gym.Env:
    return HubObservation(task.make())


def _joined(parts: Mapping[str, spaces.Space[Any]], names: Collection[str]) -> spaces.Box:
    """The box of some entries, one after the other."""
    boxes: list[Any] = [parts[name] for name in names]
    low, high = (np.concatenate([getattr(box, end) for box in boxes]).astype(np.float32) for end in ("low", "high"))
    return spaces.Box(low, high, dtype=np.float32)
