"""What is to be done, as data: an environment id and its keyword arguments, the same in every process."""

from __future__ import annotations

import json
import platform
from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib import metadata
from typing import Any

import gymnasium as gym

import clutter_env  # noqa: F401  registers the environments

__all__ = ["HELD_OUT", "Task", "versions"]

HELD_OUT = 1_000_000
"""Seeds from here on are for evaluation: nothing is collected or trained on them."""

_PACKAGES = ("clutter-env", "mujoco", "gymnasium", "numpy", "numba", "mink", "kairos-planner")


@dataclass(frozen=True)
class Task:
    """An environment to make: its id and keyword arguments (JSON values)."""

    env_id: str
    keywords: Mapping[str, Any] = field(default_factory=dict)

    def make(self, **more: Any) -> gym.Env:
        """The environment; `more` keyword arguments win over the task's own."""
        return gym.make(self.env_id, **{**self.keywords, **more})

    def to_json(self) -> str:
        """Text from which `from_json` makes an equal task."""
        return json.dumps({"env_id": self.env_id, "keywords": dict(self.keywords)}, sort_keys=True)

    @classmethod
    def from_json(cls, text: str) -> Task:
        """The task that `to_json` described."""
        content = json.loads(text)
        return cls(content["env_id"], content["keywords"])


def versions() -> dict[str, str]:
    """Versions of Python, the machine's architecture and every package that decides what an episode looks like."""
    found = {"python": platform.python_version(), "machine": platform.machine()}
    for package in _PACKAGES:
        try:
            found[package] = metadata.version(package)
        except metadata.PackageNotFoundError:
            found[package] = "not installed"
    return found
