"""Build the reachability map of a robot, save it, and report its size and quality."""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from assets.robots import RobotSpec
from clutter_env.experiments.maps.slices import draw_arm_map
from clutter_env.reporting.progress import progress_bar
from irm.chain import ArmChain
from irm.grid import MapParameters
from irm.reachability_map import ReachabilityMap

__all__ = ["MapReport", "build_map"]


@dataclass(frozen=True)
class MapReport:
    """A map that was built.

    Attributes:
        robot: its name.
        poses: reachable cells.
        voxels: positions that are reachable in at least one orientation.
        mean_reachability_index: mean D of these voxels (equation 1) [%].
        best_manipulability: largest μ of the map (equation 2).
        build_s: CPU time [s].
        megabytes: size of the file.
        file, picture: where the map is, and the slices through it.
    """

    robot: str
    poses: int
    voxels: int
    mean_reachability_index: float
    best_manipulability: float
    build_s: float
    megabytes: float
    file: str
    picture: str

    def __str__(self) -> str:
        """One line for each attribute."""
        values = {name: f"{value:.4g}" if isinstance(value, float) else value for name, value in asdict(self).items()}
        return "\n".join(f"{name:>24}: {value}" for name, value in values.items())


def build_map(robot: RobotSpec | ArmChain, parameters: MapParameters, output: Path) -> MapReport:
    """Build a map with a progress bar, save it to one file, and draw slices through it into a picture beside it.

    Raises:
        ReachabilityError: the robot or the parameters make no sense.
    """
    start = time.process_time()
    rm = ReachabilityMap.build(robot, progress=progress_bar, **asdict(parameters))
    seconds = time.process_time() - start
    rm.save(output)
    picture = output.with_suffix(".png")
    draw_arm_map(rm).savefig(picture, dpi=90)
    index = rm.reachability_index
    return MapReport(
        robot=rm.robot,
        poses=len(rm),
        voxels=int(np.count_nonzero(index)),
        mean_reachability_index=float(index[index > 0].mean()) if len(rm) else 0.0,
        best_manipulability=float(rm.manipulability.max(initial=0.0)),
        build_s=seconds,
        megabytes=output.stat().st_size / 1e6,
        file=str(output),
        picture=str(picture),
    )
