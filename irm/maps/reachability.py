"""The reachability map: TCP poses in reach, in the base frame, and their manipulability (equations 1 to 3)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from assets.robots import RobotSpec
from irm.arm.kinematics import ArmChain
from irm.errors import MapFileError, ReachabilityError
from irm.maps.closed_form_field import closed_form_layers
from irm.maps.grid import MapGrid, MapParameters, Orientations
from irm.maps.map_file import load_arrays, map_key, save_arrays
from irm.maps.sampled_field import sampled_layers

__all__ = ["CERTAIN_IN_HEIGHT", "CERTAIN_IN_PITCH", "ReachabilityMap"]

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
Bools = NDArray[np.bool_]

CERTAIN_IN_HEIGHT = 1
"""Bit of `flags`: the cells above and below are reachable too."""

CERTAIN_IN_PITCH = 2
"""Bit of `flags`: the neighbouring pitches (and rolls), and the cells above and below these, are reachable too."""


@dataclass(frozen=True)
class ReachabilityMap:
    """RM = {(T_eff, T_base = I, μ)} over the reachable samples (equation 3), one per cell. Arrays are read-only.

    Attributes:
        robot: name of the robot.
        key: digest of robot and parameters; maps with equal keys are equal.
        parameters: what the map covers.
        grid: its cells.
        cells: (n,) uint32 numbers of the reachable cells, increasing.
        manipulability: (n,) float32 best μ found at the cell's centre (equation 2; linear rows in m).
        torso_index: (n,) uint8 torso height of that configuration, an index into `grid.torsos`.
        flags: (n,) uint8 of CERTAIN_IN_HEIGHT, CERTAIN_IN_PITCH.
        chain: the arm; None for a map of poses that were computed elsewhere.

    Example:
        rm = ReachabilityMap.build(FETCH, voxel=0.05, orientations=62)
        rm.save("fetch.npz")
    """

    robot: str
    key: str
    parameters: MapParameters
    grid: MapGrid
    cells: NDArray[np.uint32]
    manipulability: Singles
    torso_index: NDArray[np.uint8]
    flags: NDArray[np.uint8]
    chain: ArmChain | None = None

    @staticmethod
    def build(robot: RobotSpec | ArmChain, *, progress: bool = False, **parameters: Any) -> ReachabilityMap:
        """The map of a robot.

        Args:
            robot: of this project, or the chain of any other arm (`ArmChain.from_mjcf`). If it has the structure of
                Fetch's arm, the closed form is used; otherwise sampling and numerical inverse kinematics.
            progress: show a progress bar.
            **parameters: the fields of `MapParameters`, such as `voxel=0.05` and `orientations=62`.

        Raises:
            ReachabilityError: the robot or the parameters make no sense.
        """
        wanted = MapParameters(**parameters)
        chain = ArmChain.of(robot)
        grid = MapGrid.of(chain, wanted)
        heights = _heights_without_torso(grid)
        field = closed_form_layers if chain.has_closed_form else sampled_layers(wanted)
        layers = tqdm(field(chain, grid, heights), "reachability map", heights.size, disable=not progress)
        best, torso = _merge_torso_heights(layers, grid)
        cells = np.flatnonzero(best)
        flags = _certainty(best > 0, grid.orientations)
        columns = _columns(cells, best, torso, flags)
        return ReachabilityMap(chain.robot, map_key(chain, wanted), wanted, grid, *columns, chain=chain)

    def save(self, path: str | Path) -> None:
        """Write the map to one `.npz` file.

        Raises:
            OSError: the disk is full or cannot be written; an old file of that name stays.
        """
        arrays: dict[str, NDArray[Any]] = {"cells": self.cells, "manipulability": self.manipulability}
        arrays |= {"torso_index": self.torso_index, "flags": self.flags}
        save_arrays(Path(path), self.robot, self.key, self.parameters, arrays)

    @staticmethod
    def load(path: str | Path, robot: RobotSpec | ArmChain) -> ReachabilityMap:
        """Read a map that `save` wrote.

        Raises:
            FileNotFoundError: no such file.
            MapFileError: the file is damaged or is no map.
            MapMismatchError: it is the map of another robot, or of this robot before it was changed.
        """
        chain = ArmChain.of(robot)
        key, parameters, arrays = load_arrays(Path(path), chain)
        grid = MapGrid.of(chain, parameters)
        if arrays["cells"].size and int(arrays["cells"][-1]) >= grid.size:
            raise MapFileError(f"{path} has cells outside its grid; build it again")
        return ReachabilityMap(chain.robot, key, parameters, grid, **arrays, chain=chain)

    def __len__(self) -> int:
        return self.cells.size

    def subset(self, keep: NDArray[Any]) -> ReachabilityMap:
        """The map of some of its poses; its key ends with their number.

        Args:
            keep: mask (n,) or increasing indices.
        """
        columns: dict[str, NDArray[Any]] = {"cells": self.cells, "manipulability": self.manipulability}
        columns |= {"torso_index": self.torso_index, "flags": self.flags}
        chosen: dict[str, Any] = {name: _read_only(column[keep]) for name, column in columns.items()}
        if np.any(np.diff(chosen["cells"].astype(np.int64)) <= 0):
            raise ReachabilityError("subset needs a mask or increasing indices")
        return replace(self, key=f"{self.key}-{len(chosen['cells'])}", **chosen)

    def indices(self) -> tuple[NDArray[np.int64], ...]:
        """(layer, orientation, x, y) of every pose, each (n,)."""
        return np.unravel_index(self.cells, self.grid.shape)

    @property
    def positions(self) -> Floats:
        """(n, 3) TCP positions in the base frame [m]."""
        z, _, x, y = self.indices()
        return np.column_stack(
            [self.grid.axis(0)[x], self.grid.axis(1)[y], self.grid.bottom + (z + 0.5) * self.grid.voxel]
        )

    @property
    def yaw_pitch_roll(self) -> Floats:
        """(n, 3) TCP orientations γ, β, α in the base frame [rad]."""
        _, orientation, _, _ = self.indices()
        return np.asarray(self.grid.orientations.angles[orientation])

    @property
    def torso(self) -> Floats:
        """(n,) torso height of each pose [m]."""
        return np.array(self.grid.torsos)[self.torso_index]

    @property
    def reachability_index(self) -> Floats:
        """D = R / N × 100 of every voxel, (layers, x, y): share of the N orientations in reach [%] (equation 1)."""
        layers, orientations, width, depth = self.grid.shape
        z, _, x, y = self.indices()
        reached = np.bincount(np.ravel_multi_index((z, x, y), (layers, width, depth)), minlength=layers * width * depth)
        return reached.reshape(layers, width, depth) / orientations * 100.0

    @cached_property
    def reachable(self) -> Bools:
        """(layers, orientations, x, y) whether a cell's centre is in reach."""
        dense = np.zeros(self.grid.size, dtype=bool)
        dense[self.cells] = True
        return _read_only(dense.reshape(self.grid.shape))


