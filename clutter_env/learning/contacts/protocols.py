"""The two levels of a policy: a decider chooses the next contact, a mover brings it about."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol, TypeAlias

import gymnasium as gym
from numpy.typing import NDArray

from planners import Contact

__all__ = ["Decider", "Mover", "Observation"]

Observation: TypeAlias = Mapping[str, NDArray[Any]]
"""Of one step, from `clutter_env/Retrieve-…` with `obs_mode="state"`."""


class Decider(Protocol):
    """Chooses contacts, one at a time."""

    @property
    def failure(self) -> str:
        """Why it gave up; "" if it did not."""
        ...

    def reset(self, env: gym.Env[Any, Any], info: Mapping[str, Any]) -> None:
        """Start an episode; `env` has been reset and returned `info`."""
        ...

    def decide(self, observation: Observation) -> Contact | None:
        """The next contact, once the one before has been brought about or missed; None: gives up."""
        ...


class Mover(Protocol):
    """Brings contacts about, one at a time."""

    @property
    def is_done(self) -> bool:
        """Whether the motion has ended, and the next contact may be started."""
        ...

    @property
    def has_missed(self) -> bool:
        """Whether the motion has ended without the object in the gripper, or, of a placement, still with it."""
        ...

    def reset(self, env: gym.Env[Any, Any], info: Mapping[str, Any]) -> None:
        """Start an episode; `env` has been reset and returned `info`."""
        ...

    def start(self, contact: Contact, observation: Observation) -> None:
        """Begin to bring a contact about."""
        ...

    def act(self, observation: Observation) -> NDArray[Any]:
        """The next action; once the motion has ended, the robot stays where it is."""
        ...
