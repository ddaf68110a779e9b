"""Reachability maps in the user's cache directory, built at the first call."""

from __future__ import annotations

import logging
import os
from pathlib import Path
from typing import Any, TypeVar

import platformdirs

from assets.robots import RobotSpec
from irm.arm.kinematics import ArmChain
from irm.errors import MapFileError, MapMismatchError
from irm.maps.certificate.cells import TableParameters
from irm.maps.certificate.table import CertificateTable, table_key
from irm.maps.grid import MapParameters
from irm.maps.map_file import map_key
from irm.maps.reachability import ReachabilityMap

__all__ = ["cache_file", "cached_map", "cached_table", "table_file"]

_LOG = logging.getLogger(__name__)

Kept = TypeVar("Kept", ReachabilityMap, CertificateTable)


def cache_file(robot: RobotSpec | ArmChain | str, **parameters: Any) -> Path:
    """The file of a robot's map: in the directory `CLUTTER_ENV_CACHE` if set, else in the user's cache directory."""
    chain = ArmChain.of(robot)
    key = map_key(chain, MapParameters(**parameters))
    return _folder() / f"{chain.robot}-{key}.npz"


def table_file(robot: RobotSpec | ArmChain | str, **parameters: Any) -> Path:
    """The file of a robot's certificate table, in the same directory."""
    chain = ArmChain.of(robot)
    return _folder() / f"{chain.robot}-table-{table_key(chain, TableParameters(**parameters))}.npz"


def cached_map(robot: RobotSpec | ArmChain | str, *, progress: bool = False, **parameters: Any) -> ReachabilityMap:
    """The map of a robot, from the cache if it is there; a damaged file, or one of another robot, is replaced.

    Args:
        robot: see `ReachabilityMap.build`.
        progress: show a progress bar while building.
        **parameters: the fields of `MapParameters`.
    """
    return _cached(ReachabilityMap, cache_file(robot, **parameters), robot, progress, parameters)


def cached_table(robot: RobotSpec | ArmChain | str, *, progress: bool = False, **parameters: Any) -> CertificateTable:
    """The certificate table of a robot, as `cached_map`; `parameters` are the fields of `TableParameters`.

    Raises:
        ReachabilityError: the arm has not the structure of Fetch's arm, or the parameters make no sense.
    """
    return _cached(CertificateTable, table_file(robot, **parameters), robot, progress, parameters)


def _folder() -> Path:
    return Path(os.environ.get("CLUTTER_ENV_CACHE") or platformdirs.user_cache_dir("clutter-env"))


def _cached(
    kind: type[Kept], path: Path, robot: RobotSpec | ArmChain | str, progress: bool, parameters: dict[str, Any]
) -> Kept:
    """The map or the table in a file, built if it is not there or no good."""
    if path.exists():
        try:
            return kind.load(path, robot)
        except (MapFileError, MapMismatchError) as error:
            _LOG.warning("%s; building the map again", error)
    built = kind.build(robot, progress=progress, **parameters)
    try:
        built.save(path)
    except OSError as error:
        _LOG.warning("the map could not be kept in %s: %s", path, error)
    return built
