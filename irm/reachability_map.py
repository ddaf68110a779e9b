"""The reachability map: TCP poses in reach, in the base frame, and their manipulability (equations 1 to 3)."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from irm.chain import ArmChain
from irm.equations import reachability_index, reachability_map
from irm.errors import ReachabilityError
from irm.grid import MapGrid, MapParameters, Orientations, nearest_orientation
from irm.map_file import StoredMap, content_key, load_map, map_key, save_map
from irm.map_kernels import closed_form_layers, sampled_layers
from irm.robot import Robot
from irm.rotations import as_poses, wrap_to_pi

ProgressBar = Callable[..., Iterable[Any]]
"""Called with items, `desc=` (what is being done) and `total=`; yields the same items. For example `tqdm.tqdm`."""


def watched(items: Iterable[Any], name: str, total: int, progress: ProgressBar | None) -> Iterable[Any]:
    """The items, shown by `progress` if there is one.

    Raises:
        ReachabilityError: `progress` is neither None nor a function.
    """
    if progress is None:
        return items
    if not callable(progress):
        raise ReachabilityError(f"progress={progress!r} must be None or a function that shows progress: tqdm.tqdm")
    return progress(items, desc=name, total=total)


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
    apart = np.abs(wrap_to_pi(roll - roll[group]))
    rolls = len(np.unique(roll))
    near_roll = poles | poles[group] | (apart < 2 * np.pi / rolls * 1.01)
    return [int(k) for k in np.flatnonzero(near_pitch & near_roll)]


Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
_ROUNDING = 1e-9
"""Part of a voxel by which rounding may move a pose."""


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
    def build(robot: Robot | ArmChain, *, progress: ProgressBar | None = None, **parameters: Any) -> ReachabilityMap:
        """The map of a robot.

        Args:
            robot: a `RobotSpec`, or the chain of any other arm (`ArmChain.from_mjcf`). If it has the structure of
                Fetch's arm, the closed form is used; otherwise sampling and numerical inverse kinematics.
            progress: shows how far it is, such as `tqdm.tqdm`.
            **parameters: the fields of `MapParameters`, such as `voxel=0.05` and `orientations=62`.

        Raises:
            ReachabilityError: the robot or the parameters make no sense.
        """
        wanted = MapParameters(**parameters)
        chain = ArmChain.of(robot)
        grid = MapGrid.of(chain, wanted)
        heights = _heights_without_torso(grid)
        field = closed_form_layers if chain.has_closed_form else sampled_layers(wanted)
        layers = iter(watched(field(chain, grid, heights), "reachability map", heights.size, progress))
        best, torso = _merge_torso_heights(layers, grid)
        columns = _columns(best, torso, grid.orientations)
        return ReachabilityMap(chain.robot, map_key(chain, wanted), wanted, grid, **columns, chain=chain)

    @staticmethod
    def from_poses(
        T_base_tcp: ArrayLike, manipulability: ArrayLike, *, robot: str = "unknown", **parameters: Any
    ) -> ReachabilityMap:
        """A map of TCP poses that were computed elsewhere, each in the cell whose centre is nearest.

        Its grid lies around the poses. It is saved, loaded, inverted and queried like any other map, but no exact
        answers are known for it, and nothing is known about other heights.

        Args:
            T_base_tcp: (n, 4, 4) TCP poses in reach, x along the approach, in a base frame on the floor with z up.
                Poses below the floor, and those on no ring of `pitches`, are left out.
            manipulability: (n,) how good each pose is, in (0, 1].
            robot: a name.
            **parameters: `voxel`, `orientations`, `pitches` and `rolls` of `MapParameters`, as fine as the poses are.
                With 1 roll, the default, the map does not distinguish rolls.

        Raises:
            ReachabilityError: these are no poses, or values out of range, or none is left.

        Example:
            T, mu = read_pose_table("robocare_right_reachability_map.npy")
            rm = ReachabilityMap.from_poses(T, mu, orientations=266, pitches=(0.0,))
        """
        wanted = MapParameters(**{"rolls": 1, "lift": False, **parameters})
        T, mu = as_poses(T_base_tcp), np.asarray(manipulability, dtype=np.float32)
        if mu.shape != T.shape[:1] or not np.all((mu > 0) & (mu <= 1)):
            raise ReachabilityError(f"manipulability is one value in (0, 1] for each of the {len(T)} poses")
        above = T[:, 2, 3] >= 0.0
        if not above.any():
            raise ReachabilityError("a map needs at least one pose above the floor")
        grid = MapGrid.around(T[above, :3, 3], wanted)
        best = _best_of_cells(grid, T[above], mu[above])
        columns = _columns(best, np.zeros(grid.shape, dtype=np.uint8), grid.orientations)
        if not len(columns["cells"]):
            raise ReachabilityError("none of the poses has one of these pitches")
        return ReachabilityMap(robot, content_key(columns), wanted, grid, **columns)

    def save(self, path: str | Path) -> None:
        """Write the map to one `.npz` file.

        Raises:
            OSError: the disk is full or cannot be written; an old file of that name stays.
        """
        save_map(Path(path), StoredMap(self.robot, self.key, self.parameters, self.grid, self._stored, self.chain))

    @staticmethod
    def load(path: str | Path, robot: Robot | ArmChain | None = None) -> ReachabilityMap:
        """Read a map that `save` wrote.

        Args:
            path: of the file.
            robot: that the map should belong to; None for a map made by `from_poses`.

        Raises:
            FileNotFoundError: no such file.
            MapFileError: the file is damaged or is no map.
            MapMismatchError: it is the map of another robot, or of this robot before it was changed.
        """
        stored = load_map(Path(path), None if robot is None else ArmChain.of(robot))
        columns: dict[str, Any] = stored.columns
        about = stored.robot, stored.key, stored.parameters, stored.grid
        return ReachabilityMap(*about, **columns, chain=stored.chain)

    @property
    def _stored(self) -> dict[str, NDArray[Any]]:
        """The columns that a file holds."""
        return {name: getattr(self, name) for name in ("cells", "manipulability", "torso_index", "flags")}

    def __len__(self) -> int:
        return self.cells.size

    def subset(self, keep: NDArray[Any]) -> ReachabilityMap:
        """The map of some of its poses; its key ends with their number.

        Args:
            keep: mask (n,) or increasing indices.
        """
        chosen: dict[str, Any] = {name: _read_only(column[keep]) for name, column in self._stored.items()}
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
            [self.grid.axis(0)[x], self.grid.axis(1)[y], self.grid.bottom + (z + 0.5) * self.grid.thickness]
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
        return reachability_index(reached.reshape(layers, width, depth), orientations)

    @cached_property
    def reachable(self) -> Bools:
        """(layers, orientations, x, y) whether a cell's centre is in reach."""
        dense = np.zeros(self.grid.size, dtype=bool)
        dense[self.cells] = True
        return _read_only(dense.reshape(self.grid.shape))


