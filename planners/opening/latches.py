"""Levers that have to be pressed before a door opens: one object with two joints.

A lever is something that opens on something else that opens. It latches a door if a part of it would run into what does
not move when the door is moved, and does not when the lever is turned: that is seen in the shapes.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from planners.collision.opened import way
from planners.collision.world import are_near
from planners.scene import Body, Opening, Scene
from planners.scene.moving import moved

_STEP, _TURNS = 0.008, 32
"""[m] that a lever goes between two places at which it is looked at, and angles to which it is turned, to each side."""
_BEYOND = 0.25
"""[rad] or [m] that a lever is turned farther than it must: a hand does not hold it exactly."""


class Latch(NamedTuple):
    """A lever, by its name, and the position [rad] or [m] to which it must be turned before what it is on can move."""

    lever: str
    position: float


def latches(scene: Scene, name: str, position: float) -> tuple[Latch, ...]:
    """The ways to unlatch what opens before it is moved, the shortest turn first; () if nothing latches it.

    Args:
        scene: as it is.
        name: of what opens.
        position: [m] or [rad] to which it is to be moved.
    """
    opening = scene.opening(name)
    found: list[tuple[float, Latch]] = []
    for lever in scene.openings:
        on_it = lever.name != name and {*lever.parts} < {*opening.parts}
        if on_it and _is_stopped(scene, opening, lever, lever.position, position):
            found += [(abs(one.position - lever.position), one) for one in _freeing(scene, opening, lever, position)]
    return tuple(latch for _, latch in sorted(found))


def _freeing(scene: Scene, opening: Opening, lever: Opening, position: float) -> Iterator[Latch]:
    """To each side the least turn of a lever with which what opens can move."""
    for end in (lever.shut, lever.open):
        for turned in np.linspace(lever.position, end, _TURNS + 1)[1:].tolist():
            if not _is_stopped(scene, opening, lever, turned, position):
                beyond = turned + np.sign(end - lever.position) * _BEYOND
                yield Latch(
                    lever.name, float(np.clip(beyond, min(lever.shut, lever.open), max(lever.shut, lever.open)))
                )
                break


def _is_stopped(scene: Scene, opening: Opening, lever: Opening, turned: float, position: float) -> bool:
    """Whether a lever, turned so, runs into what does not move on the way to a position."""
    others = [one for one in scene.static_obstacles if one.name not in opening.parts]
    here = moved(scene, lever.name, turned)
    parts = [one for one in here.static_obstacles if one.name in lever.parts]
    arms = [opening.lever_arm(corner) for one in parts for corner in one.corners]
    goes = abs(position - opening.position) * (1.0 if opening.kind == "slide" else max(arms, default=0.0))
    for place in way(opening, position, max(math.ceil(goes / _STEP), 1)):
        there = moved(here, opening.name, float(place))
        parts = [one for one in there.static_obstacles if one.name in lever.parts]
        if are_near(others, Body.of_pieces(lever.name, parts), 0.0):
            return True
    return False
