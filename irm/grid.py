"""The cells of a reachability map: its parameters, sampled TCP orientations, and voxels of TCP positions.

Orientations are R(γ, β, α) = Rz(yaw γ) Ry(pitch β) Rx(roll α) of the TCP, whose x axis is the approach. The approach
axes lie on 2 m - 1 rings of equal pitch, π / 2m apart, with 4 m yaws each, and at the 2 poles. m = 3 gives the 62 of
the paper. At a pole, yaw and roll turn about the same axis. There the map has roll 0 alone, with one *yaw* sample per
roll. With one roll sample and a wrist that does not roll freely, the poles have as many yaws as the rings.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import floor, inf, pi, prod
from operator import index
from typing import Any

import numpy as np
from numpy.typing import NDArray

from irm.chain import ArmChain, has_free_roll
from irm.errors import QueryError, ReachabilityError
from irm.rotations import wrap_to_pi, yaw_pitch_roll

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
_MAX_REFINEMENT = 24
"""m of the finest orientation set: 3.75 degrees."""
_MAX_ROLLS = 96
"""Most roll samples: 3.75 degrees, as for the approach axes."""
_ANGLE_ROUNDING = 1e-6
"""[rad] Two angles closer than this are the same sample."""
_SHORT_LIFT = 0.2
"""Share of a voxel's edge. A shorter lift stays at its home height in the map, because layers would be as thin as the
lift is long. Exact answers use the whole lift."""
_BYTES_PER_CELL = 10
"""Bytes per cell while a map is built: μ, torso height, flags, and two masks."""
MAX_BYTES = 6 * 2**30
"""Most memory to build a map [bytes]. A finer map would take hours to build, and cells have 32-bit numbers."""


@dataclass(frozen=True)
class MapParameters:
    """Range and resolution of a map.

    Attributes:
        voxel: edge of the position cells [m].
        orientations: number of approach axes: 6, 26, 62, 114, 182, 266, … = 2 + 4 m (2 m - 1).
        rolls: roll samples per approach axis. 0 chooses 1 for a wrist that rolls freely and 4 for any other.
        pitches: the rings to keep [rad], () for all.
        heights: lowest and highest TCP position to cover [m], limited by the reach of the arm. By default all.
        lift: whether the torso is a free parameter of the map. If not, it stays at its home height.
        torso_margin: distance that the torso keeps from both ends of its lift [m].
        self_collision: whether cells and μ are those of configurations free of self-collision. If not, they are those
            of the joints alone, for callers that check every configuration.
        samples: random configurations, for arms without a closed form.
        seed: seed of these configurations.
    """

    voxel: float = 0.05
    orientations: int = 62
    rolls: int = 0
    pitches: tuple[float, ...] = ()
    heights: tuple[float, float] = (-10.0, 10.0)
    lift: bool = True
    torso_margin: float = 0.0
    self_collision: bool = True
    samples: int = 400_000
    seed: int = 0

    def __post_init__(self) -> None:
        try:
            numbers = {name: float(getattr(self, name)) for name in ("voxel", "torso_margin")}
            numbers |= {name: index(getattr(self, name)) for name in ("orientations", "rolls", "samples", "seed")}
            pairs = {name: tuple(float(v) for v in getattr(self, name)) for name in ("pitches", "heights")}
        except (TypeError, ValueError) as problem:
            raise ReachabilityError(f"parameters of a map are numbers, pitches and heights tuples: {self}") from problem
        flags = {name: bool(getattr(self, name)) for name in ("lift", "self_collision")}
        for name, value in {**numbers, **pairs, **flags}.items():
            object.__setattr__(self, name, value)
        if not all(np.isfinite((self.voxel, *self.heights, *self.pitches))) or not 0.005 <= self.voxel <= 0.5:
            raise ReachabilityError(f"voxel must be 0.005 to 0.5 m and every number finite: {self}")
        if not 0.0 <= self.torso_margin < np.inf:
            raise ReachabilityError(f"torso_margin must be a number ≥ 0 [m], not {self.torso_margin}")
        if len(self.heights) != 2 or not self.heights[0] < self.heights[1]:
            raise ReachabilityError(f"heights must be an increasing pair of numbers, not {self.heights}")
        if not 0 <= self.rolls <= _MAX_ROLLS or self.samples < 1:
            raise ReachabilityError(f"rolls must be 0 to {_MAX_ROLLS} and samples ≥ 1: {self}")
        refinement(self.orientations)  # raises for a number that no set has


def refinement(orientations: int) -> int:
    """Refinement m of an orientation count.

    Raises:
        ReachabilityError: no such set. The message lists the available counts.
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
        start: (k + 1,) index of each group's first orientation. The last entry is the number of orientations.
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
            ReachabilityError: a requested pitch is not on a ring. The message lists the rings.
        """
        m = refinement(parameters.orientations)
        rolls = parameters.rolls or (1 if free_roll else 4)
        pole_yaws = 4 * m if rolls == 1 and not free_roll else rolls
        groups: list[tuple[float, float, int]] = []
        for ring in _rings(m, parameters.pitches):
            pole = abs(ring) == m
            for k in range(1 if pole else rolls):
                pitch_of_ring, roll_of_group = ring * np.pi / (2 * m), wrap_to_pi(2 * np.pi * k / rolls)
                groups.append((pitch_of_ring, roll_of_group, pole_yaws if pole else 4 * m))
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
            turn = 0.0 if self.free_roll else abs(wrap_to_pi(roll - group_roll))
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
    """Multiples of π / 2m: all, or only those of the requested pitches."""
    if not pitches:
        return list(range(-m, m + 1))
    rings = sorted({round(p * 2 * m / np.pi) for p in pitches})
    off = [p for p in pitches if abs(round(p * 2 * m / np.pi) * np.pi / (2 * m) - p) > _ANGLE_ROUNDING]
    if off or abs(rings[0]) > m or abs(rings[-1]) > m:
        known = ", ".join(f"{90 * ring / m:.2f}" for ring in range(-m, m + 1))
        raise ReachabilityError(f"pitches {pitches} [rad] must lie on the rings, at {known} degrees")
    return rings


def nearest_orientation(orientations: Orientations, R: Floats) -> Integers:
    """(n,) index of the orientation cell that contains each rotation (n, 3, 3). -1 where the map has no such ring."""
    yaw, pitch, roll = yaw_pitch_roll(R).T
    rings = np.unique(orientations.pitch)
    ring = np.abs(pitch[:, None] - rings).argmin(axis=1)
    inside = np.abs(pitch - rings[ring]) <= orientations.step / 2
    result = np.full(len(R), -1, dtype=np.int64)
    for k, value in enumerate(rings):
        members = np.flatnonzero(orientations.pitch == value)
        here = np.flatnonzero(inside & (ring == k))
        turn = yaw[here]
        if orientations.is_pole(int(members[0])):
            turn = yaw[here] - np.sign(value) * roll[here]
            group = np.full(here.size, members[0])
        elif orientations.free_roll:
            group = np.full(here.size, members[0])
        else:
            group = members[np.round(roll[here] / (2 * np.pi) * members.size).astype(np.int64) % members.size]
        count = orientations.count[group]
        result[here] = orientations.start[group] + np.round(turn / (2 * np.pi) * count).astype(np.int64) % count
    return result


def orientation_neighbours(orientations: Orientations) -> Integers:
    """(size, m) neighbours of each orientation, padded with -1: yaw ± 1, pitch ± 1, roll ± 1."""
    pitch, roll, count, start = orientations.pitch, orientations.roll, orientations.count, orientations.start
    rolls = len(np.unique(roll))
    rows: list[set[int]] = [set() for _ in range(orientations.size)]
    for group in range(len(pitch)):
        for k in range(count[group]):
            own = int(start[group]) + k
            rows[own] |= {int(start[group]) + (k + turn) % int(count[group]) for turn in (1, -1)} - {own}
            for other in range(len(pitch)):
                steps = abs(pitch[other] - pitch[group]) / orientations.step
                turn = abs(wrap_to_pi(roll[other] - roll[group])) * rolls / (2 * np.pi)
                pole = orientations.is_pole(group) or orientations.is_pole(other)
                if (0.5 < steps < 1.5 and (turn < 0.5 or pole)) or (steps < 0.5 and 0.5 < turn < 1.5):
                    twin = int(start[other]) + round(k * count[other] / count[group]) % int(count[other])
                    rows[own].add(twin)
                    rows[twin].add(own)
    width = max(len(row) for row in rows)
    return np.array([sorted(row) + [-1] * (width - len(row)) for row in rows], dtype=np.int64)


@dataclass(frozen=True, eq=False)
class MapGrid:
    """Voxels and orientations of one map, and the torso heights that were tried.

    Cells are numbered by (z, orientation, x, y), the last one fastest, so that the cells of one layer and one group
    (pitch, roll) are consecutive. The x, y grid is centred on the axis of the arm's first joint.

    Attributes:
        voxel: [m] edge of the cells along x and y.
        thickness: [m] height of a layer: the voxel's edge or a little less. So torso heights one layer apart include
            both ends of the lift. A lift shorter than a fifth of an edge does not change it.
        centre: (2,) x, y of the grid's centre in the base frame [m].
        half: cells from the centre to the edge. The grid is (2 half, 2 half).
        bottom: [m] lower face of the lowest layer.
        layers: number of layers.
        torsos: (t,) torso heights, `thickness` apart [m].
        torso_range: lowest and highest torso height of the map's configurations [m]. Equal for a fixed torso.
        orientations: of the TCP.
        cut_below, cut_above: whether the parameters' heights, not the arm's reach, end the grid there.
    """

    voxel: float
    thickness: float
    centre: tuple[float, float]
    half: int
    bottom: float
    layers: int
    torsos: tuple[float, ...]
    torso_range: tuple[float, float]
    orientations: Orientations
    cut_below: bool
    cut_above: bool

    def __post_init__(self) -> None:
        if self.size * _BYTES_PER_CELL > MAX_BYTES:
            raise ReachabilityError(
                f"this map has {self.size:.3g} cells and needs {self.size * _BYTES_PER_CELL / 2**30:.3g} GiB; at most "
                f"{MAX_BYTES / 2**30:.0f} GiB are allowed: take larger voxels, fewer orientations, or some pitches and "
                "heights only"
            )

    @staticmethod
    def of(chain: ArmChain, parameters: MapParameters) -> MapGrid:
        """The grid of all cells that the arm may reach within the heights of the parameters.

        Raises:
            ReachabilityError: no cells, or more than memory should hold. The message gives their size.
        """
        voxel = parameters.voxel
        lower, upper = float(chain.lower[0]), float(chain.upper[0])
        low = high = float(np.clip(chain.home_torso, lower, upper))
        torsos: tuple[float, ...] = (low,)
        thickness = voxel
        if parameters.lift:
            margin = min(parameters.torso_margin, (upper - lower) / 2)
            low, high = lower + margin, upper - margin
            torsos = (float(np.clip(chain.home_torso, low, high)),)
        if high - low >= _SHORT_LIFT * voxel:
            # Layers are as thick as the distance of torso samples, at most a voxel's edge. The samples include both
            # ends of the lift. So one map of a fixed torso, shifted by whole layers, serves all heights.
            steps = int(np.ceil((high - low) / voxel - 1e-9))
            thickness = (high - low) / steps
            torsos = (*(low + k * thickness for k in range(steps)), high)
        reach, shoulder = chain.reach, chain.shoulder
        floor = float(shoulder[2] + low - reach)
        ceiling = float(shoulder[2] + high + reach)
        lowest = int(np.floor(max(parameters.heights[0], floor) / thickness + 1e-9))
        highest = int(np.ceil(min(parameters.heights[1], ceiling) / thickness - 1e-9))
        if highest <= lowest:
            raise ReachabilityError(f"{chain.robot} reaches nothing at heights {parameters.heights} m")
        return MapGrid(
            voxel=voxel,
            thickness=thickness,
            centre=(float(shoulder[0]), float(shoulder[1])),
            half=int(np.ceil(reach / voxel)),
            bottom=lowest * thickness,
            layers=highest - lowest,
            torsos=torsos,
            torso_range=(low, high),
            orientations=Orientations.sample(parameters, has_free_roll(chain)),
            cut_below=parameters.heights[0] > floor,
            cut_above=parameters.heights[1] < ceiling,
        )

    @staticmethod
    def around(positions: Floats, parameters: MapParameters) -> MapGrid:
        """The grid around given TCP positions (n, 3). The lowest coordinates are centres of cells."""
        voxel, low, high = parameters.voxel, positions.min(axis=0), positions.max(axis=0)
        cells = np.floor((high - low) / voxel + 0.5).astype(np.int64) + 1
        half = int(cells[:2].max() + 1) // 2
        x, y = (low[:2] + (half - 0.5) * voxel).tolist()
        extent = {"centre": [x, y], "half": half, "bottom": float(low[2] - voxel / 2), "layers": int(cells[2])}
        return MapGrid.of_extent(parameters, extent)

    @staticmethod
    def of_extent(parameters: MapParameters, extent: Any) -> MapGrid:
        """The grid with the extent that `extent()` returned, for a map without an arm.

        Raises:
            ReachabilityError: `extent` is malformed or too large.
        """
        try:
            x, y = (float(value) for value in extent["centre"])
            half, layers, bottom = index(extent["half"]), index(extent["layers"]), float(extent["bottom"])
        except (TypeError, ValueError, KeyError, OverflowError) as problem:
            raise ReachabilityError(f"{str(extent)[:100]} is no extent of a grid") from problem
        if not (np.isfinite((x, y, bottom)).all() and half > 0 and layers > 0):
            raise ReachabilityError(f"{extent} is no extent of a grid")
        return MapGrid(
            voxel=parameters.voxel,
            thickness=parameters.voxel,
            centre=(x, y),
            half=half,
            bottom=bottom,
            layers=layers,
            torsos=(0.0,),
            torso_range=(0.0, 0.0),
            orientations=Orientations.sample(parameters, parameters.rolls <= 1),
            cut_below=True,
            cut_above=True,
        )

    def extent(self) -> dict[str, Any]:
        """The part of the grid that the parameters alone do not determine, for `of_extent`."""
        return {"centre": list(self.centre), "half": self.half, "bottom": self.bottom, "layers": self.layers}

    @property
    def top(self) -> float:
        """[m] upper face of the highest layer."""
        return self.bottom + self.layers * self.thickness

    @property
    def shape(self) -> tuple[int, int, int, int]:
        """(z, orientation, x, y)."""
        return self.layers, self.orientations.size, 2 * self.half, 2 * self.half

    @property
    def size(self) -> int:
        """Number of cells."""
        return prod(self.shape)

    def layer(self, z: float) -> int:
        """Index of the layer that contains a height [m]. It may be outside the grid."""
        return floor((z - self.bottom) / self.thickness)

    def layer_height(self, layer: int) -> float:
        """[m] of a layer's middle."""
        return self.bottom + (layer + 0.5) * self.thickness

    def axis(self, side: int) -> Floats:
        """(2 half,) cell centres along x (side 0) or y (side 1) in the base frame [m]."""
        return np.asarray(self.centre[side] + (np.arange(2 * self.half) + 0.5 - self.half) * self.voxel)

    def edges(self, side: int) -> Floats:
        """(2 half + 1,) borders of the cells along x (side 0) or y (side 1) in the base frame [m]."""
        return np.asarray(self.centre[side] + np.arange(-self.half, self.half + 1) * self.voxel)

    def z_edges(self) -> Floats:
        """(layers + 1,) borders of the layers [m]."""
        return np.asarray(self.bottom + np.arange(self.layers + 1) * self.thickness)
