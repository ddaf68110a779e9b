"""The learned high-level policy: it chooses the next pick or place from observations alone."""

from __future__ import annotations

import logging
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray

import assets
from clutter_env.envs.base import layout_identity, robot_identity
from clutter_env.policies.high_level.candidates import (
    CandidateRule,
    Candidates,
    ObservedScene,
    crowding,
    object_rows,
    observed_scene,
)
from clutter_env.policies.high_level.network import CandidateBatch, CandidateNetwork
from clutter_env.policies.parsed_observation import Observation
from clutter_env.policies.protocol import PublicInfo
from clutter_env.policies.weights import WeightsInfo, damage_refused, load_weights
from clutter_env.scene.layout import find_layout
from clutter_env.scene.object_sets import OBJECT_SETS
from planners import Body, Contact

Array = NDArray[np.float64]
Rows = NDArray[np.float32]

_LOG = logging.getLogger(__name__)
_TRAINED_WITH = OBJECT_SETS["standard"]
"""The weights of both levels are trained with cylinders of this set."""
_SIZE_TOLERANCE = 0.005
"""[m] by which sizes may lie outside."""
_MIN_REACH = 0.2
"""Candidates that are reached with a smaller probability are not considered."""
_TURN_COST = 0.03 / math.radians(20)
"""[clearances / rad] of the gripper's yaw against the base's: straight grasps are preferred among equals."""
_DRIVE_COST = 0.02
"""[clearances / m] of the distance that the base drives."""
_MAX_PLACING_TURN = math.radians(20.0) + 1e-6
"""Objects are put down straight or nearly so: enough places exist."""
_BEST = 12
"""Candidates of each object that are checked to find the objects that a place would obstruct."""
_DETOUR = 0.5
"""[clearances] by which the best object to begin with may seem worse than the chain of clearances as a whole."""
_PLACED_COST = 2.0
"""[clearances] of clearing an object that has been put in the way."""
_MARGIN, _MARGIN_WORTH = 0.008, 0.1
"""[m] Thickness added to other objects, and weight of the additional collisions. Motions are inexact, so candidates
with clearance around them are preferred."""
_CROWDING_COST = 0.5
"""[clearances] of a place without any clearance around it."""
_MOVED = 0.01
"""[m] An object that is farther than this from where it was has moved."""
MAX_COST = 12.0
"""[clearances] Cost of an object that cannot be taken."""
RISK = 10.0
"""[clearances] Cost of a candidate that certainly fails."""
_AT_ONCE = 32
"""Candidate places that are judged together, those first that may be the best."""
_ROUNDS = 12
"""Rounds at most: a chain of clearances is hardly ever longer."""


class _Weighed(NamedTuple):
    """Candidates (m) that may be reached, the cost (m,) of each whatever stands in its way, and (m, n) what may."""

    candidates: Candidates
    fixed: Array
    blocks: Array

    def take(self, rows: NDArray[np.generic]) -> _Weighed:
        """Some of them."""
        return _Weighed(self.candidates.take(rows), self.fixed[rows], self.blocks[rows])

    @property
    def risk(self) -> Array:
        """(m,) cost of trying each as things stand."""
        return np.asarray(self.fixed + RISK * self.blocks.sum(axis=1))


