"""One map in one `.npz` file, with the checks that it is complete and belongs to the robot."""

from __future__ import annotations

import dataclasses
import hashlib
import io
import json
import os
import tempfile
import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from irm.arm.kinematics import ArmChain
from irm.errors import MapFileError, MapMismatchError, ReachabilityError
from irm.maps.grid import MapParameters

__all__ = ["load_arrays", "map_key", "save_arrays"]

FORMAT = "reachability map 2"
"""Changed whenever the numbers of a map, or their meaning, change."""

_COLUMNS = {
    "cells": np.uint32,
    "manipulability": np.float32,
    "torso_index": np.uint8,
    "flags": np.uint8,
}


def map_key(chain: ArmChain, parameters: MapParameters) -> str:
    """Digest of everything a map depends on: format, kinematics, parameters."""
    digest = hashlib.sha256(FORMAT.encode())
    for array in (chain.offsets, chain.axes, chain.lower, chain.upper, chain.tip, chain.links):
        digest.update(np.ascontiguousarray(array).tobytes())
    digest.update(json.dumps(dataclasses.asdict(parameters), sort_keys=True).encode())
    return digest.hexdigest()[:16]


def save_arrays(path: Path, robot: str, key: str, parameters: MapParameters, arrays: dict[str, NDArray[Any]]) -> None:
    """Write a map; the new file replaces an old one only when it is complete.

    Raises:
        OSError: the disk is full or cannot be written; the error names the file, and nothing is left behind.
    """
    about = {"format": FORMAT, "robot": robot, "key": key, "parameters": dataclasses.asdict(parameters)}
    content = io.BytesIO()
    np.savez(content, allow_pickle=False, about=np.array(json.dumps(about)), **arrays)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        _write(path, content.getbuffer())
    except OSError as problem:
        reason = f"{problem.strerror or problem}, the map cannot be saved"
        raise OSError(problem.errno, reason, str(path)) from problem


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


def load_arrays(path: Path, chain: ArmChain) -> tuple[str, MapParameters, dict[str, NDArray[Any]]]:
    """Key, parameters and columns of a map file.

    Raises:
        FileNotFoundError: no such file.
        MapFileError: the file is damaged or is no map.
        MapMismatchError: it is the map of another robot, or of this one before it was changed.
    """
    about, arrays = _read(path)
    if about.get("format") != FORMAT:
        raise MapFileError(f"{path} is no {FORMAT!r} but {about.get('format')!r}; build it again")
    parameters = _parameters(path, about)
    robot, key = about.get("robot"), str(about.get("key"))
    if robot != chain.robot:
        raise MapMismatchError(f"{path} is a map of robot {robot!r}, not of {chain.robot!r}")
    if key.split("-")[0] != map_key(chain, parameters):
        raise MapMismatchError(f"{path} was built for {robot!r} with other joints, limits or lengths; build it again")
    _check_columns(path, arrays)
    return key, parameters, arrays


def _read(path: Path) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    try:
        with np.load(path, allow_pickle=False) as file:
            about = json.loads(str(file["about"]))
            arrays = {name: file[name] for name in _COLUMNS}
    except FileNotFoundError:
        raise
    except (OSError, EOFError, KeyError, ValueError, TypeError, zipfile.BadZipFile, zlib.error) as error:
        raise MapFileError(f"{path} is damaged or is no map file ({error}); build it again") from error
    if not isinstance(about, dict):
        raise MapFileError(f"{path} is no map file; build it again")
    return about, arrays


def _parameters(path: Path, about: dict[str, Any]) -> MapParameters:
    try:
        fields: dict[str, Any] = {
            name: tuple(v) if isinstance(v, list) else v for name, v in about["parameters"].items()
        }
        return MapParameters(**fields)
    except (KeyError, TypeError, AttributeError, ReachabilityError) as error:
        raise MapFileError(f"{path} has no valid parameters ({error}); build it again") from error


def _check_columns(path: Path, arrays: dict[str, NDArray[Any]]) -> None:
    count = arrays["cells"].shape
    for name, kind in _COLUMNS.items():
        if arrays[name].dtype != kind or arrays[name].shape != count or len(count) != 1:
            raise MapFileError(f"{path}: {name} has the wrong type or shape; build the map again")
        arrays[name].setflags(write=False)
    cells, mu = arrays["cells"].astype(np.int64), arrays["manipulability"]
    if np.any(np.diff(cells) <= 0) or not np.all((mu > 0) & (mu <= 1)):
        raise MapFileError(f"{path} has values that are impossible in a map; build it again")
