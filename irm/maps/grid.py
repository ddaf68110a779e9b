"""The cells of a reachability map: voxels of TCP positions times sampled TCP orientations.

Orientations are R(γ, β, α) = Rz(yaw γ) Ry(pitch β) Rx(roll α) of the TCP, whose x axis is the approach. The approach
axes lie on 2 m - 1 rings of equal pitch, π / 2m apart, with 4 m yaws each, and at the 2 poles; m = 3 gives the 62 of
the paper. At a pole, yaw and roll turn about the same axis; there the map has one *yaw* sample for every roll, and
roll 0.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import floor, inf, pi

import numpy as np
from numpy.typing import NDArray

from irm.arm.chain import PRISMATIC, ArmChain, has_free_roll
from irm.errors import QueryError, ReachabilityError

__all__ = ["MapGrid", "MapParameters", "Orientations", "has_free_roll"]

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

_ANGLE_ROUNDING = 1e-6
"""[rad] Two angles closer than this are the same sample."""

_MAX_REFINEMENT = 24
"""m of the finest orientation set: 3.75 degrees."""


@dataclass(frozen=True)
class MapParameters:
    """Range and resolution of a map.

    Attributes:
        voxel: edge of the position cells [m].
        orientations: number of approach axes: 6, 26, 62, 114, 182, 266, … = 2 + 4 m (2 m - 1).
        rolls: roll samples per approach axis; 0 chooses 1 for a wrist that rolls freely and 4 for any other.
        pitches: the rings to keep [rad], () for all.
        heights: lowest and highest TCP position to cover [m]; limited by the reach of the arm.
        lift: whether the torso is a free parameter of the map; if not, it stays at the height it has at home.
        samples: random configurations, for arms without a closed form.
        seed: of those configurations.
    """

    voxel: float = 0.05
    orientations: int = 62
    rolls: int = 0
    pitches: tuple[float, ...] = ()
    heights: tuple[float, float] = (0.0, 10.0)
    lift: bool = True
    samples: int = 400_000
    seed: int = 0

    def __post_init__(self) -> None:
        numbers = (self.voxel, *self.heights, *self.pitches)
        if not all(np.isfinite(numbers)) or not 0.005 <= self.voxel <= 0.5:
            raise ReachabilityError(f"voxel must be 0.005 to 0.5 m and every number finite: {self}")
        if not 0.0 <= self.heights[0] < self.heights[1]:
            raise ReachabilityError(f"heights must be an increasing pair of numbers ≥ 0, not {self.heights}")
        if self.rolls < 0 or self.samples < 1:
            raise ReachabilityError(f"rolls must be ≥ 0 and samples ≥ 1: {self}")
        refinement(self.orientations)


def refinement(orientations: int) -> int:
    """m of an orientation count.

    Raises:
        ReachabilityError: no such set; the message lists those there are.
    """
    counts = {2 + 4 * m * (2 * m - 1): m for m in range(1, _MAX_REFINEMENT + 1)}
    if orientations not in counts:
        known = ", ".join(map(str, counts))
        raise ReachabilityError(f"there is no set of {orientations!r} orientations; there are sets of {known}")
    return counts[orientations]


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
        groups: list[tuple[float, float, int]] = []
        for ring in _rings(m, parameters.pitches):
            pole = abs(ring) == m
            for k in range(1 if pole else rolls):
                groups.append((ring * np.pi / (2 * m), _signed(2 * np.pi * k / rolls), rolls if pole else 4 * m))
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
            turn = 0.0 if self.free_roll else abs(_signed(roll - group_roll))
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


def _signed(angle: float) -> float:
    """The same angle in [-π, π)."""
    return (angle + pi) % (2 * pi) - pi


@dataclass(frozen=True, eq=False)
class MapGrid:
    """Voxels and orientations of one map, and the torso heights that were tried.

    Cells are numbered by (z, orientation, x, y), the last one fastest, so that the cells of one layer and one group
    (pitch, roll) are consecutive. The x, y grid is centred on the axis of the arm's first joint.

    Attributes:
        voxel: [m].
        centre: (2,) x, y of the grid's centre in the base frame [m].
        half: cells from the centre to the edge; the grid is (2 half, 2 half).
        bottom: [m] lower face of the lowest layer.
        layers: number of layers.
        torsos: (t,) torso heights, `voxel` apart [m].
        torso_range: lowest and highest torso height of the map's configurations [m]; equal for a fixed torso.
        orientations: of the TCP.
        cut_below, cut_above: whether the parameters' heights, not the floor or the arm's reach, end the grid there.
    """

    voxel: float
    centre: tuple[float, float]
    half: int
    bottom: float
    layers: int
    torsos: tuple[float, ...]
    torso_range: tuple[float, float]
    orientations: Orientations
    cut_below: bool
    cut_above: bool

    @staticmethod
    def of(chain: ArmChain, parameters: MapParameters) -> MapGrid:
        """The grid of all cells that the arm may reach within the heights of the parameters."""
        voxel = parameters.voxel
        torsos = _torso_samples(chain, parameters)
        reach = float(np.linalg.norm(chain.offsets[2:, :3], axis=1).sum() + np.linalg.norm(chain.tip[:3]))
        slides = chain.axes[1:] >= PRISMATIC
        reach += float(np.maximum(np.abs(chain.lower[1:]), np.abs(chain.upper[1:]))[slides].sum())
        shoulder = chain.offsets[0, :3] + chain.offsets[1, :3]
        floor = max(0.0, float(shoulder[2] + torsos[0] - reach))
        ceiling = float(shoulder[2] + torsos[-1] + reach)
        lowest = int(np.floor(max(parameters.heights[0], floor) / voxel + 1e-9))
        highest = int(np.ceil(min(parameters.heights[1], ceiling) / voxel - 1e-9))
        if highest <= lowest:
            raise ReachabilityError(f"{chain.robot} reaches nothing at heights {parameters.heights} m")
        return MapGrid(
            voxel=voxel,
            centre=(float(shoulder[0]), float(shoulder[1])),
            half=int(np.ceil(reach / voxel)),
            bottom=lowest * voxel,
            layers=highest - lowest,
            torsos=torsos,
            torso_range=(float(chain.lower[0]), float(chain.upper[0])) if parameters.lift else (torsos[0], torsos[0]),
            orientations=Orientations.sample(parameters, has_free_roll(chain)),
            cut_below=parameters.heights[0] > floor,
            cut_above=parameters.heights[1] < ceiling,
        )

    @property
    def top(self) -> float:
        """[m] upper face of the highest layer."""
        return self.bottom + self.layers * self.voxel

    @property
    def shape(self) -> tuple[int, int, int, int]:
        """(z, orientation, x, y)."""
        return self.layers, self.orientations.size, 2 * self.half, 2 * self.half

    @property
    def size(self) -> int:
        """Number of cells."""
        return int(np.prod(self.shape))

    def layer(self, z: float) -> int:
        """Index of the layer that contains a height [m]; may be outside the grid."""
        return floor((z - self.bottom) / self.voxel)

    def layer_height(self, layer: int) -> float:
        """[m] of a layer's middle."""
        return self.bottom + (layer + 0.5) * self.voxel

    def axis(self, side: int) -> Floats:
        """(2 half,) cell centres along x (side 0) or y (side 1) in the base frame [m]."""
        return np.asarray(self.centre[side] + (np.arange(2 * self.half) + 0.5 - self.half) * self.voxel)


def _torso_samples(chain: ArmChain, parameters: MapParameters) -> tuple[float, ...]:
    """Heights one voxel apart, centred in the lift's range.

    The rest of the range at both ends makes up for TCP heights between the middles of two layers.
    """
    lower, upper = float(chain.lower[0]), float(chain.upper[0])
    if not parameters.lift:
        return (float(np.clip(chain.home_torso, lower, upper)),)
    steps = int(np.floor((upper - lower) / parameters.voxel + 1e-9))
    first = (lower + upper - steps * parameters.voxel) / 2
    return tuple(first + k * parameters.voxel for k in range(steps + 1))
