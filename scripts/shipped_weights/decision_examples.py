"""Examples for the high-level policy: candidate picks and places, and what stands in their way.

They are collected from random scenes without physics and without planning a motion. By the planner's geometry a
candidate is free if some arm configuration reaches it that touches nothing; of several, the one that touches the fewest
objects counts.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from clutter_env.policies.high_level.candidates import CandidateRule, Candidates, ObservedScene, object_rows
from clutter_env.policies.high_level.policy import LearnedHighLevelPolicy
from clutter_env.training.grasp_labels import label, scene_of
from planners import (
    Body,
    Contact,
    HeldObject,
    Scene,
    stand_at,
)
from scripts.shipped_weights.descent import ExampleArrays

Array = NDArray[np.float64]

_PLACES = 12
"""Random places for a random object, in every scene."""
_SHARE = 0.25
"""Share of the candidates of a scene that are labelled: more scenes teach more than more candidates of one."""


@dataclass(frozen=True, eq=False)
class CandidateExamples(ExampleArrays):
    """m candidates in s scenes of at most n objects.

    Attributes:
        objects: (s, n, 5) `OBJECT_COLUMNS`; rows of absent objects, and of the one that is held, have radius 0.
        scene: (m,) index of the scene of each candidate.
        own: (m, 5) the object that is taken or put down, as it stands there.
        own_index: (m,) its index in the scene.
        tcp: (m, 5) x, y, z [m], yaw and pitch [rad] of the TCP.
        base: (m, 3) x [m], y [m], yaw [rad].
        is_reached: (m,) see `Labels`.
        blockers: (m, n) whether each object is in the way.
    """

    objects: NDArray[np.float32]
    scene: NDArray[np.int32]
    own: NDArray[np.float32]
    own_index: NDArray[np.int16]
    tcp: NDArray[np.float32]
    base: NDArray[np.float32]
    is_reached: NDArray[np.bool_]
    blockers: NDArray[np.bool_]

    @classmethod
    def joined(cls, parts: Sequence[CandidateExamples]) -> CandidateExamples:
        """Join several, the scenes numbered anew."""
        firsts = np.cumsum([0, *(len(part.objects) for part in parts[:-1])])
        return super().joined(
            [replace(part, scene=part.scene + np.int32(first)) for part, first in zip(parts, firsts, strict=True)]
        )


def examples_of(
    scene: Scene, rule: CandidateRule, rng: np.random.Generator, points: Array | None = None
) -> CandidateExamples:
    """A random share of a scene's candidate picks; or, at points (k, 3), of the candidate places of what is held."""
    rows = object_rows(scene.objects)
    if points is None:
        bodies, candidates = scene.objects, rule.picks(scene.objects)
    else:
        assert scene.held is not None
        held = scene.index(scene.held.name)
        bodies = tuple(stand_at(scene.objects[held], point) for point in points)
        candidates = rule.places(scene.objects[held], scene.held, points)
        rows[held] = 0.0
    candidates = candidates.take(rng.random(len(candidates)) < _SHARE)
    labels = label(scene, candidates, bodies)
    bits = np.arange(len(rows), dtype=np.uint64)
    own_index = candidates.index if points is None else np.full(len(candidates), held)
    return CandidateExamples(
        objects=rows[None],
        scene=np.zeros(len(candidates), np.int32),
        own=object_rows(bodies)[candidates.index],
        own_index=own_index.astype(np.int16),
        tcp=candidates.tcp.astype(np.float32),
        base=candidates.base.astype(np.float32),
        is_reached=labels.is_reached,
        blockers=(labels.blockers[:, None] >> bits & np.uint64(1)).astype(np.bool_),
    )


def random_points(scene: Scene, radius: float, rng: np.random.Generator) -> Array:
    """Random points (k, 3) [m] on the first support where an object of that radius does not stick out."""
    support = scene.support
    low, high = support.lower[:2] + radius, support.upper[:2] - radius
    return np.column_stack((rng.uniform(low, high, (_PLACES, 2)), np.full(_PLACES, support.top)))


def examples_of_scene(scene: Scene, rule: CandidateRule, rng: np.random.Generator) -> CandidateExamples:
    """Candidate picks of every object and, as if one of them were held, candidates for random places.

    Nothing is held in the scene; the object, how it is held and the places are drawn at random.
    """
    picks = rule.picks(scene.objects)
    parts = [examples_of(scene, rule, rng)]
    if len(picks):
        row = int(rng.integers(len(picks)))
        body = scene.objects[picks.index[row]]
        held = HeldObject(body.name, np.linalg.inv(picks.contact(row, "pick", body.name).tcp) @ body.pose)
        parts.append(examples_of(scene.with_held(held), rule, rng, random_points(scene, body.radius, rng)))
    return CandidateExamples.joined(parts)


