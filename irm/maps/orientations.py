"""The sampled TCP orientations of a map.

Orientations are R(γ, β, α) = Rz(yaw γ) Ry(pitch β) Rx(roll α) of the TCP, whose x axis is the approach. The approach
axes lie on 2 m - 1 rings of equal pitch, π / 2m apart, with 4 m yaws each, and at the 2 poles; m = 3 gives the 62 of
the paper. At a pole, yaw and roll turn about the same axis; there the map has one *yaw* sample for every roll, and
roll 0. A map of roll 0 alone has the yaws of the rings there, if its wrist does not roll freely.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import inf, pi

import numpy as np
from numpy.typing import NDArray

from irm.arm.angles import signed
from irm.errors import QueryError, ReachabilityError
from irm.maps.parameters import MapParameters, refinement

__all__ = ["Orientations"]

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

_ANGLE_ROUNDING = 1e-6
"""[rad] Two angles closer than this are the same sample."""


@dataclass(frozen=True, eq=False)
class Orientations:
    """Sampled TCP orientations, grouped by the pair (pitch, roll). Arrays are read-only.

    Attributes:
        pitch, roll: (k,) of each group [rad].
        count: (k,) yaw samples of each group, evenly spaced from 0.
        start: (k + 1,) index of each group's first orientation; the last one is their number.
        free_roll: whether the map does not distinguish rolls.
        step: [rad] between rings.
    """

    pitch: Floats
    roll: Floats
    count: Integers
    start: Integers
    free_roll: bool
    step: float

    @staticmethod
    def sample(parameters: MapParameters, free_roll: bool) -> Orientations:
        """The orientations of a map.

        Raises:
            ReachabilityError: a requested pitch is not on a ring; the message lists the rings.
        """
        m = refinement(parameters.orientations)
        rolls = parameters.rolls or (1 if free_roll else 4)
        pole_yaws = 4 * m if rolls == 1 and not free_roll else rolls
        groups: list[tuple[float, float, int]] = []
        for ring in _rings(m, parameters.pitches):
            pole = abs(ring) == m
            for k in range(1 if pole else rolls):
                groups.append((ring * np.pi / (2 * m), signed(2 * np.pi * k / rolls), pole_yaws if pole else 4 * m))
        pitch, roll = np.array([group[0] for group in groups]), np.array([group[1] for group in groups])
        count = np.array([group[2] for group in groups], dtype=np.int64)
        start = np.concatenate([[0], np.cumsum(count)])
        for array in (pitch, roll, count, start):
            array.setflags(write=False)
        return Orientations(pitch, roll, count, start, free_roll and rolls == 1, np.pi / (2 * m))

    @property
    def size(self) -> int:
        """Number of orientations."""
        return int(self.start[-1])

    @property
    def yaw(self) -> Floats:
        """(size,) yaw of every orientation [rad]."""
        return np.concatenate([np.arange(n) * (2 * np.pi / n) for n in self.count])

    @cached_property
    def angles(self) -> Floats:
        """(size, 3) yaw, pitch and roll of every orientation [rad]."""
        pitch, roll = (np.repeat(column, self.count) for column in (self.pitch, self.roll))
        angles = np.column_stack([self.yaw, pitch, roll])
        angles.setflags(write=False)
        return angles

    def is_pole(self, group: int) -> bool:
        """Whether the approach is vertical, so that yaw and roll turn about the same axis."""
        return bool(abs(self._groups[group][1]) > pi / 2 - _ANGLE_ROUNDING)

    def nearest(self, pitch: float, roll: float) -> int:
        """The group that contains a pitch and a roll [rad].

        Raises:
            QueryError: the map has no ring within half a step of the pitch, or no such roll.
        """
        if not abs(pitch) <= pi / 2 + _ANGLE_ROUNDING:
            raise QueryError(f"pitch must lie in [-π/2, π/2], not {pitch}")
        best, nearest, ring = -1, inf, inf
        for group, group_pitch, group_roll in self._groups:
            apart = abs(group_pitch - pitch)
            turn = 0.0 if self.free_roll else abs(signed(roll - group_roll))
            if apart < ring - _ANGLE_ROUNDING or (apart < ring + _ANGLE_ROUNDING and turn < nearest):
                best, nearest, ring = group, turn, apart
        if ring > self.step / 2 + _ANGLE_ROUNDING:
            known = ", ".join(f"{np.degrees(p):.1f}" for p in np.unique(self.pitch))
            raise QueryError(f"this map does not cover pitch {np.degrees(pitch):.1f} degrees; it has rings at {known}")
        return best

    @cached_property
    def _groups(self) -> tuple[tuple[int, float, float], ...]:
        """Number, pitch and roll of every group, as plain numbers for `nearest`."""
        return tuple(zip(range(len(self.pitch)), self.pitch.tolist(), self.roll.tolist(), strict=True))


def _rings(m: int, pitches: tuple[float, ...]) -> list[int]:
    """Multiples of π / 2m: all of them, or the requested ones."""
    if not pitches:
        return list(range(-m, m + 1))
    rings = sorted({round(p * 2 * m / np.pi) for p in pitches})
    off = [p for p in pitches if abs(round(p * 2 * m / np.pi) * np.pi / (2 * m) - p) > _ANGLE_ROUNDING]
    if off or abs(rings[0]) > m or abs(rings[-1]) > m:
        known = ", ".join(f"{90 * ring / m:.2f}" for ring in range(-m, m + 1))
        raise ReachabilityError(f"pitches {pitches} [rad] must lie on the rings, at {known} degrees")
    return rings
