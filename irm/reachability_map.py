"""Reachability map: TCP poses in reach, in the base frame, and their manipulability (equations 1 to 3).

A map is stored in one `.npz` file, written atomically and validated on load. `cached_map` loads the file that ships
with a robot. Otherwise it builds the map at the first call and stores it in the user's cache directory.
"""

from __future__ import annotations

import hashlib
import io
import json
import logging
import os
import tempfile
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from irm.chain import ArmChain, Robot
from irm.errors import MapFileError, MapMismatchError, ReachabilityError
from irm.grid import MapGrid, MapParameters, Orientations, nearest_orientation
from irm.packed_cells import PackedCells, bits_of, dense, join_cells, pack_cells
from irm.rotations import as_poses, wrap_to_pi
from irm.shapes import NO_SHAPES

if TYPE_CHECKING:
    from irm.map_kernels import Layer

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
Bools = NDArray[np.bool_]
ProgressBar = Callable[..., Iterable[Any]]
"""Called with items, `desc=` (the name of the task) and `total=`. Yields the same items. For example `tqdm.tqdm`."""
CERTAIN_IN_HEIGHT = 1
"""Bit of `flags`: the cells above and below are reachable too."""
CERTAIN_IN_PITCH = 2
"""Bit of `flags`: the neighbouring pitches (and rolls), and the cells above and below these, are reachable too."""
FORMAT = "reachability map 6"
"""Version of the format. It changes whenever the numbers of a map, or their meaning, change."""
_COLUMNS = {"reached": (np.uint8,), "free": (np.uint8,), "codes": (np.uint16, np.uint32), "levels": (np.float32,)}
"""Arrays of a file, see `join_cells`, and their allowed types."""
_ROUNDING = 1e-9
"""Share of a voxel by which rounding may move a pose."""
_LOG = logging.getLogger(__name__)


