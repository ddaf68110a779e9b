"""Decisions without physics: whether the contacts chosen are free, and how many clearances it takes.

A contact that is free by the planner's geometry is assumed to succeed: an object is then in the gripper, or stands
where it was to be put. Any other contact ends the episode.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from clutter_env.learning.decisions.contact_rule import ContactChoices
from clutter_env.learning.decisions.labels import label_picks, label_places
from clutter_env.learning.decisions.observed import ObservedScene
from planners import Body, CollisionWorld, Contact, HeldObject, Scene, stand_at

__all__ = ["Chooser", "KinematicOutcome", "apply_contact", "as_observed", "is_contact_free", "simulate_decisions"]


class Chooser(Protocol):
    """What chooses contacts."""

    def reset(self) -> None:
        """Start an episode."""
        ...

    def choose(self, scene: ObservedScene) -> Contact | None:
        """The next contact; None to give up."""
        ...


@dataclass(frozen=True)
class KinematicOutcome:
    """How an episode without physics ended.

    Attributes:
        is_taken: whether the target is held.
        clearances: objects put aside.
        failure: "" if it is taken; else "pick: not reached", "pick: blocked", the same with "place", "gave up" or
            "budget".
        scenes: the states in which a decision was made.
        contacts: the decisions.
    """

    is_taken: bool
    clearances: int
    failure: str
    scenes: tuple[Scene, ...]
    contacts: tuple[Contact, ...]


def simulate_decisions(chooser: Chooser, scene: Scene, target: str, budget: int = 8) -> KinematicOutcome:
    """Let a chooser act on a scene.

    Args:
        chooser: chooses the contacts.
        scene: at the start; nothing is held.
        target: name of the object wanted.
        budget: clearances at most.
    """
    chooser.reset()
    scenes: list[Scene] = []
    chosen: list[Contact] = []

    def ended(failure: str) -> KinematicOutcome:
        """The outcome, as things stand."""
        clearances = sum(contact.skill == "place" for contact in chosen) - failure.startswith("place")
        return KinematicOutcome(not failure, clearances, failure, tuple(scenes), tuple(chosen))

    while len(chosen) < 2 * budget + 1:
        contact = chooser.choose(as_observed(scene, target))
        if contact is None:
            return ended("gave up")
        scenes.append(scene)
        chosen.append(contact)
        failure = is_contact_free(scene, contact)
        if failure:
            return ended(f"{contact.skill}: {failure}")
        scene = apply_contact(scene, contact)
        if scene.held is not None and scene.held.name == target:
            return ended("")
    return ended("budget")


def as_observed(scene: Scene, target: str) -> ObservedScene:
    """What an observation would show of a scene."""
    held = -1 if scene.held is None else scene.index(scene.held.name)
    slots = tuple(range(len(scene.objects)))
    return ObservedScene(np.array(scene.state.base), scene.objects, slots, scene.index(target), scene.held, held)


def is_contact_free(scene: Scene, contact: Contact) -> str:
    """Why a contact is not free, "not reached" or "blocked"; "" if it is."""
    pitch = math.atan2(-contact.tcp[2, 0], contact.tcp[2, 2])
    tcp = np.array([[*contact.tcp[:3, 3], contact.yaw, pitch]])
    index = np.array([scene.index(contact.object) if contact.skill == "pick" else 0])
    choice = ContactChoices(index, tcp, contact.base[None], np.array([contact.yaw - contact.base[2]]))
    world = CollisionWorld.from_scene(scene)
    if contact.skill == "pick":
        labels = label_picks(world, choice)
    else:
        labels = label_places(world, choice, placed_body(scene, contact).foot[None])
    if not labels.is_reached[0]:
        return "not reached"
    return "" if labels.blockers[0] == 0 else "blocked"


def apply_contact(scene: Scene, contact: Contact) -> Scene:
    """The scene after a contact that succeeds."""
    state = replace(scene.state, base=contact.base)
    if contact.skill == "pick":
        T_tcp_object = np.linalg.inv(contact.tcp) @ scene.body(contact.object).pose
        return scene.with_state(state).with_held(HeldObject(contact.object, T_tcp_object))
    return scene.with_held(None).with_body(placed_body(scene, contact)).with_state(state)


def placed_body(scene: Scene, contact: Contact) -> Body:
    """The held object as it stands after it is put down at a contact."""
    assert scene.held is not None
    body = scene.body(scene.held.name)
    position = (contact.tcp @ scene.held.T_tcp_object)[:3, 3]
    return stand_at(body, np.array((*position[:2], scene.support.top)))
