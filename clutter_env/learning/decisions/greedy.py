"""A decider that has not learned anything: it takes the target and, while that fails, clears what is nearest to it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from clutter_env.learning.decisions.contact_rule import ContactChoices, ContactRule, crowding
from clutter_env.learning.decisions.examples import object_rows
from clutter_env.learning.decisions.observed import Changes, ObservedScene, are_standing, observed_scene
from planners import Contact

__all__ = ["GreedyDecider"]

_YAW_COST = 0.5
"""Cost of a radian of the base's yaw, if a radian of the gripper's yaw against the base's costs 1."""
_CROWDED = 10.0
"""Cost of a place without any room around it."""


class GreedyDecider:
    """A control for learned decisions: the same contacts to choose from, by a rule that ignores what is in the way.

    The target comes first, then the objects by their distance from it. What has been tried since an object last moved
    comes after what has not. Of an object the contact comes first for which base and gripper turn least. A held
    object goes to the nearest place with room around it.

    Attributes:
        rule: the contacts that it chooses from.
        failure: why it gave up, "" if it did not.
    """

    def __init__(self, rule: ContactRule) -> None:
        self.rule = rule
        self._points = rule.points()
        self.reset()

    def reset(self, env: gym.Env[Any, Any] | None = None, info: Mapping[str, Any] | None = None) -> None:  # noqa: ARG002  part of the protocol
        """Start an episode; nothing is read from the environment."""
        self.failure = ""
        self._changes, self._tries = Changes(), Counter[str]()

    def decide(self, observation: Mapping[str, NDArray[Any]]) -> Contact | None:
        """The next contact; None if the target is held or no contact is left."""
        return self.choose(observed_scene(observation))

    def choose(self, scene: ObservedScene) -> Contact | None:
        """As `decide`, for a scene that has been read already."""
        if self._changes.have_moved(scene):
            self._tries.clear()
        if scene.held_index == scene.target:
            return None
        found = self._pick(scene) if scene.held is None else self._place(scene)
        if found is None:
            self.failure = "no contact is left to choose"
        return found

    def _pick(self, scene: ObservedScene) -> Contact | None:
        picks = self.rule.picks(scene.bodies)
        turning = _turning(picks)
        standing, best = are_standing(scene), []
        for index in np.flatnonzero(standing):
            rows = np.flatnonzero(picks.index == index)
            tries = self._tries[scene.bodies[index].name]
            if tries < len(rows):
                row = int(rows[np.argsort(turning[rows], kind="stable")[tries]])
                away = np.linalg.norm(scene.bodies[index].position - scene.bodies[scene.target].position)
                best.append((tries, float(away), row))
        return None if not best else self._contact(picks, min(best)[2], "pick", scene)

    def _place(self, scene: ObservedScene) -> Contact | None:
        assert scene.held is not None
        body, rows = scene.bodies[scene.held_index], object_rows(scene.bodies)
        places = self.rule.places(body, scene.held, self._points)
        others = rows[are_standing(scene)]
        way = np.linalg.norm(self._points[:, :2] - scene.base[:2], axis=1)
        cost = way + _CROWDED * crowding(self._points, body.radius, others)
        order = np.argsort(cost[places.index] + _turning(places), kind="stable")
        tries = self._tries[_PLACING]
        return None if tries >= len(order) else self._contact(places, int(order[tries]), "place", scene)

    def _contact(self, choices: ContactChoices, row: int, skill: str, scene: ObservedScene) -> Contact:
        index = choices.index[row] if skill == "pick" else scene.held_index
        name = scene.bodies[index].name
        self._tries[name if skill == "pick" else _PLACING] += 1
        return choices.contact(row, skill, name)


_PLACING = "a place"
"""What tries to put the held object down are counted under; no object has this name."""


def _turning(choices: ContactChoices) -> NDArray[np.float64]:
    """(m,) How far base and gripper are turned."""
    return np.asarray(np.abs(choices.turn) + _YAW_COST * np.abs(choices.base[:, 2]))
