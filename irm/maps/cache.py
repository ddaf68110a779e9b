"""Reachability maps in the user's cache directory, built at the first call."""

from __future__ import annotations

import logging
import os
from pathlib import Path
from typing import Any

import platformdirs

from assets.robots import RobotSpec
from irm.arm.kinematics import ArmChain
from irm.errors import MapFileError, MapMismatchError
from irm.maps.grid import MapParameters
from irm.maps.map_file import map_key
from irm.maps.reachability import ReachabilityMap

__all__ = ["cache_file", "cached_map"]

_LOG = logging.getLogger(__name__)


def cache_file(robot: RobotSpec | ArmChain | str, **parameters: Any) -> Path:
    """The file of a robot's map: in the directory `CLUTTER_ENV_CACHE` if set, else in the user's cache directory."""
    chain = ArmChain.of(robot)
    key = map_key(chain, MapParameters(**parameters))
    folder = os.environ.get("CLUTTER_ENV_CACHE") or platformdirs.user_cache_dir("clutter-env")
    return Path(folder) / f"{chain.robot}-{key}.npz"


def cached_map(robot: RobotSpec | ArmChain | str, *, progress: bool = False, **parameters: Any) -> ReachabilityMap:
    """The map of a robot, from the cache if it is there; a damaged file, or one of another robot, is replaced.

    Args:
        robot: see `ReachabilityMap.build`.
        progress: show a progress bar while building.
        **parameters: the fields of `MapParameters`.
    """
    path = cache_file(robot, **parameters)
    if path.exists():
        try:
            return ReachabilityMap.load(path, robot)
        except (MapFileError, MapMismatchError) as error:
            _LOG.warning("%s; building the map again", error)
    built = ReachabilityMap.build(robot, progress=progress, **parameters)
    try:
        built.save(path)
    except OSError as error:
        _LOG.warning("the map could not be kept in %s: %s", path, error)
    return built