class LearnedHighLevelPolicy:
    """Chooses the object to pick next and from where, and where to place the held object.

    After a failure, which it sees by an empty gripper, it decides again. What it tried with an object it does not try
    again until that object has moved.

    Attributes:
        info: robot, layout and grasps that it was trained for.
        rule: the candidates that it chooses from.
        failure: why it gave up, "" if it did not.
    """

    def __init__(self, network: CandidateNetwork, rule: CandidateRule, info: WeightsInfo | None = None) -> None:
        self.rule = rule
        self.info = info or WeightsInfo(
            "decisions", robot_identity(rule.robot), layout_identity(rule.layout), rule.grasps
        )
        self._network = network.eval()
        self._points = rule.points()
        self._has_warned = False
        self.reset()

    @classmethod
    def load(cls, path: Path) -> LearnedHighLevelPolicy:
        """Load the policy from a file of weights. Raise `PolicyError`, see `load_weights`."""
        weights, info = load_weights(path, "decisions")
        with damage_refused(path):
            network = CandidateNetwork(len(weights["contact.bias"]))
            network.load_state_dict(weights)
            rule = CandidateRule(assets.robot(info.robot), find_layout(info.layout), info.grasps)
        return cls(network, rule, info)

    def check(self, public: PublicInfo) -> None:
        """Refuse an environment with another robot or layout (`PolicyError`)."""
        self.info.check(public)

    def reset(self, info: Mapping[str, Any] | None = None) -> None:  # noqa: ARG002  part of the protocol
        """Start an episode."""
        self.failure = ""
        self._tried: set[tuple[object, ...]] = set()
        self._positions: dict[str, Array] = {}

    def decide(self, observation: Observation) -> Contact | None:
        """The next pick or place, None if the target is held or no candidate is left."""
        return self.choose(observed_scene(observation))

    def choose(self, scene: ObservedScene) -> Contact | None:
        """The next pick or place in a parsed scene, see `decide`."""
        others = [body.name for body in scene.bodies if not _is_trained_with(body)]
        if others and not self._has_warned:
            self._has_warned = True
            _LOG.warning("%s, trained with standard cylinders alone: here are also %s", self.info, ", ".join(others))
        before, self._positions = self._positions, {body.name: body.position for body in scene.bodies}
        now = self._positions
        moved = {name for name in now if np.linalg.norm(now[name] - before.get(name, now[name])) > _MOVED}
        self._tried = {key for key in self._tried if key[1] not in moved}
        if scene.held is not None and scene.held_index == scene.target:
            return None
        found = self._pick(scene) if scene.held is None else self._place(scene)
        if found is None:
            self.failure = "no contact is left to choose"
            return None
        candidates, row, name = found
        skill = "pick" if scene.held is None else "place"
        self._tried.add(_key(candidates, row, skill, name))
        return candidates.contact(row, skill, name)

    def _pick(self, scene: ObservedScene) -> tuple[Candidates, int, str] | None:
        """Pick the target if that costs less than a clearance, else the object whose removal leaves the least work."""
        weighed = _best_of_each(self._weigh_picks(scene))
        index, count = weighed.candidates.index, len(scene.bodies)
        if not (index == scene.target).any():
            return None
        without = np.repeat(weighed.blocks[None], count, axis=0)
        without[np.arange(count), :, np.arange(count)] = 0.0
        now = clearing_costs(index, weighed.fixed, weighed.blocks[None])
        after = clearing_costs(index, weighed.fixed, without).objects[:, scene.target]
        left = 1.0 + after[index] + weighed.risk
        left[index == scene.target] = weighed.risk[index == scene.target]
        row = int(left.argmin())
        if left[row] > now.objects[0, scene.target] + _DETOUR:
            row = _first_of_chain(weighed.candidates, now, scene.target)
        return weighed.candidates, row, scene.bodies[index[row]].name

    def _place(self, scene: ObservedScene) -> tuple[Candidates, int, str] | None:
        """Put the held object where the least is left to do, itself in the way of nothing, with clearance around it."""
        assert scene.held is not None
        name, held, points, rows = scene.held.name, scene.held_index, self._points, object_rows(scene.bodies)
        placed = np.repeat(rows[held][None], len(points), axis=0)
        placed[:, :2], placed[:, 2] = points[:, :2], points[:, 2]
        candidates = self.rule.places(scene.bodies[held], scene.held, points)
        candidates = candidates.take(np.abs(candidates.turn) < _MAX_PLACING_TURN)
        reached = self._reached(scene, candidates, placed[candidates.index])
        candidates, fixed, _ = self._without_tried(reached, "place", [name] * len(points))
        index, picks = candidates.index, _best_of_each(self._weigh_picks(scene))
        crowded = _CROWDING_COST * crowding(points, rows[held, 3], rows[scene.is_standing])[index]
        least = fixed + crowded + self._costs_after(scene, picks, np.zeros((1, len(picks.candidates))))
        order, after, best, found = np.argsort(least, kind="stable"), np.full(len(points), np.nan), np.inf, -1
        for start in range(0, len(order), _AT_ONCE):  # until no other place can be better
            some = order[start : start + _AT_ONCE]
            if least[some[0]] >= best:
                break
            used = np.unique(index[some])
            used = used[np.isnan(after[used])]
            in_way = self._in_the_way(picks.candidates, rows[picks.candidates.index], placed[used])
            after[used] = self._costs_after(scene, picks, in_way.T)
            blocks = self._in_the_way(candidates.take(some), placed[index[some]], rows, scene.is_standing)
            cost = fixed[some] + RISK * (1.0 - np.prod(1.0 - blocks, axis=1)) + crowded[some] + after[index[some]]
            if cost.min() < best:
                best, found = float(cost.min()), int(some[cost.argmin()])
        return (candidates, found, name) if found >= 0 else None

    def _costs_after(self, scene: ObservedScene, picks: _Weighed, in_way: Array) -> Array:
        """(k,) Costs of taking the target once the held object is in the way of the picks (m,) as (k, m) says."""
        if not len(picks.candidates):
            return np.zeros(len(in_way))
        blocks = np.repeat(picks.blocks[None], len(in_way), axis=0)
        blocks[:, :, scene.held_index] = in_way
        known = np.full(len(scene.bodies), np.nan)
        known[scene.held_index] = _PLACED_COST
        return clearing_costs(picks.candidates.index, picks.fixed, blocks, known).objects[:, scene.target]

    def _weigh_picks(self, scene: ObservedScene) -> _Weighed:
        """Candidate picks of the objects that stand, and are not held."""
        candidates = self.rule.picks(scene.bodies)
        candidates = candidates.take(scene.is_standing[candidates.index])
        rows = object_rows(scene.bodies)
        candidates, fixed, _ = self._reached(scene, candidates, rows[candidates.index])
        is_present = np.tile(scene.is_standing, (len(candidates), 1))
        is_present[np.arange(len(candidates)), candidates.index] = False
        blocks = self._in_the_way(candidates, rows[candidates.index], rows, is_present)
        return self._without_tried(_Weighed(candidates, fixed, blocks), "pick", [body.name for body in scene.bodies])

    def _reached(self, scene: ObservedScene, candidates: Candidates, own: Rows) -> _Weighed:
        """Those that may be reached, of candidates with their own objects (m, 5) there, before what is in their way."""
        alone = _batch(candidates, own, own[:0], np.ones((len(candidates), 0), np.bool_))
        with torch.no_grad():
            reach = torch.sigmoid(self._network.reach_logits(alone)).numpy().astype(float)
        likely = np.flatnonzero(reach > _MIN_REACH)
        candidates, reach = candidates.take(likely), reach[likely]
        distance = np.linalg.norm(candidates.base[:, :2] - scene.base[:2], axis=1)
        fixed = RISK * (1.0 - reach) + _TURN_COST * np.abs(candidates.turn) + _DRIVE_COST * distance
        return _Weighed(candidates, fixed, np.empty((len(likely), 0)))

    def _in_the_way(self, candidates: Candidates, own: Rows, others: Rows, is_present: ArrayLike = True) -> Array:
        """(m, n) Probabilities that others (n, 5) are in the way, with a margin for motions that are not exact."""
        thicker = others + np.array((0, 0, 0, _MARGIN, 0), np.float32)
        shown = np.array(np.broadcast_to(is_present, (len(candidates), len(others))))
        with torch.no_grad():
            exact, padded = (
                torch.sigmoid(self._network(_batch(candidates, own, rows, shown))).numpy().astype(float)
                for rows in (others, thicker)
            )
        return np.asarray(exact + _MARGIN_WORTH * np.maximum(padded - exact, 0.0))

    def _without_tried(self, weighed: _Weighed, skill: str, names: list[str]) -> _Weighed:
        """Candidates that were not tried since their object moved. `names` maps `index` to the object's name."""
        tried, is_left = {key[:2] for key in self._tried}, np.ones(len(weighed.candidates), np.bool_)
        for row, i in enumerate(weighed.candidates.index):
            if (skill, names[i]) in tried:
                is_left[row] = _key(weighed.candidates, row, skill, names[i]) not in self._tried
        return weighed if is_left.all() else weighed.take(is_left)


