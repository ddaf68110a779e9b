"""A task as data: an environment id and keyword arguments, the same in every process."""

from __future__ import annotations

import json
from collections.abc import Mapping
from contextlib import closing
from dataclasses import dataclass, field
from typing import Any

import gymnasium as gym

import clutter_env  # noqa: F401  registers the environments
from clutter_env.errors import ConfigError, UnknownTask
from clutter_env.provenance import provenance


@dataclass(frozen=True)
class Task:
    """An environment id and keyword arguments (JSON values)."""

    env_id: str
    keywords: Mapping[str, Any] = field(default_factory=dict)

    def make(self, **more: Any) -> gym.Env:
        """Make the environment. `more` keyword arguments replace those of the task.

        Raises:
            UnknownTask: no such environment, or it cannot be made with these keyword arguments.
        """
        # Tasks also come from other people's files. For an id "module:name" Gymnasium would import the module.
        if self.env_id not in gym.registry:
            known = ", ".join(name for name in gym.registry if name.startswith("clutter_env/"))
            raise UnknownTask(f"no environment {self.env_id!r}; known ones: {known}")
        try:
            env = gym.make(self.env_id, **{**self.keywords, **more})
        except ConfigError as problem:
            raise UnknownTask(f"{self.env_id}: {problem}") from problem
        ours: Any = env.unwrapped
        if not hasattr(getattr(ours, "physics_env", ours), "config"):
            raise UnknownTask(
                f"{self.env_id!r} is an environment of another package, or a wrapper of one; environments of this one, "
                "such as clutter_env/ArmReach-v0, are shown by: clutter-env list environments"
            )
        return env

    def provenance(self) -> dict[str, Any]:
        """Provenance of a new recording in this environment, see `clutter_env.provenance`."""
        with closing(self.make()) as env:
            return provenance(env)

    @property
    def family(self) -> str:
        """The family of the environment: "retrieve", "rearrange", "skill" or one of `GOAL_FAMILIES`."""
        return family(self.env_id)

    @property
    def num_objects(self) -> int:
        """Number of objects on the table, 0 if the environment decides."""
        known = {**gym.spec(self.env_id).kwargs, **self.keywords}
        return int(known.get("num_objects", 0))

    def to_json(self) -> str:
        """The task as JSON text."""
        return json.dumps({"env_id": self.env_id, "keywords": dict(self.keywords)}, sort_keys=True)

    @classmethod
    def from_json(cls, text: str) -> Task:
        """The task that `to_json` wrote."""
        content = json.loads(text)
        return cls(content["env_id"], content["keywords"])


def family(env_id: str) -> str:
    """The family of an environment id: "retrieve" for clutter_env/Retrieve-o15-v0."""
    return env_id.rpartition("/")[2].partition("-")[0].lower()