@dataclass(frozen=True)
class ReachabilityMap:
    """RM = {(T_eff, T_base = I, μ)} over the reachable samples (equation 3), one per cell. Arrays are read-only.

    Attributes:
        robot: name of the robot.
        key: digest of robot and parameters. Maps with equal keys are equal.
        parameters: range and resolution of the map.
        grid: its cells.
        packed: the cells in little memory, for kernels.
        chain: the arm. None for a map of poses that were computed elsewhere.
        cells: (n,) uint32 numbers of the reachable cells, increasing.
        manipulability: (n,) float32 best μ found at the cell's centre (equation 2, linear rows in m). Zero where every
            configuration found is in self-collision. See `irm.packed_cells` for its precision.
        torso_index: (n,) uint8 torso height of that configuration, an index into `grid.torsos`.
        flags: (n,) uint8 of CERTAIN_IN_HEIGHT, CERTAIN_IN_PITCH.

    The last four, and all other arrays of n or more entries, are computed at every access.

    Example:
        rm = ReachabilityMap.build(FETCH, voxel=0.05, orientations=62)
        rm.save("fetch.npz")
    """

    robot: str
    key: str
    parameters: MapParameters
    grid: MapGrid
    packed: PackedCells
    chain: ArmChain | None = None

    @staticmethod
    def build(robot: Robot | ArmChain, *, progress: ProgressBar | None = None, **parameters: Any) -> ReachabilityMap:
        """Build the map of a robot.

        Args:
            robot: a `RobotSpec`, or the chain of any other arm (`ArmChain.from_mjcf`). If it has the structure of
                Fetch's arm, the closed form is used. Otherwise sampling and numerical inverse kinematics.
            progress: progress bar, such as `tqdm.tqdm`.
            **parameters: the fields of `MapParameters`, such as `voxel=0.05` and `orientations=62`.

        Raises:
            ReachabilityError: the robot or the parameters are invalid.
        """
        # Most maps are loaded, not built. These imports are then not needed.
        from irm.map_kernels import closed_form_layers
        from irm.sampled_layers import sampled_layers

        wanted = MapParameters(**parameters)
        chain = _chain_of(robot, wanted)
        if not (progress is None or callable(progress)):
            raise ReachabilityError(f"progress={progress!r} must be None or a function that shows progress: tqdm.tqdm")
        grid = MapGrid.of(chain, wanted)
        # Heights of the layers' middles above each torso sample. Samples are one layer apart, so most heights coincide.
        lowest, count = grid.layer_height(0) - grid.torsos[-1], grid.layers + len(grid.torsos) - 1
        heights = np.asarray(lowest + np.arange(count) * grid.thickness)
        if chain.has_closed_form:
            layers = closed_form_layers(chain, grid, heights)
        else:
            layers = sampled_layers(chain, grid, heights, wanted)
        shown = layers if progress is None else progress(layers, desc="reachability map", total=count)
        packed = _merge_torso_heights(shown, grid)
        return ReachabilityMap(chain.robot, map_key(chain, wanted), wanted, grid, packed, chain)

    @staticmethod
    def from_poses(
        T_base_tcp: ArrayLike, manipulability: ArrayLike, *, robot: str = "unknown", **parameters: Any
    ) -> ReachabilityMap:
        """Make a map of TCP poses that were computed elsewhere, each in the cell with the nearest centre.

        Its grid lies around the poses. It is saved, loaded, inverted and queried like any other map. But it has no
        exact answers, and no information about other heights.

        Args:
            T_base_tcp: (n, 4, 4) TCP poses in reach, x along the approach, in a base frame on the floor with z up.
                Poses off the rings of `pitches` are left out.
            manipulability: (n,) quality of each pose, in (0, 1].
            robot: a name.
            **parameters: `voxel`, `orientations`, `pitches` and `rolls` of `MapParameters`, as fine as the poses are.
                With 1 roll, the default, the map does not distinguish rolls.

        Raises:
            ReachabilityError: the poses are invalid, values are out of range, or no pose is left.

        Example:
            T, mu = read_pose_table("robocare_right_reachability_map.npy")
            rm = ReachabilityMap.from_poses(T, mu, orientations=266, pitches=(0.0,))
        """
        wanted = MapParameters(**{"rolls": 1, "lift": False, **parameters})
        T, mu = as_poses(T_base_tcp), np.asarray(manipulability, dtype=np.float32)
        if mu.shape != T.shape[:1] or not np.all((mu > 0) & (mu <= 1)):
            raise ReachabilityError(f"manipulability is one value in (0, 1] for each of the {len(T)} poses")
        if not len(T):
            raise ReachabilityError("a map needs at least one pose")
        grid = MapGrid.around(T[:, :3, 3], wanted)
        x, y, z = np.floor((T[:, :3, 3] - (*grid.centre, grid.bottom)) / grid.voxel + _ROUNDING).astype(np.int64).T
        orientation = nearest_orientation(grid.orientations, T[:, :3, :3])
        best, on_ring = np.zeros(grid.shape, dtype=np.float32), orientation >= 0
        cells = tuple(index[on_ring] for index in (z, orientation, x + grid.half, y + grid.half))
        np.maximum.at(best, cells, mu[on_ring])
        if not best.any():
            raise ReachabilityError("none of the poses has one of these pitches")
        free = best > 0
        mu = best[free]
        packed = pack_cells(grid, free, free, mu, np.zeros(len(mu), np.uint8))
        digest = hashlib.sha256(FORMAT.encode())
        for column in (np.flatnonzero(free), mu):
            digest.update(column.tobytes())
        return ReachabilityMap(robot, f"poses{digest.hexdigest()[:16]}", wanted, grid, packed)

    def save(self, path: str | Path) -> None:
        """Write the map to one `.npz` file. It replaces an old file only when it is complete.

        Raises:
            OSError: the disk is full or cannot be written. The error names the file, and no partial file remains.
        """
        about: dict[str, Any] = {"format": FORMAT, "robot": self.robot, "key": self.key}
        about |= {"parameters": asdict(self.parameters)}
        if self.chain is None:
            about |= {"grid": self.grid.extent()}
        reached, free = bits_of(self.packed, self.grid)
        columns = {"reached": reached, "free": free, "codes": self.packed.codes, "levels": self.packed.levels}
        content = io.BytesIO()
        np.savez_compressed(content, allow_pickle=False, about=np.array(json.dumps(about)), **columns)
        try:
            _write(Path(path), content.getbuffer())
        except OSError as problem:
            reason = f"{problem.strerror or problem}, the map cannot be saved"
            raise OSError(problem.errno, reason, str(path)) from problem

    @staticmethod
    def load(path: str | Path, robot: Robot | ArmChain | None = None) -> ReachabilityMap:
        """Read a map that `save` wrote.

        Args:
            path: of the file.
            robot: expected robot of the map. None for a map made by `from_poses`.

        Raises:
            FileNotFoundError: no such file.
            MapFileError: the file is damaged or is not a map.
            MapMismatchError: the map belongs to another robot, or to an earlier version of this robot.
        """
        about, columns = _read(Path(path))
        name, key, extent = about.get("robot"), about.get("key"), about.get("grid")
        try:
            fields: dict[str, Any] = {n: tuple(v) if isinstance(v, list) else v for n, v in about["parameters"].items()}
            parameters = MapParameters(**fields)
        except (KeyError, TypeError, AttributeError, ReachabilityError) as error:
            raise MapFileError(f"{path} has no valid parameters ({error}); build it again") from error
        chain = None if robot is None else _chain_of(robot, parameters)
        if not isinstance(name, str) or not isinstance(key, str):
            raise MapFileError(f"{path} does not name its robot; build it again")
        if chain is not None and extent is not None:
            raise MapMismatchError(f"{path} is a map of poses that no arm is known of; load it without a robot")
        if chain is None and extent is None:
            raise MapMismatchError(
                f"{path} is a map of the robot {name!r}; load it together with that RobotSpec or ArmChain"
            )
        if chain is not None and name != chain.robot:
            raise MapMismatchError(f"{path} is a map of robot {name!r}, not of {chain.robot!r}")
        if chain is not None and key.split("-")[0] != map_key(chain, parameters):
            raise MapMismatchError(
                f"{path} was built for {name!r} with other joints, limits or lengths; build it again"
            )
        try:
            grid = MapGrid.of_extent(parameters, extent) if chain is None else MapGrid.of(chain, parameters)
        except ReachabilityError as error:
            raise MapFileError(f"{path} has no valid grid ({error}); build it again") from error
        return ReachabilityMap(name, key, parameters, grid, _checked(path, columns, grid), chain)

    def __len__(self) -> int:
        return int(self.reached.sum())

    @property
    def cells(self) -> NDArray[np.uint32]:
        """(n,) numbers of the reached cells, increasing."""
        return _read_only(np.flatnonzero(self.reached).astype(np.uint32))

    @property
    def manipulability(self) -> Singles:
        """(n,) best μ of each reached cell."""
        return _read_only(self._of_codes(self.packed.levels[self.packed.codes >> self.packed.torso_bits]))

    @property
    def torso_index(self) -> NDArray[np.uint8]:
        """(n,) number of each cell's torso height."""
        return _read_only(self._of_codes((self.packed.codes & ((1 << self.packed.torso_bits) - 1)).astype(np.uint8)))

    def _of_codes(self, values: NDArray[Any]) -> NDArray[Any]:
        """Extend values of the free cells to all reached cells (n,), with 0 at the others."""
        every = np.zeros(len(self), values.dtype)
        every[self.reachable[self.reached]] = values
        return every

    @property
    def flags(self) -> NDArray[np.uint8]:
        """(n,) CERTAIN_IN_HEIGHT, CERTAIN_IN_PITCH."""
        return _read_only(_certainty(self.reachable, self.grid.orientations)[self.reached])

    def subset(self, keep: NDArray[Any]) -> ReachabilityMap:
        """Make the map of some of its poses. Its key ends with their number.

        Args:
            keep: mask (n,) or increasing indices.
        """
        cells = self.cells[keep].astype(np.int64)
        if np.any(np.diff(cells) <= 0):
            raise ReachabilityError("subset needs a mask or increasing indices")
        reached, free = np.zeros((2, self.grid.size), np.bool_)
        mu, torso = self.manipulability[keep], self.torso_index[keep]
        reached[cells], free[cells[mu > 0]] = True, True
        packed = pack_cells(self.grid, reached, free, mu[mu > 0], torso[mu > 0])
        return replace(self, key=f"{self.key}-{len(cells)}", packed=packed)

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
        voxels, free = np.ravel_multi_index((z, x, y), (layers, width, depth)), self.manipulability > 0
        reached = np.bincount(voxels[free], minlength=layers * width * depth)
        return reached.reshape(layers, width, depth) / orientations * 100.0

    @property
    def reachable(self) -> Bools:
        """(layers, orientations, x, y) whether a free configuration reaches a cell's centre."""
        return _read_only(dense(self.grid, self.packed, self.packed.free))

    def are_free(self, cells: NDArray[np.int64]) -> Bools:
        """(m,) whether free configurations reach cells (m, 4), each of layer, orientation, x and y."""
        layer, orientation, x, y = cells.T
        start, side = self.grid.orientations.start, 2 * self.grid.half
        group = np.searchsorted(start, orientation, side="right") - 1
        local = ((orientation - start[group]) * side + x) * side + y
        word = self.packed.offset[layer * (len(start) - 1) + group] + (local >> 6)
        return (self.packed.free[word] >> (local & 63).astype(np.uint64)) & np.uint64(1) > 0

    @property
    def reached(self) -> Bools:
        """(layers, orientations, x, y) whether any configuration reaches a cell's centre, in self-collision or not."""
        return _read_only(dense(self.grid, self.packed, self.packed.reached))


