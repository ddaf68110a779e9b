"""The environments as LeRobot sees them, and `make_env`, the entry point of an environment hub.

A repository on the hub needs one line in its env.py: `from clutter_env.bridges.hub import make_env`.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from functools import partial
from types import MappingProxyType
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from gymnasium.vector import AsyncVectorEnv, AutoresetMode, SyncVectorEnv, VectorEnv
from numpy.typing import NDArray

from clutter_env.envs.instruction import sentence
from clutter_env.errors import ConfigError, OptionError, check_choice
from clutter_env.suites import suite as named_suite
from clutter_env.task import Task, family

ENV_ID = "clutter_env/Retrieve-o15-v0"
TASKS: Mapping[str, str] = MappingProxyType(
    {
        "retrieve": "take the target out of the clutter",
        "rearrange": "bring the objects to their goals",
        **dict.fromkeys(("reach", "armreach"), "reach the point with the gripper"),
        **dict.fromkeys(("pick", "armpick"), "lift the object to the point"),
    }
)
"""Tasks in words, by the family of the environment."""
OBSERVATIONS = ("images", "state", "environment_state")
"""Inputs of a policy. "images": images of the cameras, the robot's own state and the commanded goal, but no pose of an
object. "state": one vector of everything, exact poses too. "environment_state": the robot's state, and apart from it
all else."""
_ROBOT = ("robot", "tcp", "gripper", "observation")
_EXACT = ("objects", "goal", "achieved_goal")
_COMMANDED = ("goals", "desired_goal")
"""The order of the entries is the same for environments and for files, which sort their names."""
_COLOUR = "_rgb"
Groups = dict[str, list[str]]


def number_groups(names: Collection[str], observations: str) -> Groups:
    """The entries of an observation behind each of LeRobot's keys: "agent_pos" and, where wanted, "environment_state".

    In goal environments the entry "observation" has the objects too, unless the environment has `obs_mode="rgbd"`.

    Raises:
        ConfigError: `observations` is none of `OBSERVATIONS`.
    """
    check_choice("observations", observations, OBSERVATIONS)
    robot, exact, commanded = ([name for name in part if name in names] for part in (_ROBOT, _EXACT, _COMMANDED))
    if observations == "environment_state":
        return {"agent_pos": robot, "environment_state": exact + commanded}
    return {"agent_pos": robot + (exact if observations == "state" else []) + commanded}


def joined(observation: Mapping[str, NDArray[Any]], names: Collection[str]) -> NDArray[np.float32]:
    """Some entries of an observation, or of the rows of many, (..., n), one after the other."""
    return np.concatenate([np.asarray(observation[name], np.float32) for name in names], axis=-1)


def image_entries(names: Collection[str]) -> dict[str, str]:
    """The entries with colour images, by the names of the cameras."""
    return {name.removesuffix(_COLOUR): name for name in names if name.endswith(_COLOUR)}


def hub_observation(observation: Mapping[str, NDArray[Any]], observations: str) -> dict[str, Any]:
    """An observation with the keys that LeRobot expects of an environment. See `OBSERVATIONS`."""
    groups = number_groups(observation, observations).items()
    found: dict[str, Any] = {key: joined(observation, names) for key, names in groups}
    if observations == "images":
        found["pixels"] = {camera: observation[name] for camera, name in image_entries(observation).items()}
    return found


class HubObservation(gym.ObservationWrapper):
    """Observations with the keys "agent_pos" and "pixels" or "environment_state".

    Attributes:
        task: what to do, in words, the same for all episodes.

    Raises:
        ConfigError: `observations` is none of `OBSERVATIONS`, or the environment has no such observations.
    """

    def __init__(self, env: gym.Env, observations: str, language: bool = False) -> None:
        super().__init__(env)
        assert env.spec is not None
        parts = env.observation_space
        if not isinstance(parts, spaces.Dict) or family(env.spec.id) not in TASKS:
            raise ConfigError(f"{env.spec.id} is not for LeRobot; these are: {', '.join(TASKS)}")
        self.task, self._language = TASKS[family(env.spec.id)], language
        self._observations = observations
        ends = [
            hub_observation({name: getattr(box, end) for name, box in parts.items()}, observations)
            for end in ("low", "high")
        ]
        images = {camera: parts[name] for camera, name in image_entries(parts).items()}
        found = {key: spaces.Box(low, ends[1][key]) for key, low in ends[0].items() if key != "pixels"}
        self.observation_space = spaces.Dict(found | ({"pixels": spaces.Dict(images)} if "pixels" in ends[0] else {}))

    @property
    def task_description(self) -> str:
        """The task in words: `task`, or with `language` the sentence of the present episode's goal."""
        return sentence(self.env) if self._language else self.task

    def observation(self, observation: Mapping[str, NDArray[Any]]) -> dict[str, Any]:
        """The observation with its entries grouped."""
        return hub_observation(observation, self._observations)


