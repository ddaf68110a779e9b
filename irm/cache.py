"""Reachability maps that come with a robot, or are built at the first call and kept in the user's cache directory."""

from __future__ import annotations

import logging
import os
from pathlib import Path
from typing import Any

import platformdirs

from irm.chain import ArmChain
from irm.errors import MapFileError, MapMismatchError
from irm.grid import MapParameters
from irm.map_file import map_key
from irm.reachability_map import ProgressBar, ReachabilityMap
from irm.robot import Robot

_LOG = logging.getLogger(__name__)


def cache_folder() -> Path:
    """The directory `CLUTTER_ENV_CACHE` if set, else the user's cache directory."""
    return Path(os.environ.get("CLUTTER_ENV_CACHE") or platformdirs.user_cache_dir("clutter-env"))


def cache_file(robot: Robot | ArmChain, **parameters: Any) -> Path:
    """The file of a robot's map in the cache.

    Its name contains the digest of all that a map depends on: after a change of the robot, the parameters or the format
    the file has another name, and the old one is no longer used.
    """
    chain = ArmChain.of(robot)
    return cache_folder() / f"{chain.robot}-{map_key(chain, MapParameters(**parameters))}.npz"


def shipped_file(robot: Robot | ArmChain, **parameters: Any) -> Path | None:
    """The map that comes with a robot, in its `map_folder` under the same name; None if there is none."""
    folder = None if isinstance(robot, ArmChain) else robot.map_folder
    file = folder and folder / cache_file(robot, **parameters).name
    return file if file and file.exists() else None


def is_map_at_hand(robot: Robot | ArmChain, **parameters: Any) -> bool:
    """Whether `cached_map` has a file to load, so that it need not build the map."""
    return shipped_file(robot, **parameters) is not None or cache_file(robot, **parameters).exists()


def cached_map(robot: Robot | ArmChain, *, progress: ProgressBar | None = None, **parameters: Any) -> ReachabilityMap:
    """The map of a robot: the one that comes with it, or the one in the cache, or built and kept there.

    A damaged file in the cache, or one of another robot, is replaced.

    Args:
        robot: see `ReachabilityMap.build`.
        progress: shows how far building is, such as `tqdm.tqdm`.
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
