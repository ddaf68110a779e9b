"""Demonstrations cut into motions: all steps that lead to one contact, and away from it."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from itertools import groupby
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clutter_env.learning.contacts.reading import Reading, read
from clutter_env.learning.demonstrations.episode import Episode
from clutter_env.learning.demonstrations.step_labels import CONTACT_SKILLS, StepLabels
from planners import Contact

__all__ = ["Motion", "cut", "motions_of"]

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Motion:
    """T steps of a demonstration that belong to one contact.

    Attributes:
        contact: which; its object is nameless.
        index: of the object's row in the observations.
        reading: of the observations before the actions, and of the one after the last: (T + 1, ...).
        actions: (T, 12) "joint" actions.
        phases: names (T).
        keyframes: (T, 12) base, torso and arm, finger position at the end of each step's phase.
    """

    contact: Contact
    index: int
    reading: Reading
    actions: Array
    phases: tuple[str, ...]
    keyframes: Array

    def runs(self) -> Iterator[tuple[str, slice]]:
        """Each phase, and its steps."""
        start = 0
        for phase, steps in groupby(self.phases):
            end = start + len(list(steps))
            yield phase, slice(start, end)
            start = end


def motions_of(episodes: Iterable[Episode]) -> Iterator[Motion]:
    """The motions of demonstrations, in order."""
    for episode in episodes:
        yield from cut(episode.observations, episode.actions, episode.labels)


def cut(observations: Mapping[str, NDArray[Any]], actions: NDArray[Any], labels: StepLabels) -> Iterator[Motion]:
    """The motions of an episode of T steps; steps without a contact are left out.

    Args:
        observations: (T + 1, ...) by name.
        actions: (T, 12).
        labels: of the T actions.
    """
    keys = [
        (int(skill), int(index), base.tobytes(), tcp.tobytes())
        for skill, index, base, tcp in zip(
            labels.skill, labels.object, labels.contact_base, labels.contact_tcp, strict=True
        )
    ]
    start = 0
    for (skill, index, *_), group in groupby(keys):
        end = start + len(list(group))
        if index >= 0:
            yield Motion(
                contact=Contact(CONTACT_SKILLS[skill], "", labels.contact_base[start], labels.contact_tcp[start]),
                index=index,
                reading=read({name: values[start : end + 1] for name, values in observations.items()}),
                actions=np.asarray(actions[start:end], float),
                phases=labels.phases[start:end],
                keyframes=labels.keyframe[start:end],
            )
        start = end
