"""Times and file sizes of building, inverting, saving and loading maps."""

from __future__ import annotations

import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from assets.robots import RobotSpec
from clutter_env.reporting.progress import progress_bar
from irm.reachability_map import ReachabilityMap
from irm.inverse_map import InverseReachabilityMap

__all__ = ["BUILDS", "BuildCost", "measure_build"]

BUILDS: dict[str, dict[str, Any]] = {
    "62 orientations": {},
    "62 orientations, torso fixed": {"lift": False},
    "level gripper, 15 degrees, 0.7 to 1.2 m": {"orientations": 266, "pitches": (0.0,), "heights": (0.7, 1.2)},
    "266 orientations": {"orientations": 266},
}


@dataclass(frozen=True)
class BuildCost:
    """CPU times of one thread [s], after compilation."""

    name: str
    poses: int
    build_s: float
    invert_s: float
    save_s: float
    load_s: float
    megabytes: float


def measure_build(robot: RobotSpec, name: str) -> BuildCost:
    """Build, invert, save and load one of the `BUILDS`."""
    ReachabilityMap.build(robot, voxel=0.25, orientations=6)
    start = time.process_time()
    rm = ReachabilityMap.build(robot, progress=progress_bar, **BUILDS[name])
    built = time.process_time()
    InverseReachabilityMap(rm)
    inverted = time.process_time()
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "map.npz"
        rm.save(file)
        saved = time.process_time()
        ReachabilityMap.load(file, robot)
        loaded = time.process_time()
        size = file.stat().st_size / 1e6
    return BuildCost(name, len(rm), built - start, inverted - built, saved - inverted, loaded - saved, size)
