"""Checkpoints of LeRobot as policies: LeRobot itself plays them, in a process of its own environment."""

from __future__ import annotations

import base64
import json
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium import spaces

from clutter_env.bridges.hub import TASKS, hub_observation
from clutter_env.bridges.remote import BridgeError, Remote
from clutter_env.policies.protocol import EE_ACTIONS, PolicyError, PublicInfo

_IMAGE = "observation.images."
_KEYS = {"observation.state": "agent_pos", "observation.environment_state": "environment_state"}


class LeRobotPolicy:
    """The policy of a checkpoint, with its own processing of observations and actions.

    Its inputs determine its observations. If they include images, the environment has `obs_mode="rgbd"` and the cameras
    that they name, so no exact poses.

    Args:
        path: directory of the checkpoint, "pretrained_model".
        python: interpreter of an environment in which LeRobot is installed, "" for the present interpreter.
        seed: of the random numbers of policies that draw them, the same in every episode.

    Raises:
        PolicyError: the checkpoint does not exist, names code that LeRobot would execute, or cannot be loaded.
    """

    grasps = "all"

    def __init__(self, path: Path, python: str = "", seed: int = 0) -> None:
        try:
            config = json.loads((path / "config.json").read_text())
            shapes = {name: tuple(entry["shape"]) for name, entry in config["input_features"].items()}
            (self._actions,) = config["output_features"]["action"]["shape"]
            steps = [step for file in path.glob("*processor.json") for step in json.loads(file.read_text())["steps"]]
            foreign = [step.get("class") for step in steps if not step.get("registry_name")]
            self._images = {key.removeprefix(_IMAGE): part for key, part in shapes.items() if key.startswith(_IMAGE)}
            size = next(iter(self._images.values()), (0,))[-1]
        except (OSError, ValueError, LookupError, TypeError, AttributeError) as problem:
            kind = "checkpoint of LeRobot, a directory such as checkpoints/last/pretrained_model"
            raise PolicyError(f"{path} is no {kind}: {problem!r}") from problem
        # A step with the name of a class may be anything that can be imported and called, such as a shell.
        if foreign:
            raise PolicyError(f"{path} wants LeRobot to import {foreign}; only its own registered steps are loaded")
        self._numbers = {_KEYS[name]: shape for name, shape in shapes.items() if name in _KEYS}
        apart = "environment_state" if "environment_state" in self._numbers else "state"
        self._observations = "images" if self._images else apart
        self.env_keywords: dict[str, Any] = {"control_mode": "ee"} if self._actions == EE_ACTIONS else {}
        if self._images:
            self.env_keywords |= {"obs_mode": "rgbd", "image_size": size, "cameras": tuple(self._images)}
        self._path, self._task = path, ""
        try:
            self._remote = Remote(python or sys.executable, "lerobot_worker.py")
            self._remote("load", path=str(path.absolute()), seed=seed)
        except BridgeError as problem:
            hint = "" if python else "; name an interpreter that has LeRobot: --python PATH"
            raise PolicyError(f"{path} cannot be loaded{hint}: {problem}") from problem

    def check(self, public: PublicInfo) -> None:
        """Refuse an environment with other observations or actions (`PolicyError`)."""
        space, self._task = public.observation_space, TASKS.get(public.family, "")
        shown = space.sample() if isinstance(space, spaces.Dict) and self._task else {}
        there = {name: np.shape(part) for name, part in self._seen(shown).items()} if shown else {}
        own = {**self._numbers, **{camera: (*shape[1:], shape[0]) for camera, shape in self._images.items()}}
        wrong = {name: there.get(name) for name, shape in own.items() if there.get(name) != shape}
        if wrong or public.action_space.shape != (self._actions,):
            raise PolicyError(
                f"{self._path} is for observations {own} and {self._actions} numbers in an action; the environment has "
                f"{there} and {public.action_space.shape}"
            )

    def reset(self, info: Mapping[str, Any]) -> None:  # noqa: ARG002  part of the protocol
        """Start an episode."""
        self._remote("reset")

    def act(self, observation: Any) -> Any:
        """The next action."""
        seen = self._seen(observation)
        numbers = {name: seen[name].tolist() for name in self._numbers}
        images = {name: (seen[name].shape, base64.b64encode(seen[name].tobytes()).decode()) for name in self._images}
        answer = self._remote("act", numbers=numbers, images=images, task=self._task)
        return np.array(answer["action"], np.float32)

    def _seen(self, observation: Mapping[str, Any]) -> dict[str, Any]:
        """Inputs of the policy: vectors by LeRobot's names, and images by camera."""
        found = hub_observation(observation, self._observations)
        images = found.pop("pixels", {})
        return {**found, **images}
