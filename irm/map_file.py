"""One map in one `.npz` file, written whole or not at all, and validated on load.

Numbers of cells are stored as differences from one cell to the next, which are small and compress well.
"""

from __future__ import annotations

import dataclasses
import hashlib
import io
import json
import os
import tempfile
from collections.abc import Collection
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from irm.chain import ArmChain
from irm.errors import MapFileError, MapMismatchError, ReachabilityError
from irm.grid import MapGrid, MapParameters


def write_archive(path: Path, about: dict[str, Any], arrays: dict[str, NDArray[Any]]) -> None:
    """Write arrays and a description of them; the new file replaces an old one only when it is complete.

    Raises:
        OSError: the disk is full or cannot be written; the error names the file, and nothing is left behind.
    """
    content = io.BytesIO()
    np.savez_compressed(content, allow_pickle=False, about=np.array(json.dumps(about)), **arrays)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        _write(path, content.getbuffer())
    except OSError as problem:
        reason = f"{problem.strerror or problem}, the map cannot be saved"
        raise OSError(problem.errno, reason, str(path)) from problem


def read_archive(path: Path, names: Collection[str]) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    """Read the description and the named arrays of a file.

    Raises:
        FileNotFoundError: no such file.
        MapFileError: the file is damaged or is no such archive.
    """
    try:
        with np.load(path, allow_pickle=False) as file:
            about = json.loads(str(file["about"][()]))
            arrays = {name: np.asarray(file[name]) for name in names}
    except FileNotFoundError:
        raise
    except Exception as error:  # zipfile and NumPy raise a dozen kinds for damaged bytes, MemoryError among them
        raise MapFileError(f"{path} is damaged or is no map file ({error}); build it again") from error
    if not isinstance(about, dict):
        raise MapFileError(f"{path} is no map file; build it again")
    return about, arrays


def _write(path: Path, content: memoryview) -> None:
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


FORMAT = "reachability map 4"
"""Changed whenever the numbers of a map, or their meaning, change."""
_COLUMNS = {
    "cells": np.uint32,
    "manipulability": np.float32,
    "torso_index": np.uint8,
    "flags": np.uint8,
}
_ALL_FLAGS = 3
"""Largest value of `flags`."""


@dataclasses.dataclass(frozen=True)
class StoredMap:
    """What a file contains; `chain` is None for a map of poses that were computed elsewhere."""

    robot: str
    key: str
    parameters: MapParameters
    grid: MapGrid
    columns: dict[str, NDArray[Any]]
    chain: ArmChain | None


def map_key(chain: ArmChain, parameters: MapParameters) -> str:
    """Digest of everything a map depends on: format, kinematics, parameters."""
    digest = hashlib.sha256(FORMAT.encode())
    for array in (chain.offsets, chain.axes, chain.lower, chain.upper, chain.tip, chain.links):
        digest.update(np.ascontiguousarray(array).tobytes())
    digest.update(json.dumps(dataclasses.asdict(parameters), sort_keys=True).encode())
    return digest.hexdigest()[:16]


def content_key(columns: dict[str, NDArray[Any]]) -> str:
    """Digest of the poses of a map that no chain describes."""
    digest = hashlib.sha256(FORMAT.encode())
    for name in _COLUMNS:
        digest.update(columns[name].tobytes())
    return f"poses{digest.hexdigest()[:16]}"


def save_map(path: Path, stored: StoredMap) -> None:
    """Write a map; the new file replaces an old one only when it is complete.

    Raises:
        OSError: the disk is full or cannot be written; the error names the file, and nothing is left behind.
    """
    about: dict[str, Any] = {"format": FORMAT, "robot": stored.robot, "key": stored.key}
    about |= {"parameters": dataclasses.asdict(stored.parameters)}
    if stored.chain is None:
        about |= {"grid": stored.grid.extent()}
    steps = np.diff(stored.columns["cells"], prepend=np.uint32(0))
    write_archive(path, about, {"cells": steps} | {n: c for n, c in stored.columns.items() if n != "cells"})