def _is_trained_with(body: Body) -> bool:
    """Whether an object is a cylinder of a size that the weights are trained with."""
    sizes = ((body.half_extents[0], _TRAINED_WITH.radius), (2 * body.half_extents[2], _TRAINED_WITH.height))
    return body.shape == "cylinder" and all(
        low - _SIZE_TOLERANCE < size < high + _SIZE_TOLERANCE for size, (low, high) in sizes
    )


def _first_of_chain(candidates: Candidates, costs: Costs, target: int) -> int:
    """The candidate to begin with where objects have to be cleared for each other: that of the first of them."""
    taken, seen, row = target, set[int](), 0
    while taken not in seen:
        seen.add(taken)
        rows = np.flatnonzero(candidates.index == taken)
        row = int(rows[costs.candidates[0, rows].argmin()])
        before = [int(i) for i in np.flatnonzero(costs.is_cleared[0, row]) if (candidates.index == i).any()]
        if not before:
            break
        taken = min(before, key=lambda i: float(costs.objects[0, i]))
    return row


def _best_of_each(weighed: _Weighed) -> _Weighed:
    """The candidates of each object with the least risk of touching anything."""
    order = np.lexsort((weighed.risk, weighed.candidates.index))
    index = weighed.candidates.index[order]
    rank = np.arange(len(index)) - np.searchsorted(index, index)
    return weighed.take(order[rank < _BEST])