class Rollout(NamedTuple):
    """An episode without physics.

    Attributes:
        failure: "" if the target is taken; else "pick: not reached", "pick: blocked", the same with "place", "gave up"
            or "budget".
        clearances: objects put aside.
        decisions: the states in which a decision was made, and the decisions.
    """

    failure: str
    clearances: int
    decisions: tuple[tuple[Scene, Contact], ...]


def initial_scenes(env: gym.Env[Any, Any], seeds: Sequence[int]) -> Iterator[tuple[Scene, str]]:
    """The scenes of some seeds, and the names of their targets."""
    for seed in seeds:
        _, info = env.reset(seed=seed)
        yield scene_of(env), str(info["target"])


def roll_out(policy: LearnedHighLevelPolicy, scene: Scene, target: str, budget: int = 8) -> Rollout:
    """Let a high-level policy decide in a scene, without physics.

    A pick or place that is free by the planner's geometry is assumed to succeed: the object is then in the gripper, or
    stands where it was to be put. Any other one ends the rollout, and so do `budget` clearances.
    """
    policy.reset()
    decisions: list[tuple[Scene, Contact]] = []
    failure = "budget"
    while len(decisions) < 2 * budget + 1:
        contact = policy.choose(as_observed(scene, target))
        if contact is None:
            failure = "gave up"
            break
        decisions.append((scene, contact))
        if problem := why_not_free(scene, contact):
            failure = f"{contact.skill}: {problem}"
            break
        scene = after_contact(scene, contact)
        if scene.held is not None and scene.held.name == target:
            failure = ""
            break
    clearances = sum(contact.skill == "place" for _, contact in decisions) - failure.startswith("place")
    return Rollout(failure, clearances, tuple(decisions))


def visited_examples(
    rollouts: Iterable[Rollout], rule: CandidateRule, rng: np.random.Generator
) -> Iterator[CandidateExamples]:
    """Examples from the states in which decisions were made.

    Labelling the visited states is DAgger (Ross et al. 2011): choosing the best of many candidates finds those that the
    network is wrong about. Beside the places that it chose random ones are labelled.
    """
    for scene, contact in (decision for rollout in rollouts for decision in rollout.decisions):
        points = None
        if scene.held is not None:
            body = placed_body(scene, contact)
            points = np.concatenate((body.foot[None], random_points(scene, body.radius, rng)))
        yield examples_of(scene, rule, rng, points)


def as_observed(scene: Scene, target: str) -> ObservedScene:
    """The scene as an observation would show it."""
    held = -1 if scene.held is None else scene.index(scene.held.name)
    return ObservedScene(np.array(scene.state.base), scene.objects, scene.index(target), scene.held, held)


def why_not_free(scene: Scene, contact: Contact) -> str:
    """Why a pick or place is not free, "not reached" or "blocked"; "" if it is."""
    pitch = math.atan2(-contact.tcp[2, 0], contact.tcp[2, 2])
    tcp = np.array([[*contact.tcp[:3, 3], contact.yaw, pitch]])
    body = scene.body(contact.object) if contact.skill == "pick" else placed_body(scene, contact)
    candidate = Candidates(np.zeros(1, int), tcp, contact.base[None], np.array([contact.yaw - contact.base[2]]))
    labels = label(scene, candidate, [body])
    if not labels.is_reached[0]:
        return "not reached"
    return "" if labels.is_free[0] else "blocked"


def after_contact(scene: Scene, contact: Contact) -> Scene:
    """The scene after a pick or place that succeeds."""
    state = replace(scene.state, base=contact.base)
    if contact.skill == "pick":
        T_tcp_object = np.linalg.inv(contact.tcp) @ scene.body(contact.object).pose
        return scene.with_state(state).with_held(HeldObject(contact.object, T_tcp_object))
    return scene.with_held(None).with_body(placed_body(scene, contact)).with_state(state)


def placed_body(scene: Scene, contact: Contact) -> Body:
    """The held object as it stands after a place."""
    assert scene.held is not None
    body = scene.body(scene.held.name)
    position = (contact.tcp @ scene.held.T_tcp_object)[:3, 3]
    return stand_at(body, np.array((*position[:2], scene.support.top)))
