"""Examples of contacts and what stands in their way, collected from random scenes without physics."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from clutter_env.learning.decisions.contact_rule import ContactChoices, ContactRule
from clutter_env.learning.decisions.labels import ContactLabels, label_picks, label_places
from planners import Body, CollisionWorld, HeldObject, Scene, stand_at

__all__ = [
    "OBJECT_COLUMNS",
    "ContactExamples",
    "examples_of_scene",
    "object_rows",
    "pick_examples",
    "place_examples",
    "random_points",
    "scene_of",
]

OBJECT_COLUMNS = ("x", "y", "bottom", "radius", "height")
"""Of an object: position of its axis, height of its lowest point, radius and height, all [m] in the world."""
PLACES = 12
"""Random places for a random object, in every scene."""
SHARE = 0.25
"""Share of the contacts of a scene that are labelled: more scenes teach more than more contacts of one."""


@dataclass(frozen=True, eq=False)
class ContactExamples:
    """m contacts in s scenes of at most n objects.

    Attributes:
        objects: (s, n, 5) `OBJECT_COLUMNS`; rows of absent objects, and of the one that is held, have radius 0.
        scene: (m,) index of the scene of each contact.
        own: (m, 5) the object that is taken or put down, as it stands at the contact.
        own_index: (m,) its index in the scene.
        tcp: (m, 5) x, y, z [m], yaw and pitch [rad] of the TCP.
        base: (m, 3) x [m], y [m], yaw [rad].
        is_reached: (m,) see `ContactLabels`.
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

    def __len__(self) -> int:
        return len(self.scene)

    @classmethod
    def joined(cls, parts: Sequence[ContactExamples]) -> ContactExamples:
        """All of them in one, the scenes numbered anew."""
        firsts = np.cumsum([0, *(len(part.objects) for part in parts[:-1])])
        columns = {field.name: np.concatenate([getattr(part, field.name) for part in parts]) for field in fields(cls)}
        columns["scene"] = np.concatenate([part.scene + first for part, first in zip(parts, firsts, strict=True)])
        return cls(**columns)

    def save(self, path: Path) -> None:
        """Write them as a compressed npz file with an array for each attribute."""
        path.parent.mkdir(parents=True, exist_ok=True)
        np.savez_compressed(path, **{field.name: getattr(self, field.name) for field in fields(self)})

    @classmethod
    def load(cls, path: Path) -> ContactExamples:
        """What `save` wrote; raises `OSError` if there is no such file."""
        with np.load(path) as content:
            return cls(**{field.name: content[field.name] for field in fields(cls)})


def scene_of(env: gym.Env[Any, Any], held: str = "") -> Scene:
    """The planner's view of an environment, with exact poses (privileged)."""
    inner: Any = env.unwrapped
    return Scene.from_mujoco(inner.model, inner.data, inner.robot, held)


def object_rows(bodies: Iterable[Body]) -> NDArray[np.float32]:
    """`OBJECT_COLUMNS` (n, 5) of objects that stand."""
    rows = [(*body.position[:2], body.bottom, body.radius, body.top - body.bottom) for body in bodies]
    return np.array(rows, np.float32).reshape(-1, len(OBJECT_COLUMNS))


def pick_examples(scene: Scene, rule: ContactRule, rng: np.random.Generator, share: float = SHARE) -> ContactExamples:
    """A random share of the contacts at which the objects of a scene can be taken; nothing is held."""
    choices, rows = _some(rule.picks(scene.objects), rng, share), object_rows(scene.objects)
    labels = label_picks(CollisionWorld.from_scene(scene), choices)
    return _examples(rows, choices, labels, rows[choices.index], choices.index)


def place_examples(
    scene: Scene, rule: ContactRule, points: NDArray[np.float64], rng: np.random.Generator, share: float = SHARE
) -> ContactExamples:
    """A random share of the contacts at which the held object of a scene can be put down at points (k, 3) [m]."""
    assert scene.held is not None
    index = scene.index(scene.held.name)
    body, rows = scene.objects[index], object_rows(scene.objects)
    choices = _some(rule.places(body, scene.held, points), rng, share)
    labels = label_places(CollisionWorld.from_scene(scene), choices, points)
    rows[index] = 0.0
    own = object_rows(stand_at(body, point) for point in points)[choices.index]
    return _examples(rows, choices, labels, own, np.full(len(choices), index))


def random_points(scene: Scene, radius: float, rng: np.random.Generator, count: int = PLACES) -> NDArray[np.float64]:
    """Random points (k, 3) [m] on the first support where an object of that radius does not stick out."""
    support = scene.support
    low, high = support.lower[:2] + radius, support.upper[:2] - radius
    return np.column_stack((rng.uniform(low, high, (count, 2)), np.full(count, support.top)))


def examples_of_scene(scene: Scene, rule: ContactRule, rng: np.random.Generator) -> ContactExamples:
    """The contacts for taking every object and, as if one of them were held, those for random places.

    Args:
        scene: nothing is held.
        rule: the contacts to choose from.
        rng: chooses the object, how it is held and the places.
    """
    picks = rule.picks(scene.objects)
    parts = [pick_examples(scene, rule, rng)]
    if len(picks):
        row = int(rng.integers(len(picks)))
        body = scene.objects[picks.index[row]]
        held = HeldObject(body.name, np.linalg.inv(picks.contact(row, "pick", body.name).tcp) @ body.pose)
        parts.append(place_examples(scene.with_held(held), rule, random_points(scene, body.radius, rng), rng))
    return ContactExamples.joined(parts)


def _some(choices: ContactChoices, rng: np.random.Generator, share: float) -> ContactChoices:
    return choices.take(rng.random(len(choices)) < share)


def _examples(
    rows: NDArray[np.float32],
    choices: ContactChoices,
    labels: ContactLabels,
    own: NDArray[np.float32],
    own_index: NDArray[np.int64],
) -> ContactExamples:
    bits = np.arange(len(rows), dtype=np.uint64)
    return ContactExamples(
        objects=rows[None],
        scene=np.zeros(len(choices), np.int32),
        own=own,
        own_index=own_index.astype(np.int16),
        tcp=choices.tcp.astype(np.float32),
        base=choices.base.astype(np.float32),
        is_reached=labels.is_reached,
        blockers=(labels.blockers[:, None] >> bits & np.uint64(1)).astype(np.bool_),
    )