def _key(candidates: Candidates, row: int, skill: str, name: str) -> tuple[object, ...]:
    """Key of a tried candidate: skill, object, place [m], gripper yaw, pitch and turn [rad]."""
    x, y, _, yaw, pitch = (round(float(value), 2) for value in candidates.tcp[row])
    place = (x, y) if skill == "place" else (0.0, 0.0)
    return skill, name, *place, yaw, pitch, round(float(candidates.turn[row]), 2)


def _batch(candidates: Candidates, own: Rows, others: Rows, is_present: NDArray[np.bool_]) -> CandidateBatch:
    """A batch with the same others (n, 5) for all candidates."""
    others = others[None].repeat(len(candidates), axis=0)
    arrays = (own, candidates.tcp.astype(np.float32), candidates.base.astype(np.float32), others, is_present)
    return CandidateBatch(*(torch.from_numpy(np.ascontiguousarray(array)) for array in arrays))


class Costs(NamedTuple):
    """Costs [clearances] in k variants of a scene: (k, n) of taking each object, and (k, m) of each candidate.

    `is_cleared` (k, m, n): whether an object that may be in the way of a candidate had better be cleared first.
    """

    objects: Array
    candidates: Array
    is_cleared: NDArray[np.bool_]


def clearing_costs(own: NDArray[np.int64], fixed: Array, blocks: Array, known: Array | None = None) -> Costs:
    """Costs of m candidates of n objects: the clearances that are left, by value iteration over the objects.

    The cost of taking an object is that of its best candidate. At a candidate every object that may be in the way costs
    the lesser of two: the risk of touching it, or clearing it first, one clearance and what it takes to take that
    object. Costs start at `MAX_COST` and fall until they no longer change, as in Bellman-Ford. An object that stands in
    the way of two others that are both cleared is counted twice: the values are upper bounds of the clearances.

    Args:
        own: (m,) index of the object of each candidate.
        fixed: (m,) cost of a candidate whatever stands in its way.
        blocks: (k, m, n) probabilities that an object is in the way, 0 for its own.
        known: (n,) costs of objects that are known already, NaN for others.
    """
    variants, candidates, count = blocks.shape
    objects = np.full((variants, count), MAX_COST)
    order = np.argsort(own, kind="stable")
    present, first = np.unique(own[order], return_index=True)
    risk = RISK * blocks
    total = np.full((variants, candidates), MAX_COST)
    is_known = np.zeros(count, np.bool_) if known is None else ~np.isnan(known)
    for _ in range(_ROUNDS):
        if known is not None:
            objects[:, is_known] = known[is_known]
        total = fixed + np.minimum(risk, 1.0 + objects[:, None]).sum(axis=2)
        found = objects.copy()
        if candidates:
            found[:, present] = np.minimum(np.minimum.reduceat(total[:, order], first, axis=1), MAX_COST)
        if np.allclose(found, objects):
            break
        objects = found
    return Costs(objects, total, risk > 1.0 + objects[:, None])