def load_map(path: Path, chain: ArmChain | None) -> StoredMap:
    """Read and check a map file.

    Args:
        path: of the file.
        chain: of the arm the map should belong to; None for a map of poses that were computed elsewhere.

    Raises:
        FileNotFoundError: no such file.
        MapFileError: the file is damaged or is no map.
        MapMismatchError: it is the map of another robot, or of this one before it was changed.
    """
    about, columns = read_archive(path, _COLUMNS)
    if about.get("format") != FORMAT:
        raise MapFileError(f"{path} is no {FORMAT!r} but {about.get('format')!r}; build it again")
    parameters = _parameters(path, about)
    robot, key, extent = about.get("robot"), about.get("key"), about.get("grid")
    if not isinstance(robot, str) or not isinstance(key, str):
        raise MapFileError(f"{path} does not name its robot; build it again")
    if (extent is None) != (chain is not None):
        raise MapMismatchError(
            f"{path} is a map of poses that no arm is known of; load it without a robot"
            if chain is not None
            else f"{path} is a map of the robot {robot!r}; load it together with that RobotSpec or ArmChain"
        )
    if chain is not None:
        _check_arm(path, robot, key, chain, parameters)
    grid = _grid(path, chain, parameters, extent)
    columns = _checked(path, columns, grid)
    return StoredMap(robot, key, parameters, grid, columns, chain)


def _check_arm(path: Path, robot: str, key: str, chain: ArmChain, parameters: MapParameters) -> None:
    """Raise if a map is not that of an arm."""
    if robot != chain.robot:
        raise MapMismatchError(f"{path} is a map of robot {robot!r}, not of {chain.robot!r}")
    if key.split("-")[0] != map_key(chain, parameters):
        raise MapMismatchError(f"{path} was built for {robot!r} with other joints, limits or lengths; build it again")


def _parameters(path: Path, about: dict[str, Any]) -> MapParameters:
    try:
        fields: dict[str, Any] = {
            name: tuple(v) if isinstance(v, list) else v for name, v in about["parameters"].items()
        }
        return MapParameters(**fields)
    except (KeyError, TypeError, AttributeError, ReachabilityError) as error:
        raise MapFileError(f"{path} has no valid parameters ({error}); build it again") from error


def _grid(path: Path, chain: ArmChain | None, parameters: MapParameters, extent: Any) -> MapGrid:
    try:
        return MapGrid.of_extent(parameters, extent) if chain is None else MapGrid.of(chain, parameters)
    except ReachabilityError as error:
        raise MapFileError(f"{path} has no valid grid ({error}); build it again") from error


def _checked(path: Path, columns: dict[str, NDArray[Any]], grid: MapGrid) -> dict[str, NDArray[Any]]:
    """The columns of a file with the numbers of the cells, read-only."""
    count = columns["cells"].shape
    for name, kind in _COLUMNS.items():
        if columns[name].dtype != kind or columns[name].shape != count or len(count) != 1:
            raise MapFileError(f"{path}: {name} has the wrong type or shape; build the map again")
        columns[name].setflags(write=False)
    steps, mu = columns["cells"], columns["manipulability"]
    cells = np.cumsum(steps, dtype=np.uint64)
    if np.any(steps[1:] == 0) or not np.all((mu > 0) & (mu <= 1)):
        raise MapFileError(f"{path} has values that are impossible in a map; build it again")
    if len(cells) and int(cells[-1]) >= grid.size:
        raise MapFileError(f"{path} has cells outside its grid; build it again")
    largest = {"torso_index": len(grid.torsos) - 1, "flags": _ALL_FLAGS}
    for name, limit in largest.items():
        if columns[name].size and int(columns[name].max()) > limit:
            raise MapFileError(f"{path} has {name} outside its grid; build it again")
    numbers = cells.astype(np.uint32)
    numbers.setflags(write=False)
    return columns | {"cells": numbers}
