"""Rollouts of a high-level policy without physics: how good its decisions are, and examples from the visited states.

A pick or place that is free by the planner's geometry is assumed to succeed: the object is then in the gripper, or
stands where it was to be put. Any other one ends the rollout. Labelling the visited states is DAgger (Ross et al.
2011): choosing the best of many candidates finds those that the network is wrong about.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any, NamedTuple, Protocol

import gymnasium as gym
import numpy as np

from clutter_env.policies.high_level.candidates import CandidateRule, Candidates, ObservedScene
from clutter_env.training.high_level_examples import (
    CandidateExamples,
    label_picks,
    label_places,
    pick_examples,
    place_examples,
    random_points,
    scene_of,
)
from planners import Body, CollisionWorld, Contact, HeldObject, Scene, stand_at


class Chooser(Protocol):
    """Chooses picks and places: `LearnedHighLevelPolicy`."""

    def reset(self) -> None:
        """Start an episode."""

    def choose(self, scene: ObservedScene) -> Contact | None:
        """The next pick or place; None to give up."""


class Rollout(NamedTuple):
    """An episode without physics.

    Attributes:
        failure: "" if the target is taken; else "pick: not reached", "pick: blocked", the same with "place", "gave up"
            or "budget".
        clearances: objects put aside.
        scenes: the states in which a decision was made.
        contacts: the decisions.
    """

    failure: str
    clearances: int
    scenes: tuple[Scene, ...]
    contacts: tuple[Contact, ...]


def initial_scenes(env: gym.Env[Any, Any], seeds: Sequence[int]) -> Iterator[tuple[Scene, str]]:
    """The scenes of some seeds, and the names of their targets."""
    for seed in seeds:
        _, info = env.reset(seed=seed)
        yield scene_of(env), str(info["target"])


def roll_out(chooser: Chooser, scene: Scene, target: str, budget: int = 8) -> Rollout:
    """Let a high-level policy decide in a scene.

    Args:
        chooser: the policy.
        scene: at the start; nothing is held.
        target: name of the object wanted.
        budget: clearances at most.
    """
    chooser.reset()
    scenes: list[Scene] = []
    chosen: list[Contact] = []
    failure = "budget"
    while len(chosen) < 2 * budget + 1:
        contact = chooser.choose(as_observed(scene, target))
        if contact is None:
            failure = "gave up"
            break
        scenes.append(scene)
        chosen.append(contact)
        if problem := why_not_free(scene, contact):
            failure = f"{contact.skill}: {problem}"
            break
        scene = after_contact(scene, contact)
        if scene.held is not None and scene.held.name == target:
            failure = ""
            break
    clearances = sum(contact.skill == "place" for contact in chosen) - failure.startswith("place")
    return Rollout(failure, clearances, tuple(scenes), tuple(chosen))


def visited_examples(
    rollouts: Sequence[Rollout], rule: CandidateRule, rng: np.random.Generator
) -> CandidateExamples | None:
    """Examples from the states in which decisions were made; None if there were none.

    Args:
        rollouts: of the learner.
        rule: the candidates that are labelled.
        rng: for more places beside those that it chose.
    """
    parts = []
    for rollout in rollouts:
        for scene, contact in zip(rollout.scenes, rollout.contacts, strict=True):
            if scene.held is None:
                parts.append(pick_examples(scene, rule, rng))
            else:
                body = placed_body(scene, contact)
                points = np.concatenate((body.foot[None], random_points(scene, body.radius, rng)))
                parts.append(place_examples(scene, rule, points, rng))
    return CandidateExamples.joined(parts) if parts else None


def as_observed(scene: Scene, target: str) -> ObservedScene:
    """The scene as an observation would show it."""
    held = -1 if scene.held is None else scene.index(scene.held.name)
    return ObservedScene(np.array(scene.state.base), scene.objects, scene.index(target), scene.held, held)


def why_not_free(scene: Scene, contact: Contact) -> str:
    """Why a pick or place is not free, "not reached" or "blocked"; "" if it is."""
    pitch = math.atan2(-contact.tcp[2, 0], contact.tcp[2, 2])
    tcp = np.array([[*contact.tcp[:3, 3], contact.yaw, pitch]])
    index = np.array([scene.index(contact.object) if contact.skill == "pick" else 0])
    candidate = Candidates(index, tcp, contact.base[None], np.array([contact.yaw - contact.base[2]]))
    world = CollisionWorld.from_scene(scene)
    if contact.skill == "pick":
        labels = label_picks(world, candidate)
    else:
        labels = label_places(world, candidate, placed_body(scene, contact).foot[None])
    if not labels.is_reached[0]:
        return "not reached"
    return "" if labels.blockers[0] == 0 else "blocked"


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