class SuiteScenes(gym.Wrapper):
    """The test scenes of a suite in place of random ones. A reset with a seed starts the scene of this number, modulo
    the number of scenes. A reset without a seed starts the next scene.

    Args:
        suite: its name.
        keywords: of the environment, that do not change the scenes.

    Raises:
        SuiteError: there is no such suite, or a keyword argument changes its scenes.
    """

    def __init__(self, suite: str, **keywords: Any) -> None:
        self._scenes, self._next = named_suite(suite).test, 0
        super().__init__(self._scenes[0].make(**keywords))

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Start the episode of a scene.

        Raises:
            OptionError: there are options, which would make another scene.
        """
        if options:
            raise OptionError("a scene of a suite is reset without options")
        number = self._next if seed is None else seed
        self._next = number + 1
        return self._scenes[number % len(self._scenes)].reset(self.env)


def make_one(
    env_id: str = ENV_ID,
    observations: str = "environment_state",
    suite: str = "",
    language: bool = False,
    **keywords: Any,
) -> gym.Env:
    """One environment of a hub.

    Args:
        env_id: of the environment. Ignored if a suite is named.
        observations: one of `OBSERVATIONS`. "images" implies `obs_mode="rgbd"`.
        suite: plays the test scenes of this suite, see `SuiteScenes`.
        language: whether `task_description` is the sentence of the episode's goal.
        keywords: of the environment, such as "control_mode" or "image_size".

    Raises:
        UnknownTask: no environment of that id, or not with these keyword arguments.
        ConfigError: see `HubObservation`.
        SuiteError: see `SuiteScenes`.
    """
    mode = {"obs_mode": "rgbd"} if observations == "images" else {}
    chosen = {**keywords, **mode}
    return HubObservation(
        SuiteScenes(suite, **chosen) if suite else Task(env_id, chosen).make(), observations, language
    )


def make_env(
    n_envs: int = 1, use_async_envs: bool = False, cfg: Mapping[str, Any] | None = None
) -> dict[str, dict[int, VectorEnv]]:
    """A vector of environments, reset in the step that ends an episode (SAME_STEP). `info["is_success"]` is success.

    Args:
        n_envs: environments in the vector.
        use_async_envs: whether each of them gets a process of its own.
        cfg: arguments of `make_one`.

    Returns:
        The vector, under the environment's id and the number 0 of its only task.

    Raises:
        UnknownTask, ConfigError: see `make_one`, or a number of environments below 1.
    """
    if n_envs < 1:
        raise ConfigError(f"n_envs={n_envs} is not valid; it must be at least 1")
    make = partial(make_one, **(cfg or {}))
    make().close()
    if use_async_envs:
        vector: VectorEnv = AsyncVectorEnv([make] * n_envs, context="spawn", autoreset_mode=AutoresetMode.SAME_STEP)
    else:
        vector = SyncVectorEnv([make] * n_envs, autoreset_mode=AutoresetMode.SAME_STEP)
    return {(cfg or {}).get("env_id", ENV_ID): {0: vector}}