def cache_folder() -> Path:
    """The directory `CLUTTER_ENV_CACHE` if set, or the user's cache directory."""
    if own := os.environ.get("CLUTTER_ENV_CACHE"):
        return Path(own)
    import platformdirs  # maps are built and queried without it

    return Path(platformdirs.user_cache_dir("clutter-env"))


def cache_file(robot: Robot | ArmChain, **parameters: Any) -> Path:
    """The file of a robot's map in the cache.

    Its name contains the digest of everything a map depends on. After a change of the robot, the parameters or the
    format, the file has another name, and the old file is no longer used.
    """
    wanted = MapParameters(**parameters)
    chain = _chain_of(robot, wanted)
    return cache_folder() / f"{chain.robot}-{map_key(chain, wanted)}.npz"


def shipped_file(robot: Robot | ArmChain, **parameters: Any) -> Path | None:
    """The map file that ships with a robot, in its `map_folder` under the same name. None without such a file."""
    folder = None if isinstance(robot, ArmChain) else robot.map_folder
    file = folder and folder / cache_file(robot, **parameters).name
    return file if file and file.exists() else None


def is_map_at_hand(robot: Robot | ArmChain, **parameters: Any) -> bool:
    """Whether `cached_map` can load a file, and need not build the map."""
    return shipped_file(robot, **parameters) is not None or cache_file(robot, **parameters).exists()


