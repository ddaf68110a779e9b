"""Reachability maps: of the package, or built at the first call and kept in the user's cache directory."""

from __future__ import annotations

import logging
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any, Protocol, TypeVar

import platformdirs

import assets
from assets.robots import RobotSpec
from irm.arm.kinematics import ArmChain
from irm.errors import MapFileError, MapMismatchError
from irm.maps.certificate.cells import TableParameters
from irm.maps.certificate.table import CertificateTable, table_key
from irm.maps.grid import MapParameters
from irm.maps.map_file import map_key
from irm.maps.reachability import ReachabilityMap
from irm.progress import ProgressBar

__all__ = [
    "cache_file",
    "cache_folder",
    "cached",
    "cached_map",
    "cached_table",
    "is_map_at_hand",
    "shipped_file",
    "table_file",
]

_LOG = logging.getLogger(__name__)


class _Saved(Protocol):
    """What can be kept in a file."""

    def save(self, path: str | Path) -> None: ...


Kept = TypeVar("Kept", bound=_Saved)


def cache_file(robot: RobotSpec | ArmChain | str, **parameters: Any) -> Path:
    """The file of a robot's map: in the directory `CLUTTER_ENV_CACHE` if set, else in the user's cache directory."""
    chain = ArmChain.of(robot)
    key = map_key(chain, MapParameters(**parameters))
    return cache_folder() / f"{chain.robot}-{key}.npz"


def shipped_file(robot: RobotSpec | ArmChain | str, **parameters: Any) -> Path:
    """Where the map of a robot is if it comes with the package.

    Its name contains the digest of all that a map depends on: after a change of the robot, the parameters or the format
    the file has another name, and the old one is no longer used.
    """
    return assets.folder("maps") / cache_file(robot, **parameters).name


def table_file(robot: RobotSpec | ArmChain | str, **parameters: Any) -> Path:
    """The file of a robot's certificate table, in the same directory."""
    chain = ArmChain.of(robot)
    return cache_folder() / f"{chain.robot}-table-{table_key(chain, TableParameters(**parameters))}.npz"


def cached_map(
    robot: RobotSpec | ArmChain | str, *, progress: ProgressBar | None = None, **parameters: Any
) -> ReachabilityMap:
    """The map of a robot, from the package or the cache if it is there.

    A damaged file in the cache, or one of another robot, is replaced.

    Args:
        robot: see `ReachabilityMap.build`.
        progress: shows how far building is, such as `tqdm.tqdm`.
        **parameters: the fields of `MapParameters`.
    """
    shipped = shipped_file(robot, **parameters)
    if shipped.exists():
        try:
            return ReachabilityMap.load(shipped, robot)
        except MapFileError as error:
            _LOG.warning("the installation is damaged: %s", error)
    return cached(
        cache_file(robot, **parameters),
        lambda path: ReachabilityMap.load(path, robot),
        lambda: ReachabilityMap.build(robot, progress=progress, **parameters),
    )


def is_map_at_hand(robot: RobotSpec | ArmChain | str, **parameters: Any) -> bool:
    """Whether `cached_map` has a file to load, so that it need not build the map."""
    return shipped_file(robot, **parameters).exists() or cache_file(robot, **parameters).exists()


def cached_table(
    robot: RobotSpec | ArmChain | str, *, progress: ProgressBar | None = None, **parameters: Any
) -> CertificateTable:
    """The certificate table of a robot, as `cached_map`; `parameters` are the fields of `TableParameters`.

    Raises:
        ReachabilityError: the arm has not the structure of Fetch's arm, or the parameters make no sense.
    """
    return cached(
        table_file(robot, **parameters),
        lambda path: CertificateTable.load(path, robot),
        lambda: CertificateTable.build(robot, progress=progress, **parameters),
    )


def cache_folder() -> Path:
    """The directory `CLUTTER_ENV_CACHE` if set, else the user's cache directory."""
    return Path(os.environ.get("CLUTTER_ENV_CACHE") or platformdirs.user_cache_dir("clutter-env"))


def cached(path: Path, load: Callable[[Path], Kept], build: Callable[[], Kept]) -> Kept:
    """What is in a file; if it is not there, or no good, it is built and kept there.

    Args:
        path: of the file.
        load: reads it, or raises MapFileError or MapMismatchError.
        build: makes it.
    """
    if path.exists():
        try:
            return load(path)
        except (MapFileError, MapMismatchError) as error:
            _LOG.warning("%s; building the map again", error)
    built = build()
    try:
        built.save(path)
    except OSError as error:
        _LOG.warning("the map could not be kept in %s: %s", path, error)
    return built
