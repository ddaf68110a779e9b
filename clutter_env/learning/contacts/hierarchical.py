"""A policy of two levels: a decider and a mover, in the protocol of `clutter-env evaluate`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import gymnasium as gym
from numpy.typing import NDArray

from clutter_env.envs.success import HOLD_STEPS
from clutter_env.learning.contacts.protocols import Decider, Mover, Observation

__all__ = ["MOST_CONTACTS", "HierarchicalPolicy"]

MOST_CONTACTS = 40
"""Contacts tried in an episode, missed ones included, before the policy gives up."""


class HierarchicalPolicy:
    """Asks the decider for a contact, lets the mover bring it about, and asks again; see `SuitePolicy`.

    It has finished once the target has been taken, and has given up when the decider does.

    Attributes:
        grasps: "side" or "all": the grasps that the decider chooses from.
        failure: why it gave up, "" if it did not.
        contacts, missed: how many were started and missed in this episode.
    """

    def __init__(self, decider: Decider, mover: Mover, grasps: str = "side") -> None:
        self.grasps = grasps
        self._decider, self._mover = decider, mover
        self._start()

    def reset(self, env: gym.Env[Any, Any], info: Mapping[str, Any]) -> None:
        """Start an episode; `env` has been reset and returned `info`."""
        self._start()
        self._target = str(info["target"])
        self._decider.reset(env, info)
        self._mover.reset(env, info)

    @property
    def done(self) -> bool:
        """Whether it has finished or given up."""
        return bool(self.failure) or self._steps_after > 2 * HOLD_STEPS

    @property
    def phase(self) -> str:
        """The contact that is brought about and the phase of its motion, such as "pick object_03: lift"."""
        return f"{self._contact}: {getattr(self._mover, 'phase', '')}" if self._is_moving else ""

    def act(self, observation: Observation) -> NDArray[Any]:
        """The next action."""
        if not self._is_moving or self._mover.is_done:
            self._conclude()
            if not self._is_taken and not self.failure:
                self._begin(observation)
        self._steps_after += self._is_taken
        return self._mover.act(observation)

    def _start(self) -> None:
        self._target, self._taking, self._contact = "", "", ""
        self._is_moving = self._is_taken = False
        self._steps_after = self.contacts = self.missed = 0
        self.failure = ""

    def _conclude(self) -> None:
        """Note how the last contact went."""
        if not self._is_moving:
            return
        self._is_moving = False
        self.missed += self._mover.has_missed
        self._is_taken = self._taking == self._target and not self._mover.has_missed

    def _begin(self, observation: Observation) -> None:
        """Start the next contact, or give up."""
        if self.contacts >= MOST_CONTACTS:
            self.failure = f"the target was not taken after {self.contacts} contacts"
            return
        contact = self._decider.decide(observation)
        if contact is None:
            self.failure = self._decider.failure or "the decider gave up"
            return
        self.contacts += 1
        self._contact = f"{contact.skill} {contact.object}"
        self._taking = contact.object if contact.skill == "pick" else ""
        self._is_moving = True
        self._mover.start(contact, observation)