def cached_map(robot: Robot | ArmChain, *, progress: ProgressBar | None = None, **parameters: Any) -> ReachabilityMap:
    """Load the map of a robot, shipped or cached, or build it and store it in the cache.

    A damaged file in the cache, or a file of another robot, is replaced.

    Args:
        robot: see `ReachabilityMap.build`.
        progress: progress bar of the build, such as `tqdm.tqdm`.
        **parameters: the fields of `MapParameters`.
    """
    file = cache_file(robot, **parameters)
    for found in (shipped_file(robot, **parameters), file):
        if found is not None and found.exists():
            try:
                return ReachabilityMap.load(found, robot)
            except (MapFileError, MapMismatchError) as error:
                _LOG.warning("%s; the map is built again", error)
    built = ReachabilityMap.build(robot, progress=progress, **parameters)
    try:
        built.save(file)
    except OSError as error:
        _LOG.warning("the map could not be kept in %s: %s", file, error)
    return built


def _chain_of(robot: Robot | ArmChain, parameters: MapParameters) -> ArmChain:
    """The arm for a map with these parameters, without shapes if self-collision is ignored."""
    chain = ArmChain.of(robot)
    return chain if parameters.self_collision else replace(chain, shapes=NO_SHAPES)


def map_key(chain: ArmChain, parameters: MapParameters) -> str:
    """Digest of everything a map depends on: format, kinematics, shapes, parameters."""
    digest = hashlib.sha256(FORMAT.encode())
    for array in (chain.offsets, chain.axes, chain.lower, chain.upper, chain.tip, chain.links, *chain.shapes):
        digest.update(np.ascontiguousarray(array).tobytes())
    digest.update(json.dumps(asdict(parameters), sort_keys=True).encode())
    return digest.hexdigest()[:16]


