"""Models of Stable-Baselines3 and sb3-contrib as policies: those of training runs, and files made elsewhere."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

import gymnasium as gym
import numpy as np
import torch
from sb3_contrib import TQC, MaskablePPO
from stable_baselines3 import A2C, DDPG, DQN, PPO, SAC, TD3
from stable_baselines3.common.base_class import BaseAlgorithm

from clutter_env.envs.skill import observed_masks
from clutter_env.policies.protocol import EE_ACTIONS, FREE_KEYWORDS, PolicyError, PublicInfo
from clutter_env.policies.runs import load_run
from clutter_env.policies.weights import damage_refused
from clutter_env.task import family

_OF_SB3 = {"sac": SAC, "tqc": TQC, "ppo": PPO, "dqn": DQN, "a2c": A2C, "ddpg": DDPG, "td3": TD3}
ALGORITHMS: Mapping[str, type[BaseAlgorithm]] = MappingProxyType(_OF_SB3 | {"maskable_ppo": MaskablePPO})
"""Algorithms by name. `clutter-env train` has settings for sac, tqc, ppo, dqn and maskable_ppo."""
MODEL_FILE = "model.pt"
"""Networks, optimisers and number of steps, in the directory of a run."""


def network_name(observations: gym.Space[Any]) -> str:
    """Stable-Baselines3's name of the networks for a space of observations."""
    return "MultiInputPolicy" if isinstance(observations, gym.spaces.Dict) else "MlpPolicy"


def read_model(path: Path) -> dict[str, Any]:
    """Read a run's file: tensors, numbers and texts. No code in it is executed.

    Raises:
        PolicyError: the file is missing, damaged, or of another version.
    """
    with damage_refused(path):
        return dict(torch.load(path, map_location="cpu", weights_only=True))


class ModelPolicy:
    """A model as a policy: the most probable action.

    Action masks exclude skills that have just failed, but not skills without a free grasp.

    Args:
        algorithm: the algorithm that trained the model.
        model: a model of Stable-Baselines3, or its networks.
    """

    def __init__(self, algorithm: str, model: Any) -> None:
        self._model, self._is_masked = model, algorithm == "maskable_ppo"

    def reset(self, info: Mapping[str, Any]) -> None:
        """Start an episode. Nothing is kept from the last episode."""

    def act(self, observation: Any) -> Any:
        """The most probable action."""
        options = {"action_masks": observed_masks(observation)} if self._is_masked else {}
        action, _ = self._model.predict(observation, deterministic=True, **options)
        return np.asarray(action)


class RunPolicy(ModelPolicy):
    """The policy of a training run in a directory, loaded for the first episode."""

    def __init__(self, directory: Path) -> None:
        record = load_run(directory)
        self._algorithm, self._directory = str(record["algorithm"]), directory
        super().__init__(self._algorithm, None)
        self.acts_by_skills = family(record["task"]["env_id"]) == "skill"
        self.grasps = "side" if self.acts_by_skills else "all"
        chosen = {} if self.acts_by_skills else record["task"]["keywords"]
        self.env_keywords = {key: chosen[key] for key in FREE_KEYWORDS if key in chosen}

    def check(self, public: PublicInfo) -> None:
        """Make the networks for the environment's spaces before the first episode.

        Raises:
            PolicyError: the model is missing, damaged, or made for other observations or actions.
        """
        if self._model is None:
            path, spaces = self._directory / MODEL_FILE, (public.observation_space, public.action_space)
            content = read_model(path)
            with damage_refused(path):
                kind = ALGORITHMS[self._algorithm].policy_aliases[network_name(spaces[0])]
                model, parameters = kind(*spaces, lambda _: 0.0, **content["network"]), content["parameters"]["policy"]
                fits = all(parameters[name].shape == part.shape for name, part in model.state_dict().items())
                if fits:
                    model.load_state_dict(parameters)
            if not fits:
                raise PolicyError(f"{self._directory} was trained with other observations or actions than those here")
            self._model = model


class ZipPolicy(ModelPolicy):
    """The policy in a file that Stable-Baselines3 saved.

    Loading the file executes code that is in it.

    Args:
        algorithm: that trained it, one of `ALGORITHMS`.
        path: of the file.

    Raises:
        PolicyError: no such algorithm or file, or one that cannot be loaded.
    """

    def __init__(self, algorithm: str, path: Path) -> None:
        if algorithm not in ALGORITHMS:
            known = ", ".join(ALGORITHMS)
            raise PolicyError(f"{algorithm!r} is no algorithm; name a file ALGORITHM:{path}, with one of {known}")
        if not path.is_file():
            raise PolicyError(f"there is no file {path}")
        try:
            model = ALGORITHMS[algorithm].load(path, device="cpu")
        except Exception as problem:  # whatever the code in the file raises
            raise PolicyError(f"{path} cannot be loaded as a model of {algorithm}: {problem!r}") from problem
        super().__init__(algorithm, model)
        self._spaces = (model.observation_space, model.action_space)
        self.place = str(path)
        self.acts_by_skills = isinstance(model.action_space, gym.spaces.Discrete)
        self.grasps = "side" if self.acts_by_skills else "all"
        mode = "ee" if model.action_space.shape == (EE_ACTIONS,) else "joint"
        self.env_keywords = {} if self.acts_by_skills else {"control_mode": mode}

    def check(self, public: PublicInfo) -> None:
        """Refuse an environment with other observations or actions (`PolicyError`)."""
        own, there = (
            " and ".join(map(_shape_text, spaces))
            for spaces in (self._spaces, (public.observation_space, public.action_space))
        )
        if own != there:
            raise PolicyError(f"{self.place} is for observations and actions {own}; the environment has {there}")


def _shape_text(space: gym.Space[Any]) -> str:
    """Number of choices, shape, or shapes by name."""
    if isinstance(space, gym.spaces.Dict):
        return str({name: _shape_text(part) for name, part in space.items()})
    return str(space.n) if isinstance(space, gym.spaces.Discrete) else str(list(space.shape or ()))
