"""Which cells of a map have all their neighbours in reach, so that an answer from them is certain."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from irm.arm.angles import signed
from irm.maps.orientations import Orientations

__all__ = ["CERTAIN_IN_HEIGHT", "CERTAIN_IN_PITCH", "certainty"]

Bools = NDArray[np.bool_]

CERTAIN_IN_HEIGHT = 1
"""Bit of `flags`: the cells above and below are reachable too."""

CERTAIN_IN_PITCH = 2
"""Bit of `flags`: the neighbouring pitches (and rolls), and the cells above and below these, are reachable too."""


def certainty(reachable: Bools, orientations: Orientations) -> NDArray[np.uint8]:
    """Flags of every cell (layers, orientations, x, y), given which are in reach."""
    upright = _with_neighbours(reachable)
    flags = upright.astype(np.uint8) * np.uint8(CERTAIN_IN_HEIGHT)
    for group in range(len(orientations.pitch)):
        beside = _neighbouring_groups(orientations, group)
        if not beside:
            continue
        first, last = orientations.start[group : group + 2]
        certain = upright[:, first:last].copy()
        for other in beside:
            start, end = orientations.start[other : other + 2]
            block = upright[:, start:end]
            certain &= block if end - start == last - first else block.all(axis=1, keepdims=True)
        flags[:, first:last] |= certain.astype(np.uint8) * np.uint8(CERTAIN_IN_PITCH)
    return flags


def _with_neighbours(reachable: Bools) -> Bools:
    """Whether a cell and those above and below it are reachable; false in the outermost layers."""
    inside = np.zeros_like(reachable)
    inside[1:-1] = reachable[1:-1] & reachable[:-2] & reachable[2:]
    return inside


def _neighbouring_groups(orientations: Orientations, group: int) -> list[int]:
    """Groups within one step of pitch and roll; empty if the map lacks the ring on one side."""
    pitch, roll = orientations.pitch, orientations.roll
    near_pitch = np.abs(pitch - pitch[group]) < orientations.step * 1.01
    sides = np.unique(np.sign(np.round((pitch[near_pitch] - pitch[group]) / orientations.step)))
    if len(sides) < (2 if orientations.is_pole(group) else 3):
        return []
    poles = np.array([orientations.is_pole(k) for k in range(len(pitch))])
    apart = np.abs(signed(roll - roll[group]))
    rolls = len(np.unique(roll))
    near_roll = poles | poles[group] | (apart < 2 * np.pi / rolls * 1.01)
    return [int(k) for k in np.flatnonzero(near_pitch & near_roll)]