def _read_only(array: NDArray[Any]) -> NDArray[Any]:
    array.setflags(write=False)
    return array


def _columns(cells: NDArray[Any], best: Singles, torso: NDArray[Any], flags: NDArray[Any]) -> tuple[NDArray[Any], ...]:
    flat = [cells.astype(np.uint32), *(volume.reshape(-1)[cells] for volume in (best, torso, flags))]
    return tuple(_read_only(array) for array in flat)


def _heights_without_torso(grid: MapGrid) -> Floats:
    """Every height of a layer's middle above a torso sample; samples are one voxel apart, so most heights coincide."""
    lowest = grid.layer_height(0) - grid.torsos[-1]
    return np.asarray(lowest + np.arange(grid.layers + len(grid.torsos) - 1) * grid.voxel)


def _merge_torso_heights(layers: Iterator[Singles], grid: MapGrid) -> tuple[Singles, NDArray[np.uint8]]:
    """Best μ over the torso heights, and its torso height: a lift of the torso shifts the map of a fixed torso up."""
    best = np.zeros(grid.shape, dtype=np.float32)
    torso = np.zeros(grid.shape, dtype=np.uint8)
    count = len(grid.torsos)
    for height, layer in enumerate(layers):
        for k in range(count):
            z = height + k - (count - 1)
            if 0 <= z < grid.layers:
                better = layer > best[z]
                best[z][better] = layer[better]
                torso[z][better] = k
    return best, torso


def _certainty(reachable: Bools, orientations: Orientations) -> NDArray[np.uint8]:
    """Flags of every cell."""
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
    apart = np.abs((roll - roll[group] + np.pi) % (2 * np.pi) - np.pi)
    rolls = len(np.unique(roll))
    near_roll = poles | poles[group] | (apart < 2 * np.pi / rolls * 1.01)
    return [int(k) for k in np.flatnonzero(near_pitch & near_roll)]