def _write(path: Path, content: memoryview) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    descriptor, draft = tempfile.mkstemp(dir=path.parent, prefix=path.stem, suffix=".tmp")
    try:
        with os.fdopen(descriptor, "wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        os.replace(draft, path)
    except BaseException:
        os.unlink(draft)
        raise


def _read(path: Path) -> tuple[dict[str, Any], dict[str, Any]]:
    """The description and the columns in a file of this format."""
    try:
        with np.load(path, allow_pickle=False) as file:
            about = json.loads(str(file["about"][()]))
            columns = {name: np.asarray(file[name]) for name in _COLUMNS}
    except FileNotFoundError:
        raise
    except Exception as error:  # zipfile and NumPy raise a dozen kinds for damaged bytes, MemoryError among them
        raise MapFileError(f"{path} is damaged or is no map file ({error}); build it again") from error
    if not isinstance(about, dict):
        raise MapFileError(f"{path} is no map file; build it again")
    if about.get("format") != FORMAT:
        raise MapFileError(f"{path} is no {FORMAT!r} but {about.get('format')!r}; build it again")
    return about, columns


def _checked(path: str | Path, columns: dict[str, Any], grid: MapGrid) -> PackedCells:
    """The cells of a file."""
    for name, kinds in _COLUMNS.items():
        if columns[name].dtype not in kinds or columns[name].ndim != 1:
            raise MapFileError(f"{path}: {name} has the wrong type or shape; build the map again")
    reached, free, codes, levels = (columns[name] for name in _COLUMNS)
    size, torsos = -(-grid.size // 8), len(grid.torsos)
    if len(reached) != size or len(free) != size or np.any(free & ~reached):
        raise MapFileError(f"{path} has cells outside its grid; build it again")
    if len(codes) != int(np.bitwise_count(free).sum()) or (grid.size % 8 and reached[-1] >> grid.size % 8):
        raise MapFileError(f"{path} has cells outside its grid; build it again")
    if not np.all((levels > 0) & (levels <= 1)) or np.any(np.diff(levels) <= 0):
        raise MapFileError(f"{path} has values that are impossible in a map; build it again")
    cells = join_cells(grid, reached, free, codes, levels)
    level, torso = codes >> cells.torso_bits, codes & ((1 << cells.torso_bits) - 1)
    if len(codes) and (int(level.max()) >= len(levels) or int(torso.max()) >= torsos):
        raise MapFileError(f"{path} has codes outside its levels; build it again")
    return cells


def _read_only(array: NDArray[Any]) -> NDArray[Any]:
    array.setflags(write=False)
    return array


def _merge_torso_heights(layers: Iterable[Layer], grid: MapGrid) -> PackedCells:
    """Find the best μ over the torso heights, and its torso height. A lift shifts the map of a fixed torso up.

    Layer `height` of a fixed torso contributes to one layer of the map per torso height. So a layer of the map is
    complete after the last contribution. Only incomplete layers are kept as arrays of numbers.
    """
    count, shape = len(grid.torsos), grid.shape[1:]
    reached, free = np.zeros((2, *grid.shape), np.bool_)
    best, torso = np.zeros((count, *shape), np.float32), np.zeros((count, *shape), np.uint8)
    values: list[Singles] = []
    torsos: list[NDArray[np.uint8]] = []
    for height, layer in enumerate(layers):
        for k in range(count):
            z = height + k - (count - 1)
            if 0 <= z < grid.layers:
                better = layer.mu[k] > best[z % count]
                best[z % count][better] = layer.mu[k][better]
                torso[z % count][better] = k
                reached[z] |= layer.reached
        z = height - (count - 1)
        if 0 <= z < grid.layers:
            free[z] = best[z % count] > 0
            values.append(best[z % count][free[z]])
            torsos.append(torso[z % count][free[z]])
            best[z % count], torso[z % count] = 0.0, 0
    return pack_cells(grid, reached, free, np.concatenate(values), np.concatenate(torsos))


def _certainty(reachable: Bools, orientations: Orientations) -> NDArray[np.uint8]:
    """Flags of every cell (layers, orientations, x, y), from the cells in reach."""
    upright = np.zeros_like(reachable)  # with the cells above and below, false in the outermost layers
    upright[1:-1] = reachable[1:-1] & reachable[:-2] & reachable[2:]
    flags = upright.astype(np.uint8) * np.uint8(CERTAIN_IN_HEIGHT)
    for group in range(len(orientations.pitch)):
        if not (beside := _groups_beside(orientations, group)):
            continue
        first, last = orientations.start[group : group + 2]
        certain = upright[:, first:last].copy()
        for other in beside:
            start, end = orientations.start[other : other + 2]
            block = upright[:, start:end]
            certain &= block if end - start == last - first else block.all(axis=1, keepdims=True)
        flags[:, first:last] |= certain.astype(np.uint8) * np.uint8(CERTAIN_IN_PITCH)
    return flags


def _groups_beside(orientations: Orientations, group: int) -> list[int]:
    """Groups within one step of pitch and roll. Empty if the map lacks the ring on one side."""
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


def neighbouring_groups(orientations: Orientations) -> NDArray[np.int64]:
    """(groups, m) groups within one step of pitch and roll of each, padded with -1. All -1 if the map lacks a
    neighbour."""
    rows = [_groups_beside(orientations, group) for group in range(len(orientations.pitch))]
    width = max(1, *(len(row) for row in rows)) if rows else 1
    return np.array([row + [-1] * (width - len(row)) for row in rows], dtype=np.int64)