def _read_only(array: NDArray[Any]) -> NDArray[Any]:
    array.setflags(write=False)
    return array


def _columns(best: Singles, torso: NDArray[np.uint8], orientations: Orientations) -> dict[str, Any]:
    """The columns of a map, given μ and torso height of every cell."""
    cells, mu = reachability_map(best)
    flags = certainty(best > 0, orientations)
    columns: dict[str, NDArray[Any]] = {"cells": cells.astype(np.uint32), "manipulability": mu}
    columns |= {"torso_index": torso.reshape(-1)[cells], "flags": flags.reshape(-1)[cells]}
    return {name: _read_only(column) for name, column in columns.items()}


def _best_of_cells(grid: MapGrid, T: Floats, mu: Singles) -> Singles:
    """Best μ of the poses (n, 4, 4) in each cell, 0 where there is none."""
    origin = np.array([*grid.centre, grid.bottom])
    x, y, z = np.floor((T[:, :3, 3] - origin) / grid.voxel + _ROUNDING).astype(np.int64).T
    orientation = nearest_orientation(grid.orientations, T[:, :3, :3])
    best, on_ring = np.zeros(grid.shape, dtype=np.float32), orientation >= 0
    np.maximum.at(best, tuple(index[on_ring] for index in (z, orientation, x + grid.half, y + grid.half)), mu[on_ring])
    return best


def _heights_without_torso(grid: MapGrid) -> Floats:
    """Every height of a layer's middle above a torso sample; samples are one layer apart, so most heights coincide."""
    lowest = grid.layer_height(0) - grid.torsos[-1]
    return np.asarray(lowest + np.arange(grid.layers + len(grid.torsos) - 1) * grid.thickness)


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
