"""A decider that has learned: it chooses the next contact from observations alone."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
import torch
from numpy.typing import NDArray

from clutter_env.learning.decisions.clearing import RISK, Costs, clearing_costs
from clutter_env.learning.decisions.contact_rule import ContactChoices, ContactRule, crowding
from clutter_env.learning.decisions.examples import object_rows
from clutter_env.learning.decisions.model_file import DecisionModel
from clutter_env.learning.decisions.network import ContactBatch, ContactNetwork
from clutter_env.learning.decisions.observed import Changes, ObservedScene, are_standing, observed_scene
from planners import Contact

__all__ = ["LearnedDecider"]

Array = NDArray[np.float64]

_LEAST_REACH = 0.2
"""Contacts that are reached with a smaller probability are not considered."""
_TURN_COST = 0.03 / math.radians(20)
"""[clearances / rad] of the gripper's yaw against the base's: straight contacts are preferred among equals."""
_DRIVE_COST = 0.02
"""[clearances / m] of the way of the base."""
_WIDEST_PLACING_TURN = math.radians(20.0) + 1e-6
"""Objects are put down straight or nearly so: there are places enough."""
_BEST_CONTACTS = 12
"""Contacts of each object that are looked at when it is worked out what a place would be in the way of."""
_DETOUR = 0.5
"""[clearances] by which the best object to begin with may seem worse than the chain of clearances as a whole."""
_PLACED_COST = 2.0
"""[clearances] of clearing an object that has been put in the way."""
_MARGIN, _MARGIN_WORTH = 0.008, 0.1
"""[m] by which other objects are also imagined to be thicker, and the weight of what is then in the way: a mover is not
exact, so contacts with room around them are preferred."""
_ROOM_COST = 0.5
"""[clearances] of a place without any room around it."""
_DETOUR = 0.5
"""[clearances] by which the best object to begin with may seem worse than the chain of clearances as a whole."""
_PLACED_COST = 2.0
"""[clearances] of clearing an object that has been put in the way."""
_MARGIN, _MARGIN_WORTH = 0.008, 0.1
"""[m] by which other objects are also imagined to be thicker, and the weight of what is then in the way: a mover is not
exact, so contacts with room around them are preferred."""
_ROOM, _ROOM_COST = 0.08, 0.5
"""[m] of free space around a place that is worth a cost [clearances]."""


class _Tried(NamedTuple):
    """What a contact that was decided for is known by: object, place [m], gripper yaw, pitch and turn [rad]."""

    skill: str
    object: str
    x: float
    y: float
    yaw: float
    pitch: float
    turn: float


class _Judged(NamedTuple):
    """Contacts (m) that may be reached, with the cost of each whatever stands in its way, and what may stand there."""

    choices: ContactChoices
    fixed: Array
    blocks: Array


class LearnedDecider:
    """Chooses the object to take next and from where, and where to put down the one that is held.

    After a miss, which it sees by an empty gripper, it decides again without the contacts tried since an object moved.

    Attributes:
        rule: the contacts that it chooses from.
        failure: why it gave up, "" if it did not.
    """

    def __init__(self, network: ContactNetwork, rule: ContactRule) -> None:
        self.rule = rule
        self._network = network.eval()
        self._points = rule.points()
        self.reset()

    @classmethod
    def load(cls, path: Path) -> LearnedDecider:
        """The decider with the weights of a file.

        Raises:
            LearningError: there is no such file, or it is not one of a learned decider.
        """
        model = DecisionModel.load(path)
        return cls(model.network, model.rule)

    def reset(self, env: gym.Env[Any, Any] | None = None, info: Mapping[str, Any] | None = None) -> None:  # noqa: ARG002  part of the protocol
        """Start an episode; nothing is read from the environment."""
        self.failure = ""
        self._tried: set[_Tried] = set()
        self._changes = Changes()

    def decide(self, observation: Mapping[str, NDArray[Any]]) -> Contact | None:
        """The next contact; None if the target is held or no contact is left."""
        return self.choose(observed_scene(observation))

    def choose(self, scene: ObservedScene) -> Contact | None:
        """As `decide`, for a scene that has been read already."""
        if self._changes.have_moved(scene):
            self._tried.clear()
        if scene.held is None:
            found = self._pick(scene)
        elif scene.held_index == scene.target:
            return None
        else:
            found = self._place(scene)
        if found is None:
            self.failure = "no contact is left to choose"
            return None
        choices, row, name = found
        skill = "pick" if scene.held is None else "place"
        self._tried.add(_tried(choices, row, skill, name))
        return choices.contact(row, skill, name)

    def _pick(self, scene: ObservedScene) -> tuple[ContactChoices, int, str] | None:
        """Take the target if that costs less than clearing; else the object after which the least is left to do."""
        judged = _best_of_each(self._judge_picks(scene))
        index, count = judged.choices.index, len(scene.bodies)
        if not (index == scene.target).any():
            return None
        without = np.repeat(judged.blocks[None], count, axis=0)
        without[np.arange(count), :, np.arange(count)] = 0.0
        now = clearing_costs(index, judged.fixed, judged.blocks[None])
        after = clearing_costs(index, judged.fixed, without).objects[:, scene.target]
        directly = judged.fixed + RISK * judged.blocks.sum(axis=1)
        left = 1.0 + after[index] + directly
        left[index == scene.target] = directly[index == scene.target]
        row = int(left.argmin())
        if left[row] > now.objects[0, scene.target] + _DETOUR:
            row = _first_of_chain(judged.choices, now, scene.target)
        return judged.choices, row, scene.bodies[index[row]].name

    def _place(self, scene: ObservedScene) -> tuple[ContactChoices, int, str] | None:
        assert scene.held is not None
        name, held = scene.held.name, scene.held_index
        points = self._points
        choices = self.rule.places(scene.bodies[held], scene.held, points)
        choices = choices.take(np.abs(choices.turn) < _WIDEST_PLACING_TURN)
        rows = object_rows(scene.bodies)
        placed = np.repeat(rows[held][None], len(points), axis=0)
        placed[:, :2], placed[:, 2] = points[:, :2], points[:, 2]
        standing = are_standing(scene)
        judged = self._judge(scene, choices, placed[choices.index], rows, np.full(len(choices), held), standing)
        judged = self._without_tried(judged, "place", [name] * len(points))
        if not len(judged.choices):
            return None
        cost = judged.fixed + RISK * (1.0 - np.prod(1.0 - judged.blocks, axis=1))
        cost += _ROOM_COST * crowding(points, rows[held, 3], rows[standing])[judged.choices.index]
        index = np.unique(judged.choices.index)
        after = self._costs_after(scene, placed[index])
        cost += after[np.searchsorted(index, judged.choices.index)]
        return judged.choices, int(cost.argmin()), name

    def _costs_after(self, scene: ObservedScene, placed: NDArray[np.float32]) -> Array:
        """(k,) Costs of taking the target once the held object stands at each of k places."""
        judged = _best_of_each(self._judge_picks(scene))
        choices, held = judged.choices, scene.held_index
        if not len(choices):
            return np.zeros(len(placed))
        rows = object_rows(scene.bodies)
        others = np.repeat(placed[None], len(choices), axis=0)
        own = rows[choices.index]
        in_way = self._in_the_way(choices, own, others, np.ones(others.shape[:2], np.bool_)).T
        blocks = np.repeat(judged.blocks[None], len(placed), axis=0)
        blocks[:, :, held] = in_way
        known = np.full(len(rows), np.nan)
        known[held] = _PLACED_COST
        return clearing_costs(choices.index, judged.fixed, blocks, known).objects[:, scene.target]

    def _judge_picks(self, scene: ObservedScene) -> _Judged:
        """The contacts at which the objects that stand, and are not held, can be taken."""
        rows = object_rows(scene.bodies)
        standing = are_standing(scene)
        choices = self.rule.picks(scene.bodies)
        choices = choices.take(standing[choices.index])
        judged = self._judge(scene, choices, rows[choices.index], rows, choices.index, standing)
        return self._without_tried(judged, "pick", [body.name for body in scene.bodies])

    def _judge(
        self,
        scene: ObservedScene,
        choices: ContactChoices,
        own: NDArray[np.float32],
        rows: NDArray[np.float32],
        own_index: NDArray[np.int64],
        standing: NDArray[np.bool_],
    ) -> _Judged:
        none = _batch(choices, own, rows[None, :0].repeat(len(choices), 0), np.ones((len(choices), 0), np.bool_))
        with torch.no_grad():
            reach = torch.sigmoid(self._network.reach_logits(none)).numpy().astype(float)
        likely = np.flatnonzero(reach > _LEAST_REACH)
        choices, reach = choices.take(likely), reach[likely]
        is_present = np.tile(standing, (len(likely), 1))
        is_present[np.arange(len(likely)), own_index[likely]] = False
        blocks = self._in_the_way(choices, own[likely], rows[None].repeat(len(likely), 0), is_present)
        way = np.linalg.norm(choices.base[:, :2] - scene.base[:2], axis=1)
        fixed = RISK * (1.0 - reach) + _TURN_COST * np.abs(choices.turn) + _DRIVE_COST * way
        return _Judged(choices, fixed, blocks)

    def _in_the_way(
        self,
        choices: ContactChoices,
        own: NDArray[np.float32],
        others: NDArray[np.float32],
        is_present: NDArray[np.bool_],
    ) -> Array:
        """(m, k) Probabilities that others (m, k, 5) are in the way of contacts, with room for an inexact mover."""
        thicker = others + np.array((0, 0, 0, _MARGIN, 0), np.float32)
        with torch.no_grad():
            exact, padded = (
                torch.sigmoid(self._network(_batch(choices, own, rows, is_present)).blocks).numpy().astype(float)
                for rows in (others, thicker)
            )
        return np.asarray(exact + _MARGIN_WORTH * np.maximum(padded - exact, 0.0))

    def _without_tried(self, judged: _Judged, skill: str, names: list[str]) -> _Judged:
        if not self._tried:
            return judged
        name = (names[index] for index in judged.choices.index)
        kept = np.array([_tried(judged.choices, row, skill, one) not in self._tried for row, one in enumerate(name)])
        return _Judged(judged.choices.take(kept), judged.fixed[kept], judged.blocks[kept])


def _first_of_chain(choices: ContactChoices, costs: Costs, target: int) -> int:
    """The contact to begin with where several objects have to be cleared for each other: that of the first of them."""
    taken, seen, row = target, set[int](), 0
    while taken not in seen:
        seen.add(taken)
        rows = np.flatnonzero(choices.index == taken)
        row = int(rows[costs.contacts[0, rows].argmin()])
        before = [int(i) for i in np.flatnonzero(costs.is_cleared[0, row]) if (choices.index == i).any()]
        if not before:
            break
        taken = min(before, key=lambda i: float(costs.objects[0, i]))
    return row


def _best_of_each(judged: _Judged) -> _Judged:
    """The contacts of each object with the least risk of touching anything."""
    risk = judged.fixed + RISK * judged.blocks.sum(axis=1)
    order = np.lexsort((risk, judged.choices.index))
    index = judged.choices.index[order]
    rank = np.arange(len(index)) - np.searchsorted(index, index)
    kept = order[rank < _BEST_CONTACTS]
    return _Judged(judged.choices.take(kept), judged.fixed[kept], judged.blocks[kept])


def _tried(choices: ContactChoices, row: int, skill: str, name: str) -> _Tried:
    x, y, _, yaw, pitch = (round(float(value), 2) for value in choices.tcp[row])
    place = (x, y) if skill == "place" else (0.0, 0.0)
    return _Tried(skill, name, *place, yaw, pitch, round(float(choices.turn[row]), 2))


def _batch(
    choices: ContactChoices,
    own: NDArray[np.float32],
    others: NDArray[np.float32],
    is_present: NDArray[np.bool_],
) -> ContactBatch:
    arrays = (own, choices.tcp.astype(np.float32), choices.base.astype(np.float32), others, is_present)
    return ContactBatch(*(torch.from_numpy(np.ascontiguousarray(array)) for array in arrays))
